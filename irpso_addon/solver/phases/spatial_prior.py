"""The spatial prior: neighbours of similar material improve parameters that a texel's own samples leave uncertain."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from ...gpu.bands import Bands
from ...gpu.passes import Pass
from ...gpu.textures import Texture
from ..kernels.spatial_prior import (
    DEVIATION,
    FIRST_ROUND,
    NOISE,
    SpatialPriorPasses,
    build_spatial_prior_passes,
    evaluations_of,
    stencil_radius_of,
)
from ..settings.resolve import ResolvedSpatialPrior
from ..state.phase_textures import PhaseTextures, spatial_prior_table
from ..state.textures import loss_constants
from .phase import Acceptance, PhaseContext, TexturePhase


class SpatialPriorPhase(TexturePhase):
    """A Phase: empirical Bayes over similar neighbours, then a fit to the samples and to that prior.

    Iteration 0 measures the noise of the samples, iteration 1 the deviation of each parameter. Each round pools the
    neighbours' parameters; the remaining iterations step to the most probable material. A texel keeps its estimates if
    that material fits significantly worse, or if the acceptance test rejects it.
    """

    shared = ("noise", "mean", "deviation")
    has_result = False  # nothing to show before the end, when the most probable material is compared with the samples
    passes: SpatialPriorPasses

    def __init__(self, resolved: ResolvedSpatialPrior, context: PhaseContext, acceptance: Acceptance | None = None):
        super().__init__(resolved, context, acceptance)
        self.resolved = resolved
        self.passes = build_spatial_prior_passes(
            self.model, resolved, self.schedule, self.domain.defines, context.entry
        )
        self.textures = PhaseTextures(spatial_prior_table(self.estimates.count), *self.estimates.size)
        self._first_step = FIRST_ROUND + resolved.prior.rounds

    @property
    def evaluations(self) -> int:
        """Renders of all observations in the next iteration, at a texel that has not converged."""
        return evaluations_of(self.resolved, self.model, self.iteration)

    @property
    def stencil_radius(self) -> int:
        """Distance, in texels, at which the next iteration reads neighbours."""
        return stencil_radius_of(self.resolved.prior) if NOISE < self.iteration < self._first_step else 0

    def advance(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Make one iteration in bands of rows of about ``seconds``; yields after each band."""
        yield from self.textures.make()
        textures, passes = self.textures, self.passes
        if self.iteration == NOISE:
            yield from self._in_bands("noise", passes.noise, textures.of("noise", "mean"), bands, seconds)
        elif self.iteration == DEVIATION:
            yield from self._in_bands("variance", passes.variance, textures.spares("noise"), bands, seconds)
            textures.swap("noise")
            yield from self._in_bands("deviation", passes.deviation, textures.of("own"), bands, seconds)
            yield from self._copy(bands, textures.of("own"), textures.of("deviation"))
        elif self.iteration < self._first_step:
            last = self.iteration == self._first_step - 1
            pass_, name = (passes.pool_last, "pool last") if last else (passes.pool, "pool")
            yield from self._in_bands(name, pass_, textures.spares("mean", "deviation"), bands, seconds)
            textures.swap("mean", "deviation")
        else:
            if self.iteration == self._first_step:
                targets = textures.of("work", "status", "penalty")
                yield from self._in_bands("prior begin", passes.begin, targets, bands, seconds)
            bound = {f"u_estimate_{i}": texture for i, texture in enumerate(textures.of("work"))}
            bound["u_status"] = textures.of("status")[0]
            targets = textures.spares("work", "status")
            yield from self._in_bands("prior step", passes.step, targets, bands, seconds, bound)
            textures.swap("work", "status")
        self.iteration += 1

    def write_estimates(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Write the most probable materials into the next estimates; the current ones before the last iteration."""
        if not self.done:
            yield from self._copy(bands, self.estimates.current, self.estimates.next)
            return
        yield from self._in_bands("prior keep", self.passes.keep, self.estimates.next, bands, seconds)
        if self.acceptance is not None:
            yield from self.acceptance.decide_steps(bands, seconds)

    def _copy(self, bands: Bands, sources: Sequence[Texture], targets: Sequence[Texture]) -> Iterator[None]:
        for source, target in zip(sources, targets, strict=True):
            yield from self.passes.copy.in_one_draw(bands, [target], {"u_source": source})

    def _in_bands(
        self,
        name: str,
        pass_: Pass,
        targets: Sequence[Texture],
        bands: Bands,
        seconds: float,
        bound: Mapping[str, Texture] = {},
    ) -> Iterator[None]:
        inputs = {**self._inputs(), **bound}
        constants = {**loss_constants(self.domain, self.schedule.fitness.delta), "u_settles": 1}
        passes = self.passes
        counted = pass_ in (passes.noise, passes.deviation, passes.pool, passes.pool_last, passes.step)
        return pass_.in_bands(name, bands, seconds, targets, inputs, constants, counted)
