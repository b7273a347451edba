"""Poses of cameras over one plane, from homographies alone (Zhang 2000; Triggs 1998 for a plane of unknown form).

Inside, axes are OpenCV's: x right, y down, z away from the camera. Pictures are in focal lengths from the principal
point. A pose is (R, t): a place X of the world is seen at R X + t; the plane is z = 0, its front side toward +z.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_FLIP = np.diag([1.0, -1.0, -1.0])
_SLOPES = np.tan(np.radians(np.linspace(-60, 60, 13)))  # of the plane, seen from the reference photograph
_FOCALS = np.geomspace(0.55, 3.2, 9)  # times the longer side


def pose_of(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (R, t) of the homography from places of the plane, y up, to a picture in focal lengths."""
    scale = 2 / (np.linalg.norm(matrix[:, 0]) + np.linalg.norm(matrix[:, 1]))
    first, second, t = (scale * matrix * (np.sign(matrix[2, 2]) or 1.0)).T
    u, _, v = np.linalg.svd(np.stack([first, second, np.cross(first, second)], axis=1))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    return rotation, t


def camera_matrix(rotation: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return (4, 4) camera to world in Blender's axes: x right, y up, z toward the viewer."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation.T @ _FLIP
    matrix[:3, 3] = -rotation.T @ t
    return matrix


def focal_of(matrices: Sequence[np.ndarray]) -> float | None:
    """Return the focal length, in the unit of the pictures, of homographies from one plane of known form.

    matrices: to pictures from their principal points. By the two constraints of each on the image of the absolute conic
    (Zhang 2000, eq. 3 and 4); None where they tell none.
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
    """Return the form of a plane that is known by one picture of it, the focal length, and a misfit.

    matrices: homographies from the reference picture, both from their principal points in pixels. focal: where it is
    known; size: of the pictures' longer side. The form is (3, 3): from places in the plane, y up, at distance 1 along
    the reference's axis, to the reference in focal lengths. All other pictures must then show right angles and equal
    lengths (Triggs 1998); solved from a grid of slopes, then by Gauss–Newton.
    """
    stacked = np.stack(matrices)
    best, answer = np.inf, np.array([0.0, 0.0, np.log(focal or size)])
    for log_focal in np.log([focal] if focal else _FOCALS * size):
        for a in _SLOPES:
            for b in _SLOPES:
                misfit = float(np.abs(_violations(stacked, np.array([a, b, log_focal]))).sum())
                if misfit < best:
                    best, answer = misfit, np.array([a, b, log_focal])
    free = 2 if focal else 3
    for _ in range(30):
        now = _violations(stacked, answer)
        slopes = np.stack([(_violations(stacked, answer + 1e-5 * np.eye(3)[k]) - now) / 1e-5 for k in range(free)], -1)
        weight = 1 / np.maximum(np.abs(now), 0.01)  # least absolute values
        left = slopes.T @ (weight[:, None] * slopes) + 1e-9 * np.eye(free)
        step = -np.linalg.solve(left, slopes.T @ (weight * now))
        answer[:free] += np.clip(step, -0.3, 0.3)
    return form(answer[:2]), float(np.exp(answer[2])), float(np.abs(_violations(stacked, answer)).mean())


def form(slopes: np.ndarray) -> np.ndarray:
    """Return (3, 3) from places (x, y up) of a plane to the rays of the picture that shows it at distance 1.

    slopes: the plane is z = 1 + slopes · (x, y) in the camera's axes.
    """
    normal = np.array([slopes[0], slopes[1], -1.0])
    normal /= np.linalg.norm(normal)  # toward the camera
    up = np.array([0.0, -1.0, 0.0])
    up = up - normal * (up @ normal)
    up /= np.linalg.norm(up)
    return np.stack([np.cross(up, normal), up, np.array([0.0, 0.0, 1.0])], axis=1)


def _violations(matrices: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return (2 K,) cosines between the axes of the plane in all pictures, and differences of their lengths."""
    focal = np.exp(values[2])
    scale = np.diag([1 / focal, 1 / focal, 1.0])
    seen = scale @ matrices @ np.linalg.inv(scale) @ form(values[:2])
    a, b = seen[:, :, 0], seen[:, :, 1]
    first, second = np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)
    return np.concatenate([(a * b).sum(axis=1) / (first * second), (first - second) / np.sqrt(first * second)])
