"""Recovery of a domain that does not fit into memory: tiles in lock step, with an untiled one's maps bit for bit."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ...core.optional import present
from ...core.steps import map_steps
from ...geometry.domain import Domain, tile
from ...gpu import context
from ...gpu.kernel import EntryChoice
from ...reflectance.model import ReflectanceModel
from ...results.maps import Maps
from ..settings.levels import refuse_levels
from ..settings.schedule import Schedule
from ..state import prepare
from ..state.checkpoint import NEVER, Checkpoint
from ..state.layout import TexelLayout, joined, numbered
from ..state.separation_record import Separation
from .engine import Capabilities, RecoveryEngine
from .halo import Box, own_of, own_rows, part_of, rectangle, tile_rows
from .lockstep import LocalTransport, LockStep
from .progress import Progress
from .tiles import Tile, TilePool
from .watch import TexelRecord, Watch, recorded_by_all


class TiledRecovery(RecoveryEngine):
    """A ``RecoveryEngine`` over tiles. Its maps equal those of an untiled recovery bit for bit.

    boxes: (x0, y0, width, height) of rectangles that do not overlap and together hold all solvable texels. halo: at
    least the stencil radius of every phase. on_device: most tiles on the device at once, None for all. If fewer, tiles
    take turns, up to the next iteration that reads neighbours; the others' state is in memory, or in files in the
    folder ``scratch``. prepared, guess: as for Recovery. Errors are those of Recovery. Shown by
    solver/views/tiled_view.py.
    """

    def __init__(
        self,
        domain: Domain,
        model: ReflectanceModel,
        schedule: Schedule,
        seed: int = 0,
        fixed: Mapping[str, np.ndarray] | None = None,
        entry: EntryChoice = "auto",
        *,
        boxes: Sequence[Box],
        halo: int,
        on_device: int | None = None,
        scratch: Path | None = None,
        prepared: prepare.Prepared | None = None,
        guess: Mapping[str, np.ndarray] | None = None,
    ):
        refuse_levels(schedule)
        context.ensure()
        super().__init__(domain, model, schedule, seed, fixed, entry)
        self._halo = halo
        self._watched: list[tuple[Watch, np.ndarray]] = []  # with the indices of its texels among the watched
        self._once: int | None = None  # a stage that cannot restart from its begin
        _check_boxes(boxes, domain)
        prepared = prepared or prepare.prepare(domain, model, schedule, pack=False)
        if guess is not None:
            prepared = replace(prepared, guess=dict(guess))
        tiles = [self._tile(box, prepared) for box in boxes if domain.solvable[part_of(box)].any()]
        self._pool = TilePool(tiles, model, schedule, seed, self.entry, on_device, scratch)
        self._separation: tuple[int, Separation | None] | None = None  # the separation at a stage
        self._driver = LockStep(self._pool, LocalTransport([part.place for part in tiles]), halo)

    def preparation(self, domain: Domain, schedule: Schedule) -> Generator[None, None, prepare.Prepared | None]:
        return map_steps(prepare.prepare_steps(domain, self.model, schedule, pack=False), lambda part: None)

    @property
    def capabilities(self) -> Capabilities:
        return Capabilities("tiles", reconfigure=False, turns=not self._pool.resident, watches=True)

    def tiles(self) -> list[tuple[Box, RecoveryEngine]]:
        return [(part.box, part.recovery) for part in self._pool.tiles if part.recovery is not None]

    def step(self, iterations: int | None = None, time_budget_s: float | None = None) -> Progress:
        self._driver.step(iterations, time_budget_s)
        return self.progress

    @property
    def settled(self) -> bool:
        return self._driver.settled

    @property
    def progress(self) -> Progress:
        """The progress of the slowest tile; the fraction includes the lead of the others."""
        parts = self._pool.tiles
        slowest = min((part.progress for part in parts), key=lambda p: (p.done, p.stage, p.iteration))
        ahead = sum(part.solved * (part.progress.fraction - slowest.fraction) for part in parts)
        fraction = slowest.fraction + ahead / max(1, self._solved)
        evaluations = sum(part.progress.evaluations for part in parts)
        end = max(fraction, slowest.stage_end)
        return replace(slowest, fraction=fraction, stage_end=end, evaluations=evaluations)

    def maps(self, confidence: bool = True) -> Maps:
        """Return the maps so far, as RecoveryEngine.maps; tiles that take turns need one turn each.

        No turn is needed without ``confidence`` after a step that has run all the requested iterations.
        """
        self._driver.finish_round()
        shape = self.domain.shape
        values = {p.name: np.empty((*shape, p.components), np.float32) for p in self.model.parameters}
        for p in self.model.parameters:
            values[p.name][:] = p.default
        residual = np.zeros(shape, np.float32)
        uncertainties: tuple[dict[str, np.ndarray], ...] = {}, {}  # deviations, alternatives
        for number in self._pool.order():
            part = self._pool.tiles[number]
            round_maps, part.round_maps = part.round_maps, None
            maps = self._pool.recovery(number).maps(confidence) if confidence or round_maps is None else round_maps
            texels, own = part_of(part.box), own_of(part.domain)
            residual[texels] = present(maps.residual)[own]
            for name, value in maps.values.items():
                values[name][texels] = value[own]
            for wholes, parts in zip(uncertainties, (maps.confidence, maps.alternatives), strict=True):
                for name, value in (parts or {}).items():
                    whole = wholes.setdefault(name, np.zeros((*shape, value.shape[-1]), np.float32))
                    whole[texels] = value[own]
        deviations, alternatives = uncertainties if confidence else (None, None)
        return Maps(self.model, values, self.domain.solvable, residual, deviations, alternatives=alternatives)

    def watch(self, rows: np.ndarray, columns: np.ndarray, due: Callable[[Progress], bool]) -> None:
        self._watched = []
        for part in self._pool.tiles:
            x0, y0, width, height = part.box
            left, _, bottom, _ = part.domain.halo
            inside = (x0 <= columns) & (columns < x0 + width) & (y0 <= rows) & (rows < y0 + height)
            part.watch = None
            if inside.any():
                there = rows[inside] - y0 + bottom, columns[inside] - x0 + left
                part.watch = Watch(*there, due, last=part.progress.iteration_in_all)
                self._watched.append((part.watch, np.flatnonzero(inside)))

    def records(self) -> list[TexelRecord]:
        # In a round the threshold may still end the stage.
        return recorded_by_all(self._watched) if self._driver.settled or self.progress.done else []

    @property
    def separation(self) -> Separation | None:
        stage = self.progress.stage
        if self._separation is None or self._separation[0] != stage:
            whole = Separation.none(self.domain.shape)
            for number, part in enumerate(self._pool.tiles):
                if (found := self._pool.separation(number)) is not None:
                    whole[part_of(part.box)] = found[own_of(part.domain)]
            self._separation = stage, whole if whole.any() else None
        return self._separation[1]

    def state(self, running: bool = True) -> Checkpoint:
        """Return the state of all tiles, in memory or in files like the tiles' own."""
        self._driver.finish_round()
        numbers, at, particle_tiles = (
            numbered(self.domain.solvable),
            self._pool.active.at,
            self._pool.active.particle_tiles,
        )

        running, begun = running or at[0] == self._once, []

        def rows(number: int) -> dict[str, np.ndarray]:
            part = self._pool.tiles[number]
            if part.snapshot is None:
                saved = self._pool.recovery(number).state(running)
                begun.append(saved.begun)
                return saved.arrays
            begun.append(part.snapshot.begun)
            snapshot = part.snapshot if running else part.snapshot.of_stage
            return TexelLayout(part.domain).rows(snapshot.arrays, particle_tiles)

        parts = ((own_rows(numbers, part.box), rows(number)) for number, part in enumerate(self._pool.tiles))
        arrays = joined(self._solved, parts, self._pool.empty)
        saved = Checkpoint(*at, self.progress.evaluations, arrays, begun=NEVER if at[0] == self._once else sum(begun))
        return saved if running else saved.of_stage

    def restore(self, saved: Checkpoint) -> None:
        self._driver.restart()
        self._once = saved.stage if saved.begun == NEVER else None
        numbers, limit = numbered(self.domain.solvable), context.max_texture_size()
        for number, part in enumerate(self._pool.tiles):
            of_tile = tile_rows(numbers, part.place)
            arrays = TexelLayout(part.domain).arrays({n: rows[of_tile] for n, rows in saved.arrays.items()}, limit)
            made, begun = (max(0, n) // max(1, self._solved) * part.solved for n in (saved.evaluations, saved.begun))
            self._pool.wait(number, replace(saved, evaluations=made, begun=begun, arrays=arrays))
        self._pool.fill()
        for part in self._pool.tiles:
            if part.snapshot is not None:
                part.progress = replace(part.progress, evaluations=part.snapshot.evaluations)

    def mean_error(self) -> float:
        """Return the mean error over a few thousand texels of each tile; of a waiting tile its last value, if any."""
        for part in self._pool.tiles:
            if part.recovery is not None:
                part.error = part.recovery.mean_error()
        errors = [(part.error, part.solved) for part in self._pool.tiles if part.error is not None]
        return float(np.average([error for error, _ in errors], weights=[solved for _, solved in errors]))

    def close(self) -> None:
        self._driver.restart()
        self._pool.close()

    @cached_property
    def _solved(self) -> int:
        return int(np.count_nonzero(self.domain.solvable))

    def _tile(self, box: Box, prepared: prepare.Prepared) -> Tile:
        domain = tile(self.domain, *box, halo=self._halo)
        around = rectangle(box, domain.halo)
        fixed = {name: value[around] for name, value in self.fixed.items()}
        solved = int(np.count_nonzero(self.domain.solvable[part_of(box)]))
        return Tile(box, domain, prepared.part(*around), fixed, solved)


def _check_boxes(boxes: Sequence[Box], domain: Domain) -> None:
    """Raise ValueError where a solvable texel lies in no box or in several."""
    count = np.zeros(domain.shape, np.uint8)
    for box in boxes:
        count[part_of(box)] += 1
    if not (count[domain.solvable] == 1).all():
        raise ValueError("tiles: every solvable texel must lie in one of them, and in one only")
