"""Refinement: Levenberg–Marquardt at every texel, from several starts and from the neighbours' estimates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ...gpu import textures
from ...gpu.bands import Bands
from ...gpu.passes import Entry, Pass
from ...reflectance.model import ReflectanceModel
from ..kernels.refinement import NO_PENALTY, SPREAD_REACH, build_refinement_passes
from ..settings.groups import Refinement
from ..settings.resolve import ResolvedRefinement
from ..settings.schedule import Schedule
from ..state.reader import Reader
from ..state.textures import (
    HALO,
    SOLVED,
    DomainTextures,
    Estimates,
    IncrementalAllocation,
    loss_constants,
    packed_states,
    texel_states,
)
from .phase import Phase

SPREAD = -2  # in place of a start: what the neighbours offer
BEST = -1  # in place of a start: the best so far, its damping and all


@dataclass(frozen=True)
class Track:
    """Steps made from one start: the index of the model's, or BEST or SPREAD."""

    start: int
    iterations: int


def tracks_of(refinement: Refinement, starts: int) -> tuple[Track, ...]:
    """Return what is refined one after the other; after each, every texel keeps the best that it has had."""
    several = [Track(start, refinement.start_iterations) for start in range(BEST, starts)] if starts else []
    spreads = [Track(SPREAD, refinement.round_iterations)] * refinement.rounds
    return (*several, Track(BEST, refinement.iterations), *spreads)


