"""One rank's part of a recovery, and what every rank does at rank 0's orders."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Concatenate, ParamSpec, Protocol, TypeVar

import numpy as np

from ..geometry.domain import Domain, subset, tile, with_lights
from ..geometry.samples import SampleStack
from ..gpu import context
from ..reflectance.model import ReflectanceModel
from ..results.maps import Maps
from ..solver.engine.halo import held_rows, own_of, own_rows, part_of, rectangle
from ..solver.engine.lockstep import LockStep
from ..solver.engine.progress import Progress
from ..solver.engine.tiles import Tile, TilePool
from ..solver.settings.fixed import full_map
from ..solver.settings.schedule import Schedule
from ..solver.state import prepare
from ..solver.state.checkpoint import Checkpoint, named
from ..solver.state.layout import digest_of_texels, joined, numbered
from .exchange import RankTransport
from .partition import Partition
from .transport import Ranks

P, Result = ParamSpec("P"), TypeVar("Result")


class Ask(Protocol):
    """Has all ranks call one of their ``Worker``'s methods with the same arguments; returns what rank 0 is given."""

    def __call__(
        self, order: Callable[Concatenate[Worker, P], Result], *arguments: P.args, **named: P.kwargs
    ) -> Result: ...  # noqa: D102


class Worker:
    """What every rank does at the same time; rank 0 is given the result.

    Each method is called on all ranks, in one order and with the same arguments, unless it says otherwise.
    """

    def __init__(
        self,
        ranks: Ranks,
        partition: Partition,
        model: ReflectanceModel,
        schedule: Schedule,
        seed: int,
        fixed: Mapping[str, np.ndarray],
    ):
        self.ranks = ranks
        self.model, self.schedule, self.seed = model, schedule, seed
        self.fixed = {name: full_map(model, name, value, partition.whole.shape) for name, value in fixed.items()}
        self._box = partition.boxes[ranks.rank]
        self.domain: Domain | None = None  # the whole, of the observations that are fitted
        self._pool: TilePool | None = None  # of this rank's one tile
        self._driver: LockStep | None = None
        self._progress: Progress | None = None
        self.partition = partition
        lit = self.lit(range(partition.whole.observations))
        self.partition = replace(partition, whole=replace(partition.whole, solvable=lit))

    def take_lights(self, lights: np.ndarray, intensities: np.ndarray) -> None:
        """Take other lights than the capture's."""
        held, window = self.partition, self.partition.window
        window = window and with_lights(window, lights, intensities)
        self.partition = replace(held, whole=with_lights(held.whole, lights, intensities), window=window)

    def layer(self, observation: int) -> np.ndarray | None:
        """Return (H, W, 4) the samples of one observation."""
        return self._pasted(None if self._box is None else {"layer": self._samples().layer(observation)}).get("layer")

    def texels(self, observations: Sequence[int], rows: np.ndarray, columns: np.ndarray) -> np.ndarray | None:
        """Return (K, N, 4) the samples of observations at N texels."""
        found = np.zeros((len(observations), 0, 4), np.float32)
        here = np.zeros(len(rows), bool)
        if self._box is not None:
            x0, y0, width, height = self._box
            here = (columns >= x0) & (columns < x0 + width) & (rows >= y0) & (rows < y0 + height)
            found = self._samples().texels(rows[here] - y0, columns[here] - x0)[list(observations)]
        told = self.ranks.collected({"here": np.flatnonzero(here), "found": found})
        whole = np.zeros((len(observations), len(rows), 4), np.float32)
        for one in told:
            whole[:, one["here"]] = one["found"]
        return whole

    def lit(self, observations: Sequence[int]) -> np.ndarray:
        """Return (H, W) bool: covered texels that one of the observations sees lit. Every rank is told."""
        mask = np.zeros(self.partition.whole.shape, bool)
        own = None
        if self._box is not None:
            own = subset(self.partition.window, observations).solvable[self._within()]
        told = self.ranks.all(None if own is None else np.packbits(own))
        for box, bits in zip(self.partition.boxes, told, strict=True):
            if box is not None:
                width, height = box[2:]
                mask[part_of(box)] = np.unpackbits(bits, count=width * height).reshape(height, width).astype(bool)
        return mask

    def begin(self, fitted: Sequence[int], entry: str) -> Progress:
        """Set up the recovery by some observations."""
        solvable = self.lit(fitted)
        self.domain = subset(self.partition.whole, fitted, solvable)
        boxes = self.partition.boxes
        works = [box is not None and bool(solvable[part_of(box)].any()) for box in boxes]
        works[0] |= not any(works)
        self._lead, self._total = works.index(True), int(np.count_nonzero(solvable))
        works_here = works[self.ranks.rank]
        part = self._part(fitted) if works_here else None
        brightness = self._brightness(part)
        team = self.ranks.among(works_here)
        if part is not None:
            self._pool = self._pool_of(part, brightness, entry)
        places = self.ranks.all(None if self._tile is None else self._tile.place)
        self.places = {rank: place for rank, place in enumerate(places) if place is not None}
        if self._pool is not None:
            self._driver = LockStep(self._pool, RankTransport(self.ranks, team, self.places), self.partition.halo)
        return self._told_progress()

    def advance(self, iterations: int | None) -> Progress:
        """Make so many iterations, or all, in step with the others."""
        if self._driver is not None:
            self._driver.step(iterations)
        return self._told_progress()

    def maps(self, confidence: bool) -> Maps | None:
        """Return what has been found so far."""
        parts = None
        if self._tile is not None:
            found = self._tile.recovery.maps(confidence)
            own = own_of(self._tile.domain)
            parts = {"residual": found.residual[own]}
            parts |= {f"value {name}": value[own] for name, value in found.values.items()}
            parts |= {f"deviation {name}": value[own] for name, value in (found.confidence or {}).items()}
            parts |= {f"alternative {name}": value[own] for name, value in (found.alternatives or {}).items()}
        whole = self._pasted(parts)
        if not self.ranks.leads:
            return None
        values = {p.name: whole[f"value {p.name}"] for p in self.model.parameters}
        covered = np.zeros(self.domain.shape, bool)
        for rank in self.places:
            covered[part_of(self.partition.boxes[rank])] = True
        for p in self.model.parameters:
            values[p.name][~covered] = p.default
        deviations = alternatives = None
        if confidence:
            deviations, alternatives = named(whole, "deviation "), named(whole, "alternative ")
        return Maps(self.model, values, self.domain.solvable, whole["residual"], deviations, alternatives=alternatives)

    def mean_error(self) -> float:
        """Return the mean error over a few thousand texels of each rank."""
        told = self.ranks.all(None if self._tile is None else (self._tile.recovery.mean_error(), self._tile.solved))
        told = [one for one in told if one is not None]
        return float(np.average([error for error, _ in told], weights=[max(1, count) for _, count in told]))

    def state(self) -> Checkpoint | None:
        """Return the state of the whole domain."""
        found = None if self._tile is None else self._tile.recovery.state()
        at = self.ranks.given(found and (found.stage, found.iteration), self._lead)
        parts = self.ranks.collected(found and found.arrays)
        if not self.ranks.leads:
            return None
        numbers = numbered(self.domain.solvable)
        rows = ((own_rows(numbers, self.places[r].box), arrays) for r, arrays in enumerate(parts) if arrays is not None)
        return Checkpoint(*at, self._progress.evaluations, joined(self._total, rows))

    def restore(self, saved: Checkpoint | None) -> Progress:
        """Go on from what ``state`` returned to rank 0; the others give None."""
        at = self.ranks.given(saved and (saved.stage, saved.iteration, saved.evaluations))
        parts: list[dict[str, np.ndarray] | None] = []
        if saved is not None:
            numbers = numbered(self.domain.solvable)
            for place in map(self.places.get, range(self.ranks.size)):
                held = None if place is None else held_rows(numbers, place)
                parts.append(None if held is None else {name: rows[held] for name, rows in saved.arrays.items()})
        arrays = self.ranks.dealt(parts)
        if self._driver is not None:
            stage, iteration, evaluations = at
            here = evaluations // max(1, self._total) * self._tile.solved
            self._tile.recovery.restore(Checkpoint(stage, iteration, here, arrays))
            self._tile.progress = self._tile.recovery.progress
            self._driver.restart()
        return self._told_progress()

    def renderers(self) -> list[str]:
        """Return the names of all ranks' devices."""
        return self.ranks.all(str(context.describe()["renderer"]))

    def sent(self) -> list[tuple[int, int]]:
        """Return the messages and bytes that each rank has sent to others before iterations."""
        return self.ranks.all(self.ranks.sent)

    def digest(self) -> int:
        """Return a number that tells the samples of all solved texels, however the domain is cut."""
        found = 0
        if self._tile is not None:
            found = digest_of_texels(self._tile.domain)
        return sum(self.ranks.all(found)) % 2**64

    def close(self) -> None:
        """Free what lies on the GPU."""
        if self._pool is not None:
            self._pool.close()
        self._pool = self._driver = None

    @property
    def _tile(self) -> Tile | None:
        """This rank's tile, None where it is left without texels."""
        return None if self._pool is None else self._pool.tiles[0]

    def _pool_of(self, part: Domain, brightness: float, entry: str) -> TilePool:
        prepared = replace(prepare.prepare(part, self.model, self.schedule, pack=False), brightness=brightness)
        fixed = {name: value[rectangle(self._box, part.halo)] for name, value in self.fixed.items()}
        solved = int(np.count_nonzero(self.domain.solvable[part_of(self._box)]))
        tile = Tile(self._box, part, prepared, fixed, solved)
        return TilePool([tile], self.model, self.schedule, self.seed, entry)

    def _part(self, fitted: Sequence[int]) -> Domain:
        """This rank's own texels with their halo, as a tile of the whole would be."""
        cut = tile(self.domain, *self._box, halo=self.partition.halo)
        return replace(cut, stack=self.partition.window.stack.subset(np.asarray(fitted, np.intp)))

    def _brightness(self, part: Domain | None) -> float:
        """The lights' mean irradiance/π over the texels of all ranks: sums of whole numbers, exact in any order."""
        told = None
        if part is not None:
            counted = np.zeros(part.shape, bool)
            counted[own_of(part)] = True
            told = prepare.brightness_sums(part, counted & part.solvable)
        found = [one for one in self.ranks.all(told) if one is not None]
        return prepare.brightness_of(self.domain, sum(s for s, _ in found), sum(count for _, count in found))

    def _told_progress(self) -> Progress:
        """Return the progress of the whole on every rank: in lock step only the evaluations differ."""
        progress = None
        if self.ranks.rank == self._lead:
            progress = self._tile.recovery.progress
            each = progress.evaluations // max(1, self._tile.solved)
            progress = replace(progress, evaluations=each * self._total)
        self._progress = self.ranks.given(progress, self._lead)
        return self._progress

    def _within(self) -> tuple[slice, slice]:
        """Where the rank's own texels lie in its window."""
        x0, y0, width, height = self._box
        left, bottom = x0 - self.partition.window.origin[0], y0 - self.partition.window.origin[1]
        return slice(bottom, bottom + height), slice(left, left + width)

    def _samples(self) -> SampleStack:
        return self.partition.window.stack.window(*self._within())

    def _pasted(self, parts: Mapping[str, np.ndarray] | None) -> dict[str, np.ndarray]:
        """Return to rank 0, by name, (H, W, …) of the ranks' own (h, w, …), 0 where there is none."""
        whole: dict[str, np.ndarray] = {}
        for rank, arrays in enumerate(self.ranks.collected(parts)):
            for name, value in (arrays or {}).items():
                held = whole.setdefault(name, np.zeros((*self.partition.whole.shape, *value.shape[2:]), value.dtype))
                held[part_of(self.partition.boxes[rank])] = value
        return whole
