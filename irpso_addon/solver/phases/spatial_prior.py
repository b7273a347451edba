"""The spatial prior under way: what neighbours say of the numbers that a texel's own samples do not tell."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ...gpu import textures
from ...gpu.bands import Bands
from ...gpu.passes import Entry, Pass
from ...reflectance.model import ReflectanceModel
from ..kernels.spatial_prior import DEVIATION, FIRST_ROUND, NOISE, build_prior_passes, evaluations_of, reach_of
from ..settings.resolve import ResolvedPrior
from ..settings.schedule import Schedule
from ..state.reader import Reader
from ..state.textures import HALO, DomainTextures, Estimates, IncrementalAllocation, loss_constants, packed_states
from .phase import Phase
from .refinement import AcceptanceTest


class PriorTextures(IncrementalAllocation):
    """What a prior remembers of every texel.

    noise: of the samples (shaders/prior/variance.glsl). belief: means, then deviations, of the numbers: what
    neighbours look at, and after the last round the prior itself. own: how well the texel's own samples tell them.
    work: the estimates that are fitted to both, and their status. penalty: of the estimates as they were.
    """

    def __init__(self, width: int, height: int, count: int):
        super().__init__()
        self._size, self.count = (width, height), count

    def _make(self) -> Iterator[None]:
        def several(number: int) -> list[Any]:
            return [textures.empty(*self._size, value=0.0) for _ in range(number)]

        count = self.count
        self.noise, self.spare_noise = several(2)
        yield
        self.belief = several(2 * count)
        yield
        self.spare_belief = several(2 * count)
        yield
        self.own = several(count)
        yield
        self.work = several(count + 1)
        yield
        self.spare_work = several(count + 1)
        self.penalty = textures.empty(*self._size, "R32F", value=0.0)
        yield

    @property
    def remembered(self) -> dict[str, Any]:
        """The textures that outlive an iteration, by name: what a checkpoint holds."""
        groups = {"belief": self.belief, "own": self.own, "work": self.work}
        several = {f"{name}_{i}": texture for name, group in groups.items() for i, texture in enumerate(group)}
        return {"noise": self.noise, "penalty": self.penalty, **several}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Take the contents that ``remembered`` had, from arrays of the same names."""
        self.ensure()
        self.noise, self.penalty = textures.upload(arrays["noise"]), textures.upload(arrays["penalty"])
        self.belief = [textures.upload(arrays[f"belief_{i}"]) for i in range(2 * self.count)]
        self.own = [textures.upload(arrays[f"own_{i}"]) for i in range(self.count)]
        self.work = [textures.upload(arrays[f"work_{i}"]) for i in range(self.count + 1)]

    def bindings(self) -> dict[str, Any]:
        """Return by sampler name what is remembered."""
        means, deviations = self.belief[: self.count], self.belief[self.count :]
        groups = {"mean": means, "deviation": deviations, "own": self.own, "work": self.work[:-1]}
        several = {f"u_{name}_{i}": texture for name, group in groups.items() for i, texture in enumerate(group)}
        return {"u_noise": self.noise, "u_penalty": self.penalty, "u_work_status": self.work[-1], **several}


