"""Cameras with lens distortion, in which straight edges are bent: the plain camera in which they can be drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...capture.camera import Camera

_MARGIN = 2  # pixels around what the lens shows
_LARGEST = 4  # times the image's longer side: near 90° off the axis a plain picture has no end


def undistorted_frame(camera: Camera) -> tuple[Camera, np.ndarray]:
    """Return a camera without distortion whose frame holds all that a distorting one shows, and where its pixels fall.

    The second is (H, W) int64: for each pixel of the camera the flat index of the nearest pixel of the other, −1 where
    the lens shows nothing. Both have the same scale, unless the frame would be wider than four times the image.
    """
    plain = replace(camera, distortion=())
    places, _ = plain.project(camera.points(1.0))
    shown = np.isfinite(places).all(axis=-1)
    if not shown.any():
        return replace(plain, width=1, height=1), np.full(shown.shape, -1)
    low = np.floor(places[shown].min(axis=0)) - _MARGIN
    size = np.ceil(places[shown].max(axis=0)) + _MARGIN - low
    part = min(1.0, _LARGEST * max(camera.width, camera.height) / size.max())
    width, height = (int(side) for side in np.ceil(size * part))
    frame = replace(
        plain, width=width, height=height, scale=tuple(part * np.asarray(plain.scale)),
        centre=tuple(part * (np.asarray(plain.centre) - low)),
    )  # fmt: skip
    x, y = np.moveaxis(np.floor(np.where(shown[..., None], part * (places - low), 0)).astype(np.int64), -1, 0)
    return frame, np.where(shown, np.clip(y, 0, height - 1) * width + np.clip(x, 0, width - 1), -1)
