"""Lattices of patches: quadrilaterals that lie beside each other in rows and columns, in perspective."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...capture.frame.homography import mapped
from ...core.opencv import opencv

_STEP = (1.0, 1.75)  # from a patch to the next, over its side: edges make the found side shorter than the patch
_ASIDE = 0.3  # the most that the next one lies off the row, over the side
_ALIKE = 2.2  # area of a patch over its neighbour's
_SAME = 0.35  # of the side: centres nearer to each other belong to one patch
_INNER = 6.0  # area of a patch over that of a region inside it that is no patch of its own
_OFF = 0.2  # of the pitch: the most that a centre lies off its place in the lattice
_LEAST = 7  # patches of a lattice
_FEWER = 2  # patches in a field than in the fullest one: clutter beside a chart may lie in its lattice
_REACH = 5  # places beyond a lattice's first patches where more are searched
_ROUNDS = 3


@dataclass(frozen=True)
class Lattice:
    """Patches in rows and columns. matrix: (3, 3), column and row of a patch's centre to pixels. cells: (K, 2)."""

    matrix: np.ndarray
    cells: np.ndarray

    def at(self, places: np.ndarray) -> np.ndarray:
        """Return pixels (…, 2) of columns and rows (…, 2)."""
        return _through(self.matrix, np.asarray(places, np.float64))


@dataclass(frozen=True)
class _Patches:
    """centres: (N, 2). sides: (N, 2, 2), the mean vectors of opposite sides. areas: (N,)."""

    centres: np.ndarray
    sides: np.ndarray
    areas: np.ndarray


def lattices(quads: np.ndarray) -> list[Lattice]:
    """Return the lattices of quadrilaterals (N, 4, 2), those with most patches first."""
    patches = _patches(quads)
    left, found = set(range(len(patches.areas))), []
    for seed in np.argsort(-patches.areas):
        if seed not in left:
            continue
        cells = _grown(patches, int(seed))
        left -= set(cells)
        if len(cells) >= _LEAST and (fitted := _fitted(patches, cells)) is not None:
            found.append(fitted[0])
            left -= set(fitted[1].tolist())
    return sorted(found, key=lambda lattice: -len(lattice.cells))


def _patches(quads: np.ndarray) -> _Patches:
    """Return the patches of quadrilaterals, each once: of those at one place, the largest."""
    a, b, c, d = (quads[:, n] for n in range(4))
    first, second = ((b - a) + (c - d)) / 2, ((d - a) + (c - b)) / 2
    areas = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    centres = quads.mean(axis=1)
    kept: list[int] = []
    for n in np.argsort(-areas):
        if kept:
            others = np.array(kept)
            apart = np.linalg.norm(centres[others] - centres[n], axis=1)
            alike = areas[others] < _INNER * areas[n]
            if (alike & (apart < _SAME * np.sqrt(areas[others]))).any():
                continue
        kept.append(int(n))
    return _Patches(centres[kept], np.stack([first, second], axis=1)[kept], areas[kept])


def _grown(patches: _Patches, seed: int) -> dict[int, tuple[int, int]]:
    """Return patch → column and row of all that neighbours of neighbours of a patch reach."""
    cells, taken = {seed: (0, 0)}, {(0, 0)}
    waiting = deque([(seed, patches.sides[seed])])
    while waiting:
        n, sides = waiting.popleft()
        for axis, way in ((0, 1), (0, -1), (1, 1), (1, -1)):
            step = np.eye(2, dtype=int)[axis] * way
            cell = (cells[n][0] + int(step[0]), cells[n][1] + int(step[1]))
            if cell in taken or (other := _neighbour(patches, n, sides, step)) is None or other in cells:
                continue
            cells[other] = cell
            taken.add(cell)
            waiting.append((other, _turned(patches.sides[other], sides)))
    return cells


