"""Lens distortion: a camera without distortion for drawing, where straight edges stay straight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...capture.camera import Camera

_MARGIN = 2  # pixels around the lens's view
_MAX_SIDE = 4  # times the image's longer side: near 90° off the axis an undistorted image is infinite


def undistorted_frame(camera: Camera) -> tuple[Camera, np.ndarray]:
    """Return a camera without distortion that covers the view of a distorting one, and the map between their pixels.

    The map is (H, W) int64: for each pixel of the distorting camera the flat index of the other's nearest pixel, −1
    where the lens shows nothing. Scales are equal, unless the frame would exceed four times the image.
    """
    plain = replace(camera, distortion=())
    places, _ = plain.project(camera.points(1.0))
    shown = np.isfinite(places).all(axis=-1)
    if not shown.any():
        return replace(plain, width=1, height=1), np.full(shown.shape, -1)
    low = np.floor(places[shown].min(axis=0)) - _MARGIN
    size = np.ceil(places[shown].max(axis=0)) + _MARGIN - low
    part = min(1.0, _MAX_SIDE * max(camera.width, camera.height) / size.max())
    width, height = (int(side) for side in np.ceil(size * part))
    frame = replace(
        plain, width=width, height=height, scale=tuple(part * np.asarray(plain.scale)),
        centre=tuple(part * (np.asarray(plain.centre) - low)),
    )  # fmt: skip
    x, y = np.moveaxis(np.floor(np.where(shown[..., None], part * (places - low), 0)).astype(np.int64), -1, 0)
    return frame, np.where(shown, np.clip(y, 0, height - 1) * width + np.clip(x, 0, width - 1), -1)
