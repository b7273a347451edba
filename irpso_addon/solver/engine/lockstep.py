"""The lock-step driver of tiles and of ranks: the same rounds, with different transport of halos."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Protocol, TypeVar

import numpy as np

from ..phases.phase import BAND_SECONDS
from ..state.texel_subset import TexelSubset, merged_subset
from .halo import HaloOverlap, Place, cells_of, overlaps_of
from .tiles import TilePool, TileRecovery

Value = TypeVar("Value")
Received = tuple[HaloOverlap, np.ndarray]  # its texels' values (n, channels): of the halo, then of the ghosts


class HaloTransport(Protocol):
    """Sends results of a tile's own texels to the tiles that have these texels in their halo or as ghosts.

    Tiles are numbered in their process. All processes call ``exchange``, ``allgather`` and ``publish`` in the same
    order.
    """

    connected: bool  # whether any tile reads another

    def publish(self, tile: int, results: np.ndarray, halo: int) -> None:
        """Publish (H, W, n) results of a tile's texels. halo: width of the halos that the next iteration reads."""

    def exchange(self) -> None:
        """Send what was published. All tiles of this process have published, at the same iteration."""

    def received(self, tile: int) -> Sequence[Received]:
        """Return the results that other tiles have published for the texels that a tile reads."""

    def allgather(self, value: Value) -> list[Value]:
        """Return the value of each process."""


class LocalTransport:
    """A ``HaloTransport`` between tiles of one process, at these places."""

    def __init__(self, places: Sequence[Place]):
        self._overlaps = overlaps_of(places)
        self.connected = any(self._overlaps)
        self._arriving: list[dict[int, Received]] = [{} for _ in places]
        self._received: list[dict[int, Received]] = [{} for _ in places]

    def publish(self, tile: int, results: np.ndarray, halo: int) -> None:
        for overlap in self._overlaps[tile]:
            self._arriving[overlap.other][tile] = overlap, overlap_values(overlap, results)

    def exchange(self) -> None:
        self._received, self._arriving = self._arriving, [{} for _ in self._received]

    def received(self, tile: int) -> Sequence[Received]:
        return list(self._received[tile].values())

    def allgather(self, value: Value) -> list[Value]:
        return [value]


