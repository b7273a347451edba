"""Places past the borders of islands: their nearest border edge, and the texel nearest to a place."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .edges import SeamEdges

Covered = Callable[[np.ndarray, np.ndarray], np.ndarray]

# Texels that a place may lie inside its own border: rounding of the rasterizer.
_INSIDE = 0.75
# Of two equally near edges, at their common corner, prefer the one that faces the place.
_BESIDE = 1e-4
# A place inside a border has a covered texel's centre within a texel; a place without one lies past the border too.
_WITHIN = 0.99
_AROUND = np.array([(x, y) for y in (-1, 0, 1) for x in (-1, 0, 1)])


def places_beyond(
    edges: SeamEdges, view: np.ndarray, covered: Covered, shape: tuple[int, ...], radius: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 2) places past borders, and (N,) the nearest border edge of the same view.

    view: (E,) from 0, the chart that looks past an edge; views are independent. covered: tests (n,) views and (n, 2)
    places: inside the view's own border, or to be skipped. shape: (H, W) texels; the search extends ``radius`` texels
    on every side. It proceeds ring by ring outward; each place tries the edges of its neighbours.
    """
    grid = shape[1] + 2 * radius + 2, shape[0] + 2 * radius + 2

    def nearest(place: np.ndarray, edge: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return sorted new keys (view and place), and the nearest of the edges tried for each."""
        far = ((place < -radius) | (place >= (shape[1] + radius, shape[0] + radius))).any(axis=1)
        place, edge = place[~far], edge[~far]
        left = ~covered(view[edge], place)
        place, edge = place[left], edge[left]
        key = (view[edge].astype(np.int64) * grid[1] + place[:, 1] + radius) * grid[0] + place[:, 0] + radius
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
        return np.stack([x, rest % grid[1]], axis=-1) - radius

    before = np.zeros(0, np.int64)
    last = nearest(*_seeds(edges), before)
    rings = [last]
    for _ in range(radius - 1):
        key, edge = last
        around = (place_of(key)[:, None] + _AROUND).reshape(-1, 2)
        new = nearest(around, np.repeat(edge, len(_AROUND)), np.union1d(before, key))
        before, last = key, new
        rings.append(new)
    keys, chosen = (np.concatenate(parts) for parts in zip(*rings, strict=True))
    return place_of(keys), chosen


def _seeds(edges: SeamEdges) -> tuple[np.ndarray, np.ndarray]:
    """Return places along and around all edges, and the edge of each."""
    length = np.linalg.norm(edges.end - edges.start, axis=-1)
    count = np.ceil(2 * length).astype(np.int64) + 1
    edge = np.repeat(np.arange(len(count)), count)
    step = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    t = (step / np.maximum(count[edge] - 1, 1))[:, None]
    place = np.floor(edges.start[edge] * (1 - t) + edges.end[edge] * t).astype(np.int64)
    return (place[:, None] + _AROUND).reshape(-1, 2), np.repeat(edge, len(_AROUND))


def _distance(place: np.ndarray, edge: np.ndarray, edges: SeamEdges) -> tuple[np.ndarray, np.ndarray]:
    """Return (N,) costs for the choice of the nearest edge, and whether a place lies in front of its edge."""
    start, side = edges.start[edge], edges.end[edge] - edges.start[edge]
    away = place + 0.5 - start
    t = (away * side).sum(axis=-1) / np.maximum((side**2).sum(axis=-1), 1e-30)
    past = t - np.clip(t, 0, 1)
    distance = ((away - np.clip(t, 0, 1)[:, None] * side) ** 2).sum(axis=-1)
    cost = distance + _BESIDE * past**2 * (side**2).sum(axis=-1)
    return cost, (away * edges.outward[edge]).sum(axis=-1) > -_INSIDE


def texel_at(at: np.ndarray, target_island: np.ndarray, island: np.ndarray) -> np.ndarray:
    """Return (N,) flat indices of the target island's texel whose centre is nearest to a place, −1 for none.

    Candidates are the texel that contains the place and the eight around it.
    """
    height, width = island.shape
    result, least = np.full(len(at), -1, np.int64), np.full(len(at), _WITHIN**2)
    with np.errstate(invalid="ignore"):
        middle = np.clip(np.floor(np.nan_to_num(at, nan=-9)), -9, max(width, height) + 9).astype(np.int64)
    for offset in _AROUND:
        texel = middle + offset
        x, y = np.clip(texel, 0, (width - 1, height - 1)).T
        there = (
            (texel == np.stack([x, y], axis=-1)).all(axis=1) & (target_island >= 0) & (island[y, x] == target_island)
        )
        distance = ((texel + 0.5 - at) ** 2).sum(axis=-1)
        better = there & (distance < least)
        result[better], least[better] = (y * width + x)[better], distance[better]
    return result
