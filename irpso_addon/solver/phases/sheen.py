"""Selection between the first prefit and the one with sheen, by the fitness of both around a texel."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import replace

import numpy as np

from ...core.optional import present
from ...gpu.bands import Bands
from ..settings.resolve import ResolvedSheen
from ..settings.schedule import Schedule
from ..state.phase_textures import sheen_table
from ..state.prefit_measurements import PrefitMeasurements
from ..state.textures import UNFIT
from .neighbour_test import NeighbourTest
from .phase import PhaseContext
from .prefit import adopt_pass, adopt_where

# A bunny without sheen, whose base only darkens toward the terminator: the prefit with sheen fits better by a third and
# turns the normals by 2.7°. Its mean fitness around a texel is 0.11, with highlights 0.20 (95 %: 0.33), on velvet 0.57.
_MIN_FITNESS = 0.37
# Part of a texel's misfit. Where sheen removes more, the recovery's model, which has none, worsens the normal. Effect
# of this rule on mean errors: on a rendered head of velvet 14.6 instead of 14.9°, on metal paint 3.36 instead of 3.34°.
_STRONG_GAIN = 0.1


class SheenPhase(NeighbourTest):
    """A NeighbourTest of two prefits; it adopts the normals of the second where they are chosen."""

    def __init__(self, resolved: ResolvedSheen, context: PhaseContext, measurements: PrefitMeasurements):
        self._context = context
        self._measurements, self._ratio = measurements, context.schedule.prefit.acceptance_ratio
        super().__init__(
            resolved, context, sheen_table(), "prefit/sheen.glsl", limits(context.schedule),
            fits_of(present(measurements.fitness), measurements.sheen_fitness),
        )  # fmt: skip
        self._adopt = adopt_pass(self.model, self.domain.defines)

    def write_estimates(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Write the chosen normals into the next estimates."""
        chosen, normals = self.read(self.decided)[..., 0] > 0, self._measurements.sheen_normal
        yield from adopt_where(self._adopt, bands, self._context, chosen, normals)

    def measure_steps(self, bands: Bands, seconds: float) -> Generator[None, None, PrefitMeasurements]:
        """Yields once; returns the measurements with the chosen texels, whose fitness is the one with sheen.

        Where sheen lowers the misfit much, it is divided by the acceptance ratio: a model without must fit as well.
        """
        yield
        chosen = self.read(self.decided)[..., 0] > 0
        first, fitness = present(self._measurements.fitness), self._measurements.sheen_fitness
        with np.errstate(divide="ignore"):  # a ratio of 0 accepts no other normal
            strict = np.where(fitness < (1 - _STRONG_GAIN) * first, fitness / np.float32(self._ratio), fitness)
        fitness, sheen_chosen = np.where(chosen, strict, first), chosen.astype(np.float32)
        return replace(self._measurements, fitness=fitness, sheen=None, sheen_chosen=sheen_chosen)

    def close(self) -> None:
        """Free shaders and textures."""
        super().close()
        self._adopt.close()


def fits_of(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return (h, w, 4): two fitnesses (h, w), 1, 0; all are 0 where one of the two was not measured."""
    counted = (first < UNFIT) & (second < UNFIT)
    fits = np.stack([first, second, counted, 0 * first], axis=-1)
    return np.where(counted[..., None], fits, 0).astype(np.float32)


def limits(schedule: Schedule) -> dict[str, float]:
    """Return the limits of the test."""
    return {"MIN_FITNESS": _MIN_FITNESS, "SHEEN_GAIN": schedule.prefit.sheen_gain}