class AcceptanceTest(Protocol):
    """Has the last word on what is resolved."""

    def deciding(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Put into the resolved estimates what is to be believed of them, in bands; the last one makes it so."""

    def close(self) -> None:
        """Free shaders and textures."""


class RefinementTextures(IncrementalAllocation):
    """Three sets of a material and its status, of which two are in use, and a status to begin or to end with."""

    def __init__(self, width: int, height: int, count: int):
        super().__init__()
        self._size, self._count = (width, height), count + 1
        self.sets: list[list[Any]] = []

    def _make(self) -> Iterator[None]:
        for _ in range(3):
            self.sets.append([textures.empty(*self._size) for _ in range(self._count)])
            yield
        self.kept = textures.empty(*self._size, value=0.0)
        yield


class RefinementPhase(Phase):
    """The refinement of a recovery, a Phase.

    Every texel has a best material so far, and one that is worked on; both with its fitness, its damping, and for how
    long it has been done (shaders/refine/status.glsl).
    """

    def __init__(
        self,
        resolved: ResolvedRefinement,
        model: ReflectanceModel,
        schedule: Schedule,
        domain: DomainTextures,
        estimates: Estimates,
        entry: Entry,
        acceptance: AcceptanceTest | None = None,
        penalty: Path = NO_PENALTY,
    ):
        self._acceptance = acceptance
        self.title, self.iterations = resolved.title, resolved.iterations
        self.iteration = 0
        self._resolved, self._model = resolved, model
        self._schedule, self._domain, self._estimates = schedule, domain, estimates
        self._components = model.components
        self.passes = build_refinement_passes(model, resolved, schedule.fitness, domain.defines, entry, penalty)
        self._refinement = resolved.refinement
        self._tracks = tracks_of(resolved.refinement, len(resolved.starts))
        self._reader = Reader(entry)
        self.textures = RefinementTextures(*estimates.size, estimates.count)
        self.best: list[Any] = []
        self.work: list[Any] = []

    @property
    def done(self) -> bool:
        """Whether all iterations have been made."""
        return self.iteration >= self.iterations

    @property
    def evaluations(self) -> int:
        """Renders of all observations that the next iteration makes at a texel, unless that is done already."""
        track, made = self._track()
        return self.passes.evaluations + (self.passes.offers if track.start == SPREAD and made == 0 else 0)

    @property
    def reach(self) -> int:
        """SPREAD_REACH where the next iteration begins with what the neighbours have found."""
        track, made = self._track()
        return SPREAD_REACH if track.start == SPREAD and made == 0 and not self.done else 0

    @property
    def placed(self) -> bool:
        """Whether a step has been made."""
        return self.iteration > 0

    def advance(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Make one iteration in bands of rows of about ``seconds``; yields after each. Counts up when it is whole."""
        yield from self._open(bands)
        track, made = self._track()
        if made == 0:
            yield from self._begin(track, bands, seconds)
        target = self._spare()
        widening = self._widening(track, made)
        yield from self._banded(
            "refinement", self.passes.step, target, self._bindings(self.work), bands, seconds, widening
        )
        self.work = target
        if made == track.iterations - 1:
            target = self._spare()
            if track.start == SPREAD and self.passes.vote is not None:
                yield from self._banded("vote", self.passes.vote, target, self._kept_from(), bands, seconds)
            else:
                yield from self._once(bands, self.passes.keep, target, self._kept_from())
            self.best = self.work = target
        self.iteration += 1

    def conclude(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Put the better of the best so far and what is worked on into the resolved estimates, if it is believed."""
        yield from self._open(bands)
        targets = [*self._estimates.resolved, self.textures.kept]
        yield from self._once(bands, self.passes.keep, targets, self._kept_from())
        if self._acceptance is not None:
            yield from self._acceptance.deciding(bands, seconds)

    def preview(self, targets: list[Any]) -> None:
        """Put the better of the best so far and what is worked on into other textures, before it is judged."""
        inputs = {**self._kept_from(), **self._domain.textures}
        self.passes.keep.run([*targets, self.textures.kept], inputs, self._constants())

    def _keep(self) -> None:
        self._ensure()
        self.preview(self._estimates.resolved)

    def reached(self, threshold: float) -> bool:
        """Return whether the fitness of every texel that is solved here is at or under ``threshold``."""
        self._keep()
        moved = texel_states(self._domain.domain) == SOLVED
        fitness = self._domain.packing.unpack(textures.download(self.textures.kept)[..., 0])
        return bool((fitness[moved] <= threshold).all())

    def spent(self) -> int:
        """Return how many renders of all observations were made, over all texels: one that is done costs nothing."""
        self._keep()
        return int(textures.download(self.textures.kept)[..., 3].sum(dtype=np.float64))

    def halo(self) -> np.ndarray:
        """Return (H, W, n) float32 over the domain: every texel's best material; NaN where none is solved."""
        self._keep()
        packed = np.concatenate([textures.download(t) for t in self._estimates.resolved], axis=-1)
        return self._domain.packing.unpack(packed[..., : self._components], np.nan)

    def take_halo(self, values: np.ndarray, ghosts: np.ndarray | float = 0.0) -> None:
        """Take (H, W, n) materials, and (M, n), as the best ones of the texels that belong to other tiles."""
        self._ensure()
        packing = self._domain.packing
        theirs = packed_states(self._domain.domain, packing) == HALO
        given = packing.pack(values, ghosts)
        given = np.pad(given, ((0, 0), (0, 0), (0, 4 * self._estimates.count - given.shape[-1])))
        for i in range(self._estimates.count):
            part = np.where(theirs[..., None], given[..., 4 * i : 4 * i + 4], self._reader.read(self.best[i]))
            self.best[i] = textures.upload(part.astype(np.float32))

    def state(self) -> dict[str, np.ndarray]:
        """Return all that outlives an iteration."""
        self._ensure()
        sets = {"best": self.best, "work": self.work}
        return {f"{name}_{i}": self._reader.read(t) for name, held in sets.items() for i, t in enumerate(held)}

    def restore(self, arrays: dict[str, np.ndarray], iteration: int) -> None:
        """Go on from what ``state`` returned at an iteration."""
        self.textures.ensure()
        for held, name in zip(self.textures.sets, ("best", "work"), strict=False):
            held[:] = [textures.upload(arrays[f"{name}_{i}"]) for i in range(len(held))]
        self.best, self.work = self.textures.sets[:2]
        self.iteration = iteration

    def close(self) -> None:
        """Free shaders and textures."""
        if self._acceptance is not None:
            self._acceptance.close()
        self.passes.close()
        self._reader.close()
        if self.textures is not None:
            self.textures.stop()
        self.textures = self.best = self.work = None

    def _open(self, bands: Bands) -> Iterator[None]:
        """Make what is not there yet, and begin at the current estimates where nothing else has been given."""
        yield from self.textures.make()
        if not self.best:
            target, status = self.textures.sets[0], self.textures.kept
            inputs = {**self._estimates.bindings(), "u_status": status}
            yield from self._once(bands, self.passes.begin, target, inputs)
            self.best = self.work = target

    def _ensure(self) -> None:
        for _ in self._open(Bands()):
            pass

    def _track(self) -> tuple[Track, int]:
        """The track of the next iteration, and how many of its own have been made."""
        made = self.iteration
        for track in self._tracks:
            if made < track.iterations:
                return track, made
            made -= track.iterations
        return self._tracks[-1], made

    def _widening(self, track: Track, made: int) -> float:
        """How many times its own width δ is in an iteration of a track: 1 in its last, and always but from starts."""
        if track.start < 0 or track.iterations < 2:
            return 1.0
        return self._refinement.widening ** (1 - made / (track.iterations - 1))

    def _begin(self, track: Track, bands: Bands, seconds: float) -> Iterator[None]:
        if track.start == BEST:
            self.work = self.best
            return
        target = self._spare()
        if track.start == SPREAD:
            yield from self._banded("spread", self.passes.spread, target, self._bindings(self.best), bands, seconds)
        else:
            yield from self._once(bands, self.passes.begin, target, self._bindings(self.best), track.start)
        self.work = target

    def _spare(self) -> list[Any]:
        """A set of textures that holds nothing needed."""
        return next(held for held in self.textures.sets if held is not self.best and held is not self.work)

    def _bindings(self, held: list[Any]) -> dict[str, Any]:
        return {**{f"u_estimate_{i}": t for i, t in enumerate(held[:-1])}, "u_status": held[-1]}

    def _kept_from(self) -> dict[str, Any]:
        work = {f"u_work_{i}": t for i, t in enumerate(self.work[:-1])}
        return {**self._bindings(self.best), **work, "u_work_status": self.work[-1]}

    def _constants(self, start: int = BEST, widening: float = 1.0) -> dict[str, int | float]:
        constants = loss_constants(self._domain, widening * self._schedule.fitness.delta)
        return {**constants, "u_start": start, "u_settles": int(widening == 1)}

    def _once(
        self, bands: Bands, work: Pass, targets: list[Any], inputs: dict[str, Any], start: int = BEST
    ) -> Iterator[None]:
        return work.at_once(bands, targets, {**inputs, **self._domain.textures}, self._constants(start))

    def _banded(
        self,
        name: str,
        work: Pass,
        targets: list[Any],
        inputs: dict[str, Any],
        bands: Bands,
        seconds: float,
        widening: float = 1.0,
    ) -> Iterator[None]:
        given, constants = {**inputs, **self._domain.textures}, self._constants(widening=widening)
        return work.in_bands(name, bands, seconds, targets, given, constants, counted=work is self.passes.step)
