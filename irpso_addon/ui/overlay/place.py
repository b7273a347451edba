"""Placement of the subject: from the domain's frame to the world, and from the world to a region's pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry.spaces import unit

_SIDES = 40  # sides of the polygon that is drawn for a circle


@dataclass(frozen=True)
class Placement:
    """Current placement of a subject. frame: (4, 4) from the domain's frame (positions, lights) to the world.

    centre: (3,) and radius of a sphere around the subject, in world units.
    """

    frame: np.ndarray
    centre: np.ndarray
    radius: float

    def directions(self, vectors: np.ndarray) -> np.ndarray:
        """Return unit vectors (N, 3) of the domain's frame in world axes."""
        return unit(vectors @ self.frame[:3, :3].T)


def placement_of(frame: np.ndarray, corners: np.ndarray) -> Placement:
    """Return the placement of points (N, 3) in the domain's frame."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    centre = (low + high) / 2
    reach = np.linalg.norm((corners - centre) @ frame[:3, :3].T, axis=1).max()
    return Placement(frame, transformed(frame, centre[None])[0], float(max(reach, 1e-9)))


def card_corners(position: np.ndarray) -> np.ndarray:
    """Return the card's corners (4, 3) in the domain's frame, counter-clockwise from the lower left.

    position: (H, W, 3) its texels' centres. The corners lie half a texel outside them.
    """
    x, y = _pitch(position)
    low, high = position[0, 0] - (x + y) / 2, position[-1, -1] + (x + y) / 2
    return np.stack([low, low + x * position.shape[1], high, low + y * position.shape[0]]).astype(np.float64)


def card_frame(position: np.ndarray) -> np.ndarray:
    """Return (4, 4) from a card's domain frame to its object's frame: width 1, centre at the origin."""
    corners = card_corners(position)
    scale = 1 / max(corners[:, 0].max() - corners[:, 0].min(), 1e-30)
    frame = np.diag([scale, scale, scale, 1.0])
    frame[:3, 3] = -scale * corners.mean(axis=0)
    return frame


def transformed(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return points (…, 3) transformed by an affine (4, 4)."""
    return np.asarray(points, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def to_pixels(perspective: np.ndarray, points: np.ndarray, size: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels (N, 2) of world points (N, 3), and (N,) bool: whether they are in front of the viewer."""
    clip = np.asarray(points, np.float64) @ perspective[:, :3].T + perspective[:, 3]
    in_front = clip[:, 3] > 1e-9
    place = clip[:, :2] / np.where(in_front, clip[:, 3], 1.0)[:, None]
    return (place * 0.5 + 0.5) * np.asarray(size, np.float64), in_front


def pixel_size(perspective: np.ndarray, point: np.ndarray, size: tuple[float, float]) -> float:
    """Return the width of a pixel in world units at a world point (3,); 0 behind the viewer."""
    depth = float(perspective[3, :3] @ point + perspective[3, 3])
    return max(0.0, 2 * depth / (size[0] * float(np.linalg.norm(perspective[0, :3]))))


def circle(centre: np.ndarray, normal: np.ndarray, radius: float, begin: float = 0.0, end: float = 1.0) -> np.ndarray:
    """Return points (N, 3) on a circle, or on its arc between two fractions of a turn."""
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    across /= np.linalg.norm(across)
    angles = 2 * np.pi * np.linspace(begin, end, _SIDES + 1)[:, None]
    return centre + radius * (np.cos(angles) * across + np.sin(angles) * np.cross(normal, across))


def _pitch(position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the vectors (3,) to the next column and the next row. A single row or column has square texels."""
    height, width = position.shape[:2]
    x = (position[0, -1] - position[0, 0]) / max(width - 1, 1)
    y = (position[-1, 0] - position[0, 0]) / max(height - 1, 1)
    if width == 1:
        x = np.array([np.linalg.norm(y) or 1.0, 0, 0])
    if height == 1:
        y = np.array([0, np.linalg.norm(x), 0])
    return x, y
