"""Normals of one surface: integrable and smooth, within the uncertainty that their samples leave."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ...gpu.bands import Bands
from ...gpu.passes import Pass
from ...gpu.textures import Texture
from ..kernels.surface import (
    FIRST_ROUND,
    INFORMATION,
    NOISE,
    NOISE_STENCIL_RADIUS,
    STENCIL_RADIUS,
    SWEEPS,
    SurfacePasses,
    build_surface_passes,
    evaluations_of,
)
from ..settings.resolve import ResolvedSurface
from ..state.phase_textures import PhaseTextures, surface_table
from ..state.textures import loss_constants
from .phase import Acceptance, PhaseContext, TexturePhase


class SurfacePhase(TexturePhase):
    """A Phase: iteration 0 measures the noise of the samples, iteration 1 the covariance of the slopes.

    Each round relaxes the slopes (shaders/surface/relax.glsl). In the end they are smoothed (smooth.glsl), the normals
    are bent, and the linear parameters adapt (bend.glsl). A texel keeps its old estimates if its samples or the
    acceptance test reject the new.
    """

    shared = ("noise", "field", "covariance")
    has_result = False  # nothing to show before the end
    passes: SurfacePasses

    def __init__(self, resolved: ResolvedSurface, context: PhaseContext, acceptance: Acceptance | None = None):
        super().__init__(resolved, context, acceptance)
        self.resolved = resolved
        self.passes = build_surface_passes(self.model, resolved, self.schedule, self.domain.defines, context.entry)
        self.textures = PhaseTextures(surface_table(), *self.estimates.size)

    @property
    def evaluations(self) -> int:
        """Renders of all observations in the next iteration, at a texel that has not converged."""
        return evaluations_of(self.resolved, self.model, self.schedule, self.iteration)

    @property
    def stencil_radius(self) -> int:
        """Distance, in texels, at which the next iteration reads neighbours."""
        return (
            0
            if self.done or self.iteration == NOISE
            else NOISE_STENCIL_RADIUS
            if self.iteration == INFORMATION
            else STENCIL_RADIUS
        )

    def advance(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Make one iteration in bands of rows of about ``seconds``; yields after each band."""
        yield from self.textures.make()
        textures, passes = self.textures, self.passes
        if self.iteration == NOISE:
            # The pass also copies the estimates, into textures that are free now.
            targets = [*textures.of("noise"), *self.estimates.next]
            yield from self._in_bands("noise", passes.noise, targets, bands, seconds)
        elif self.iteration == INFORMATION:
            yield from self._in_bands("variance", passes.variance, textures.spares("noise"), bands, seconds)
            textures.swap("noise")
            targets = textures.of("field", "covariance")
            yield from self._in_bands("information", passes.information, targets, bands, seconds)
        else:
            first = SWEEPS * (self.iteration - FIRST_ROUND)
            for sweep in range(first, first + SWEEPS):
                momentum = sweep / (sweep + 3)
                yield from self._in_bands("relax", passes.relax, textures.spares("field"), bands, seconds, momentum)
                textures.swap("field")
        self.iteration += 1

    def write_estimates(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Write the materials with bent normals into the next estimates."""
        textures, passes = self.textures, self.passes
        slopes = textures.spares("field")
        yield from self._in_bands("settle", passes.settle, slopes, bands, seconds)
        if self.resolved.surface.smoothness > 0:
            smoothed = textures.spares("noise")
            yield from self._in_bands("smooth", passes.smooth, smoothed, bands, seconds, field=slopes)
            slopes = smoothed
        yield from self._in_bands("bend", passes.bend, self.estimates.next, bands, seconds, field=slopes)
        if self.acceptance is not None:
            yield from self.acceptance.decide_steps(bands, seconds)

    def _in_bands(
        self,
        name: str,
        pass_: Pass,
        targets: Sequence[Texture],
        bands: Bands,
        seconds: float,
        momentum: float = 0.0,
        field: Sequence[Texture] = (),
    ) -> Iterator[None]:
        inputs = self._inputs() | (self.textures.bound("field", field) if field else {})
        constants = {**loss_constants(self.domain, self.schedule.fitness.delta), "u_momentum": momentum}
        return pass_.in_bands(name, bands, seconds, targets, inputs, constants, counted=True)
