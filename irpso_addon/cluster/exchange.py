"""What ranks tell one another before an iteration that reads neighbours."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..geometry.domain import Domain
from ..solver.engine.halo import HaloOverlap, Place, ghosts_of, overlap
from ..solver.engine.recovery import Recovery
from .transport import Ranks


class Exchange:
    """The borders of one rank's tile: which of its texels others read, and which of theirs it does.

    places: of all ranks that have texels. domain: this rank's tile.
    """

    def __init__(self, ranks: Ranks, places: Mapping[int, Place], domain: Domain):
        self._ranks, self._places, self._domain = ranks, places, domain
        self._found: dict[int | None, tuple[dict[int, HaloOverlap], dict[int, HaloOverlap]]] = {}

    def before_iteration(self, recovery: Recovery) -> None:
        """Tell the others, and hear from them, what the iteration that is next reads, if it reads any."""
        reach = recovery.reach
        if not reach or len(self._places) == 1:
            return
        # Across a seam a texel may see any of the halo, however far from the box it lies.
        told, heard = self._overlaps(reach if self._domain.seams is None else None)
        found = recovery.halo()
        size = found.shape[-1]
        if size == 0:  # a stage that searches nothing: all is solved in closed form
            return
        outgoing = {
            rank: np.concatenate([found[one.here].reshape(-1, size), found[one.seen]]) for rank, one in told.items()
        }
        incoming = {rank: (_cells(one) + len(one.ghosts), size) for rank, one in heard.items()}
        received = self._ranks.exchanged(outgoing, incoming)
        values = np.full((*self._domain.shape, size), np.nan, np.float32)
        ghosts = np.full((ghosts_of(self._domain), size), np.nan, np.float32)
        for rank, one in heard.items():
            cells = _cells(one)
            place = values[one.there]
            place[:] = received[rank][:cells].reshape(place.shape)
            ghosts[one.ghosts] = received[rank][cells:]
        recovery.set_halo(values, ghosts)

    def _overlaps(self, reach: int | None) -> tuple[dict[int, HaloOverlap], dict[int, HaloOverlap]]:
        """Return what is told to and what is heard from each other rank, no more of halos than is read."""
        if reach not in self._found:
            here, own = self._ranks.rank, self._places[self._ranks.rank]
            others = {rank: place for rank, place in self._places.items() if rank != here}
            told = {rank: overlap(own, place, rank, reach) for rank, place in others.items()}
            heard = {rank: overlap(place, own, here, reach) for rank, place in others.items()}
            self._found[reach] = tuple({r: one for r, one in m.items() if one is not None} for m in (told, heard))
        return self._found[reach]


def _cells(one: HaloOverlap) -> int:
    rows, columns = one.there
    return (rows.stop - rows.start) * (columns.stop - columns.start)
