"""The search for texels whose light is mostly indirect: there darker samples count as shadow from here on."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping

import numpy as np

from ...gpu.bands import Bands
from ...gpu.kernel import Entry
from ...reflectance.model import ReflectanceModel
from ..settings.resolve import ResolvedIndirect
from ..settings.schedule import Schedule
from ..state.phase_textures import indirect_table
from ..state.textures import DomainTextures, Estimates
from .neighbour_test import NeighbourTest
from .prefit import EVIDENCE

SHADOW = "prefit_shadow"
# On rendered captures like DiLiGenT's both are exceeded at 38 % of the texels of a goblet and at 23 % of those of a
# concave mix, whose normals are off by 55 and 27° there; at 3 % of convex metal, 2 % of velvet, and nowhere on a bunny
# that only casts shadows.
_LEAST_MISFIT, _LEAST_SURPLUS = 0.2, 0.03


class IndirectPhase(NeighbourTest):
    """A NeighbourTest of the evidence of indirect light, which raises the shadow."""

    def __init__(
        self,
        resolved: ResolvedIndirect,
        model: ReflectanceModel,
        schedule: Schedule,
        domain: DomainTextures,
        estimates: Estimates,
        entry: Entry,
        measured: Mapping[str, np.ndarray],
    ):
        self._known = {name: array for name, array in measured.items() if name != EVIDENCE}
        super().__init__(
            resolved, model, schedule, domain, estimates, entry, indirect_table(), "prefit/indirect.glsl",
            limits(schedule), measured.get(EVIDENCE),
        )  # fmt: skip

    def conclude(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Leave the estimates as they are: what is accepted twice is as it was."""
        yield
        self.estimates.accept()

    def measuring(self, bands: Bands, seconds: float) -> Generator[None, None, dict[str, np.ndarray]]:
        """Return what is known by name, the shadow (h, w) of each texel, packed, in place of the evidence.

        It is 0 where the light is not indirect.
        """
        yield
        return {**self._known, SHADOW: self.read(self.decided)[..., 0]}


def limits(schedule: Schedule) -> dict[str, float]:
    """Return the limits of the test."""
    return {
        "RAISED_SHADOW": schedule.prefit.indirect_shadow, "LEAST_MISFIT": _LEAST_MISFIT, "LEAST_SURPLUS": _LEAST_SURPLUS
    }  # fmt: skip
