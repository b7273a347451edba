"""Base class of phases that decide for each texel from prefit measurements at the texel and its neighbours."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping

import numpy as np

from ...gpu.bands import Bands
from ...gpu.kernel import Defines, Kernel, Output
from ...gpu.passes import Pass
from ..kernels import declarations
from ..kernels.spatial_prior import taps_of
from ..settings.refinement_groups import SpatialPrior
from ..settings.resolve import ResolvedIndirect, ResolvedSheen
from ..state.phase_textures import PhaseTextures, TextureTable
from ..state.prefit_measurements import PrefitMeasurements
from .phase import PhaseContext, TexturePhase

STENCIL_RADIUS, TAPS = 8, taps_of(SpatialPrior(scales=3))


class NeighbourTest(TexturePhase):
    """A Phase of one iteration: it compares measurements at a texel and its neighbours with limits.

    table: two groups, the compared values and the decisions. compared: the values (h, w, 4), packed; None if
    ``restore`` follows. limits: by their names in the shader.
    """

    has_result = False  # it changes no estimate
    passes: Pass

    def __init__(
        self,
        resolved: ResolvedIndirect | ResolvedSheen,
        context: PhaseContext,
        table: TextureTable,
        source: str,
        limits: Mapping[str, float],
        compared: np.ndarray | None,
    ):
        super().__init__(resolved, context)
        self._compared_group, self.decided = table.groups
        self.shared = (self._compared_group,)
        self.textures = PhaseTextures(table, *self.estimates.size)
        self.passes = decision_pass(source, self.decided, limits, self.domain.defines)
        self._compared = compared

    @property
    def evaluations(self) -> int:
        """0: this phase renders nothing."""
        return 0

    @property
    def stencil_radius(self) -> int:
        """Distance, in texels, at which the next iteration reads neighbours."""
        return 0 if self.done else STENCIL_RADIUS

    def advance(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Make the decisions, in bands."""
        self._ensure_inputs()
        textures = self.textures
        inputs = {**textures.bound(self._compared_group, textures.of(self._compared_group)), **self.domain.textures}
        yield from self.passes.in_bands(self.title, bands, seconds, textures.of(self.decided), inputs, {})
        self.iteration += 1

    def measure_steps(self, bands: Bands, seconds: float) -> Generator[None, None, PrefitMeasurements]:
        """Yields often; returns the measurements after the decisions."""
        raise NotImplementedError

    def read(self, *names: str) -> np.ndarray:
        """Return (h, w, channels) of the current textures of some groups, channels side by side."""
        self._ensure_inputs()
        return super().read(*names)

    def state(self) -> dict[str, np.ndarray]:
        """Return name → array of all that persists between iterations."""
        self._ensure_inputs()
        return super().state()

    def restore(self, arrays: dict[str, np.ndarray], iteration: int) -> None:
        """Continue from the ``state`` of an iteration."""
        self._ensure_inputs()
        super().restore(arrays, iteration)

    def _ensure_inputs(self) -> None:
        """Allocate the textures and upload the compared values, at first use."""
        self.textures.ensure()
        if self._compared is not None:
            self.textures.upload(self._compared_group, [self._compared])
            self._compared = None


def decision_pass(source: str, decided: str, limits: Mapping[str, float], defines: Defines) -> Pass:
    """Compile the pass of a NeighbourTest."""
    samplers = {"u_measured": declarations.FLOAT_2D, **declarations.PACKING}
    defines = {**defines, "TAPS": TAPS, **{name: f"{value:.9f}" for name, value in limits.items()}}
    return Pass(Kernel(source, (Output(f"o_{decided}", "R32F"),), samplers, {}, defines, {}))
