"""The search for texels whose light is mostly indirect: there darker samples count as shadow from here on."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence

import numpy as np

from ...gpu.bands import Bands
from ...gpu.passes import Defines, Entry, Kernel, Output, Pass
from ...reflectance.model import ReflectanceModel
from ..kernels import kernels
from ..kernels.spatial_prior import taps_of
from ..settings.groups import Prior
from ..settings.resolve import Resolved, ResolvedIndirect, ResolvedPrefit
from ..settings.schedule import Schedule
from ..state.phase_textures import PhaseTextures, indirect_table
from ..state.textures import DomainTextures, Estimates
from .phase import TexturePhase
from .prefit import EVIDENCE, FITNESS

SHADOW = "prefit_shadow"
MEASURED = FITNESS, EVIDENCE, SHADOW
REACH, TAPS = 8, taps_of(Prior(scales=3))
# On rendered captures like DiLiGenT's both are exceeded at 38 % of the texels of a goblet and at 23 % of those of a
# concave mix, whose normals are off by 55 and 27° there; at 3 % of convex metal, 2 % of velvet, and nowhere on a bunny
# that only casts shadows.
_LEAST_MISFIT, _LEAST_SURPLUS = 0.2, 0.03


class IndirectPhase(TexturePhase):
    """A Phase of one iteration: it compares what the prefit has measured of a texel and its neighbours with limits."""

    shared = ("evidence",)
    placed = False  # it moves no estimate
    passes: Pass

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
        super().__init__(resolved, model, schedule, domain, estimates, entry)
        self.textures = PhaseTextures(indirect_table(), *estimates.size)
        self.passes = _indirect_pass(schedule, domain.defines)
        self._measured = dict(measured)

    @property
    def evaluations(self) -> int:
        """Return 0: it renders nothing."""
        return 0

    @property
    def reach(self) -> int:
        """Distance, in texels, at which the next iteration reads neighbours."""
        return 0 if self.done else REACH

    def advance(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Find the texels, in bands."""
        self._make()
        held = self.textures
        inputs = {**held.bound("evidence", held.of("evidence")), **self.domain.textures}
        yield from self.passes.in_bands("indirect", bands, seconds, held.of("shadow"), inputs, {})
        self.iteration += 1

    def conclude(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Leave the estimates as they are: what is accepted twice is as it was."""
        yield
        self.estimates.accept()

    def measuring(self, bands: Bands, seconds: float) -> Generator[None, None, dict[str, np.ndarray]]:
        """Return what is known by name, the shadow (h, w) of each texel, packed, in place of the evidence.

        It is 0 where the light is not indirect.
        """
        yield
        return {**self._measured, SHADOW: self.read("shadow")[..., 0]}

    def reached(self, threshold: float) -> bool:
        """Return False: nothing is searched."""
        return False

    def read(self, *names: str) -> np.ndarray:
        """Return (h, w, channels) of the current textures of some groups, channels side by side."""
        self._make()
        return super().read(*names)

    def state(self) -> dict[str, np.ndarray]:
        """Return all that outlives an iteration, by name."""
        self._make()
        return super().state()

    def restore(self, arrays: dict[str, np.ndarray], iteration: int) -> None:
        """Continue from the ``state`` of an iteration."""
        self._make()
        super().restore(arrays, iteration)

    def _make(self) -> None:
        """Allocate the textures, and give them the evidence, at first use."""
        self.textures.ensure()
        if EVIDENCE in self._measured:
            self.textures.upload("evidence", [self._measured.pop(EVIDENCE)])


def measured_by(stages: Sequence[Resolved], measured: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return of what prefits have measured that of some first stages of the recovery."""
    ended = {type(stage) for stage in stages}
    kinds = {FITNESS: ResolvedPrefit, EVIDENCE: ResolvedPrefit, SHADOW: ResolvedIndirect}
    return {name: array for name, array in measured.items() if kinds[name] in ended}


def _indirect_pass(schedule: Schedule, defines: Defines) -> Pass:
    samplers = {"u_evidence": kernels.FLOAT_2D, **kernels.PACKING}
    numbers = {
        "RAISED_SHADOW": schedule.prefit.indirect_shadow, "LEAST_MISFIT": _LEAST_MISFIT, "LEAST_SURPLUS": _LEAST_SURPLUS
    }  # fmt: skip
    defines = {**defines, "TAPS": TAPS, **{name: f"{value:.9f}" for name, value in numbers.items()}}
    return Pass(Kernel("prefit/indirect.glsl", (Output("o_shadow", "R32F"),), samplers, {}, defines, {}))
