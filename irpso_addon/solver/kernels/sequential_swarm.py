"""The passes of a sequential swarm (shaders/swarm/sequential/), compiled for one model and stage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ...gpu.kernel import Defines, Entry, Kernel, Output, Samplers
from ...gpu.passes import Pass
from ...reflectance.model import ReflectanceModel
from ..settings.schedule import Schedule
from .declarations import FLOAT_2D, MOVE, OBSERVATIONS, PACKING, SIZE, model_includes, packed, schedule_defines
from .encoding import Encoding
from .single_passes import take_halo_pass


@dataclass(frozen=True)
class SequentialSwarmPasses:
    """The compiled passes of a stage. ``decode_best`` is always a fragment pass: its output may be read back."""

    start: Pass
    move: Pass
    commit_state: Pass
    commit_personal: Pass
    commit_global: Pass
    decode_best: Pass
    take_halo: Pass

    def close(self) -> None:
        """Free the shaders."""
        for name in self.__dataclass_fields__:
            getattr(self, name).close()


def build_sequential_swarm_passes(
    model: ReflectanceModel,
    encoding: Encoding,
    schedule: Schedule,
    particles: int,
    across: int,
    domain_defines: Defines,
    entry: Entry,
) -> SequentialSwarmPasses:
    """Compile the passes of a stage for ``particles`` in an atlas ``across`` tiles wide."""
    estimates = packed(model)
    includes = {**model_includes(model), "particle_encoding.glsl": encoding.source}
    defines = {
        **domain_defines, **encoding.defines, **schedule_defines(schedule), "PARTICLES": particles, "TILES_X": across
    }  # fmt: skip
    fixed = {"u_best": encoding.packed, "u_estimate": estimates, **PACKING}
    particle = {f"u_particle_{name}": FLOAT_2D for name in ("position", "velocity", "best", "fitness")}
    candidate = {f"u_candidate_{name}": encoding.packed for name in ("position", "velocity")} | {"u_verdict": FLOAT_2D}
    moved = (*(Output(f"o_{name}", encoding.packed) for name in ("position", "velocity")), Output("o_verdict"))
    fitness = Output("o_fitness", "R32F")

    def make(
        source: str, outputs: tuple[Output, ...], samplers: Samplers, constants: Mapping[str, str],
        how: Entry = entry, **more: int,
    ) -> Pass:  # fmt: skip
        kernel = Kernel(f"swarm/sequential/{source}.glsl", outputs, samplers, constants, {**defines, **more}, includes)
        return Pass(kernel, how)

    read = {**particle, "u_best_fitness": FLOAT_2D, **fixed, **OBSERVATIONS}
    return SequentialSwarmPasses(
        start=make("move", moved, read, MOVE, START=1),
        move=make("move", moved, read, MOVE),
        commit_state=make("commit_state", (Output("o_position"), Output("o_velocity")), candidate, SIZE),
        commit_personal=make("commit_personal", (Output("o_best"), fitness), candidate, SIZE),
        commit_global=make("commit_global", (Output("o_best", encoding.packed), fitness), candidate, SIZE),
        decode_best=make("decode_best", (Output("o_estimate", estimates),), fixed, SIZE, how="fragment"),
        take_halo=take_halo_pass(encoding, defines),
    )
