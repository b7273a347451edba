"""A recovery of a domain that does not fit at once: tiles in lock step, to the maps of the whole bit for bit."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from ...core.errors import InputError
from ...geometry.domain import Domain, tile
from ...geometry.samples import mapped_array
from ...gpu import context, probe
from ...reflectance.model import ReflectanceModel
from ...results.maps import Maps
from ..phases.mixture import merged
from ..phases.phase import BACKGROUND_BAND_SECONDS, BAND_SECONDS
from ..settings.fixed import full_map
from ..settings.schedule import Schedule, refuse_levels
from ..state import checkpoint, prepare
from ..state.checkpoint import Checkpoint, named
from .halo import Box, HaloOverlap, Part, ghosts_of, overlaps_of, own_of, part_of, place_of, rectangle
from .progress import Progress
from .recovery import Recovery

Told = tuple[HaloOverlap, np.ndarray, np.ndarray]  # values of the halo's texels, and of the ghosts's


class TileRecovery(Recovery):
    """A recovery that does not stop at the threshold by itself: only the whole domain may."""

    reached = False  # whether the last iteration ended with every swarm of the tile at the threshold

    def finish_stage(self) -> None:
        """Go on to the next stage, as at the threshold, and place its swarms."""
        for _ in self._end_stage(BACKGROUND_BAND_SECONDS):
            pass
        self.step(iterations=0)

    def making(self, iterations: int, time_budget_s: float | None) -> Iterator[None]:
        """Make iterations as ``step`` does; yields in between whenever about ``time_budget_s`` has gone by."""
        self.step(iterations, time_budget_s)
        while self._work is not None:
            yield
            self.step(iterations, time_budget_s)

    def _reached_threshold(self) -> bool:
        self.reached = super()._reached_threshold()
        return False


@dataclass
class _Tile:
    """A tile, and where its recovery is.

    domain: with its halo. solved: texels of its own. error: their mean when it was looked at last. state: of the
    recovery while that is not on the device; files: where it lies, if not in memory. strips: what other tiles have told
    of the texels of this one's halo and ghosts; coming: the same of the iteration that the burst under way leads to.
    sample: this tile's part of what that iteration reads of the whole domain, if it does.
    """

    box: Box
    domain: Domain
    prepared: prepare.Prepared
    fixed: dict[str, np.ndarray]
    solved: int
    recovery: TileRecovery | None = None
    progress: Progress | None = None
    reached: bool = False
    error: float | None = None
    state: Checkpoint | None = None
    files: dict[str, np.ndarray] = field(default_factory=dict)
    strips: dict[int, Told] = field(default_factory=dict)
    coming: dict[int, Told] = field(default_factory=dict)
    sample: np.ndarray | None = None

    @property
    def own(self) -> Part:
        """Its own texels, without the halo, in its own arrays."""
        return own_of(self.domain)


class TiledRecovery:
    """One run over tiles, with the face of Recovery: the maps are those of the whole domain at once, bit for bit.

    boxes: (x0, y0, width, height) of rectangles that do not overlap and together hold all solvable texels. halo: at
    least the reach of every phase. on_device: how many tiles lie on the device at once, None for all; fewer take turns,
    each making as many iterations as need no neighbours, and what the others remember waits in memory, or in files in
    the folder ``scratch``. Needs, and raises, what Recovery does. There is no view(): no textures hold the
    whole, and some tiles may not be on the device; a window looks at it through solver/views/tiled_view.py.
    """

    def __init__(
        self,
        domain: Domain,
        model: ReflectanceModel,
        schedule: Schedule,
        seed: int = 0,
        fixed: Mapping[str, np.ndarray] | None = None,
        entry: Literal["auto", "fragment", "compute"] = "auto",
        *,
        boxes: Sequence[Box],
        halo: int,
        on_device: int | None = None,
        scratch: Path | None = None,
        prepared: prepare.Prepared | None = None,
    ):
        refuse_levels(schedule)
        context.ensure()
        self.domain, self.model, self.schedule, self.seed = domain, model, schedule, seed
        self.entry = probe.faster_entry() if entry == "auto" else entry
        self._halo, self._scratch = halo, scratch
        self._fixed = {name: full_map(model, name, value, domain.shape) for name, value in (fixed or {}).items()}
        _check_boxes(boxes, domain)
        prepared = prepared or prepare.prepare(domain, model, schedule, pack=False)
        self._tiles = [self._tile(box, prepared) for box in boxes if domain.solvable[part_of(box)].any()]
        self._overlaps = overlaps_of([place_of(part.box, part.domain) for part in self._tiles])
        self._most = len(self._tiles) if on_device is None else min(on_device, len(self._tiles))
        self._active = 0  # the tile that was used last
        self._sample: np.ndarray | None = None  # of all tiles, for the iteration that they are at
        self._told = False  # whether strips are those of the iteration that all tiles are at
        self._made = 0  # iterations of the burst that was made last
        self._work: Iterator[None] | None = None
        for number in range(self._most):
            self._recovery(number)
        for part in self._tiles:  # a tile that has not been on the device is where the first one is
            part.progress = part.progress or self._tiles[0].progress

    @property
    def live(self) -> list[tuple[Box, TileRecovery]]:
        """The tiles on the device now: their own texels, and their recoveries, to look at and not to step."""
        return [(part.box, part.recovery) for part in self._tiles if part.recovery is not None]

    @property
    def resident(self) -> bool:
        """Whether all tiles stay on the device."""
        return self._most == len(self._tiles)

    def step(self, iterations: int | None = None, time_budget_s: float | None = None) -> Progress:
        """Advance by whole iterations, or for about so long, or to the end; return the progress, as Recovery.step.

        With a time budget it may stop while some tiles are ahead of others, and goes on there next time; where tiles
        take turns, the iterations that were begun are made first, however few are asked for then.
        """
        deadline = None if time_budget_s is None else time.perf_counter() + time_budget_s
        left = iterations
        while self._work is not None or not self._done and (left is None or left > 0 or self._placing):
            if self._work is None:
                # Where nothing is gained by more at a time, the next call shall find little to finish.
                most = 1 if left is None and deadline is not None and self.resident else left
                self._work = self._burst(0 if self._placing else most, deadline is not None)
            for _ in self._work:
                if deadline is not None and time.perf_counter() >= deadline:
                    return self.progress
            self._work = None
            left = None if left is None else left - self._made
        return self.progress

    @property
    def progress(self) -> Progress:
        """How far the recovery is: as far as its slowest tile; the fraction counts what the others are ahead."""
        told = [part.progress for part in self._tiles]
        slowest = min(told, key=lambda p: (p.done, p.stage, p.iteration))
        ahead = sum(part.solved * (p.fraction - slowest.fraction) for part, p in zip(self._tiles, told, strict=True))
        fraction = slowest.fraction + ahead / max(1, sum(part.solved for part in self._tiles))
        end = max(fraction, slowest.stage_end)
        return replace(slowest, fraction=fraction, stage_end=end, evaluations=sum(p.evaluations for p in told))

    def maps(self, confidence: bool = True) -> Maps:
        """Return what has been found so far, as Recovery.maps; tiles that take turns each have one for it."""
        self._finish_burst()
        shape = self.domain.shape
        values = {p.name: np.empty((*shape, p.components), np.float32) for p in self.model.parameters}
        for p in self.model.parameters:
            values[p.name][:] = p.default
        residual = np.zeros(shape, np.float32)
        told: tuple[dict[str, np.ndarray], ...] = {}, {}  # deviations, alternatives
        for number in self._order():
            part, found = self._tiles[number], self._recovery(number).maps(confidence)
            texels = part_of(part.box)
            residual[texels] = found.residual[part.own]
            for name, value in found.values.items():
                values[name][texels] = value[part.own]
            for wholes, parts in zip(told, (found.confidence, found.alternatives), strict=True):
                for name, value in (parts or {}).items():
                    whole = wholes.setdefault(name, np.zeros((*shape, value.shape[-1]), np.float32))
                    whole[texels] = value[part.own]
        deviations, alternatives = told if confidence else (None, None)
        return Maps(self.model, values, self.domain.solvable, residual, deviations, alternatives=alternatives)

    def save(self, path: str | Path, notes: Mapping[str, np.ndarray] = MappingProxyType({})) -> None:
        """Write a checkpoint, as Recovery.save, from which the same tiles go on to the same maps bit for bit."""
        self._finish_burst()
        states = [part.recovery.state() if part.recovery else part.state for part in self._tiles]
        arrays = {_EVALUATIONS: np.array([part.progress.evaluations for part in self._tiles])}
        for number, state in enumerate(states):
            arrays |= {f"tile_{number}_{name}": array for name, array in (state.arrays if state else {}).items()}
        at, total = states[self._active], int(arrays[_EVALUATIONS].sum())
        whole = Checkpoint(at.stage, at.iteration, total, arrays, notes)
        checkpoint.write(Path(path), self._identity, whole)

    def load(self, path: str | Path) -> dict[str, np.ndarray]:
        """Go on from a checkpoint of the same domain, tiles and settings, and return its notes, as Recovery.load."""
        saved = checkpoint.read(Path(path), self._identity)
        self._work, self._told = None, False
        for number, part in enumerate(self._tiles):
            if part.recovery is not None:
                part.recovery.close()
                part.recovery = None
            arrays = named(saved.arrays, f"tile_{number}_")
            evaluations = int(saved.arrays[_EVALUATIONS][number])
            state = Checkpoint(saved.stage, saved.iteration, evaluations, arrays)
            part.state = self._stored(part, state) if arrays else None
        for number in range(self._most):
            self._recovery(number)
        for number, part in enumerate(self._tiles):
            evaluations = int(saved.arrays[_EVALUATIONS][number])
            part.progress = replace(self._tiles[0].progress, evaluations=evaluations)
        return dict(saved.notes)

    def mean_error(self) -> float:
        """Return the mean error over a few thousand texels of each tile, as Recovery.mean_error.

        Of a tile that waits for its turn it is the one that was found last; one that never was looked at has no part.
        """
        for part in self._tiles:
            if part.recovery is not None:
                part.error = part.recovery.mean_error()
        fixed = [part for part in self._tiles if part.error is not None]
        return float(np.average([part.error for part in fixed], weights=[part.solved for part in fixed]))

    def changed(self, schedule: Schedule, seed: int | None = None) -> TiledRecovery:
        """Raise InputError: a recovery in tiles does not change its settings midway."""
        raise InputError("a recovery in tiles takes no other settings in mid-run: stop, and recover again with them")

    def refresh_confidence(self, time_budget_s: float | None = None) -> bool:
        """Return True: tiles that take turns find theirs in maps()."""
        return True

    def close(self) -> None:
        """Free all that lies on the GPU, and the files."""
        self._work = None
        for part in self._tiles:
            if part.recovery is not None:
                part.recovery.close()
            part.recovery = part.state = None
            part.files, part.strips, part.coming = {}, {}, {}

    def __enter__(self) -> TiledRecovery:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def _done(self) -> bool:
        return all(part.progress.done for part in self._tiles)

    @property
    def _placing(self) -> bool:
        return any(part.progress.iteration < 0 for part in self._tiles)

    def _burst(self, most: int | None, paced: bool) -> Iterator[None]:
        """Let all tiles make the same iterations: ``most``, or as many as need nothing more of neighbours.

        The first tile finds out how many: it stops before an iteration that reads neighbours, and where it has reached
        the threshold. Yields after each iteration of a tile; paced: every few milliseconds, each band waited for.
        """
        order = self._order()
        if self._recovery(order[0]).reach and not self._told:
            for number in order:
                self._tell(number)
            self._all_told()
        count, budget = most, BAND_SECONDS if paced else None
        for turn, number in enumerate(order):
            part, recovery = self._tiles[number], self._recovery(number)
            self._hear(number)
            if most == 0:
                yield from self._noting(part, recovery.making(0, budget))
            made = 0
            while (count is None or made < count) and not recovery.progress.done:
                recovery.reached = False
                yield from self._noting(part, recovery.making(1, budget))
                made, part.progress, part.reached = made + 1, recovery.progress, recovery.reached
                yield
                if turn == 0 and (recovery.reach or recovery.reached):
                    break
            count = made
            part.progress = recovery.progress
            self._tell(number)
        self._made = count
        self._all_told()
        if all(part.reached for part in self._tiles):
            yield from self._finish_stage()

    @staticmethod
    def _noting(part: _Tile, work: Iterator[None]) -> Iterator[None]:
        """Do a tile's work and note its progress in between."""
        for _ in work:
            part.progress = part.recovery.progress
            yield

    def _finish_stage(self) -> Iterator[None]:
        """Let all tiles go on to the next stage: the whole domain has reached the threshold."""
        for number in self._order():
            part, recovery = self._tiles[number], self._recovery(number)
            recovery.finish_stage()
            part.progress, part.reached = recovery.progress, False
            self._tell(number)
            yield
        self._all_told()

    def _finish_burst(self) -> None:
        if self._work is not None:
            for _ in self._work:
                pass
            self._work = None

    def _order(self) -> list[int]:
        """The tiles, those on the device first: every turn spared is an upload of a part of the sample stack."""
        return sorted(range(len(self._tiles)), key=lambda number: self._tiles[number].recovery is None)

    def _recovery(self, number: int) -> TileRecovery:
        """Return a tile's recovery, put on the device if it is not there."""
        part = self._tiles[number]
        if part.recovery is None:
            if sum(other.recovery is not None for other in self._tiles) == self._most:
                # The one used last: those before it stay for the next round, which begins with them.
                last = self._tiles[self._active]
                last.state = self._stored(last, last.recovery.state())
                last.recovery.close()
                last.recovery = None
            part.recovery = TileRecovery(
                part.domain, self.model, self.schedule, self.seed, part.fixed, self.entry, part.prepared, part.state
            )
            part.state = None
            part.progress = part.recovery.progress
        self._active = number
        return part.recovery

    def _stored(self, part: _Tile, state: Checkpoint) -> Checkpoint:
        """Return a tile's state as it lies where states are kept: in memory, or in its files."""
        if self._scratch is None:
            return state
        files = {}
        for name, array in state.arrays.items():
            kept = part.files.get(name)
            if kept is None or kept.shape != array.shape or kept.dtype != array.dtype:
                kept = mapped_array(self._scratch, array.shape, array.dtype)
            kept[:] = array
            files[name] = kept
        part.files = files
        return replace(state, arrays=files)

    def _tell(self, number: int) -> None:
        """Note for the tiles around what this one's texels have found, if the next iteration reads it."""
        recovery = self._recovery(number)
        if not recovery.reach:
            return
        if recovery.reach > self._halo:
            raise ValueError(f"halo {self._halo}: the next iteration reads {recovery.reach} texels away")
        self._tiles[number].sample = recovery.sample()
        found = recovery.halo()
        for overlap in self._overlaps[number]:
            self._tiles[overlap.other].coming[number] = overlap, found[overlap.here].copy(), found[overlap.seen]

    def _all_told(self) -> None:
        """Let what has been told be heard: every tile is at one iteration now."""
        self._told = bool(self._recovery(self._active).reach)
        samples = [part.sample for part in self._tiles if part.sample is not None]
        self._sample = merged(samples) if samples else None
        for part in self._tiles:
            part.strips, part.coming, part.sample = part.coming, {}, None

    def _hear(self, number: int) -> None:
        """Give a tile what its neighbours have told, if its next iteration reads it."""
        part, recovery = self._tiles[number], self._recovery(number)
        if not recovery.reach:
            return
        if self._sample is not None:
            recovery.take_sample(self._sample)
        if not part.strips:
            return
        size = next(iter(part.strips.values()))[1].shape[-1]
        values = np.full((*part.domain.shape, size), np.nan, np.float32)
        ghosts = np.full((ghosts_of(part.domain), size), np.nan, np.float32)
        for overlap, strip, seen in part.strips.values():
            values[overlap.there], ghosts[overlap.ghosts] = strip, seen
        recovery.set_halo(values, ghosts)

    def _tile(self, box: Box, prepared: prepare.Prepared) -> _Tile:
        domain = tile(self.domain, *box, halo=self._halo)
        around = rectangle(box, domain.halo)
        fixed = {name: value[around] for name, value in self._fixed.items()}
        solved = int(np.count_nonzero(self.domain.solvable[part_of(box)]))
        return _Tile(box, domain, prepared.part(*around), fixed, solved)

    @cached_property
    def _identity(self) -> dict[str, Any]:
        """Who this is to a checkpoint; found once: it reads all samples."""
        who = checkpoint.identity(self.domain, self.model, self.schedule, self.seed, self.entry, self._fixed)
        return who | {"tiles": [[*part.box, self._halo] for part in self._tiles]}


_EVALUATIONS = "tiles_evaluations"  # the name in a checkpoint of how many each tile has made


def _check_boxes(boxes: Sequence[Box], domain: Domain) -> None:
    """Raise ValueError where a solvable texel lies in no box or in several."""
    count = np.zeros(domain.shape, np.uint8)
    for box in boxes:
        count[part_of(box)] += 1
    if not (count[domain.solvable] == 1).all():
        raise ValueError("tiles: every solvable texel must lie in one of them, and in one only")
