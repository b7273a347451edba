"""Tiles of a domain: recoveries on the device, and the stored state of tiles that wait for their turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ...geometry.domain import Domain
from ...geometry.samples import mapped_array
from ...gpu.kernel import Entry
from ...gpu.program import ProgramCache
from ...reflectance.model import ReflectanceModel
from ...results.maps import Maps
from ..phases.phase import BACKGROUND_BAND_SECONDS
from ..settings.schedule import Schedule
from ..state.checkpoint import Checkpoint
from ..state.packing import Packing
from ..state.prefit_measurements import PrefitMeasurements
from ..state.prepare import Prepared
from ..state.separation_record import Separation
from ..state.texel_subset import TexelSubset
from .halo import Box, Place, place_of
from .progress import Progress
from .recovery import Recovery
from .watch import Watch


class TileRecovery(Recovery):
    """A recovery whose phases read results of neighbouring tiles.

    It does not end a stage at the threshold by itself: all tiles must reach it.
    """

    reached = False  # whether every swarm of the tile was at the threshold after the last iteration

    def halo(self) -> np.ndarray:
        """Return (H, W, n): the results of this tile's texels that neighbouring tiles read; NaN elsewhere."""
        self._finish_iteration()
        return self._running().halo()

    def set_halo(self, values: np.ndarray, ghosts: np.ndarray | float = 0.0) -> None:
        """Take (H, W, n) results of neighbouring tiles at their texels; NaN elsewhere. ghosts: (M, n) of the ghosts."""
        self._finish_iteration()
        self._running().take_halo(values, ghosts)

    def texel_subset(self) -> TexelSubset:
        """Return this tile's part of the whole domain's subset for the next iteration."""
        self._finish_iteration()
        return self._running().texel_subset()

    def take_texel_subset(self, subset: TexelSubset) -> None:
        """Take the subset of the whole domain, from ``merged_subset``."""
        self._finish_iteration()
        self._running().take_texel_subset(subset)

    @property
    def stencil_radius(self) -> int:
        """How many texels away the next iteration reads other texels' results; 0 where it needs no halo."""
        return self._phase.stencil_radius if self._phase is not None else 0

    @property
    def reads_other_tiles(self) -> bool:
        """Whether the next iteration needs the halo, or the subset of the whole domain."""
        return self.stencil_radius > 0 or self.needs_texel_subset

    @property
    def needs_texel_subset(self) -> bool:
        """Whether the next iteration needs the texel subset of the whole domain."""
        return self._phase is not None and self._phase.needs_texel_subset

    def finish_stage(self) -> None:
        """Begin the next stage, as at the threshold, and initialise its swarms."""
        for _ in self._end_stage(self._running(), BACKGROUND_BAND_SECONDS):
            pass
        self.step(iterations=0)

    def _reached_threshold(self) -> bool:
        self.reached = super()._reached_threshold()
        return False


@dataclass
class Tile:
    """A tile and its recovery.

    domain: with its halo. solved: the number of its own texels. error: their last mean error. snapshot: state of the
    recovery while it is not on the device. files: the arrays of ``snapshot``, if they are in files. round_maps: at the
    end of a round with all requested iterations, until they are read or the next round starts. watch: of own texels.
    """

    box: Box
    domain: Domain
    prepared: Prepared
    fixed: dict[str, np.ndarray]
    solved: int
    recovery: TileRecovery | None = None
    progress: Progress = field(init=False)  # set by the pool
    reached: bool = False
    error: float | None = None
    round_maps: Maps | None = None
    watch: Watch | None = None
    snapshot: Checkpoint | None = None
    files: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def place(self) -> Place:
        """Its place in the whole domain."""
        return place_of(self.box, self.domain)

    def record_due(self) -> None:
        """Record the values of the watched texels if they are due."""
        if self.watch is not None and self.recovery is not None:
            self.watch.record_due(self.recovery.progress, self.recovery.record)


