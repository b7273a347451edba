"""One texel of a running recovery: estimate, error and swarm, read back as a few hundred numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...core.errors import InputError
from ...gpu import textures
from ...gpu.kernel import Kernel, Output, Packed
from ...gpu.passes import Pass
from ...gpu.textures import Texture
from ...reflectance.model import Parameter, ReflectanceModel
from ..engine.engine import RecoveryEngine
from ..kernels import declarations
from ..phases.prefit import PrefitPhase
from ..phases.swarm import SwarmPhase
from ..state.packing import level_size
from ..state.textures import UNFIT, kernel_defines

_AT = {"u_column": "INT", "u_row": "INT"}
# As shaders/view/probe_swarm.glsl lays them out.
_POSITIONS, _BESTS, _FITNESS, _GLOBAL, _ROWS = slice(0, 3), slice(3, 6), 6, 7, 8
_PARTS = "xyzw"
_COLORS = "rgba"


@dataclass(frozen=True)
class Particles:
    """The swarm of a texel, in the parameters' own units.

    names: of the n searched components, such as "roughness", "base_color.r" or "normal.x"; normals are unit vectors in
    every encoding. positions, bests: (m, n) of the m particles. fitness: (m,) of the bests, infinite where unknown.
    global_best: (n,).
    """

    names: tuple[str, ...]
    positions: np.ndarray
    bests: np.ndarray
    fitness: np.ndarray
    global_best: np.ndarray


@dataclass(frozen=True)
class TexelState:
    """The current state of a texel.

    error: mean absolute difference between render and reference over channels and weighted observations. values:
    parameter name → (components,). particles: None without a searching swarm, or while it is being initialised.
    """

    error: float
    values: dict[str, np.ndarray]
    particles: Particles | None


class TexelProbe:
    """Reads texels of one recovery repeatedly. Close it before the recovery."""

    def __init__(self, recovery: RecoveryEngine):
        if recovery.capabilities.view != "whole":
            raise InputError("the recovery runs in tiles, whose texels cannot be probed; lower the resolution")
        self._recovery = recovery
        domain = recovery.domain
        self._defines = kernel_defines(domain)
        self._texel: Pass | None = None
        self._row: Texture | None = None
        self._swarm: _SwarmProbe | None = None

    def read(self, row: int, column: int) -> TexelState | None:
        """Return the state of a texel of the domain, row 0 at the bottom, or None where it is not solved.

        During a coarser level the state is of that level's texel.
        """
        with self._recovery.view() as lent:
            at = self._constants(lent, row, column)
            numbers = self._read_texel(lent, at)
            if numbers is None:
                return None
            particles = self._read_swarm(lent, at)
        model = self._recovery.model
        values = {
            p.name: numbers[model.offset(p.name) : model.offset(p.name) + p.components].copy() for p in model.parameters
        }
        return TexelState(float(numbers[-4]), values, particles)

    def close(self) -> None:
        """Free shaders and textures."""
        if self._texel is not None:
            self._texel.close()
        if self._swarm is not None:
            self._swarm.close()
        self._texel = self._swarm = self._row = None

    def _constants(self, lent: Mapping[str, Texture], row: int, column: int) -> dict[str, int]:
        height, width = self._recovery.domain.shape
        if not (0 <= row < height and 0 <= column < width):
            raise InputError(f"texel ({row}, {column}): the domain has {height} rows and {width} columns, from 0")
        level = level_size(lent, self._defines)
        return {"u_column": column * level[0] // width, "u_row": row * level[1] // height}

    def _read_texel(self, lent: Mapping[str, Texture], at: dict[str, int]) -> np.ndarray | None:
        """Return the components of the estimate, padded to RGBA texels, then the error and three more numbers."""
        if self._texel is None or self._row is None:
            model = self._recovery.model
            packed = declarations.packed(model)
            samplers: dict[str, str | Packed]
            samplers = {"u_estimate": packed, **declarations.OBSERVATIONS, **declarations.PACKING}
            defines = {**self._defines, "ESTIMATES": packed.textures}
            constants = {**_AT, "u_observations": "INT"}
            glsl = declarations.model_includes(model)
            self._texel = Pass(
                Kernel("view/probe_texel.glsl", (Output("o_numbers"),), samplers, constants, defines, glsl)
            )
            self._row = textures.empty(packed.textures + 1, 1)
        self._texel.run([self._row], lent, {**at, "u_observations": self._recovery.domain.observations})
        numbers = textures.download(self._row).ravel()
        return numbers if numbers[-1] > 0 else None

    def _read_swarm(self, lent: Mapping[str, Texture], at: dict[str, int]) -> Particles | None:
        running = running_swarm(self._recovery)
        if self._swarm is not None and (running is None or self._swarm.phase is not running[0]):
            self._swarm.close()
            self._swarm = None
        if running is None or running[0].iteration < 0:
            return None
        if self._swarm is None:
            self._swarm = _SwarmProbe(*running, self._defines)
        return self._swarm.read(lent, at)


def running_swarm(recovery: RecoveryEngine) -> tuple[SwarmPhase, ReflectanceModel] | None:
    """Return the phase with searching swarms and their model, or None."""
    phase, model = recovery.phase, recovery.model
    if isinstance(phase, PrefitPhase):
        model, phase = phase.own.model, phase.inner
    # Between two phases the textures of the first are already freed.
    if not isinstance(phase, SwarmPhase) or phase.encoding.dimensions == 0 or not phase.textures.current:
        return None
    return phase, model


class _SwarmProbe:
    """The pass that gathers the swarm of a texel of one phase."""

    def __init__(self, phase: SwarmPhase, model: ReflectanceModel, domain_defines: Mapping[str, str | int]):
        self.phase, self._model = phase, model
        self._held = phase.textures
        encoding = phase.encoding
        defines = {
            **domain_defines,
            **encoding.defines,
            **declarations.schedule_defines(phase.schedule),
            "PARTICLES": phase.particles,
            "TILES_X": self._held.atlas.across,
        }
        samplers: dict[str, str | Packed] = {
            **{f"u_particle_{name}": declarations.FLOAT_2D for name in ("position", "best", "fitness")},
            "u_best": encoding.packed, "u_estimate": declarations.packed(model), **declarations.PACKING,
        }  # fmt: skip
        glsl = {**declarations.model_includes(model), "particle_encoding.glsl": encoding.source}
        constants = {**_AT, "u_width": "INT", "u_height": "INT"}
        self._pass = Pass(Kernel("view/probe_swarm.glsl", (Output("o_numbers"),), samplers, constants, defines, glsl))
        self._target = textures.empty(max(phase.particles, 3), _ROWS)

    def read(self, lent: Mapping[str, Texture], at: dict[str, int]) -> Particles:
        """Return the swarm of a solved texel."""
        phase = self.phase
        inputs = {**lent, **self._held.bindings(), **phase.estimates.bindings()}
        self._pass.run([self._target], inputs, {**at, "u_width": phase.width, "u_height": phase.height})
        numbers = textures.download(self._target)
        chosen, names = _searched(phase, self._model)
        count = phase.particles

        def of(rows: slice) -> np.ndarray:
            return numbers[rows, :count].transpose(1, 0, 2).reshape(count, -1)[:, chosen]

        fitness = numbers[_FITNESS, :count, 0]
        fitness = np.where(fitness < UNFIT, fitness, np.inf)
        return Particles(names, of(_POSITIONS), of(_BESTS), fitness, numbers[_GLOBAL, :3].ravel()[chosen])

    def close(self) -> None:
        """Free shader and texture."""
        self._pass.close()
        del self._target, self._held


def component_names(parameter: Parameter) -> list[str]:
    """Return the names of a parameter's components: "roughness", or "base_color.r"."""
    parts = _COLORS if parameter.color_space == "sRGB" else _PARTS
    several = parameter.components > 1
    return [f"{parameter.name}.{parts[i]}" if several else parameter.name for i in range(parameter.components)]


def _searched(phase: SwarmPhase, model: ReflectanceModel) -> tuple[list[int], tuple[str, ...]]:
    """Return the indices and names of the components that a phase searches."""
    chosen: list[int] = []
    names: list[str] = []
    for p in phase.stage.parameters:
        chosen += range(model.offset(p.name), model.offset(p.name) + p.components)
        names += component_names(p)
    return chosen, tuple(names)
