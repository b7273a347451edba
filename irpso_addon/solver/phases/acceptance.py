"""The acceptance test: whether a phase of the recovery's model may replace the prefit's normal at a texel."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...gpu import textures
from ...gpu.bands import Bands
from ...gpu.kernel import Defines, Kernel, Output, Samplers
from ...gpu.passes import Pass
from ...reflectance.model import ReflectanceModel
from ..kernels import declarations
from ..settings.schedule import Schedule
from ..state.textures import DomainTextures, Estimates
from .prefit import acceptance_constants, grey

_ACCEPTANCE_FLOOR = 0.005  # mean of bounded losses: fits below it are equally good


class AcceptanceTest:
    """Decides at every texel whether a phase of the recovery's model may replace the prefit's normal.

    fitness: (h, w) of the prefit, packed. The accepted estimates become the next ones.
    """

    def __init__(
        self,
        model: ReflectanceModel,
        schedule: Schedule,
        domain: DomainTextures,
        estimates: Estimates,
        fitness: np.ndarray,
    ):
        self._domain, self._estimates = grey(domain, schedule), estimates
        self._fitness = [textures.upload(fitness)]
        self._schedule = schedule
        self._decided = [textures.empty(*estimates.size) for _ in range(estimates.count)]
        self._pass = acceptance_pass(model, schedule, self._domain.defines)

    def decide_steps(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Replace the next estimates by the accepted ones, in bands; takes effect after the last one."""
        work = {f"u_work_{i}": texture for i, texture in enumerate(self._estimates.next)}
        inputs = {**self._estimates.bindings(), **work, **self._domain.textures, "u_prefit_fitness": self._fitness[0]}
        constants = acceptance_constants(self._domain, self._schedule)
        yield from self._pass.in_bands("acceptance", bands, seconds, self._decided, inputs, constants)
        self._estimates.next, self._decided = self._decided, self._estimates.next

    def close(self) -> None:
        """Free shader and textures."""
        self._pass.close()
        self._fitness, self._decided = [], []


def acceptance_pass(model: ReflectanceModel, schedule: Schedule, defines: Defines) -> Pass:
    """Compile the pass of an AcceptanceTest."""
    packed = declarations.packed(model)
    samplers: Samplers = {
        "u_estimate": packed, "u_work": packed, "u_prefit_fitness": declarations.FLOAT_2D, **declarations.OBSERVATIONS
    }  # fmt: skip
    defines = {
        **defines, **declarations.fitness_defines(schedule.fitness, "geman_mcclure"),
        "ACCEPTANCE_RATIO": f"{schedule.prefit.acceptance_ratio:.9f}", "ACCEPTANCE_FLOOR": f"{_ACCEPTANCE_FLOOR:.9f}",
    }  # fmt: skip
    outputs, includes = (Output("o_estimate", packed),), declarations.model_includes(model)
    return Pass(Kernel("prefit/acceptance.glsl", outputs, samplers, declarations.LOSS_CONSTANTS, defines, includes))
