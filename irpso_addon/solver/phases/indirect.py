"""Detection of texels with mostly indirect light. In later phases their darker samples count as shadow."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import replace

from ...gpu.bands import Bands
from ..settings.resolve import ResolvedIndirect
from ..settings.schedule import Schedule
from ..state.phase_textures import indirect_table
from ..state.prefit_measurements import PrefitMeasurements
from .neighbour_test import NeighbourTest
from .phase import PhaseContext

# Share of texels above both limits on rendered captures like DiLiGenT's: goblet 38 % and concave mix 23 %, with normal
# errors of 55 and 27° there; convex metal 3 %, velvet 2 %, a bunny that only casts shadows 0.
_MIN_MISFIT, _MIN_SURPLUS = 0.2, 0.03


class IndirectPhase(NeighbourTest):
    """A NeighbourTest of the indirect misfit. It raises the shadow threshold of texels above the limits."""

    def __init__(self, resolved: ResolvedIndirect, context: PhaseContext, measurements: PrefitMeasurements):
        self._measurements = replace(measurements, indirect_misfit=None)
        super().__init__(
            resolved, context, indirect_table(), "prefit/indirect.glsl",
            limits(context.schedule), measurements.indirect_misfit,
        )  # fmt: skip

    @property
    def keeps_estimates(self) -> bool:
        """True: this phase only measures."""
        return True

    def write_estimates(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Write nothing."""
        yield from ()

    def measure_steps(self, bands: Bands, seconds: float) -> Generator[None, None, PrefitMeasurements]:
        """Yields once; returns the measurements, with shadow thresholds in place of the indirect misfit."""
        yield
        return replace(self._measurements, shadow=self.read(self.decided)[..., 0])


def limits(schedule: Schedule) -> dict[str, float]:
    """Return the limits of the test."""
    return {
        "RAISED_SHADOW": schedule.prefit.indirect_shadow, "MIN_MISFIT": _MIN_MISFIT, "MIN_SURPLUS": _MIN_SURPLUS
    }  # fmt: skip
