"""Finds the texel under a click."""

from __future__ import annotations

import numpy as np

_BLOCK = 1 << 17  # triangles per block, which bounds the memory


def view_ray(
    perspective: np.ndarray, place: tuple[float, float], size: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return origin (3,), on the near plane, and unit direction (3,) of the view ray at a pixel, in world space.

    perspective: (4, 4) world to clip coordinates. place, size: of the click and of the region, in pixels.
    """
    inverse = np.linalg.inv(np.asarray(perspective, np.float64))
    x, y = 2 * place[0] / size[0] - 1, 2 * place[1] / size[1] - 1
    near, far = (inverse @ np.array([[x, y, -1, 1], [x, y, 1, 1]], np.float64).T).T
    near, far = near[:3] / near[3], far[:3] / far[3]
    return near, (far - near) / np.linalg.norm(far - near)


def first_hit(origin: np.ndarray, direction: np.ndarray, triangles: np.ndarray) -> tuple[int, np.ndarray, float] | None:
    """Return index, barycentric weights (3,) and distance of the first of (T, 3, 3) triangles that a ray hits.

    None if it hits none. Both sides of a triangle count (Möller and Trumbore 1997).
    """
    best: tuple[int, np.ndarray, float] | None = None
    for start in range(0, len(triangles), _BLOCK):
        corners = np.asarray(triangles[start : start + _BLOCK], np.float64)
        first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        p = np.cross(direction, second)
        determinant = np.einsum("ij,ij->i", first, p)
        determinant = np.where(determinant == 0, np.nan, determinant)  # the ray is parallel to the triangle's plane
        offset = origin - corners[:, 0]
        u = np.einsum("ij,ij->i", offset, p) / determinant
        q = np.cross(offset, first)
        v = q @ direction / determinant
        distance = np.einsum("ij,ij->i", q, second) / determinant
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0)
        if not hit.any():
            continue
        index = int(np.flatnonzero(hit)[np.argmin(distance[hit])])
        if best is None or distance[index] < best[2]:
            weights = np.array([1 - u[index] - v[index], u[index], v[index]])
            best = (start + index, weights, float(distance[index]))
    return best


def texel_at(uv: np.ndarray, shape: tuple[int, int]) -> tuple[int, int] | None:
    """Return (row, column) of the texel at texture coordinates (2,), None outside the unit square."""
    if not ((uv >= 0) & (uv <= 1)).all():
        return None
    height, width = shape
    return min(int(uv[1] * height), height - 1), min(int(uv[0] * width), width - 1)


def nearest_texel(solvable: np.ndarray, row: int, column: int, reach: int) -> tuple[int, int] | None:
    """Return the nearest solvable texel, at most ``reach`` rows and columns away, or None. solvable: (H, W) bool."""
    top, left = max(row - reach, 0), max(column - reach, 0)
    rows, columns = np.nonzero(solvable[top : row + reach + 1, left : column + reach + 1])
    if not len(rows):
        return None
    nearest = int(np.argmin((rows + top - row) ** 2 + (columns + left - column) ** 2))
    return int(rows[nearest] + top), int(columns[nearest] + left)
