"""Homographies: maps between images of a plane (Hartley & Zisserman 2004, Multiple View Geometry, Chapter 4)."""

from __future__ import annotations

import numpy as np


def mapped(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return (…, 2) the images of points (…, 2) under a homography (3, 3)."""
    homogeneous = points @ matrix[:, :2].T + matrix[:, 2]
    return homogeneous[..., :2] / homogeneous[..., 2:]


def homography(points: np.ndarray, images: np.ndarray) -> np.ndarray:
    """Return the (3, 3) homography from points (N, 2) to images (N, 2), N ≥ 4; its last entry is 1.

    Least squares by the normalised direct linear transform (Algorithm 4.2).
    """
    first, second = _normaliser(points), _normaliser(images)
    a, b = mapped(first, points), mapped(second, images)
    ones, zeros = np.ones((len(a), 1)), np.zeros((len(a), 3))
    homogeneous = np.concatenate([a, ones], axis=1)
    rows = np.concatenate([
        np.concatenate([homogeneous, zeros, -b[:, :1] * homogeneous], axis=1),
        np.concatenate([zeros, homogeneous, -b[:, 1:] * homogeneous], axis=1),
    ])  # fmt: skip
    solution = np.linalg.svd(rows, full_matrices=True)[2][-1].reshape(3, 3)
    matrix = np.linalg.inv(second) @ solution @ first
    return matrix / matrix[2, 2]


def _normaliser(points: np.ndarray) -> np.ndarray:
    """Return the (3, 3) similarity that brings points to mean 0 and mean distance √2."""
    middle = points.mean(axis=0)
    scale = np.sqrt(2) / max(float(np.linalg.norm(points - middle, axis=1).mean()), 1e-300)
    return np.array([(scale, 0, -scale * middle[0]), (0, scale, -scale * middle[1]), (0, 0, 1)])
