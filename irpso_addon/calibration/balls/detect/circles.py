"""Candidate circles by Hough transform: edge pixels vote for centres (Duda and Hart 1972)."""

from __future__ import annotations

import numpy as np

from ....core.filters import blurred
from .edges import Edges

_STEP = 1.09  # ratio of neighbouring radii
_EDGES = 0.2  # of the pixels: the strongest edges vote
_SURROUNDINGS = 0.05  # of the images' width: sigma of the blur by which edge strengths are normalised
_BIN = 0.09  # of the radius: side of an accumulator's cell
_PER_RADIUS = 24  # candidates
_APART = 0.35  # of the radius: closer centres, at similar radii, are one candidate


def candidates(edges: Edges, smallest: float, largest: float, most: int) -> np.ndarray:
    """Return centre x, y and radius (N, 3) in pixels, most votes first, N ≤ ``most``.

    Each edge pixel votes for the centres a radius away on both sides of it, along its gradient (Kimme, Ballard and
    Sklansky 1975), for radii between ``smallest`` and ``largest``.
    """
    strength = edges.strength
    # Relative to the surroundings: edges of a patterned subject are five times as strong as those of a dark ball.
    strength = strength / (blurred(strength, _SURROUNDINGS * strength.shape[1]) + np.median(strength))
    floor = max(float(np.quantile(strength, 1 - _EDGES)), 1e-9)
    rows, columns = np.nonzero(strength > floor)
    nx, ny = (part[rows, columns] for part in edges.normal)
    weight = np.minimum(strength[rows, columns] / floor - 1, 2.0)
    per_radius = [np.zeros((0, 4))]  # pictures too small for balls have no radius
    count = int(np.ceil(np.log(largest / smallest) / np.log(_STEP))) + 1
    for radius in smallest * _STEP ** np.arange(count):
        per_radius.append(_best_centres(columns + 0.5, rows + 0.5, nx, ny, weight, radius, edges.size))
    ranked = np.concatenate(per_radius)
    ranked = ranked[np.argsort(-ranked[:, 3], kind="stable")]
    selected: list[np.ndarray] = []
    for circle in ranked:
        if not any(_same_circle(circle, other) for other in selected):
            selected.append(circle)
            if len(selected) == most:
                break
    return np.array(selected).reshape(-1, 4)[:, :3]


def _best_centres(
    x: np.ndarray, y: np.ndarray, nx: np.ndarray, ny: np.ndarray, weight: np.ndarray, radius: float,
    shape: tuple[int, int],
) -> np.ndarray:  # fmt: skip
    """Return the best centres for one radius (N, 4): x, y, radius, votes over the circumference."""
    cell = max(_BIN * radius, 0.7)
    height, width = (int(np.ceil(side / cell)) + 1 for side in shape)
    votes = np.zeros(height * width)
    for sign in (-1, 1):
        cx, cy = x + sign * radius * nx, y + sign * radius * ny
        inside = (cx >= 0) & (cx < shape[1]) & (cy >= 0) & (cy < shape[0])
        index = (cy[inside] / cell).astype(int) * width + (cx[inside] / cell).astype(int)
        votes += np.bincount(index, weight[inside], height * width)
    padded = np.pad(votes.reshape(height, width), 1)
    pooled = np.sum([padded[j : j + height, i : i + width] for j in range(3) for i in range(3)], axis=0)
    order = np.argsort(-pooled.ravel(), kind="stable")[: 12 * _PER_RADIUS]
    selected: list[tuple[int, int]] = []
    for index in order:
        row, column = divmod(int(index), width)
        if all(max(abs(row - r), abs(column - c)) > 2 for r, c in selected):
            selected.append((row, column))
            if len(selected) == _PER_RADIUS:
                break
    rows, columns = np.array(selected).T
    score = pooled[rows, columns] / (2 * np.pi * radius)
    return np.stack([(columns + 0.5) * cell, (rows + 0.5) * cell, np.full(len(rows), radius), score], axis=-1)


def _same_circle(one: np.ndarray, other: np.ndarray) -> bool:
    distance = np.hypot(one[0] - other[0], one[1] - other[1])
    return bool(distance < _APART * other[2] and abs(np.log(one[2] / other[2])) < 1.5 * np.log(_STEP))
