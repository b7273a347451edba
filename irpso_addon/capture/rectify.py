"""Rectification of a tilted card, by a rotation of the camera about its centre.

Hartley & Zisserman 2004, Multiple View Geometry, Section 8.4.2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .camera import Camera
from .distortion import undistorted
from .errors import CaptureError

MIN_SIDE = 4  # pixels of a framed picture
_MOST_PIXELS = 4  # of a rectified card, over the photograph's
_ANGLE_TOLERANCE = 10.0  # degrees: of a right angle between two sides, for the camera's lens


def size_in_pixels(width: float, height: float, scale: float) -> tuple[int, int]:
    """Return the size of a framed picture. Raises CaptureError if the scale leaves less than MIN_SIDE pixels."""
    longest = max(width, height)
    if scale < 1 and round(scale * longest) < MIN_SIDE:
        raise CaptureError(
            f"scale is {scale:g}: that leaves less than {MIN_SIDE} of {longest:.0f} pixels; give"
            f" {min(1.0, MIN_SIDE / longest):.2g} or more",
            "value",
        )
    return max(MIN_SIDE, round(scale * width)), max(MIN_SIDE, round(scale * height))


def rectified_camera(camera: Camera, corners: Sequence[tuple[float, float]], scale: float) -> Camera:
    """Return the camera rotated to face the rectangle of the corners, and cropped to it.

    corners: (x, y) of four, clockwise, from the picture's upper left corner on; the first becomes the upper left one.
    The resolution is that of the rectangle's best resolved side in the image, times ``scale``. Raises CaptureError
    where they are not those of a rectangle, or the result has more than four times the picture's pixels.
    """
    places = np.array(corners, np.float64) * (1, -1) + (0, camera.height)
    rays = _rays(camera, places)
    axes = _axes(camera, rays)
    if camera.perspective:
        rays /= -(rays @ axes[:, 2:])  # onto the card's plane at distance 1
    flat = rays @ axes[:, :2]
    sides, lengths = (np.linalg.norm(np.roll(ends, -1, axis=0) - ends, axis=1) for ends in (places, flat))
    finest = float((sides / lengths).max())
    low = flat[[0, 3], 0].mean(), flat[[2, 3], 1].mean()
    high = flat[[1, 2], 0].mean(), flat[[0, 1], 1].mean()
    across, upward = finest * (high[0] - low[0]), finest * (high[1] - low[1])
    if not 0 < across * upward * scale**2 <= _MOST_PIXELS * camera.width * camera.height:
        raise CaptureError(
            f"corners: the card would have {across:.0f}×{upward:.0f} pixels, as one seen almost from its edge; check if"
            " two of them lie too close together, or give a smaller scale",
            "corners",
        )
    width, height = size_in_pixels(across, upward, scale)
    pixels = width / (high[0] - low[0]), height / (high[1] - low[1])
    matrix = np.array(camera.matrix, np.float64)
    matrix[:3, :3] = matrix[:3, :3] @ axes
    return Camera(width, height, pixels, (-low[0] * pixels[0], -low[1] * pixels[1]), matrix, camera.perspective)


def _rays(camera: Camera, corners: np.ndarray) -> np.ndarray:
    """Return (4, 3) the rays to z = −1, in the camera's axes, through corners (4, 2) in pixels from the lower left."""
    if not ((corners >= 0) & (corners <= (camera.width, camera.height))).all():
        raise CaptureError(
            f"corners: one lies outside the picture of {camera.width}×{camera.height} pixels; count from its upper left"
            " corner, x to the right and y down",
            "corners",
        )
    if not (turns(corners) < 0).all():
        raise CaptureError(
            "corners: they do not go around a rectangle clockwise; give them from the upper left one, to the right and"
            " down",
            "corners",
        )
    plane = (corners - camera.centre) / np.asarray(camera.scale)
    if any(camera.distortion):
        plane = undistorted(plane, camera.distortion)
    if not np.isfinite(plane).all():
        raise CaptureError(
            "corners: one lies where a lens of this distortion shows nothing; check the camera's distortion and"
            " fov_degrees, and the corners",
            "corners",
        )
    return np.concatenate([plane, np.full((4, 1), -1.0)], axis=-1)


def turns(corners: np.ndarray) -> np.ndarray:
    """Return (4,) the cross product of the sides before and after each of four corners (4, 2), beside the first.

    Above 0 for a turn from x toward y: anticlockwise with y up, clockwise with y down.
    """
    sides = np.roll(corners, -1, axis=0) - corners
    (x, y), (next_x, next_y) = sides.T, np.roll(sides, -1, axis=0).T
    return np.asarray(x * next_y - y * next_x)


def _axes(camera: Camera, rays: np.ndarray) -> np.ndarray:
    """Return (3, 3), as columns in the camera's axes: right, up and toward the viewer of a rectangle.

    rays: (4, 3) through its corners, to z = −1. The planes through the centre of projection and two opposite sides
    intersect in a line parallel to both. Under an orthographic camera the card faces the camera.
    """
    top, right, bottom, left = np.roll(rays, -1, axis=0) - rays
    across, upward = top - bottom, left - right
    if camera.perspective:
        planes = np.cross(rays, np.roll(rays, -1, axis=0))
        lines = np.cross(planes[0], planes[2]), np.cross(planes[3], planes[1])
        across, upward = (line * np.sign(line @ rough) for line, rough in zip(lines, (across, upward), strict=True))
    across, upward = across / np.linalg.norm(across), upward / np.linalg.norm(upward)
    angle = math.degrees(math.acos(np.clip(across @ upward, -1, 1)))
    if not abs(angle - 90) <= _ANGLE_TOLERANCE:
        raise CaptureError(
            f"corners: seen through this lens their sides meet at {angle:.0f}°, not at a right angle; check them, and"
            " the camera's fov_degrees",
            "corners",
        )
    toward = np.cross(across, upward)
    toward /= np.linalg.norm(toward)
    return np.stack([across, np.cross(toward, across), toward], axis=-1)
