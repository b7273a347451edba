"""``RankTransport``: sends halos from rank to rank."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..solver.engine.halo import HaloOverlap, Place, cells_of, overlap_of
from ..solver.engine.lockstep import Received, Value, overlap_values
from .transport import Ranks


class RankTransport:
    """A ``HaloTransport`` (solver/engine/lockstep.py) of ranks that have one tile each.

    team: the ranks that have texels. places: of their tiles, by rank in ``ranks``. seams: whether the domain has UV
    seams.
    """

    def __init__(self, ranks: Ranks, team: Ranks, places: Mapping[int, Place], seams: bool):
        self._ranks, self._team, self._places, self._seams = ranks, team, places, seams
        self.connected = len(places) > 1
        self._overlaps: dict[int | None, tuple[dict[int, HaloOverlap], dict[int, HaloOverlap]]] = {}
        self._outgoing: dict[int, np.ndarray] = {}
        self._read: dict[int, HaloOverlap] = {}
        self._size = 0
        self._received: list[Received] = []

    def publish(self, tile: int, results: np.ndarray, halo: int) -> None:
        """Cut this rank's results to what others read; nothing in a stage solved in closed form."""
        # Across a seam a texel may read all of the halo, at any distance from the box.
        sent, read = self._between(None if self._seams else halo)
        self._size = results.shape[-1]
        self._outgoing = (
            {rank: overlap_values(overlap, results) for rank, overlap in sent.items()} if self._size else {}
        )
        self._read = read if self._size else {}

    def exchange(self) -> None:
        shapes = {rank: (cells_of(part) + len(part.ghosts), self._size) for rank, part in self._read.items()}
        received = self._ranks.exchanged(self._outgoing, shapes)
        self._received = [(part, received[rank]) for rank, part in self._read.items()]

    def received(self, tile: int) -> Sequence[Received]:
        return self._received

    def allgather(self, value: Value) -> list[Value]:
        return self._team.allgather(value)

    def _between(self, halo: int | None) -> tuple[dict[int, HaloOverlap], dict[int, HaloOverlap]]:
        """Return rank → overlap that this one sends, and reads. halo: its width in texels; None: all."""
        if halo not in self._overlaps:
            here, own = self._ranks.rank, self._places[self._ranks.rank]
            others = {rank: place for rank, place in self._places.items() if rank != here}
            sent = {rank: overlap_of(own, place, rank, halo) for rank, place in others.items()}
            read = {rank: overlap_of(place, own, here, halo) for rank, place in others.items()}
            out, back = ({r: part for r, part in parts.items() if part is not None} for parts in (sent, read))
            self._overlaps[halo] = out, back
        return self._overlaps[halo]
