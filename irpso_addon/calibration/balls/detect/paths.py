"""Circles from the paths of highlights: on black cloth a mirror ball shows no edge, and one spot for each lamp."""

from __future__ import annotations

import numpy as np

from ....core.filters import blurred

_SHARED = 3  # a spot is brighter than the photographs' highest third
_LEAST = 0.1  # of white
_A_PHOTOGRAPH = 20  # spots
_APART = 2  # pixels
_COVERED = 0.8  # of the photographs: each has a spot on the path
_SURPLUS = 1.6  # spots for each photograph
_WIDTHS = 1.35 ** np.arange(10)  # of the smallest path
_RADII = (1.6, 2.2, 3.0)  # of the path's reach: lamps up to 77°, 54° and 39° from the viewer
_MOST = 8  # paths


def circles_of_paths(stack: np.ndarray, smallest: float, largest: float) -> np.ndarray:
    """Return (N, 3) centre x, y and radius in pixels of balls on which highlights' paths may lie, best first.

    stack: (K, H, W) grey values over white. smallest, largest: radius of a ball. A mirror ball shows the light of a
    lamp θ from the viewer at sin(θ / 2) of its radius, so that the path fills a part of the disc that depends on the
    lamps.
    """
    places, numbers = _spots(stack)
    count = len(stack)
    if len(places) < _COVERED * count:
        return np.zeros((0, 3))
    away = np.linalg.norm(places[:, None] - places[None], axis=-1)
    found: list[tuple[float, float, float, float]] = []
    for width in smallest / _RADII[-1] * _WIDTHS:
        for near in np.unique(away < 2 * width, axis=0):
            covered = len(np.unique(numbers[near]))
            if covered < _COVERED * count or near.sum() > _SURPLUS * count:
                continue
            centre = (places[near].max(axis=0) + places[near].min(axis=0)) / 2
            reach = float(np.linalg.norm(places[near] - centre, axis=-1).max())
            found.append((2 * covered - float(near.sum()), *centre.tolist(), reach))
    kept: list[tuple[float, float, float, float]] = []
    for path in sorted(found, reverse=True):
        if all(np.hypot(path[1] - other[1], path[2] - other[2]) > 0.5 * other[3] for other in kept):
            kept.append(path)
    circles = [(x, y, factor * reach) for _, x, y, reach in kept[:_MOST] for factor in _RADII]
    return np.array([circle for circle in circles if smallest <= circle[2] <= largest]).reshape(-1, 3)


def _spots(stack: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return pixel coordinates (N, 2) of the brightest spots that few photographs share, and photographs (N,)."""
    rank = len(stack) - 1 - max(1, len(stack) // _SHARED)
    common = np.partition(stack, rank, axis=0)[rank]
    places, numbers = [], []
    for number, picture in enumerate(stack):
        alone = blurred(np.clip(picture, 0, 1) - np.clip(common, 0, 1), 1.0)
        padded = np.pad(alone, _APART)
        height, width = alone.shape
        steps = range(2 * _APART + 1)
        highest = np.max([padded[y : y + height, x : x + width] for y in steps for x in steps], axis=0)
        rows, columns = np.nonzero((alone == highest) & (alone > _LEAST))
        order = np.argsort(-alone[rows, columns], kind="stable")[:_A_PHOTOGRAPH]
        places.append(np.stack([columns[order], rows[order]], axis=-1) + 0.5)
        numbers.append(np.full(len(order), number))
    return np.concatenate(places), np.concatenate(numbers)
