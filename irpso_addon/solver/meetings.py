"""Which texels of one tile others read: those in their halo, and those that they see across UV seams."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry.domain import Domain

Box = tuple[int, int, int, int]  # x0, y0, width, height
Part = tuple[slice, slice]  # rows, columns


@dataclass(frozen=True)
class Meeting:
    """Texels of one tile's own that another reads.

    other: the number of the one that reads them. here, there: where those in its halo lie in either's arrays. seen:
    (M,) rows and columns, in the arrays of the one that has them, of those in the annex of its seams; annex: (M,)
    which of the annex they are.
    """

    other: int
    here: Part
    there: Part
    seen: tuple[np.ndarray, np.ndarray]
    annex: np.ndarray


def meetings_of(tiles: Sequence[tuple[Box, Domain]]) -> list[list[Meeting]]:
    """Return for each tile, a box of the whole domain and the domain of it with its halo, which others read its own."""
    meetings: list[list[Meeting]] = [[] for _ in tiles]
    for number, (box, domain) in enumerate(tiles):
        for other, there in enumerate(tiles):
            if number == other:
                continue
            here, beside = _in_halo(box, domain, *there)
            seen, annex = _in_annex(domain, there[1])
            if len(annex) or here[0].stop > here[0].start:
                meetings[number].append(Meeting(other, here, beside, seen, annex))
    return meetings


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


def annex_of(domain: Domain) -> int:
    """Return how many texels a tile sees across seams."""
    return 0 if domain.seams is None else len(domain.seams.annex)


def _in_halo(box: Box, domain: Domain, other: Box, beside: Domain) -> tuple[Part, Part]:
    """Return where a tile's own texels that lie in another's halo are in either's arrays: nowhere where none do."""
    around, here = rectangle(other, beside.halo), rectangle(box, domain.halo)
    shared = [slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(part_of(box), around, strict=True)]
    if any(s.start >= s.stop for s in shared):
        return ((slice(0, 0), slice(0, 0)),) * 2
    return tuple(
        tuple(slice(s.start - r.start, s.stop - r.start) for s, r in zip(shared, place, strict=True))
        for place in (here, around)
    )


def _in_annex(domain: Domain, other: Domain) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Return rows and columns of a tile's own texels in another's annex, and which of that they are."""
    if other.seams is None:
        nothing = np.zeros(0, np.intp)
        return (nothing, nothing), nothing
    x, y = (other.seams.annex - np.array(domain.origin, np.int32)).T
    rows, columns = own_of(domain)
    annex = np.flatnonzero((x >= columns.start) & (x < columns.stop) & (y >= rows.start) & (y < rows.stop))
    return (y[annex], x[annex]), annex
