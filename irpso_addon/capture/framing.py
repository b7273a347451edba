"""The part of a camera's pictures that is used: cropped, made smaller, or a tilted card seen straight from the front.

A picture of a plane from the front is the picture of a camera that is turned about its place (Hartley & Zisserman 2004,
Multiple View Geometry, Section 8.4.2). So the result is a capture like any other: only its cameras are turned and
their pictures resampled; the world and the lights stay.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from ..core.optional import present
from ..core.steps import at_once
from .bounds import bounded, weight_and_clipped
from .camera import Camera
from .distortion import undistorted
from .errors import CaptureError
from .frame.find import Found, corner_steps
from .types import Capture

AUTO = "auto"  # corners that are found in the photographs

Point = tuple[float, float]
_SQUARE = 10.0  # degrees: how far the angle between two sides may be from a right one, with the lens as given
_LEAST_SIDE = 4  # pixels of a framed picture
_BLOCK = 1 << 19  # samples resampled at a time
_TOUCHED = 1e-3  # share of a pixel above which a clipped sample makes it a bound


@dataclass(frozen=True)
class Framing:
    """What is used of pictures. Pixels count from the upper left corner, to the right and down.

    crop: x, y, width, height. corners: (x, y) of a flat rectangle's four, clockwise as seen; the first becomes the
    upper left one; AUTO: those of printed markers' field, or of the one rectangle that shows. scale: of the pictures'
    size, above 0 and up to 1. card_width: of the card that is then shown, in the unit of the lights' positions.
    Raises CaptureError where they contradict each other.
    """

    crop: tuple[float, float, float, float] | None = None
    corners: tuple[Point, Point, Point, Point] | Literal["auto"] | None = None
    scale: float = 1.0
    card_width: float | None = None

    def __post_init__(self) -> None:
        if self.crop and not all(float(value).is_integer() for value in self.crop):
            raise CaptureError("crop: give four whole numbers, x, y, width and height", "value")
        if self.corners and self.corners != AUTO and len(self.corners) != 4:
            raise CaptureError(f"corners: give four, not {len(self.corners)}", "value")
        if self.crop and self.corners:
            raise CaptureError("crop and corners: give one of them", "value")
        if not 0 < self.scale <= 1:
            raise CaptureError(f"scale is {self.scale:g}; give a number above 0 and up to 1", "value")
        if self.card_width is not None and not 0 < self.card_width < math.inf:
            raise CaptureError(f"card_width is {self.card_width:g}; give a length above 0", "value")


def framed_steps(capture: Capture, framing: Framing) -> Generator[float, None, Capture]:
    """Return a capture of the chosen part of the pictures, which are resampled as they are read.

    Yields the fraction done while corners are searched.

    A framed pixel is the weighted mean of what it shows; it is a lower bound where a part of it is clipped. A scale
    applies to all cameras, the others to a capture of one. Raises CaptureError where the part is none of the picture,
    the corners are not a rectangle's under the camera's lens, or are not found.
    """
    if framing == Framing():
        return capture
    if framing.corners == AUTO:
        framing, _ = yield from found_corner_steps(capture, framing)
    part = next((name for name in ("crop", "corners", "card_width") if getattr(framing, name)), None)
    if part and len(capture.cameras) != 1:
        raise CaptureError(f"{part}: capture '{capture.name}' has {len(capture.cameras)} cameras; it is for one", part)
    views = [_view(camera, framing) for camera in capture.cameras]
    observations = tuple(
        replace(shot, read=partial(_read, shot.read, views[shot.camera])) for shot in capture.observations
    )
    masks = tuple(view.mask(mask) for view, mask in zip(views, capture.masks, strict=True))
    if not all(mask.any() for mask in masks):
        raise CaptureError(
            f"{part or 'scale'}: the mask of '{capture.name}' leaves no pixel of this part; choose another part",
            "mask_empty",
        )
    distance = capture.card_distance
    if framing.card_width is not None:
        distance = _distance(views[0].camera, framing.card_width)
    return replace(
        capture, observations=observations, masks=masks, cameras=tuple(v.camera for v in views), card_distance=distance
    )


framed = at_once("framed", framed_steps)


def found_corner_steps(capture: Capture, framing: Framing) -> Generator[float, None, tuple[Framing, Found]]:
    """Return the framing with corners found in the photographs, and how: see ``corner_steps``.

    Printed markers also give the card's width, in millimetres, where neither it nor the card's distance is known.
    """
    found = yield from corner_steps(capture)
    first, second, third, fourth = found.corners
    width = framing.card_width
    if width is None and capture.card_distance is None and capture.cameras[0].perspective:
        width = found.width
    return replace(framing, corners=(first, second, third, fourth), card_width=width), found


with_found_corners = at_once("with_found_corners", found_corner_steps)


@dataclass(frozen=True)
class _View:
    """A framed picture. camera: its own. places: pixel coordinates (…, 2) in it → in the picture (…, 2).

    count: samples of a pixel along each side. window: (x0, y0, width, height) where it is a part as it is, else None.
    upright: its rows and columns are the picture's.
    """

    camera: Camera
    places: Callable[[np.ndarray], np.ndarray]
    count: int
    window: tuple[int, int, int, int] | None = None
    upright: bool = True

    def image(self, rgba: np.ndarray) -> np.ndarray:
        """Return (h, w, 4) of a picture (H, W, 4) with encoded weights, as ``Observation.read`` has them."""
        if self.window is not None:
            return self._cut(rgba)
        mean = self._resampled(rgba, _weighted)
        colour = mean[..., :3] / np.maximum(mean[..., 3:4], 1e-12)
        alpha = bounded(np.minimum(mean[..., 3], 1), mean[..., 4:] > _TOUCHED)
        return np.concatenate([colour, alpha[..., None]], axis=-1).astype(np.float32)

    def mask(self, mask: np.ndarray) -> np.ndarray:
        """Return (h, w) bool of a mask (H, W): where it covers over half of a pixel."""
        if self.window is not None:
            return self._cut(np.asarray(mask, bool))
        covered: np.ndarray = self._resampled(np.asarray(mask, np.float32)[..., None], np.asarray)[..., 0] > 0.5
        return covered

    def _cut(self, image: np.ndarray) -> np.ndarray:
        x, y, width, height = present(self.window)
        return image[y : y + height, x : x + width]

    def _resampled(self, image: np.ndarray, prepared: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Return (h, w, C) means of ``count``² bilinear samples of what ``prepared`` makes of an image's pixels."""
        if self.upright:
            return self._by_axes(image, prepared)
        width, height, count = self.camera.width, self.camera.height, self.count
        image = np.ascontiguousarray(prepared(image), np.float32)
        out = np.empty((height, width, image.shape[-1]), np.float32)
        x = (np.arange(width * count) + 0.5) / count
        rows = max(1, _BLOCK // (width * count**2))
        for first in range(0, height, rows):
            last = min(first + rows, height)
            y = (np.arange(first * count, last * count) + 0.5) / count
            places = self.places(np.stack(np.meshgrid(x, y), axis=-1))
            samples = _bilinear(image, places).reshape(last - first, count, width, count, -1)
            out[first:last] = samples.mean(axis=(1, 3))
        return out

    def _by_axes(self, image: np.ndarray, prepared: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Work as ``_resampled``, one axis after the other: of 4 · count values in place of 4 · count²."""
        count, height = self.count, self.camera.height
        x, y = ((np.arange(size * count) + 0.5) / count for size in (self.camera.width, height))
        columns = _Between.at(self.places(np.stack([x, x], axis=-1))[:, 0], image.shape[1], count)
        rows = _Between.at(self.places(np.stack([y, y], axis=-1))[:, 1], image.shape[0], count)
        parts = []
        for first in range(0, height, step := max(1, _BLOCK // (image.shape[1] * count))):
            some = rows.part(first, first + step)
            low, high = some.low.min(), some.high.max() + 1
            across = some.means(np.asarray(prepared(image[low:high]), np.float32), low)
            parts.append(columns.means(across.swapaxes(0, 1)).swapaxes(0, 1))
        return np.concatenate(parts)


@dataclass(frozen=True)
class _Between:
    """Samples along an axis, ``count`` a pixel: each between the pixels ``low`` and ``high``, at ``share`` from low."""

    low: np.ndarray
    high: np.ndarray
    share: np.ndarray
    count: int

    @staticmethod
    def at(places: np.ndarray, size: int, count: int) -> _Between:
        """Return the samples at pixel coordinates (n · count,), 0…size."""
        at = np.clip(places - 0.5, 0, size - 1)
        low = at.astype(np.int64)
        return _Between(low, np.minimum(low + 1, size - 1), (at - low).astype(np.float32), count)

    def part(self, first: int, last: int) -> _Between:
        """Return the samples of some pixels."""
        samples = slice(first * self.count, last * self.count)
        return _Between(self.low[samples], self.high[samples], self.share[samples], self.count)

    def means(self, values: np.ndarray, first: int = 0) -> np.ndarray:
        """Return (n, …) the mean of each pixel's samples. values: (N, W, C), of which the first is pixel ``first``."""
        total: np.ndarray = np.zeros((), np.float32)
        for k in range(self.count):
            share = self.share[k :: self.count, None, None]
            low, high = self.low[k :: self.count] - first, self.high[k :: self.count] - first
            total = total + values[low] * (1 - share) + values[high] * share
        return total / np.float32(self.count)


def _weighted(rgba: np.ndarray) -> np.ndarray:
    """Return (h, w, 7): colours times the weight, the weight, and the weight where each channel is clipped."""
    weight, clipped = weight_and_clipped(rgba[..., 3])
    finite = np.isfinite(rgba)
    weight[~(finite[..., 0] & finite[..., 1] & finite[..., 2] & finite[..., 3])] = 0
    out = np.empty((*weight.shape, 7), np.float32)
    with np.errstate(invalid="ignore"):  # infinity times 0
        for channel in range(3):  # one by one: with an axis of three numpy takes four times as long
            np.multiply(rgba[..., channel], weight, out=out[..., channel])
            np.multiply(clipped[..., channel], weight, out=out[..., 4 + channel])
    out[..., 3] = weight
    out[weight == 0] = 0
    return out


def _read(read: Callable[[], np.ndarray], view: _View) -> np.ndarray:
    return view.image(read())


def _bilinear(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return (…, C) values of an image (H, W, C) at pixel coordinates (…, 2); 0 outside."""
    height, width = image.shape[:2]
    flat, size = image.reshape(height * width, -1), np.array([width, height])
    inside = ((places >= 0) & (places <= size)).all(axis=-1)  # false for NaN, beyond a lens's field
    at = np.clip(np.where(inside[..., None], places, 0) - 0.5, 0, size - 1)
    low = np.minimum(at.astype(np.int64), np.maximum(size - 2, 0))
    share = (at - low).astype(np.float32)
    first = low[..., 1] * width + low[..., 0]
    right, up = int(width > 1), width * int(height > 1)
    x, y = share[..., :1], share[..., 1:]
    values: np.ndarray = (flat[first] * (1 - x) + flat[first + right] * x) * (1 - y)
    values += (flat[first + up] * (1 - x) + flat[first + up + right] * x) * y
    return values * inside[..., None]


def _view(camera: Camera, framing: Framing) -> _View:
    count = math.ceil(1 / framing.scale - 1e-9)
    if framing.corners:
        seen = _facing(camera, framing)
        return _View(seen, partial(_through, seen, camera), count, upright=False)
    x, top, width, height = map(int, framing.crop or (0, 0, camera.width, camera.height))
    if min(x, top) < 0 or min(width, height) < _LEAST_SIDE or x + width > camera.width or top + height > camera.height:
        raise CaptureError(
            f"crop {x},{top},{width},{height}: is no part of pictures of {camera.width}×{camera.height} pixels; give"
            f" x, y, width and height from the upper left corner, at least {_LEAST_SIDE} pixels wide and high",
            "crop",
        )
    y = camera.height - top - height
    size = _size(width, height, framing.scale)
    ratio = size[0] / width, size[1] / height
    centre = (camera.centre[0] - x) * ratio[0], (camera.centre[1] - y) * ratio[1]
    scale = camera.scale[0] * ratio[0], camera.scale[1] * ratio[1]
    seen = replace(camera, width=size[0], height=size[1], scale=scale, centre=centre)
    return _View(seen, lambda at: at / ratio + (x, y), count, (x, y, width, height) if framing.scale == 1 else None)


def _size(width: float, height: float, scale: float) -> tuple[int, int]:
    longest = max(width, height)
    if scale < 1 and round(scale * longest) < _LEAST_SIDE:
        raise CaptureError(
            f"scale is {scale:g}: that leaves less than {_LEAST_SIDE} of {longest:.0f} pixels; give"
            f" {min(1.0, _LEAST_SIDE / longest):.2g} or more",
            "value",
        )
    return max(_LEAST_SIDE, round(scale * width)), max(_LEAST_SIDE, round(scale * height))


def _through(seen: Camera, camera: Camera, at: np.ndarray) -> np.ndarray:
    """Return the pixel coordinates (…, 2) in ``camera`` of what the pixels (…, 2) of a turned camera show."""
    plane = (at - seen.centre) / np.asarray(seen.scale)
    world = np.concatenate([plane, np.full((*plane.shape[:-1], 1), -1.0)], axis=-1) @ seen.matrix[:3, :3].T
    return camera.project(world + seen.position)[0]


def _facing(camera: Camera, framing: Framing) -> Camera:
    """Return the camera, turned to look straight at the rectangle of the corners, that shows nothing else.

    Its pixels are as fine as the picture shows the rectangle's finest side, times the scale.
    """
    corners = np.array(framing.corners, np.float64) * (1, -1) + (0, camera.height)
    if not ((corners >= 0) & (corners <= (camera.width, camera.height))).all():
        raise CaptureError(
            f"corners: one lies outside the picture of {camera.width}×{camera.height} pixels; count from its upper left"
            " corner, x to the right and y down",
            "corners",
        )
    sides = np.roll(corners, -1, axis=0) - corners
    if not (turns(corners) < 0).all():
        raise CaptureError(
            "corners: they do not go around a rectangle clockwise; give them from the upper left one, to the right and"
            " down",
            "corners",
        )
    plane = (corners - camera.centre) / np.asarray(camera.scale)
    if any(camera.distortion):
        plane = undistorted(plane, camera.distortion)
    rays = np.concatenate([plane, np.full((4, 1), -1.0)], axis=-1)
    axes = _axes(camera, rays)
    if camera.perspective:
        rays /= -(rays @ axes[:, 2:])  # onto the card's plane at distance 1
    flat = rays @ axes[:, :2]
    lengths = np.linalg.norm(np.roll(flat, -1, axis=0) - flat, axis=1)
    finest = float((np.linalg.norm(sides, axis=1) / lengths).max())
    low = flat[[0, 3], 0].mean(), flat[[2, 3], 1].mean()
    high = flat[[1, 2], 0].mean(), flat[[0, 1], 1].mean()
    width, height = _size(finest * (high[0] - low[0]), finest * (high[1] - low[1]), framing.scale)
    scale = width / (high[0] - low[0]), height / (high[1] - low[1])
    matrix = np.array(camera.matrix, np.float64)
    matrix[:3, :3] = matrix[:3, :3] @ axes
    return Camera(width, height, scale, (-low[0] * scale[0], -low[1] * scale[1]), matrix, camera.perspective)


def turns(corners: np.ndarray) -> np.ndarray:
    """Return (4,) the cross product of the sides before and after each of four corners (4, 2), beside the first.

    Above 0 where they turn from x toward y: anticlockwise with y up, clockwise with y down.
    """
    sides = np.roll(corners, -1, axis=0) - corners
    (x, y), (next_x, next_y) = sides.T, np.roll(sides, -1, axis=0).T
    return np.asarray(x * next_y - y * next_x)


def _axes(camera: Camera, rays: np.ndarray) -> np.ndarray:
    """Return (3, 3), as columns in the camera's axes: right, up and toward the viewer of a rectangle.

    rays: (4, 3) through its corners, to z = −1. The planes through the eye and two opposite sides meet in a line that
    is parallel to both sides. Without perspective the card faces the camera.
    """
    top, right, bottom, left = np.roll(rays, -1, axis=0) - rays
    across, upward = top - bottom, left - right
    if camera.perspective:
        planes = np.cross(rays, np.roll(rays, -1, axis=0))
        lines = np.cross(planes[0], planes[2]), np.cross(planes[3], planes[1])
        across, upward = (line * np.sign(line @ seen) for line, seen in zip(lines, (across, upward), strict=True))
    across, upward = across / np.linalg.norm(across), upward / np.linalg.norm(upward)
    angle = math.degrees(math.acos(np.clip(across @ upward, -1, 1)))
    if abs(angle - 90) > _SQUARE:
        raise CaptureError(
            f"corners: seen through this lens their sides meet at {angle:.0f}°, not at a right angle; check them, and"
            " the camera's fov_degrees",
            "corners",
        )
    toward = np.cross(across, upward)
    toward /= np.linalg.norm(toward)
    return np.stack([across, np.cross(toward, across), toward], axis=-1)


def _distance(camera: Camera, width: float) -> float:
    if not camera.perspective:
        raise CaptureError(
            "card_width: an orthographic camera shows the card equally wide at all distances; give world_width", "value"
        )
    return width * camera.scale[0] / camera.width
