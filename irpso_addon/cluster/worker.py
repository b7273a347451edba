"""One rank's part of a recovery, and the orders that rank 0 gives to all ranks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Concatenate, ParamSpec, Protocol, TypeVar

import numpy as np

from ..core.optional import present
from ..geometry.domain import Domain, subset, tile, with_lights
from ..geometry.samples import ArrayStack, SampleStack, new_stack
from ..gpu import context
from ..gpu.kernel import Entry
from ..reflectance.model import ReflectanceModel
from ..results.maps import Maps
from ..solver.engine.halo import Box, Part, Place, own_of, own_rows, part_of, rectangle, tile_rows
from ..solver.engine.lockstep import LockStep
from ..solver.engine.progress import Progress
from ..solver.engine.tiles import Tile, TilePool
from ..solver.settings.fixed import full_map
from ..solver.settings.schedule import Schedule
from ..solver.state import prepare
from ..solver.state.checkpoint import NEVER, Checkpoint, named
from ..solver.state.layout import digest_of_texels, joined, numbered
from ..solver.state.separation_record import Separation
from .exchange import RankTransport
from .partition import Partition, around
from .transport import Ranks

P = ParamSpec("P")
T = TypeVar("T")
Result = TypeVar("Result")


class Orders(Protocol):
    """Rank 0's calls of a method of ``Worker`` on all ranks."""

    def ask(
        self, order: Callable[Concatenate[Worker, P], Result | None], *arguments: P.args, **named: P.kwargs
    ) -> Result:
        """Have all ranks call the method with the same arguments; return rank 0's result."""

    def scatter(self, order: Callable[[Worker, T | None], Result], value: T) -> Result:
        """Have all ranks call a method that scatters its argument, rank 0's; return rank 0's result.

        Rank 0 passes the value, the others None.
        """


