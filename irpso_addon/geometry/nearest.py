"""Nearest neighbours among points, in blocks of numpy: time grows as n log n, memory is bounded."""

from __future__ import annotations

import numpy as np

_LEAF, _CHILDREN = 8, 4  # points of a leaf; nodes of a level that are one of the level above
_BITS = 10  # of each coordinate in the order along a Z curve
_AT_ONCE = 1 << 10  # points whose neighbours are sought at a time
_MARGIN = 1 + 1e-5  # for the rounding of distances to boxes


def nearest(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return (N,) int: for each of (N, 3) points the index of the nearest of (M, 3) others, M > 0.

    Of equally near ones the first. Distances are rounded as the arrays' own numbers.
    """
    order = np.argsort(_along_curve(others), kind="stable")
    leaves = -(-len(order) // _LEAF)
    order = np.pad(order, (0, leaves * _LEAF - len(order)), mode="edge").reshape(leaves, _LEAF)
    levels = [(others[order].min(axis=1), others[order].max(axis=1), others[order[:, 0]])]
    while len(levels[-1][0]) > _CHILDREN:
        low, high, one = levels[-1]
        starts = np.arange(0, len(low), _CHILDREN)
        levels.append((np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts), one[starts]))
    result = np.empty(len(points), int)
    for start in range(0, len(points), _AT_ONCE):
        result[start : start + _AT_ONCE] = _nearest(points[start : start + _AT_ONCE], others, order, levels)
    return result


def _nearest(points: np.ndarray, others: np.ndarray, order: np.ndarray, levels: list) -> np.ndarray:
    """Return the nearest of others. order: (leaves, _LEAF) their indices. levels: boxes of nodes, and a point in each,
    leaves first. A node that is farther than a point of another is left out.
    """
    point = np.repeat(np.arange(len(points)), len(levels[-1][0]))
    node = np.tile(np.arange(len(levels[-1][0])), len(points))
    limit = np.full(len(points), np.inf, points.dtype)
    for level, (low, high, one) in reversed(list(enumerate(levels))):
        np.minimum.at(limit, point, _squared(points[point], one[node]))
        own = points[point]
        least = _squared(own, np.clip(own, low[node], high[node]))
        kept = least <= _MARGIN * limit[point]
        point, node = point[kept], node[kept]
        if level:
            node = (_CHILDREN * node[:, None] + np.arange(_CHILDREN)).ravel()
            point = np.repeat(point, _CHILDREN)
            inside = node < len(levels[level - 1][0])
            point, node = point[inside], node[inside]
    squared = _squared(points[point, None], others[order[node]])
    np.minimum.at(limit, point, squared.min(axis=1))
    pair, member = np.nonzero(squared == limit[point, None])
    first = np.full(len(points), len(others))
    np.minimum.at(first, point[pair], order[node[pair], member])
    return first


def _squared(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return (…) squared distances of points (…, 3)."""
    x, y, z = ((a[..., axis] - b[..., axis]) ** 2 for axis in range(3))
    return x + y + z


def _along_curve(points: np.ndarray) -> np.ndarray:
    """Return (N,) int places of points (N, 3) along a Z curve (Morton 1966) through their box."""
    low = points.min(axis=0)
    cell = ((points - low) * ((2**_BITS - 1) / max(float(np.ptp(points, axis=0).max()), 1e-30))).astype(np.int64)
    place = np.zeros(len(points), np.int64)
    for bit in range(_BITS):
        for axis in range(3):
            place |= (cell[:, axis] >> bit & 1) << 3 * bit + axis
    return place
