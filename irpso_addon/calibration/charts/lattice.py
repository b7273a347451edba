"""Lattices of quadrilateral patches: rows and columns, in perspective."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...capture.frame.homography import mapped
from ...core.opencv import opencv

_STEP = (1.0, 1.75)  # from a patch to the next, over its detected side, which edges shorten
_ASIDE = 0.3  # most offset of the next one from the row, over the side
_ALIKE = 2.2  # area of a patch over its neighbour's
_SAME_PATCH = 0.35  # of the side: closer centres belong to one patch
_INNER = 6.0  # area of a patch over that of a region inside: above, the region is a patch of its own
_MAX_OFFSET = 0.2  # of the pitch: of a centre from its position in the lattice
_MIN_PATCHES = 7  # least patches of a lattice
_FEWER = 2  # patches below the fullest field: clutter beside a chart may fit its lattice
_REACH = 5  # cells beyond a lattice's first patches in which more are searched
_ROUNDS = 3


@dataclass(frozen=True)
class Lattice:
    """Patches in rows and columns. matrix: (3, 3), column and row of a patch's centre to pixels. cells: (K, 2)."""

    matrix: np.ndarray
    cells: np.ndarray

    def at(self, places: np.ndarray) -> np.ndarray:
        """Return pixels (…, 2) of columns and rows (…, 2)."""
        return _projected(self.matrix, np.asarray(places, np.float64))


@dataclass(frozen=True)
class _Patches:
    """centres: (N, 2). sides: (N, 2, 2), the mean vectors of opposite sides. areas: (N,)."""

    centres: np.ndarray
    sides: np.ndarray
    areas: np.ndarray


def lattices(quads: np.ndarray) -> list[Lattice]:
    """Return the lattices of quadrilaterals (N, 4, 2), those with most patches first."""
    patches = _patches(quads)
    remaining, results = set(range(len(patches.areas))), []
    for seed in np.argsort(-patches.areas):
        if seed not in remaining:
            continue
        cells = _grown(patches, int(seed))
        remaining -= set(cells)
        if len(cells) >= _MIN_PATCHES and (fitted := _fitted(patches, cells)) is not None:
            results.append(fitted[0])
            remaining -= set(fitted[1].tolist())
    return sorted(results, key=lambda lattice: -len(lattice.cells))


def _patches(quads: np.ndarray) -> _Patches:
    """Return the patches of quadrilaterals; of duplicates, the largest."""
    a, b, c, d = (quads[:, n] for n in range(4))
    first, second = ((b - a) + (c - d)) / 2, ((d - a) + (c - b)) / 2
    areas = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    centres = quads.mean(axis=1)
    selected: list[int] = []
    for n in np.argsort(-areas):
        if selected:
            others = np.array(selected)
            distance = np.linalg.norm(centres[others] - centres[n], axis=1)
            similar = areas[others] < _INNER * areas[n]
            if (similar & (distance < _SAME_PATCH * np.sqrt(areas[others]))).any():
                continue
        selected.append(int(n))
    return _Patches(centres[selected], np.stack([first, second], axis=1)[selected], areas[selected])


def _grown(patches: _Patches, seed: int) -> dict[int, tuple[int, int]]:
    """Return patch → column and row for all patches connected to a seed through neighbours."""
    cells, taken = {seed: (0, 0)}, {(0, 0)}
    queue = deque([(seed, patches.sides[seed])])
    while queue:
        n, sides = queue.popleft()
        for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
            step = np.eye(2, dtype=int)[axis] * sign
            cell = (cells[n][0] + int(step[0]), cells[n][1] + int(step[1]))
            if cell in taken or (other := _neighbour(patches, n, sides, step)) is None or other in cells:
                continue
            cells[other] = cell
            taken.add(cell)
            queue.append((other, _aligned(patches.sides[other], sides)))
    return cells


