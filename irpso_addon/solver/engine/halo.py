"""Texels of one tile that other tiles read: those in their halos, and those that are ghosts of their UV seams."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...geometry.domain import Domain

Box = tuple[int, int, int, int]  # x0, y0, width, height
Part = tuple[slice, slice]  # rows, columns


@dataclass(frozen=True)
class HaloOverlap:
    """A tile's own texels that another tile reads.

    other: the reader's number. here, there: the part in its halo, in the owner's and in the reader's arrays. seen: (M,)
    rows and columns, in the owner's arrays, of the texels that are ghosts of the reader's seams. ghosts: (M,) their
    indices among its ghosts.
    """

    other: int
    here: Part
    there: Part
    seen: tuple[np.ndarray, np.ndarray]
    ghosts: np.ndarray


@dataclass(frozen=True)
class Place:
    """A tile's place in the whole domain: box, halo, its arrays' origin, and (M, 2) the ghosts of its seams."""

    box: Box
    halo: tuple[int, int, int, int]  # left, right, bottom, top
    origin: tuple[int, int]
    ghosts: np.ndarray


def place_of(box: Box, domain: Domain) -> Place:
    """Return a tile's place. box: its own texels; domain: the tile with its halo."""
    ghosts = np.zeros((0, 2), np.int32) if domain.seams is None else domain.seams.ghosts
    return Place(box, domain.halo, domain.origin, ghosts)


def overlaps_of(places: Sequence[Place]) -> list[list[HaloOverlap]]:
    """Return for each tile the overlaps of its own texels with the reads of other tiles."""
    pairs = [
        [overlap_of(place, there, other) for other, there in enumerate(places) if number != other]
        for number, place in enumerate(places)
    ]
    return [[overlap for overlap in readers if overlap is not None] for readers in pairs]


def overlap_of(place: Place, there: Place, other: int, width: int | None = None) -> HaloOverlap | None:
    """Return the texels at ``place`` that the tile at ``there`` reads; None where it reads none.

    other: the reader's number. width: width of the halo that it reads, in texels; None for all of it.
    """
    here, in_halo = _in_halo(place, there, width)
    seen, ghosts = _in_ghosts(place, there)
    if not len(ghosts) and here[0].stop <= here[0].start:
        return None
    return HaloOverlap(other, here, in_halo, seen, ghosts)


def part_of(box: Box) -> Part:
    """Return a box as rows and columns."""
    x0, y0, width, height = box
    return slice(y0, y0 + height), slice(x0, x0 + width)


def rectangle(box: Box, halo: tuple[int, int, int, int]) -> Part:
    """Return the rows and columns of a box with its halo, in the whole domain."""
    x0, y0, width, height = box
    left, right, bottom, top = halo
    return slice(y0 - bottom, y0 + height + top), slice(x0 - left, x0 + width + right)


def own_of(domain: Domain) -> Part:
    """Return the part of a tile's arrays that holds its own texels."""
    left, right, bottom, top = domain.halo
    height, width = domain.shape
    return slice(bottom, height - top), slice(left, width - right)


def cells_of(overlap: HaloOverlap) -> int:
    """Return the number of an overlap's texels in the halo."""
    rows, columns = overlap.there
    return (rows.stop - rows.start) * (columns.stop - columns.start)


def own_rows(numbers: np.ndarray, box: Box) -> np.ndarray:
    """Return the rows of a tile's own texels. numbers: of ``layout.numbered``."""
    own = numbers[part_of(box)]
    return own[own >= 0]


def tile_rows(numbers: np.ndarray, place: Place) -> np.ndarray:
    """Return the rows of all texels of a tile's textures: own and halo, then the ghosts."""
    rows, columns = rectangle(place.box, place.halo)
    inside, (x, y) = numbers[rows, columns], (place.ghosts - place.origin + (columns.start, rows.start)).T
    return np.concatenate([inside[inside >= 0], numbers[y, x]])


def _in_halo(place: Place, other: Place, width: int | None) -> tuple[Part, Part]:
    """Return the part of a tile's own texels in another's halo, in either's arrays; empty where there is none."""
    left, right, bottom, top = other.halo if width is None else np.minimum(other.halo, width).tolist()
    read = rectangle(other.box, (left, right, bottom, top))
    rows, columns = (
        slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(part_of(place.box), read, strict=True)
    )
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return ((slice(0, 0), slice(0, 0)),) * 2
    return _within(place, rows, columns), _within(other, rows, columns)


def _within(place: Place, rows: slice, columns: slice) -> Part:
    """Return a part of the whole domain in a tile's arrays."""
    down, across = (side.start for side in rectangle(place.box, place.halo))
    return slice(rows.start - down, rows.stop - down), slice(columns.start - across, columns.stop - across)


def _in_ghosts(place: Place, other: Place) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Return rows and columns of a tile's own texels among another's ghosts, and their indices there."""
    x, y = (other.ghosts[:, axis] - place.origin[axis] for axis in (0, 1))
    left, _, bottom, _ = place.halo
    _, _, width, height = place.box
    ghosts = np.flatnonzero((x >= left) & (x < left + width) & (y >= bottom) & (y < bottom + height))
    return (y[ghosts], x[ghosts]), ghosts
