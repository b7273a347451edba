"""The choice between the first prefit and the one with sheen, by what both leave unexplained around a texel."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping

import numpy as np

from ...gpu.bands import Bands
from ...gpu.kernel import Entry
from ...reflectance.model import ReflectanceModel
from ..settings.resolve import ResolvedSheen
from ..settings.schedule import Schedule
from ..state.phase_textures import sheen_table
from ..state.textures import DomainTextures, Estimates
from .neighbour_test import NeighbourTest
from .prefit import FITNESS, SHEEN, UNFIT, adopt_pass, adopt_where

CHOSEN = "prefit_sheen_chosen"  # (h, w) float32, above 0 where sheen is
# On a bunny whose base only darkens toward the terminator the prefit with sheen fits by a third better, and turns the
# normals by 2.7°. There the mean fitness around a texel is 0.11, with highlights 0.20 (95 %: 0.33), on velvet 0.57.
_LEAST_FITNESS = 0.37
# Of a texel's misfit. Where sheen lowers it so, the recovery's model, which has none, turns the normal for the worse.
# On a rendered head of velvet their mean error falls from 14.9 to 14.6°; on metal paint it rises from 3.34 to 3.36°.
_MUCH = 0.1


class SheenPhase(NeighbourTest):
    """A NeighbourTest of two prefits, which takes over the normals of the second."""

    def __init__(
        self,
        resolved: ResolvedSheen,
        model: ReflectanceModel,
        schedule: Schedule,
        domain: DomainTextures,
        estimates: Estimates,
        entry: Entry,
        measured: Mapping[str, np.ndarray],
    ):
        self._prefits, self._ratio = dict(measured), schedule.prefit.acceptance_ratio
        super().__init__(
            resolved, model, schedule, domain, estimates, entry, sheen_table(), "prefit/sheen.glsl", limits(schedule),
            fits_of(measured[FITNESS], measured[SHEEN][..., 3]),
        )  # fmt: skip
        self._adopt = adopt_pass(model, domain.defines)

    def conclude(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Write the normals that are chosen into the resolved estimates."""
        chosen, normals = self.read(self.decided)[..., 0] > 0, self._prefits[SHEEN][..., :3]
        yield from adopt_where(self._adopt, bands, self.domain, self.estimates, self.model, chosen, normals)

    def measuring(self, bands: Bands, seconds: float) -> Generator[None, None, dict[str, np.ndarray]]:
        """Return what the prefits have measured, by name, and which texels are chosen: of these the fitness with sheen.

        Where sheen explains much it is divided by the acceptance ratio: a model without has to fit as well.
        """
        yield
        chosen, known = self.read(self.decided)[..., 0] > 0, dict(self._prefits)
        fitness = known.pop(SHEEN)[..., 3]
        strict = np.where(fitness < (1 - _MUCH) * known[FITNESS], fitness / np.float32(self._ratio), fitness)
        known[FITNESS] = np.where(chosen, strict, known[FITNESS])
        return {**known, CHOSEN: chosen.astype(np.float32)}

    def close(self) -> None:
        """Free shaders and textures."""
        super().close()
        self._adopt.close()


def fits_of(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return (h, w, 4) of two fitnesses (h, w): both, and 1 where both are measures, 0 elsewhere."""
    counted = (first < UNFIT) & (second < UNFIT)
    fits = np.stack([first, second, counted, 0 * first], axis=-1)
    return np.where(counted[..., None], fits, 0).astype(np.float32)


def limits(schedule: Schedule) -> dict[str, float]:
    """Return the limits of the test."""
    return {"LEAST_FITNESS": _LEAST_FITNESS, "SHEEN_GAIN": schedule.prefit.sheen_gain}