def _neighbour(patches: _Patches, n: int, sides: np.ndarray, step: np.ndarray) -> int | None:
    """Return the patch beside patch n one step along its sides (2, 2), None where there is none."""
    away = (patches.centres - patches.centres[n]) @ np.linalg.inv(sides)  # in sides of the patch
    along, aside = away @ step, np.abs(away @ (1 - np.abs(step)))
    ratio = patches.areas / patches.areas[n]
    fits = (along > _STEP[0]) & (along < _STEP[1]) & (aside < _ASIDE) & (ratio < _ALIKE) & (ratio > 1 / _ALIKE)
    return int(np.flatnonzero(fits)[np.argmin(along[fits] + aside[fits])]) if fits.any() else None


def _turned(sides: np.ndarray, like: np.ndarray) -> np.ndarray:
    """Return the side vectors (2, 2) in the order and with the signs that agree with another patch's."""
    ways = (sides, sides[::-1] * [(1,), (-1,)], -sides, sides[::-1] * [(-1,), (1,)])
    return max(ways, key=lambda way: float((way * like).sum()))


def _fitted(patches: _Patches, cells: dict[int, tuple[int, int]]) -> tuple[Lattice, np.ndarray] | None:
    """Return the lattice through patches' centres and its patches, with those that growing missed; or None."""
    cv = opencv("the search for a colour chart")
    chosen, places = np.array(list(cells)), np.array(list(cells.values()), np.float64)
    matrix = np.eye(3)
    for _ in range(_ROUNDS):
        pitch = float(np.sqrt(np.median(patches.areas[chosen])))
        found, inside = cv.findHomography(places, patches.centres[chosen], cv.RANSAC, _OFF * pitch)
        if found is None or inside.sum() < _LEAST or not _spans(places[inside[:, 0] > 0]):
            return None
        matrix = found
        chosen, places = _at_places(patches, matrix, places[inside[:, 0] > 0])
        if len(chosen) < _LEAST:
            return None
    # The median of the distances, not their squares: centres of patches that are found in part lie up to _OFF away.
    finer, _ = cv.findHomography(places, patches.centres[chosen], cv.LMEDS)
    return Lattice(matrix if finer is None else finer, np.unique(places.astype(int), axis=0)), chosen


def _spans(places: np.ndarray) -> bool:
    """Return whether cells lie in two or more rows and columns, which a perspective map needs."""
    return bool((np.ptp(places, axis=0) >= 1).all())


def _at_places(patches: _Patches, matrix: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the patches (K,) whose centres lie at places of a lattice, and the places (K, 2)."""
    low, high = known.min(axis=0) - _REACH, known.max(axis=0) + _REACH
    away = _through(np.linalg.inv(matrix), patches.centres)
    places = np.rint(away)
    near = (np.abs(away - places) < _OFF).all(axis=1) & ((places >= low) & (places <= high)).all(axis=1)
    # The lattice's own size of a cell at each patch, by the map's slope.
    steps = [_through(matrix, places + step) - _through(matrix, places) for step in np.eye(2)]
    cell = np.abs(steps[0][:, 0] * steps[1][:, 1] - steps[0][:, 1] * steps[1][:, 0])
    near &= (patches.areas < 1.1 * cell) & (patches.areas > 0.25 * cell)
    return np.flatnonzero(near), places[near]


def _through(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return points (…, 2), mapped by a projective map (3, 3); those at infinity are not finite."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return mapped(matrix, points)


def windows(cells: np.ndarray, columns: int, rows: int) -> Iterator[tuple[int, int]]:
    """Yield the first column and row of each field of columns × rows cells that holds about the most of the cells."""
    low, high = cells.min(axis=0), cells.max(axis=0)
    places = [
        (int(c), int(r))
        for c in range(min(low[0], high[0] - columns + 1), max(low[0], high[0] - columns + 1) + 1)
        for r in range(min(low[1], high[1] - rows + 1), max(low[1], high[1] - rows + 1) + 1)
    ]
    held = [
        int(((cells >= place) & (cells < (place[0] + columns, place[1] + rows))).all(axis=1).sum()) for place in places
    ]
    yield from (place for place, count in zip(places, held, strict=True) if count >= max(held) - _FEWER)
