"""The kernels of swarms that move all particles in each iteration."""

from __future__ import annotations

from dataclasses import dataclass

from ...gpu.kernel import Defines, Entry, Kernel, Output, Packed, Samplers
from ...gpu.passes import Pass
from ...reflectance.model import ReflectanceModel
from ..settings.schedule import MAX_PARTICLES, Schedule
from .declarations import FLOAT_2D, MOVE, OBSERVATIONS, PACKING, model_includes, packed, schedule_defines
from .encoding import Encoding
from .linear_weights import LinearWeights
from .single_passes import take_halo_pass

# Four outputs of four fitnesses; two more hold the linear weights of the best.
_CHUNK = 4  # particles evaluated per read of an observation


@dataclass(frozen=True)
class SynchronousSwarmPasses:
    """The compiled passes of a generation: place or move and evaluate, then commit. decode_best is a fragment pass."""

    place: Pass
    place_commit: Pass
    place_best: Pass
    mean: Pass
    move: Pass
    commit: Pass
    best: Pass
    decode_best: Pass
    take_halo: Pass

    def close(self) -> None:
        """Free the shaders."""
        for name in self.__dataclass_fields__:
            getattr(self, name).close()


def build_synchronous_swarm_passes(
    model: ReflectanceModel,
    encoding: Encoding,
    linear: LinearWeights,
    schedule: Schedule,
    particles: int,
    across: int,
    domain_defines: Defines,
    entry: Entry,
) -> SynchronousSwarmPasses:
    """Compile the passes for ``particles`` in an atlas ``across`` tiles wide."""
    estimates, fitness = packed(model), Packed(-(-particles // 4), MAX_PARTICLES)
    state = {f"u_particle_{name}": FLOAT_2D for name in ("position", "velocity", "best", "fitness")}
    best_inputs: Samplers = {
        "u_best": encoding.packed, "u_best_linear": linear.packed, "u_best_fitness": FLOAT_2D, **PACKING
    }  # fmt: skip
    fitness_inputs = {"u_fitness": fitness, "u_linear": linear.packed}
    # Placing reads the estimates, moving reads the means: both together would exceed 16 textures.
    place_inputs = {**best_inputs, "u_estimate": estimates}
    move_inputs = {**best_inputs, **state, "u_mean": encoding.packed, "u_estimate": Packed(0)}
    defines = {
        **domain_defines, **encoding.defines, **linear.defines, **schedule_defines(schedule),
        "PARTICLES": particles, "TILES_X": across,
        "CHUNK": min(_CHUNK, particles),
    }  # fmt: skip
    includes = {**model_includes(model), "particle_encoding.glsl": encoding.source, "basis.glsl": linear.source}

    def make(source: str, outputs: tuple[Output, ...], samplers: Samplers, how: Entry = entry, **more: int) -> Pass:
        name = f"swarm/synchronous/{source}.glsl"
        return Pass(Kernel(name, outputs, samplers, MOVE, {**defines, **more}, includes), how)

    fitness_outputs = Output("o_fitness", fitness), Output("o_linear", linear.packed)
    committed = Output("o_position"), Output("o_velocity"), Output("o_best"), Output("o_fitness", "R32F")
    best = (
        Output("o_best", encoding.packed), Output("o_best_linear", linear.packed), Output("o_best_fitness", "R32F")
    )  # fmt: skip
    return SynchronousSwarmPasses(
        place=make("evaluate", fitness_outputs, {**place_inputs, **OBSERVATIONS}, START=1),
        place_commit=make("commit", committed, {**place_inputs, **state, **fitness_inputs}, START=1),
        place_best=make("best", best, {**place_inputs, **fitness_inputs}, START=1),
        mean=make("mean", (Output("o_mean", encoding.packed),), best_inputs),
        move=make("evaluate", fitness_outputs, {**move_inputs, "u_estimate": estimates, **OBSERVATIONS}),
        commit=make("commit", committed, {**move_inputs, **fitness_inputs}),
        best=make("best", best, {**move_inputs, **fitness_inputs}),
        decode_best=make("decode_best", (Output("o_estimate", estimates),), {**place_inputs, **state}, how="fragment"),
        take_halo=take_halo_pass(encoding, defines),
    )
