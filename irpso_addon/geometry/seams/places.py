"""Places past the borders of islands: which border edge each is nearest to, and which texel is nearest to a place."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .edges import SeamEdges

Covered = Callable[[np.ndarray, np.ndarray], np.ndarray]

# A place may lie so many texels inside its own border: rounding of the raster that drew the island.
_INSIDE = 0.75
# Of two edges equally near, at their common corner, the one that a place lies more in front of.
_BESIDE = 1e-4
# A place within a border has a covered texel's centre less than a texel away; what has not lies past the border too.
_WITHIN = 0.99
_AROUND = np.array([(x, y) for y in (-1, 0, 1) for x in (-1, 0, 1)])


def places_beyond(
    edges: SeamEdges, view: np.ndarray, covered: Covered, shape: tuple[int, ...], reach: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 2) places past borders, and (N,) the border edge of their view that each is nearest to.

    view: (E,) from 0, who looks past an edge; each looks by itself. covered: of (n,) views and (n, 2) places, whether
    they are within the view's own border, or not to be looked at. shape: (H, W) texels; ``reach`` more are looked at on
    every side. They are found ring by ring outward, each place trying the edges of those around it.
    """
    grid = shape[1] + 2 * reach + 2, shape[0] + 2 * reach + 2

    def nearest(place: np.ndarray, edge: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return sorted keys (view and place) that are not known, and the nearest of the edges tried for each."""
        far = ((place < -reach) | (place >= (shape[1] + reach, shape[0] + reach))).any(axis=1)
        place, edge = place[~far], edge[~far]
        left = ~covered(view[edge], place)
        place, edge = place[left], edge[left]
        key = (view[edge].astype(np.int64) * grid[1] + place[:, 1] + reach) * grid[0] + place[:, 0] + reach
        if len(known):
            new = known[np.minimum(np.searchsorted(known, key), len(known) - 1)] != key
            place, edge, key = place[new], edge[new], key[new]
        cost, front = _distance(place, edge, edges)
        order = np.lexsort((edge, cost, key))
        order = order[front[order]]
        first = np.diff(key[order], prepend=-1) != 0
        return key[order][first], edge[order][first]

    def place_of(key: np.ndarray) -> np.ndarray:
        rest, x = np.divmod(key, grid[0])
        return np.stack([x, rest % grid[1]], axis=-1) - reach

    before = np.zeros(0, np.int64)
    last = nearest(*_seeds(edges), before)
    found = [last]
    for _ in range(reach - 1):
        key, edge = last
        around = (place_of(key)[:, None] + _AROUND).reshape(-1, 2)
        new = nearest(around, np.repeat(edge, len(_AROUND)), np.union1d(before, key))
        before, last = key, new
        found.append(new)
    keys, chosen = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return place_of(keys), chosen


def _seeds(edges: SeamEdges) -> tuple[np.ndarray, np.ndarray]:
    """Return places along all edges and around them, and which edge each is of."""
    length = np.linalg.norm(edges.end - edges.start, axis=-1)
    count = np.ceil(2 * length).astype(np.int64) + 1
    edge = np.repeat(np.arange(len(count)), count)
    step = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    t = (step / np.maximum(count[edge] - 1, 1))[:, None]
    place = np.floor(edges.start[edge] * (1 - t) + edges.end[edge] * t).astype(np.int64)
    return (place[:, None] + _AROUND).reshape(-1, 2), np.repeat(edge, len(_AROUND))


def _distance(place: np.ndarray, edge: np.ndarray, edges: SeamEdges) -> tuple[np.ndarray, np.ndarray]:
    """Return (N,) by which the nearest edge is chosen, and whether a place lies in front of its edge."""
    start, side = edges.start[edge], edges.end[edge] - edges.start[edge]
    away = place + 0.5 - start
    t = (away * side).sum(axis=-1) / np.maximum((side**2).sum(axis=-1), 1e-30)
    past = t - np.clip(t, 0, 1)
    distance = ((away - np.clip(t, 0, 1)[:, None] * side) ** 2).sum(axis=-1)
    cost = distance + _BESIDE * past**2 * (side**2).sum(axis=-1)
    return cost, (away * edges.outward[edge]).sum(axis=-1) > -_INSIDE


def texel_at(at: np.ndarray, wanted: np.ndarray, island: np.ndarray) -> np.ndarray:
    """Return (N,) flat indices of the texel of the wanted island whose centre is nearest to a place, −1 where none is.

    Looked for is in the texel that the place lies in, and in the eight around it.
    """
    height, width = island.shape
    result, least = np.full(len(at), -1, np.int64), np.full(len(at), _WITHIN**2)
    with np.errstate(invalid="ignore"):
        middle = np.clip(np.floor(np.nan_to_num(at, nan=-9)), -9, max(width, height) + 9).astype(np.int64)
    for offset in _AROUND:
        texel = middle + offset
        x, y = np.clip(texel, 0, (width - 1, height - 1)).T
        there = (texel == np.stack([x, y], axis=-1)).all(axis=1) & (wanted >= 0) & (island[y, x] == wanted)
        distance = ((texel + 0.5 - at) ** 2).sum(axis=-1)
        better = there & (distance < least)
        result[better], least[better] = (y * width + x)[better], distance[better]
    return result
