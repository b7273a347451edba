"""Which texels of one tile others read: those in their halo, and those that they see across UV seams."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...geometry.domain import Domain

Box = tuple[int, int, int, int]  # x0, y0, width, height
Part = tuple[slice, slice]  # rows, columns


@dataclass(frozen=True)
class HaloOverlap:
    """Texels of one tile's own that another reads.

    other: the number of the one that reads them. here, there: where those in its halo lie in either's arrays. seen:
    (M,) rows and columns, in the arrays of the one that has them, of those in the ghosts of its seams; ghosts: (M,)
    which of the ghosts they are.
    """

    other: int
    here: Part
    there: Part
    seen: tuple[np.ndarray, np.ndarray]
    ghosts: np.ndarray


@dataclass(frozen=True)
class Place:
    """Where a tile lies in the whole domain: box, halo, its arrays' origin, and (M, 2) the ghosts of its seams."""

    box: Box
    halo: tuple[int, int, int, int]  # left, right, bottom, top
    origin: tuple[int, int]
    ghosts: np.ndarray


def place_of(box: Box, domain: Domain) -> Place:
    """Return where a tile lies. box: its own texels; domain: the tile with its halo."""
    ghosts = np.zeros((0, 2), np.int32) if domain.seams is None else domain.seams.ghosts
    return Place(box, domain.halo, domain.origin, ghosts)


def overlaps_of(places: Sequence[Place]) -> list[list[HaloOverlap]]:
    """Return for each tile which others read its own texels."""
    pairs = [
        [overlap_of(place, there, other) for other, there in enumerate(places) if number != other]
        for number, place in enumerate(places)
    ]
    return [[found for found in of_one if found is not None] for of_one in pairs]


def overlap_of(place: Place, there: Place, other: int, reach: int | None = None) -> HaloOverlap | None:
    """Return what of a tile's own texels another reads, None where it reads none.

    other: the number that the overlap names. reach: how much of the other's halo is read; all of it where None.
    """
    here, beside = _in_halo(place, there, reach)
    seen, ghosts = _in_ghosts(place, there)
    if not len(ghosts) and here[0].stop <= here[0].start:
        return None
    return HaloOverlap(other, here, beside, seen, ghosts)


def part_of(box: Box) -> Part:
    """Return a box as rows and columns."""
    x0, y0, width, height = box
    return slice(y0, y0 + height), slice(x0, x0 + width)


def rectangle(box: Box, halo: tuple[int, int, int, int]) -> Part:
    """Return where a tile lies in the whole domain with the halo that it has there."""
    x0, y0, width, height = box
    left, right, bottom, top = halo
    return slice(y0 - bottom, y0 + height + top), slice(x0 - left, x0 + width + right)


def own_of(domain: Domain) -> Part:
    """Return where a tile's own texels lie in its arrays."""
    left, right, bottom, top = domain.halo
    height, width = domain.shape
    return slice(bottom, height - top), slice(left, width - right)


def cells_of(overlap: HaloOverlap) -> int:
    """Return how many texels of the halo an overlap has."""
    rows, columns = overlap.there
    return (rows.stop - rows.start) * (columns.stop - columns.start)


def own_rows(numbers: np.ndarray, box: Box) -> np.ndarray:
    """Return the rows of a tile's own texels. numbers: of ``layout.numbered``."""
    found = numbers[part_of(box)]
    return found[found >= 0]


def held_rows(numbers: np.ndarray, place: Place) -> np.ndarray:
    """Return the rows of all texels that a tile holds, as its textures do: own and halo, then the ghosts."""
    rows, columns = rectangle(place.box, place.halo)
    found, (x, y) = numbers[rows, columns], (place.ghosts - place.origin + (columns.start, rows.start)).T
    return np.concatenate([found[found >= 0], numbers[y, x]])


def _in_halo(place: Place, other: Place, reach: int | None) -> tuple[Part, Part]:
    """Return where a tile's own texels that lie in another's halo are in either's arrays: nowhere where none do."""
    read = other.halo if reach is None else tuple(min(side, reach) for side in other.halo)
    shared = [
        slice(max(a.start, b.start), min(a.stop, b.stop))
        for a, b in zip(part_of(place.box), rectangle(other.box, read), strict=True)
    ]
    if any(s.start >= s.stop for s in shared):
        return ((slice(0, 0), slice(0, 0)),) * 2
    return tuple(
        tuple(slice(s.start - r.start, s.stop - r.start) for s, r in zip(shared, around, strict=True))
        for around in (rectangle(place.box, place.halo), rectangle(other.box, other.halo))
    )


def _in_ghosts(place: Place, other: Place) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Return rows and columns of a tile's own texels in another's ghosts, and which of that they are."""
    x, y = (other.ghosts - np.array(place.origin, np.int32)).T
    left, _, bottom, _ = place.halo
    _, _, width, height = place.box
    ghosts = np.flatnonzero((x >= left) & (x < left + width) & (y >= bottom) & (y < bottom + height))
    return (y[ghosts], x[ghosts]), ghosts