class LockStep:
    """Drives the tiles of one process so that all tiles of the domain make the same iterations.

    halo: texels around every tile. A round receives the published halos, iterates tile after tile up to the next
    iteration that reads neighbours, and publishes the halos for that iteration.
    """

    def __init__(self, pool: TilePool, transport: HaloTransport, halo: int):
        self._pool, self._transport, self._halo = pool, transport, halo
        self._published = False  # whether the next iteration's halos have been exchanged
        self._subsets: list[TexelSubset] = []  # of this process's tiles, for the next iteration
        self._subset: TexelSubset | None = None  # of all tiles
        self._iterations_made = 0  # iterations of the last round
        self._pending: Iterator[None] | None = None

    def step(self, iterations: int | None = None, time_budget_s: float | None = None) -> None:
        """Advance as RecoveryEngine.step.

        With a time budget it may stop while some tiles are ahead of others; the next step continues there. Where tiles
        take turns, the next step finishes this round, even if that exceeds ``iterations``, and then returns.
        """
        deadline = None if time_budget_s is None else time.perf_counter() + time_budget_s
        left = iterations
        while self._pending is not None or not self._done and (left is None or left > 0 or self._initialising):
            if self._pending is None:
                # Longer rounds only save turns. Without turns, short ones leave little for the next call to finish.
                most = 1 if left is None and deadline is not None and self._pool.resident else left
                self._pending = self._round(0 if self._initialising else most, deadline is not None)
            for _ in self._pending:
                if deadline is not None and time.perf_counter() >= deadline:
                    return
            self._pending = None
            left = None if left is None else left - self._iterations_made
            if deadline is not None and not self._pool.resident:
                return  # all tiles are at the same iteration: a checkpoint now takes no extra turn

    def finish_round(self) -> None:
        """Bring all tiles to the same iteration."""
        if self._pending is not None:
            for _ in self._pending:
                pass
            self._pending = None

    def restart(self) -> None:
        """Discard the round and the published halos: the tiles' recoveries have changed."""
        self._pending, self._published, self._subset = None, False, None

    @property
    def settled(self) -> bool:
        """Whether all tiles are at the same iteration."""
        return self._pending is None

    @property
    def _done(self) -> bool:
        return all(tile.progress.done for tile in self._pool.tiles)

    @property
    def _initialising(self) -> bool:
        return any(tile.progress.iteration < 0 for tile in self._pool.tiles)

    def _round(self, most: int | None, paced: bool) -> Iterator[None]:
        """Run the same iterations on all tiles, at most ``most``.

        The first tile sets their number: it stops before an iteration that reads neighbours, and at the threshold.
        Yields after each iteration of a tile; paced: every few milliseconds, after each band has ended.
        """
        order = self._pool.order()
        if self._pool.recovery(order[0]).reads_other_tiles and not self._published:
            for number in order:
                self._publish(number)
            self._exchange()
        count, budget = most, BAND_SECONDS if paced else None
        for turn, number in enumerate(order):
            tile, recovery = self._pool.tiles[number], self._pool.recovery(number)
            tile.round_maps = None
            self._receive(number)
            if most == 0:
                yield from self._tile_steps(number, 0, budget)
            made = 0
            while (count is None or made < count) and not recovery.progress.done:
                recovery.reached = False
                yield from self._tile_steps(number, 1, budget)
                made, tile.reached = made + 1, recovery.reached
                yield
                if turn == 0 and (recovery.reads_other_tiles or self._reached(recovery)):
                    break
            count = made
            if made and made == most and not self._pool.resident:  # for the caller, while the tile is here
                tile.round_maps = recovery.maps(confidence=False)
            self._publish(number)
        self._iterations_made = count or 0
        self._exchange()
        reached = all(tile.reached for tile in self._pool.tiles)
        if self._pool.active.checks_threshold and all(self._transport.allgather(reached)):
            yield from self._finish_stage()

    def _tile_steps(self, number: int, iterations: int, budget: float | None) -> Iterator[None]:
        """Run iterations of a tile, and record its progress."""
        tile, recovery = self._pool.tiles[number], self._pool.recovery(number)
        for _ in recovery.iteration_steps(iterations, budget):
            tile.progress = recovery.progress
            yield
        tile.progress = recovery.progress
        tile.record_due()

    def _reached(self, recovery: TileRecovery) -> bool:
        """Return whether the first tile of any process has reached the threshold."""
        return recovery.checks_threshold and any(self._transport.allgather(recovery.reached))

    def _finish_stage(self) -> Iterator[None]:
        """Begin the next stage on all tiles: the whole domain has reached the threshold."""
        for number in self._pool.order():
            tile, recovery = self._pool.tiles[number], self._pool.recovery(number)
            before = recovery.progress.iteration_in_all
            recovery.finish_stage()
            tile.progress, tile.reached, tile.round_maps = recovery.progress, False, None
            if tile.watch is not None and recovery.progress.iteration_in_all != before:
                tile.watch.discard(before)  # an untiled recovery would not have recorded it
            tile.record_due()
            self._publish(number)
            yield
        self._exchange()

    def _publish(self, number: int) -> None:
        """Publish the results of a tile's texels, if the next iteration reads them."""
        recovery = self._pool.recovery(number)
        radius = recovery.stencil_radius
        if radius > self._halo:
            raise ValueError(f"halo {self._halo}: the next iteration reads {radius} texels away")
        if recovery.needs_texel_subset:
            self._subsets.append(recovery.texel_subset())
        if radius and self._transport.connected:
            self._transport.publish(number, recovery.halo(), radius)

    def _exchange(self) -> None:
        self._published = self._pool.active.reads_other_tiles
        subsets, self._subsets = self._subsets, []
        self._subset = (
            merged_subset([each for part in self._transport.allgather(subsets) for each in part]) if subsets else None
        )
        if self._pool.active.stencil_radius and self._transport.connected:
            self._transport.exchange()

    def _receive(self, number: int) -> None:
        """Copy the published halos into a tile, if its next iteration reads them."""
        tile, recovery = self._pool.tiles[number], self._pool.recovery(number)
        received = self._transport.received(number) if recovery.stencil_radius else ()
        if recovery.needs_texel_subset and self._subset is not None:
            recovery.take_texel_subset(self._subset)
        if received:
            size = received[0][1].shape[-1]
            values = np.full((*tile.domain.shape, size), np.nan, np.float32)
            ghosts = np.full((len(tile.place.ghosts), size), np.nan, np.float32)
            for overlap, result in received:
                cells = cells_of(overlap)
                part = values[overlap.there]
                part[:] = result[:cells].reshape(part.shape)
                ghosts[overlap.ghosts] = result[cells:]
            recovery.set_halo(values, ghosts)


def overlap_values(overlap: HaloOverlap, results: np.ndarray) -> np.ndarray:
    """Return (n, channels) of a tile's results (H, W, channels): at texels of another's halo, then at its ghosts."""
    return np.concatenate([results[overlap.here].reshape(cells_of(overlap), results.shape[-1]), results[overlap.seen]])
