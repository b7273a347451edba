"""Circles from the paths of highlights: a mirror ball on black cloth has no visible edges, only one spot per lamp."""

from __future__ import annotations

import numpy as np

from ....core.filters import blurred

_SHARED = 3  # a spot is brighter than its pixel in all but a third of the photographs
_MIN_SIGNAL = 0.1  # of white
_PER_PHOTOGRAPH = 20  # spots
_APART = 2  # pixels
_COVERED = 0.8  # of the photographs: least number with a spot on the path
_SURPLUS = 1.6  # most spots per photograph
_WIDTHS = 1.35 ** np.arange(10)  # of the smallest path
_RADII = (1.6, 2.2, 3.0)  # over the path's radius: lamps up to 77°, 54° and 39° from the viewer
_MAX_PATHS = 8  # paths


def circles_of_paths(stack: np.ndarray, smallest: float, largest: float) -> np.ndarray:
    """Return centre x, y and radius (N, 3), in pixels, of balls that may contain a path of highlights, best first.

    stack: (K, H, W) grey values over white. smallest, largest: radius of a ball. A mirror ball shows a lamp at an angle
    θ from the viewer at sin(θ / 2) of its radius, so the lamps determine how much of the disc the path covers.
    """
    places, numbers = _spots(stack)
    count = len(stack)
    if len(places) < _COVERED * count:
        return np.zeros((0, 3))
    distance = np.linalg.norm(places[:, None] - places[None], axis=-1)
    paths: list[tuple[float, float, float, float]] = []
    for width in smallest / _RADII[-1] * _WIDTHS:
        for near in np.unique(distance < 2 * width, axis=0):
            covered = len(np.unique(numbers[near]))
            if covered < _COVERED * count or near.sum() > _SURPLUS * count:
                continue
            centre = (places[near].max(axis=0) + places[near].min(axis=0)) / 2
            reach = float(np.linalg.norm(places[near] - centre, axis=-1).max())
            paths.append((2 * covered - float(near.sum()), *centre.tolist(), reach))
    distinct: list[tuple[float, float, float, float]] = []
    for path in sorted(paths, reverse=True):
        if all(np.hypot(path[1] - other[1], path[2] - other[2]) > 0.5 * other[3] for other in distinct):
            distinct.append(path)
    circles = [(x, y, factor * reach) for _, x, y, reach in distinct[:_MAX_PATHS] for factor in _RADII]
    return np.array([circle for circle in circles if smallest <= circle[2] <= largest]).reshape(-1, 3)


def _spots(stack: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return pixel coordinates (N, 2) of bright spots that few photographs share, and their photographs (N,)."""
    rank = len(stack) - 1 - max(1, len(stack) // _SHARED)
    shared_level = np.partition(stack, rank, axis=0)[rank]
    places, numbers = [], []
    for number, picture in enumerate(stack):
        signal = blurred(np.clip(picture, 0, 1) - np.clip(shared_level, 0, 1), 1.0)
        padded = np.pad(signal, _APART)
        height, width = signal.shape
        steps = range(2 * _APART + 1)
        maximum = np.max([padded[y : y + height, x : x + width] for y in steps for x in steps], axis=0)
        rows, columns = np.nonzero((signal == maximum) & (signal > _MIN_SIGNAL))
        order = np.argsort(-signal[rows, columns], kind="stable")[:_PER_PHOTOGRAPH]
        places.append(np.stack([columns[order], rows[order]], axis=-1) + 0.5)
        numbers.append(np.full(len(order), number))
    return np.concatenate(places), np.concatenate(numbers)
