"""Circles that an image's edges may outline: votes of edges for centres (Hough transform, Duda and Hart 1972)."""

from __future__ import annotations

import numpy as np

from ....core.filters import blurred
from .edges import Edges

_STEP = 1.09  # ratio of neighbouring radii
_EDGES = 0.2  # of the pixels: the strongest edges vote
_AROUND = 0.05  # of the images' width: deviation of the surroundings that an edge stands out from
_BIN = 0.09  # of the radius: side of an accumulator's cell
_A_RADIUS = 24  # candidates of one radius
_APART = 0.35  # of the radius: centres closer than that, at like radii, are one candidate


def candidates(edges: Edges, smallest: float, largest: float, most: int) -> np.ndarray:
    """Return (N, 3) centre x, y and radius in pixels, the best supported first, N ≤ ``most``.

    Each edge pixel votes for the centres a radius away on both sides of it, along its gradient (Kimme, Ballard and
    Sklansky 1975), for radii between ``smallest`` and ``largest``.
    """
    strength = edges.strength
    # Over its surroundings: the edges of a patterned subject are five times as strong as those of a dark ball.
    strength = strength / (blurred(strength, _AROUND * strength.shape[1]) + np.median(strength))
    floor = max(float(np.quantile(strength, 1 - _EDGES)), 1e-9)
    rows, columns = np.nonzero(strength > floor)
    nx, ny = (part[rows, columns] for part in edges.normal)
    weight = np.minimum(strength[rows, columns] / floor - 1, 2.0)
    found = []
    count = int(np.ceil(np.log(largest / smallest) / np.log(_STEP))) + 1
    for radius in smallest * _STEP ** np.arange(count):
        found.append(_of_radius(columns + 0.5, rows + 0.5, nx, ny, weight, radius, edges.size))
    every = np.concatenate(found)
    every = every[np.argsort(-every[:, 3], kind="stable")]
    kept: list[np.ndarray] = []
    for circle in every:
        if not any(_alike(circle, other) for other in kept):
            kept.append(circle)
            if len(kept) == most:
                break
    return np.array(kept).reshape(-1, 4)[:, :3]


def _of_radius(
    x: np.ndarray, y: np.ndarray, nx: np.ndarray, ny: np.ndarray, weight: np.ndarray, radius: float,
    shape: tuple[int, int],
) -> np.ndarray:  # fmt: skip
    """Return (N, 4) x, y, radius and votes over the circumference, of the best centres for one radius."""
    cell = max(_BIN * radius, 0.7)
    height, width = (int(np.ceil(side / cell)) + 1 for side in shape)
    votes = np.zeros(height * width)
    for sign in (-1, 1):
        cx, cy = x + sign * radius * nx, y + sign * radius * ny
        inside = (cx >= 0) & (cx < shape[1]) & (cy >= 0) & (cy < shape[0])
        at = (cy[inside] / cell).astype(int) * width + (cx[inside] / cell).astype(int)
        votes += np.bincount(at, weight[inside], height * width)
    padded = np.pad(votes.reshape(height, width), 1)
    pooled = np.sum([padded[j : j + height, i : i + width] for j in range(3) for i in range(3)], axis=0)
    ranks = np.argsort(-pooled.ravel(), kind="stable")[: 12 * _A_RADIUS]
    kept: list[tuple[int, int]] = []
    for at in ranks:
        row, column = divmod(int(at), width)
        if all(max(abs(row - r), abs(column - c)) > 2 for r, c in kept):
            kept.append((row, column))
            if len(kept) == _A_RADIUS:
                break
    rows, columns = np.array(kept).T
    score = pooled[rows, columns] / (2 * np.pi * radius)
    return np.stack([(columns + 0.5) * cell, (rows + 0.5) * cell, np.full(len(rows), radius), score], axis=-1)


def _alike(one: np.ndarray, other: np.ndarray) -> bool:
    away = np.hypot(one[0] - other[0], one[1] - other[1])
    return bool(away < _APART * other[2] and abs(np.log(one[2] / other[2])) < 1.5 * np.log(_STEP))
