"""The kernels of swarms that move all their particles at once."""

from __future__ import annotations

from dataclasses import dataclass

from ...gpu.passes import Entry, Kernel, Output, Pass
from ...reflectance.model import ReflectanceModel
from ..settings.schedule import Schedule
from . import kernels
from .encoding import Encoding
from .linear_weights import LinearWeights

MAX_PARTICLES = 16  # four outputs of four fitnesses; two more hold the linear weights of the best
_CHUNK = 4  # particles evaluated per read of an observation


@dataclass(frozen=True)
class SynchronousSwarmPasses:
    """The compiled passes of a generation: place or move and evaluate, then commit. ``resolve`` is a fragment pass."""

    place: Pass
    place_commit: Pass
    place_best: Pass
    mean: Pass
    move: Pass
    commit: Pass
    best: Pass
    resolve: Pass
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
    domain_defines: dict[str, int],
    entry: Entry,
) -> SynchronousSwarmPasses:
    """Compile the passes for ``particles`` in an atlas ``across`` tiles wide."""
    blocks, linears = range(encoding.blocks), range(linear.blocks)
    bests = {f"u_best_{b}": kernels.FLOAT_2D for b in blocks}
    means = {f"u_mean_{b}": kernels.FLOAT_2D for b in blocks}
    weights = {f"u_best_linear_{b}": kernels.FLOAT_2D for b in linears}
    fitnesses = [f"fitness_{i}" for i in range(-(-particles // 4))]
    estimates = kernels.estimate_samplers(model)
    state = {f"u_particle_{name}": kernels.FLOAT_2D for name in ("position", "velocity", "best", "fitness")}
    best_so_far = {"u_best_fitness": kernels.FLOAT_2D, **bests, **weights, **kernels.PACKING}
    found = {f"u_{name}": kernels.FLOAT_2D for name in [*fitnesses, *(f"linear_{b}" for b in linears)]}
    # Particles are placed by the estimates and moved by the means: all together are more than 16 textures.
    placed, moved = {**best_so_far, **estimates}, {**best_so_far, **state, **means}
    defines = {
        **domain_defines, **encoding.defines, **linear.defines, **kernels.estimate_defines(model),
        **kernels.schedule_defines(schedule), "PARTICLES": particles, "TILES_X": across,
        "CHUNK": min(_CHUNK, particles),
    }  # fmt: skip
    given = {**kernels.model_includes(model), "codec.glsl": encoding.source, "basis.glsl": linear.source}

    def make(source: str, outputs: list[Output], samplers: dict, how: Entry = entry, **more: int) -> Pass:
        name = f"swarm/synchronous/{source}.glsl"
        return Pass(Kernel(name, tuple(outputs), samplers, kernels.MOVE, {**defines, **more}, given), how)

    finds = [Output(f"o_{name}") for name in fitnesses] + [Output(f"o_linear_{b}") for b in linears]
    commits = [Output("o_position"), Output("o_velocity"), Output("o_best"), Output("o_fitness", "R32F")]
    best = [Output(f"o_best_{b}") for b in blocks] + [Output(f"o_best_linear_{b}") for b in linears]
    best.append(Output("o_best_fitness", "R32F"))
    return SynchronousSwarmPasses(
        place=make("evaluate", finds, {**placed, **kernels.OBSERVATIONS}, START=1),
        place_commit=make("commit", commits, {**placed, **state, **found}, START=1),
        place_best=make("best", best, {**placed, **found}, START=1),
        mean=make("mean", [Output(f"o_mean_{b}") for b in blocks], best_so_far),
        move=make("evaluate", finds, {**moved, **estimates, **kernels.OBSERVATIONS}),
        commit=make("commit", commits, {**moved, **found}, ESTIMATES=0),
        best=make("best", best, {**moved, **found}, ESTIMATES=0),
        resolve=make("resolve", list(kernels.estimate_outputs(model)), {**placed, **state}, how="fragment"),
        take_halo=kernels.take_halo_pass(encoding, defines),
    )