class Worker:
    """One rank's part of a recovery. Methods return their result on rank 0; on other ranks it may be None.

    All ranks call the methods in the same order and with the same arguments, unless a method says otherwise. domain:
    the whole; once begun, of the fitted observations alone. second: read or write the stack of ``make_second``, not
    the photographs. fixed: the job's, as for RecoveryEngine.
    """

    def __init__(self, ranks: Ranks, partition: Partition, fixed: Mapping[str, np.ndarray]):
        self.ranks, self.fixed = ranks, fixed
        self._box = partition.boxes[ranks.rank]
        self._pool: TilePool | None = None  # of this rank's single tile
        self._driver: LockStep | None = None
        self._progress: Progress
        self._second: ArrayStack | None = None  # of this rank's window
        self._guess: dict[str, np.ndarray] | None = None  # on this window, for the next ``begin``
        self.partition = partition
        lit = self.lit(range(partition.whole.observations))
        self.domain = replace(partition.whole, solvable=lit)
        self.partition = replace(partition, whole=self.domain)

    def take_lights(self, lights: np.ndarray, intensities: np.ndarray) -> None:
        """Replace the capture's lights."""
        partition, window = self.partition, self.partition.window
        window = window and with_lights(window, lights, intensities)
        self.partition = replace(partition, whole=with_lights(partition.whole, lights, intensities), window=window)

    def make_second(self) -> None:
        """Make a second sample stack, of zeros, unless there is one."""
        photographs = self._stack(second=False)
        if self._second is None and photographs is not None:
            self._second = new_stack(*photographs.shape)

    def put(self, change: tuple[int, np.ndarray] | None) -> None:
        """Replace the second stack's samples of one observation; rank 0 passes (number, (H, W, 4)), the others None."""
        observation = self.ranks.broadcast(change and change[0])
        part = self._scattered(change and {"layer": change[1]})
        if part is not None and self._second is not None:
            self._second.put(observation, part["layer"])

    def take_guess(self, guess: Mapping[str, np.ndarray] | None) -> None:
        """Set the initial maps of the next recovery, name → (H, W, components); rank 0 passes them."""
        self._guess = self._scattered(guess)

    def layer(self, observation: int, second: bool) -> np.ndarray | None:
        """Return (H, W, 4) the samples of one observation."""
        samples = self._samples(second)
        return self._pasted(None if samples is None else {"layer": samples.layer(observation)}).get("layer")

    def texels(self, observations: Sequence[int], rows: np.ndarray, columns: np.ndarray, second: bool) -> np.ndarray:
        """Return (K, N, 4) the samples of observations at N texels."""
        part, samples = None, self._samples(second)
        if self._box is not None and samples is not None:
            x0, y0, width, height = self._box
            own = (columns >= x0) & (columns < x0 + width) & (rows >= y0) & (rows < y0 + height)
            values = samples.texels(rows[own] - y0, columns[own] - x0)[list(observations)]
            part = {"own": np.flatnonzero(own), "values": values}
        whole = np.zeros((len(observations), len(rows), 4), np.float32)
        for each in self.ranks.gathered(part):
            if each is not None:
                whole[:, each["own"]] = each["values"]
        return whole

    def lit(self, observations: Sequence[int], second: bool = False) -> np.ndarray:
        """Return, on every rank, (H, W) bool: covered texels that one of the observations sees lit."""
        mask = np.zeros(self.partition.whole.shape, bool)
        own, window, stack = None, self.partition.window, self._stack(second)
        if self._box is not None and window is not None and stack is not None:
            lit = stack.subset(np.asarray(observations, np.intp)).lit(window.bake.coverage)
            own = np.packbits(lit[_within(self._box, window)])
        for box, bits in zip(self.partition.boxes, self.ranks.allgather(own), strict=True):
            if box is not None and bits is not None:
                width, height = box[2:]
                mask[part_of(box)] = np.unpackbits(bits, count=width * height).reshape(height, width).astype(bool)
        return mask

    def begin(
        self,
        fitted: Sequence[int],
        second: bool,
        model: ReflectanceModel,
        schedule: Schedule,
        seed: int,
        more_fixed: Mapping[str, np.ndarray],
        entry: Entry,
    ) -> Progress:
        """Set up a recovery from some observations, from the guess if there is one.

        more_fixed: parameters that are fixed besides the job's, as for RecoveryEngine.
        """
        self.model = model
        solvable = self.lit(fitted)
        self.domain = subset(self.partition.whole, fitted, solvable)
        boxes = self.partition.boxes
        works = [box is not None and bool(solvable[part_of(box)].any()) for box in boxes]
        works[0] |= not any(works)
        self._first_working, self._total = works.index(True), int(np.count_nonzero(solvable))
        box = self._box if works[self.ranks.rank] else None
        part = None if box is None else self._part(box, fitted, second)
        mean_irradiance = self._mean_irradiance(part)
        team = self.ranks.among(part is not None)
        if box is not None and part is not None:
            fixed = {**self.fixed, **more_fixed}
            self._pool = self._pool_of(box, part, mean_irradiance, (schedule, seed, entry), fixed)
        self._guess = None
        places = self.ranks.allgather(None if self._pool is None else self._pool.tiles[0].place)
        self.places: dict[int, Place] = {rank: place for rank, place in enumerate(places) if place is not None}
        if self._pool is not None and team is not None:
            transport = RankTransport(self.ranks, team, self.places, self.domain.seams is not None)
            self._driver = LockStep(self._pool, transport, self.partition.halo)
        return self._shared_progress()

    def advance(self, iterations: int | None) -> Progress:
        """Make some iterations, or all, in step with the others."""
        if self._driver is not None:
            self._driver.step(iterations)
        return self._shared_progress()

    def maps(self, confidence: bool) -> Maps | None:
        """Return the maps so far."""
        parts = None
        if self._pool is not None:
            maps, own = self._pool.active.maps(confidence), own_of(self._pool.tiles[0].domain)
            parts = {"residual": present(maps.residual)[own]}
            parts |= {f"value {name}": value[own] for name, value in maps.values.items()}
            parts |= {f"deviation {name}": value[own] for name, value in (maps.confidence or {}).items()}
            parts |= {f"alternative {name}": value[own] for name, value in (maps.alternatives or {}).items()}
        whole = self._pasted(parts)
        if not self.ranks.leads:
            return None
        values = {p.name: whole[f"value {p.name}"] for p in self.model.parameters}
        covered = np.zeros(self.domain.shape, bool)
        for place in self.places.values():
            covered[part_of(place.box)] = True
        for p in self.model.parameters:
            values[p.name][~covered] = p.default
        deviations = alternatives = None
        if confidence:
            deviations, alternatives = named(whole, "deviation "), named(whole, "alternative ")
        return Maps(self.model, values, self.domain.solvable, whole["residual"], deviations, alternatives=alternatives)

    def separation(self) -> Separation | None:
        """Return the separation of indirect light, as RecoveryEngine.separation."""
        found = None if self._pool is None else self._pool.active.separation
        own = {} if self._pool is None or found is None else {"own": found[own_of(self._pool.tiles[0].domain)].values}
        values = self._pasted(own if self._pool is not None else None).get("own")
        return None if values is None else Separation(values)

    def mean_error(self) -> float:
        """Return the mean error over a few thousand texels of each rank."""
        own = None if self._pool is None else (self._pool.active.mean_error(), self._pool.tiles[0].solved)
        errors = [each for each in self.ranks.allgather(own) if each is not None]
        return float(np.average([error for error, _ in errors], weights=[max(1, solved) for _, solved in errors]))

    def state(self) -> Checkpoint | None:
        """Return the state of the whole domain."""
        own = None if self._pool is None else self._pool.active.state()
        stage, iteration = self.ranks.broadcast(own and (own.stage, own.iteration), self._first_working)
        parts = self.ranks.gathered(None if own is None else own.arrays)
        if not self.ranks.leads:
            return None
        numbers = numbered(self.domain.solvable)
        rows = ((own_rows(numbers, self.places[r].box), arrays) for r, arrays in enumerate(parts) if arrays is not None)
        return Checkpoint(stage, iteration, self._progress.evaluations, joined(self._total, rows), begun=NEVER)

    def restore(self, saved: Checkpoint | None) -> Progress:
        """Continue from the state that ``state`` returned on rank 0; the others pass None."""
        at = self.ranks.broadcast(saved and (saved.stage, saved.iteration, saved.evaluations))
        parts: list[Mapping[str, np.ndarray] | None] = []
        if saved is not None:
            numbers = numbered(self.domain.solvable)
            for place in map(self.places.get, range(self.ranks.size)):
                indices = None if place is None else tile_rows(numbers, place)
                parts.append(None if indices is None else {name: rows[indices] for name, rows in saved.arrays.items()})
        arrays = self.ranks.scattered(parts)
        if self._pool is not None and self._driver is not None and arrays is not None:
            stage, iteration, evaluations = at
            own, recovery = self._pool.tiles[0], self._pool.active
            recovery.restore(Checkpoint(stage, iteration, evaluations // max(1, self._total) * own.solved, arrays))
            own.progress = recovery.progress
            self._driver.restart()
        return self._shared_progress()

    def renderers(self) -> list[str]:
        """Return the names of all ranks' devices."""
        return self.ranks.allgather(str(context.describe()["renderer"]))

    def sent(self) -> list[tuple[int, int]]:
        """Return the messages and bytes that each rank has sent as halos."""
        return self.ranks.allgather(self.ranks.sent)

    def digest(self) -> int:
        """Return the 64-bit digest of all solved texels' samples, for any division of the domain."""
        own = 0 if self._pool is None else digest_of_texels(self._pool.tiles[0].domain)
        return sum(self.ranks.allgather(own)) % 2**64

    def close(self) -> None:
        """Free all that lies on the GPU."""
        if self._pool is not None:
            self._pool.close()
        self._pool = self._driver = None

    def _pool_of(
        self,
        box: Box,
        part: Domain,
        mean_irradiance: float,
        settings: tuple[Schedule, int, Entry],
        fixed: Mapping[str, np.ndarray],
    ) -> TilePool:
        prepared = replace(prepare.prepare(part, self.model, settings[0], pack=False), mean_irradiance=mean_irradiance)
        if self._guess is not None:
            prepared = replace(prepared, guess=self._guess)
        around_box, known = rectangle(box, part.halo), self.domain.solvable
        own_fixed = {name: full_map(self.model, name, value, known)[around_box] for name, value in fixed.items()}
        solved = int(np.count_nonzero(self.domain.solvable[part_of(box)]))
        return TilePool([Tile(box, part, prepared, own_fixed, solved)], self.model, *settings)

    def _part(self, box: Box, fitted: Sequence[int], second: bool) -> Domain | None:
        """Return this rank's own texels with their halo, as a tile of the whole."""
        stack = self._stack(second)
        if stack is None:
            return None
        stack = stack.subset(np.asarray(fitted, np.intp))
        return replace(tile(self.domain, *box, self.partition.halo), stack=stack)

    def _mean_irradiance(self, part: Domain | None) -> float:
        """Return the lights' mean irradiance/π over all ranks' texels: sums of whole numbers, exact in any order."""
        own = None
        if part is not None:
            counted = np.zeros(part.shape, bool)
            counted[own_of(part)] = True
            own = prepare.irradiance_sums(part, counted & part.solvable)
        sums, counts = zip(*(each for each in self.ranks.allgather(own) if each is not None), strict=True)
        return prepare.mean_irradiance_of(self.domain, np.sum(sums, axis=0), sum(counts))

    def _shared_progress(self) -> Progress:
        """Return the progress of the whole on every rank: in lock step only the evaluations differ."""
        progress = None
        if self.ranks.rank == self._first_working and self._pool is not None:
            progress = self._pool.active.progress
            each = progress.evaluations // max(1, self._pool.tiles[0].solved)
            progress = replace(progress, evaluations=each * self._total)
        self._progress = self.ranks.broadcast(progress, self._first_working)
        return self._progress

    def _stack(self, second: bool) -> SampleStack | None:
        """Return the samples of this rank's window, None where it has none."""
        if second:
            return self._second
        return None if self.partition.window is None else self.partition.window.stack

    def _samples(self, second: bool) -> SampleStack | None:
        """Return the samples of this rank's own texels, None where it has none."""
        stack, window = self._stack(second), self.partition.window
        if self._box is None or window is None or stack is None:
            return None
        return stack.window(*_within(self._box, window))

    def _scattered(self, maps: Mapping[str, np.ndarray] | None) -> dict[str, np.ndarray] | None:
        """Return, on each rank, its window of rank 0's name → (H, W, …); None on a rank without texels."""
        parts: list[Mapping[str, np.ndarray] | None] = []
        if maps is not None:
            shape, halo = self.partition.whole.shape, self.partition.halo
            windows = [box and part_of(around(shape, box, halo)) for box in self.partition.boxes]
            parts = [part and {name: value[part] for name, value in maps.items()} for part in windows]
        return self.ranks.scattered(parts)

    def _pasted(self, parts: Mapping[str, np.ndarray] | None) -> dict[str, np.ndarray]:
        """Return, on rank 0, name → (H, W, …) joined from the ranks' own (h, w, …), 0 where there is none."""
        whole: dict[str, np.ndarray] = {}
        for box, arrays in zip(self.partition.boxes, self.ranks.gathered(parts), strict=False):
            if box is None or arrays is None:
                continue
            for name, value in arrays.items():
                target = whole.setdefault(name, np.zeros((*self.partition.whole.shape, *value.shape[2:]), value.dtype))
                target[part_of(box)] = value
        return whole


def _within(box: Box, window: Domain) -> Part:
    """Return the part of a window that holds a box."""
    x, y = window.origin
    return part_of((box[0] - x, box[1] - y, box[2], box[3]))