class SpatialPriorPhase(Phase):
    """The prior of a recovery, a Phase: empirical Bayes over neighbours that are alike, then a fit to both.

    Iteration 0 asks what the fit leaves of the samples, iteration 1 how well they tell each number, the rounds what
    neighbours say of them; the steps that follow look for the most probable material. A texel keeps what it had where
    that fits significantly worse, and where the acceptance test says so.
    """

    def __init__(
        self,
        resolved: ResolvedPrior,
        model: ReflectanceModel,
        schedule: Schedule,
        domain: DomainTextures,
        estimates: Estimates,
        entry: Entry,
        acceptance: AcceptanceTest | None = None,
    ):
        self._acceptance = acceptance
        self.title, self.iterations = resolved.title, resolved.iterations
        self.iteration = 0
        self._resolved, self._model, self._schedule = resolved, model, schedule
        self._domain, self._estimates = domain, estimates
        self.passes = build_prior_passes(model, resolved, schedule, domain.defines, entry)
        self.textures = PriorTextures(*estimates.size, estimates.count)
        self._reader = Reader(entry)
        self._first_step = FIRST_ROUND + resolved.prior.rounds

    @property
    def done(self) -> bool:
        """Whether all iterations have been made."""
        return self.iteration >= self.iterations

    @property
    def evaluations(self) -> int:
        """Renders of all observations that the next iteration makes at a texel, unless that is left alone."""
        return evaluations_of(self._resolved, self._model, self.iteration)

    @property
    def reach(self) -> int:
        """How many texels away the next iteration looks at neighbours."""
        return reach_of(self._resolved.prior) if NOISE < self.iteration < self._first_step else 0

    placed = False  # what is most probable shows at the end, where it is held against the samples

    def advance(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Make one iteration in bands of rows of about ``seconds``; yields after each. Counts up when it is whole."""
        yield from self.textures.make()
        held, passes, count = self.textures, self.passes, self._estimates.count
        if self.iteration == NOISE:
            yield from self._banded("noise", passes.noise, [held.noise, *held.belief[:count]], bands, seconds)
        elif self.iteration == DEVIATION:
            yield from self._banded("variance", passes.variance, [held.spare_noise], bands, seconds)
            held.noise, held.spare_noise = held.spare_noise, held.noise
            yield from self._banded("deviation", passes.deviation, held.own, bands, seconds)
            yield from self._copies(bands, held.own, held.belief[count:])
        elif self.iteration < self._first_step:
            last = self.iteration == self._first_step - 1
            work = passes.pool_last if last else passes.pool
            yield from self._banded("pool last" if last else "pool", work, held.spare_belief, bands, seconds)
            held.belief, held.spare_belief = held.spare_belief, held.belief
        else:
            yield from self._step(bands, seconds)
        self.iteration += 1

    def conclude(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Put what is most probable into the resolved estimates once it is found; until then what was there."""
        if not self.done:
            yield from self._copies(bands, self._estimates.current, self._estimates.resolved)
            return
        yield from self._banded("prior keep", self.passes.keep, self._estimates.resolved, bands, seconds)
        if self._acceptance is not None:
            yield from self._acceptance.deciding(bands, seconds)

    def reached(self, threshold: float) -> bool:
        """Return False: a prior is not there to make the fitness better."""
        return False

    def halo(self) -> np.ndarray:
        """Return (H, W, n) float32 over the domain: the noise of every texel and what is believed of it."""
        self.textures.ensure()
        packed = [self._reader.read(texture) for texture in (self.textures.noise, *self.textures.belief)]
        return self._domain.packing.unpack(np.concatenate(packed, axis=-1), np.nan)

    def take_halo(self, values: np.ndarray, ghosts: np.ndarray | float = 0.0) -> None:
        """Take (H, W, n), and (M, n), for the texels that belong to other tiles; others are left alone."""
        self.textures.ensure()
        packing, held = self._domain.packing, self.textures
        theirs = packed_states(self._domain.domain, packing)[..., None] == HALO
        given = packing.pack(values, ghosts)
        merged = [
            textures.upload(np.where(theirs, given[..., 4 * i : 4 * i + 4], self._reader.read(texture)))
            for i, texture in enumerate((held.noise, *held.belief))
        ]
        held.noise, held.belief = merged[0], merged[1:]

    def state(self) -> dict[str, np.ndarray]:
        """Return all that outlives an iteration."""
        self.textures.ensure()
        return {name: self._reader.read(texture) for name, texture in self.textures.remembered.items()}

    def restore(self, arrays: dict[str, np.ndarray], iteration: int) -> None:
        """Go on from what ``state`` returned at an iteration."""
        self.textures.restore(arrays)
        self.iteration = iteration

    def close(self) -> None:
        """Free shaders and textures."""
        if self._acceptance is not None:
            self._acceptance.close()
        self.passes.close()
        self._reader.close()
        if self.textures is not None:
            self.textures.stop()
        self.textures = None

    def _step(self, bands: Bands, seconds: float) -> Iterator[None]:
        held = self.textures
        if self.iteration == self._first_step:
            yield from self._banded("prior begin", self.passes.begin, [*held.work, held.penalty], bands, seconds)
        estimates = {f"u_estimate_{i}": texture for i, texture in enumerate(held.work[:-1])}
        given = {**estimates, "u_status": held.work[-1]}
        yield from self._banded("prior step", self.passes.step, held.spare_work, bands, seconds, given)
        held.work, held.spare_work = held.spare_work, held.work

    def _copies(self, bands: Bands, sources: list[Any], targets: list[Any]) -> Iterator[None]:
        for source, target in zip(sources, targets, strict=True):
            yield from self.passes.copy.at_once(bands, [target], {"u_source": source})

    def _inputs(self) -> dict[str, Any]:
        return {**self._estimates.bindings(), **self.textures.bindings(), **self._domain.textures}

    def _constants(self) -> dict[str, int | float]:
        return {**loss_constants(self._domain, self._schedule.fitness.delta), "u_settles": 1}

    def _banded(
        self,
        name: str,
        work: Pass,
        targets: list[Any],
        bands: Bands,
        seconds: float,
        given: dict[str, Any] | None = None,
    ) -> Iterator[None]:
        inputs, constants, passes = {**self._inputs(), **(given or {})}, self._constants(), self.passes
        counted = work in (passes.noise, passes.deviation, passes.pool, passes.pool_last, passes.step)
        return work.in_bands(name, bands, seconds, targets, inputs, constants, counted)