def _neighbour(patches: _Patches, n: int, sides: np.ndarray, step: np.ndarray) -> int | None:
    """Return the patch one step from patch n along its sides (2, 2), or None."""
    offsets = (patches.centres - patches.centres[n]) @ np.linalg.inv(sides)  # in sides of the patch
    along, aside = offsets @ step, np.abs(offsets @ (1 - np.abs(step)))
    ratio = patches.areas / patches.areas[n]
    fits = (along > _STEP[0]) & (along < _STEP[1]) & (aside < _ASIDE) & (ratio < _ALIKE) & (ratio > 1 / _ALIKE)
    return int(np.flatnonzero(fits)[np.argmin(along[fits] + aside[fits])]) if fits.any() else None


def _aligned(sides: np.ndarray, like: np.ndarray) -> np.ndarray:
    """Return the side vectors (2, 2) in the order and with the signs of another patch's."""
    candidates = (sides, sides[::-1] * [(1,), (-1,)], -sides, sides[::-1] * [(-1,), (1,)])
    return max(candidates, key=lambda candidate: float((candidate * like).sum()))


def _fitted(patches: _Patches, cells: dict[int, tuple[int, int]]) -> tuple[Lattice, np.ndarray] | None:
    """Fit a lattice to cells; return it and its patches, including those that ``_grown`` missed; or None."""
    cv = opencv("the search for a colour chart")
    members, places = np.array(list(cells)), np.array(list(cells.values()), np.float64)
    matrix = np.eye(3)
    for _ in range(_ROUNDS):
        pitch = float(np.sqrt(np.median(patches.areas[members])))
        homography, inside = cv.findHomography(places, patches.centres[members], cv.RANSAC, _MAX_OFFSET * pitch)
        if homography is None or inside.sum() < _MIN_PATCHES or not _spans(places[inside[:, 0] > 0]):
            return None
        matrix = homography
        members, places = _at_places(patches, matrix, places[inside[:, 0] > 0])
        if len(members) < _MIN_PATCHES:
            return None
    # By least median: centres of partly detected patches lie up to _MAX_OFFSET away.
    refined, _ = cv.findHomography(places, patches.centres[members], cv.LMEDS)
    return Lattice(matrix if refined is None else refined, np.unique(places.astype(int), axis=0)), members


def _spans(places: np.ndarray) -> bool:
    """Return whether cells span two or more rows and columns, as a homography requires."""
    return bool((np.ptp(places, axis=0) >= 1).all())


def _at_places(patches: _Patches, matrix: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the patches (K,) whose centres lie at cells of a lattice, and the cells (K, 2)."""
    low, high = known.min(axis=0) - _REACH, known.max(axis=0) + _REACH
    positions = _projected(np.linalg.inv(matrix), patches.centres)
    places = np.rint(positions)
    near = (np.abs(positions - places) < _MAX_OFFSET).all(axis=1) & ((places >= low) & (places <= high)).all(axis=1)
    # Area of the lattice's cell at each patch.
    steps = [_projected(matrix, places + step) - _projected(matrix, places) for step in np.eye(2)]
    cell = np.abs(steps[0][:, 0] * steps[1][:, 1] - steps[0][:, 1] * steps[1][:, 0])
    near &= (patches.areas < 1.1 * cell) & (patches.areas > 0.25 * cell)
    return np.flatnonzero(near), places[near]


def _projected(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Map points (…, 2) by a homography (3, 3); those at infinity are not finite."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return mapped(matrix, points)


def windows(cells: np.ndarray, columns: int, rows: int) -> Iterator[tuple[int, int]]:
    """Yield the first column and row of each field of columns × rows cells with about the most patches."""
    low, high = cells.min(axis=0), cells.max(axis=0)
    places = [
        (int(c), int(r))
        for c in range(min(low[0], high[0] - columns + 1), max(low[0], high[0] - columns + 1) + 1)
        for r in range(min(low[1], high[1] - rows + 1), max(low[1], high[1] - rows + 1) + 1)
    ]
    counts = [
        int(((cells >= place) & (cells < (place[0] + columns, place[1] + rows))).all(axis=1).sum()) for place in places
    ]
    yield from (place for place, count in zip(places, counts, strict=True) if count >= max(counts) - _FEWER)