class TilePool:
    """The tiles of one process.

    most: most tiles on the device at once, None for all. If fewer, tiles take turns; the others' state is in memory, or
    in files in the folder ``scratch``.
    """

    def __init__(
        self,
        tiles: Sequence[Tile],
        model: ReflectanceModel,
        schedule: Schedule,
        seed: int,
        entry: Entry,
        most: int | None = None,
        scratch: Path | None = None,
    ):
        self.tiles = list(tiles)
        self._settings, self._entry, self._scratch = (model, schedule, seed), entry, scratch
        self._most = len(self.tiles) if most is None else min(most, len(self.tiles))
        self._last = 0  # the last tile used
        self._programs = ProgramCache()  # a tile that comes back compiles nothing
        self.fill()

    @property
    def resident(self) -> bool:
        """Whether all tiles stay on the device."""
        return self._most == len(self.tiles)

    def fill(self) -> None:
        """Put as many tiles on the device as ``most`` allows; the others get the progress of the first one."""
        for number in range(self._most):
            self.recovery(number)
        for tile in self.tiles[self._most :]:
            tile.progress = self.tiles[0].progress

    def order(self) -> list[int]:
        """Return the tiles' numbers, those on the device first: each turn uploads a part of the sample stack."""
        return sorted(range(len(self.tiles)), key=lambda number: self.tiles[number].recovery is None)

    def recovery(self, number: int) -> TileRecovery:
        """Return a tile's recovery; put it on the device if it is not there."""
        tile = self.tiles[number]
        if tile.recovery is None:
            # The tile used last leaves the device: the next round begins with the tiles used before it.
            last = self.tiles[self._last]
            if last.recovery is not None and sum(other.recovery is not None for other in self.tiles) == self._most:
                last.snapshot = self._stored(last, last.recovery.snapshot())
                last.recovery.close()
                last.recovery = None
            tile.recovery = TileRecovery(
                tile.domain, *self._settings, tile.fixed, self._entry, tile.prepared, tile.snapshot
            )
            tile.snapshot = None
            tile.recovery.give_stack()  # on the host one packed stack at a time; a subset needs it before an iteration
            tile.progress = tile.recovery.progress
        self._last = number
        return tile.recovery

    @property
    def active(self) -> TileRecovery:
        """The recovery of the last tile used."""
        return self.recovery(self._last)

    def separation(self, number: int) -> Separation | None:
        """Return the separation of a tile, as RecoveryEngine.separation, without putting it on the device."""
        tile = self.tiles[number]
        if tile.recovery is not None:
            return tile.recovery.separation
        packed = None if tile.snapshot is None else PrefitMeasurements.of_arrays(tile.snapshot.arrays).separation
        return None if packed is None else packed.unpacked(Packing(tile.domain.solvable, tile.domain.seams))

    def wait(self, number: int, snapshot: Checkpoint) -> None:
        """Take a tile off the device; it continues from ``snapshot`` when its turn comes."""
        tile = self.tiles[number]
        if tile.recovery is not None:
            tile.recovery.close()
        tile.recovery = tile.round_maps = None
        tile.snapshot = self._stored(tile, snapshot)

    def close(self) -> None:
        """Free all recoveries on the device, and the files."""
        for tile in self.tiles:
            if tile.recovery is not None:
                tile.recovery.close()
            tile.recovery = tile.snapshot = tile.round_maps = None
            tile.files = {}
        self._programs.close()

    def empty(self, shape: tuple[int, ...], dtype: type = np.float32) -> np.ndarray:
        """Return zeros in memory, or in a file."""
        return np.zeros(shape, dtype) if self._scratch is None else mapped_array(self._scratch, shape, dtype)

    def _stored(self, tile: Tile, snapshot: Checkpoint) -> Checkpoint:
        """Return a tile's state, moved to files if there is a folder for them."""
        if self._scratch is None:
            return snapshot
        files = {}
        for name, array in snapshot.arrays.items():
            file = tile.files.get(name)
            if file is None or file.shape != array.shape or file.dtype != array.dtype:
                file = self.empty(array.shape, array.dtype.type)
            file[:] = array
            files[name] = file
        tile.files = files
        return replace(snapshot, arrays=files)
