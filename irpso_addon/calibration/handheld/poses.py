"""Poses of cameras over one plane, from homographies alone (Zhang 2000; Triggs 1998 for a plane of unknown shape).

Axes are OpenCV's: x right, y down, z away from the camera. Image coordinates are in focal lengths from the principal
point. A pose (R, t) maps a point X of the world to R X + t in camera axes; the plane is z = 0, its front toward +z.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_FLIP = np.diag([1.0, -1.0, -1.0])
_SLOPES = np.tan(np.radians(np.linspace(-60, 60, 13)))  # of the plane, in the reference camera's axes
_FOCALS = np.geomspace(0.55, 3.2, 9)  # times the longer side


def pose_of(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the pose (R, t) of a homography from the plane, y up, to image coordinates in focal lengths."""
    scale = 2 / (np.linalg.norm(matrix[:, 0]) + np.linalg.norm(matrix[:, 1]))
    first, second, t = (scale * matrix * (np.sign(matrix[2, 2]) or 1.0)).T
    u, _, v = np.linalg.svd(np.stack([first, second, np.cross(first, second)], axis=1))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    return rotation, t


def camera_matrix(rotation: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return camera to world (4, 4) in Blender's axes: x right, y up, z toward the viewer."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation.T @ _FLIP
    matrix[:3, 3] = -rotation.T @ t
    return matrix


def focal_of(matrices: Sequence[np.ndarray]) -> float | None:
    """Return the focal length, in the unit of image coordinates, by homographies from a plane of known shape.

    matrices: to coordinates from the principal points. Each gives two constraints on the image of the absolute conic
    (Zhang 2000, eq. 3 and 4). None if they do not determine it.
    """
    rows, sides = [], []
    for matrix in matrices:
        a, b = (matrix / np.linalg.norm(matrix[:, :2])).T[:2]
        rows += [a[0] * b[0] + a[1] * b[1], a[0] ** 2 + a[1] ** 2 - b[0] ** 2 - b[1] ** 2]
        sides += [-a[2] * b[2], b[2] ** 2 - a[2] ** 2]
    row, side = np.array(rows), np.array(sides)
    inverse = float(row @ side / max(row @ row, 1e-300))
    return 1 / np.sqrt(inverse) if inverse > 0 else None


def plane_of(matrices: Sequence[np.ndarray], focal: float | None, size: float) -> tuple[np.ndarray, float, float]:
    """Return the homography of a plane of unknown shape, the focal length, and a misfit (Triggs 1998).

    matrices: homographies from the reference image, pixels from the principal points. focal: None if unknown. size: of
    the images' longer side, pixels. The first result (3, 3) maps the plane, y up, at distance 1 along the reference's
    axis, to the reference in focal lengths. All other images must then preserve right angles and equal lengths. The
    solution is by a grid of slopes, then by Gauss–Newton.
    """
    stacked = np.stack(matrices)
    best, solution = np.inf, np.array([0.0, 0.0, np.log(focal or size)])
    for log_focal in np.log([focal] if focal else _FOCALS * size):
        for a in _SLOPES:
            for b in _SLOPES:
                misfit = float(np.abs(_violations(stacked, np.array([a, b, log_focal]))).sum())
                if misfit < best:
                    best, solution = misfit, np.array([a, b, log_focal])
    free = 2 if focal else 3
    for _ in range(30):
        current = _violations(stacked, solution)
        slopes = np.stack(
            [(_violations(stacked, solution + 1e-5 * np.eye(3)[k]) - current) / 1e-5 for k in range(free)], -1
        )
        weight = 1 / np.maximum(np.abs(current), 0.01)  # least absolute values
        left = slopes.T @ (weight[:, None] * slopes) + 1e-9 * np.eye(free)
        step = -np.linalg.solve(left, slopes.T @ (weight * current))
        solution[:free] += np.clip(step, -0.3, 0.3)
    return form(solution[:2]), float(np.exp(solution[2])), float(np.abs(_violations(stacked, solution)).mean())


def form(slopes: np.ndarray) -> np.ndarray:
    """Return the map (3, 3) from coordinates (x, y up) of a plane at distance 1 to rays of the camera.

    slopes: the plane is z = 1 + slopes · (x, y) in the camera's axes.
    """
    normal = np.array([slopes[0], slopes[1], -1.0])
    normal /= np.linalg.norm(normal)  # toward the camera
    up = np.array([0.0, -1.0, 0.0])
    up = up - normal * (up @ normal)
    up /= np.linalg.norm(up)
    return np.stack([np.cross(up, normal), up, np.array([0.0, 0.0, 1.0])], axis=1)


def _violations(matrices: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return cosines between the plane's axes in all images, then relative differences of their lengths, (2 K,)."""
    focal = np.exp(values[2])
    scale = np.diag([1 / focal, 1 / focal, 1.0])
    projected = scale @ matrices @ np.linalg.inv(scale) @ form(values[:2])
    a, b = projected[:, :, 0], projected[:, :, 1]
    first, second = np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)
    return np.concatenate([(a * b).sum(axis=1) / (first * second), (first - second) / np.sqrt(first * second)])
