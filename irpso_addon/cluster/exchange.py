"""The transport of halos between ranks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..solver.engine.halo import HaloOverlap, Place, cells_of, overlap_of
from ..solver.engine.lockstep import Received, taken
from .transport import Ranks


class RankTransport:
    """A ``HaloTransport`` (solver/engine/lockstep.py) of ranks that have one tile each.

    team: the ranks that have texels. places: of their tiles, by number of the rank in ``ranks``.
    """

    def __init__(self, ranks: Ranks, team: Ranks, places: Mapping[int, Place]):
        self._ranks, self._team, self._places = ranks, team, places
        self._seams = any(len(place.ghosts) for place in places.values())
        self.connected = len(places) > 1
        self._overlaps: dict[int | None, tuple[dict[int, HaloOverlap], dict[int, HaloOverlap]]] = {}
        self._outgoing: dict[int, np.ndarray] = {}
        self._read: dict[int, HaloOverlap] = {}
        self._size = 0
        self._received: list[Received] = []

    def publish(self, tile: int, found: np.ndarray, reach: int) -> None:
        """Give what this rank's texels have found; nothing in a stage that searches nothing, solved in closed form."""
        # Across a seam a texel may see any of the halo, however far from the box it lies.
        sent, read = self._between(None if self._seams else reach)
        self._size = found.shape[-1]
        self._outgoing = {rank: taken(one, found) for rank, one in sent.items()} if self._size else {}
        self._read = read if self._size else {}

    def exchange(self) -> None:
        """Send what was published, and wait for what this rank reads."""
        shapes = {rank: (cells_of(one) + len(one.ghosts), self._size) for rank, one in self._read.items()}
        received = self._ranks.exchanged(self._outgoing, shapes)
        self._received = [(one, received[rank]) for rank, one in self._read.items()]

    def received(self, tile: int) -> Sequence[Received]:
        """Return what other ranks have published of the texels that this one reads."""
        return self._received

    def all(self, value: object) -> list:
        """Return what each rank with texels gives."""
        return self._team.all(value)

    def _between(self, reach: int | None) -> tuple[dict[int, HaloOverlap], dict[int, HaloOverlap]]:
        """Return what is sent to and what is read from each other rank, no more of halos than ``reach``."""
        if reach not in self._overlaps:
            here, own = self._ranks.rank, self._places[self._ranks.rank]
            others = {rank: place for rank, place in self._places.items() if rank != here}
            sent = {rank: overlap_of(own, place, rank, reach) for rank, place in others.items()}
            read = {rank: overlap_of(place, own, here, reach) for rank, place in others.items()}
            self._overlaps[reach] = tuple({r: one for r, one in m.items() if one is not None} for m in (sent, read))
        return self._overlaps[reach]
