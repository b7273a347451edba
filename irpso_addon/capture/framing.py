"""Crops, scales and rectifies the images of a capture.

The result is again a capture: corners rotate its camera (rectify.py), its images are resampled, world and lights do not
change.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, Literal, cast

import numpy as np

from ..core.optional import present
from ..core.steps import blocking
from .bounds import bounded, weight_and_clipped
from .camera import Camera
from .card import near_lights
from .errors import CaptureError
from .frame.find import DetectedCorners, corner_steps
from .rectify import MIN_SIDE, rectified_camera, size_in_pixels
from .types import Capture

AUTO = "auto"  # search the corners in the photographs

Point = tuple[float, float]
_BLOCK = 1 << 19  # samples resampled at a time
_CLIPPED_SHARE = 1e-3  # a pixel with a larger clipped share is a lower bound
_OUTSIDE = 1e-8  # weight of pixels outside the mask
_TILTED = 5.0  # degrees: of a card, from which on its distance is doubtful


@dataclass(frozen=True)
class Framing:
    """The part of the images in use, and its scale. Pixels count from the upper left corner, to the right and down.

    crop: x, y, width, height. corners: (x, y) of a flat rectangle's four, clockwise in the image; the first becomes the
    upper left one; AUTO: search printed markers, else one rectangle. scale: of the image size, above 0 and up to 1.
    card_width: of the card in the framed image, in the unit of the lights' positions.
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

    def keys(self) -> dict[str, Any]:
        """Return the keys of a capture.toml."""
        return {key: value for key, value in asdict(self).items() if value != getattr(Framing, key)}


def framed_steps(capture: Capture, framing: Framing) -> Generator[float, None, Capture]:
    """Return the capture with framed images, resampled on reading; yield the fraction done of a search for corners.

    A framed pixel is the weighted mean of the masked pixels that it covers, and a lower bound where a part is clipped.
    A scale applies to all cameras, crop, corners and card_width only to a capture of one. Raises CaptureError where the
    part is not inside the image, the corners are not those of a rectangle under the camera's lens, or are not found.
    card_distance counts along the camera's axis: where corners turn the camera, the result's is shorter.
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
        replace(
            observation,
            read=partial(_read, observation.read, views[observation.camera], capture.masks[observation.camera]),
        )
        for observation in capture.observations
    )
    masks = tuple(view.mask(mask) for view, mask in zip(views, capture.masks, strict=True))
    if not all(mask.any() for mask in masks):
        raise CaptureError(
            f"{part or 'scale'}: the mask of '{capture.name}' leaves no pixel of this part; choose another part",
            "mask_empty",
        )
    distance, warnings = capture.card_distance, capture.card_warnings
    if framing.card_width is not None:
        distance = _distance(views[0].camera, framing.card_width)
    elif distance is not None:
        cosine = axis_cosine(capture.cameras[0], views[0].camera)
        distance, warnings = distance * cosine, (*warnings, *_tilt_warnings(capture, cosine))
    return replace(
        capture, observations=observations, masks=masks, cameras=tuple(v.camera for v in views),
        card_distance=distance, card_warnings=warnings,
    )  # fmt: skip


framed = blocking("framed", framed_steps)


def found_corner_steps(capture: Capture, framing: Framing) -> Generator[float, None, tuple[Framing, DetectedCorners]]:
    """Search the corners as ``corner_steps``; return the framing with them, and the search's result.

    Printed markers also set the card's width, in millimetres, if neither it nor the card's distance is known.
    """
    result = yield from corner_steps(capture)
    first, second, third, fourth = result.corners
    width = framing.card_width
    if width is None and capture.card_distance is None and capture.cameras[0].perspective:
        width = result.width
    return replace(framing, corners=(first, second, third, fourth), card_width=width), result


def axis_cosine(whole: Camera, used: Camera) -> float:
    """Return the cosine between the axes of a camera and its framed one, which corners turn to face the card.

    A framed capture's ``card_distance`` is that of the whole one times it.
    """
    return 1.0 if np.array_equal(whole.matrix, used.matrix) else float(whole.backward @ used.backward)


def used_pixels(camera: Camera, framing: Framing) -> np.ndarray:
    """Return (H, W) bool, row 0 at the bottom: the pixels whose centre is in the crop or between the known corners."""
    x, y = np.arange(camera.width) + 0.5, (camera.height - np.arange(camera.height) - 0.5)[:, None]
    corners = framing.corners
    if framing.crop:
        left, top, width, height = framing.crop
        corners = (left, top), (left + width, top), (left + width, top + height), (left, top + height)
    used = np.ones((camera.height, camera.width), bool)
    if corners and corners != AUTO:
        places = np.array(corners, np.float64)
        for (ax, ay), (bx, by) in zip(places, np.roll(places, -1, axis=0), strict=True):  # clockwise, with y down
            used &= (bx - ax) * (y - ay) >= (by - ay) * (x - ax)
    return used


def distance_of_width(camera: Camera, framing: Framing) -> float:
    """Return the ``card_distance`` that the card_width of a framing, whose corners are known, stands for."""
    used = _view(camera, framing).camera
    return _distance(used, present(framing.card_width)) / axis_cosine(camera, used)


def _tilt_warnings(capture: Capture, cosine: float) -> list[str]:
    tilt = math.degrees(math.acos(min(cosine, 1.0)))
    if tilt <= _TILTED or not near_lights(capture):
        return []
    return [
        f"corners: the card is tilted by {tilt:.0f}°, and its distance counts along the lens's axis; its width is the"
        " more reliable number: give --card-width, or card_width in capture.toml"
    ]


with_found_corners = blocking("with_found_corners", found_corner_steps)


@dataclass(frozen=True)
class _View:
    """Resampling of one camera's images. camera: framed. to_original: framed pixel coordinates (…, 2) → original ones.

    count: samples per pixel along each axis. window: (x0, y0, width, height) of a crop without resampling, else None.
    upright: rows and columns are parallel to the original's.
    """

    camera: Camera
    to_original: Callable[[np.ndarray], np.ndarray]
    count: int
    window: tuple[int, int, int, int] | None = None
    upright: bool = True

    def image(self, rgba: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """Return the framed image (h, w, 4) of an image (H, W, 4); both as of ``Observation.read``.

        mask: (H, W) bool. Resampled pixels at its rim are means of the subject alone; those outside have weight 0 and
        show the photograph.
        """
        if self.window is not None:
            return self._cropped(rgba)
        mean = self._resampled(rgba.shape, lambda rows: _weighted(rgba[rows], mask[rows]))
        colour = mean[..., :3] / np.maximum(mean[..., 3:4], 1e-12)
        weight = np.where(mean[..., 3] > 2 * _OUTSIDE, np.minimum(mean[..., 3], 1), 0)
        alpha = bounded(weight, mean[..., 4:] > _CLIPPED_SHARE)
        return np.concatenate([colour, alpha[..., None]], axis=-1).astype(np.float32)

    def mask(self, mask: np.ndarray) -> np.ndarray:
        """Return the framed mask (h, w) bool of a mask (H, W): pixels that it covers by more than half."""
        if self.window is not None:
            return self._cropped(np.asarray(mask, bool))
        values = np.asarray(mask, np.float32)[..., None]
        covered: np.ndarray = self._resampled(values.shape, lambda rows: values[rows])[..., 0] > 0.5
        return covered

    def _cropped(self, image: np.ndarray) -> np.ndarray:
        x, y, width, height = present(self.window)
        return image[y : y + height, x : x + width]

    def _resampled(self, shape: tuple[int, ...], rows_of: Callable[[slice], np.ndarray]) -> np.ndarray:
        """Return (h, w, C) means of ``count``² bilinear samples per pixel of an image.

        shape: (H, W, …) of the image. rows_of: rows → their values (N, W, C).
        """
        if self.upright:
            return self._resampled_by_axes(shape, rows_of)
        width, height, count = self.camera.width, self.camera.height, self.count
        image = np.ascontiguousarray(rows_of(slice(None)), np.float32)
        out = np.empty((height, width, image.shape[-1]), np.float32)
        x = (np.arange(width * count) + 0.5) / count
        rows = max(1, _BLOCK // (width * count**2))
        for first in range(0, height, rows):
            last = min(first + rows, height)
            y = (np.arange(first * count, last * count) + 0.5) / count
            places = self.to_original(np.stack(np.meshgrid(x, y), axis=-1))
            samples = _bilinear(image, places).reshape(last - first, count, width, count, -1)
            out[first:last] = samples.mean(axis=(1, 3))
        return out

    def _resampled_by_axes(self, shape: tuple[int, ...], rows_of: Callable[[slice], np.ndarray]) -> np.ndarray:
        """Return the result of ``_resampled`` one axis after the other: 4 · count values per pixel, not 4 · count²."""
        count, height = self.count, self.camera.height
        x, y = ((np.arange(size * count) + 0.5) / count for size in (self.camera.width, height))
        columns = _AxisSamples.at(self.to_original(np.stack([x, x], axis=-1))[:, 0], shape[1], count)
        rows = _AxisSamples.at(self.to_original(np.stack([y, y], axis=-1))[:, 1], shape[0], count)
        parts = []
        for first in range(0, height, step := max(1, _BLOCK // (shape[1] * count))):
            band = rows.part(first, first + step)
            low, high = band.low.min(), band.high.max() + 1
            across = band.means(np.asarray(rows_of(slice(low, high)), np.float32), low)
            parts.append(columns.means(across.swapaxes(0, 1)).swapaxes(0, 1))
        return np.concatenate(parts)


@dataclass(frozen=True)
class _AxisSamples:
    """Linear interpolation along an axis, ``count`` samples a pixel, at ``fraction`` from pixel ``low`` to ``high``."""

    low: np.ndarray
    high: np.ndarray
    fraction: np.ndarray
    count: int

    @staticmethod
    def at(places: np.ndarray, size: int, count: int) -> _AxisSamples:
        """Return the samples at pixel coordinates (n · count,) in 0…size."""
        at = np.clip(places - 0.5, 0, size - 1)
        low = at.astype(np.int64)
        return _AxisSamples(low, np.minimum(low + 1, size - 1), (at - low).astype(np.float32), count)

    def part(self, first: int, last: int) -> _AxisSamples:
        """Return the samples of the pixels first…last − 1."""
        samples = slice(first * self.count, last * self.count)
        return _AxisSamples(self.low[samples], self.high[samples], self.fraction[samples], self.count)

    def means(self, values: np.ndarray, first: int = 0) -> np.ndarray:
        """Return (n, …) the mean of each pixel's samples. values: (N, W, C) of the pixels from ``first`` on."""
        total: np.ndarray = np.zeros((), np.float32)
        for k in range(self.count):
            share = self.fraction[k :: self.count, None, None]
            low, high = self.low[k :: self.count] - first, self.high[k :: self.count] - first
            total = total + values[low] * (1 - share) + values[high] * share
        return total / np.float32(self.count)


def _weighted(rgba: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return (h, w, 7): colours times the weight, the weight, and the weight where each channel is clipped.

    mask: (h, w) bool; outside the weight is so small that it counts only where there is no other.
    """
    weight, clipped = weight_and_clipped(rgba[..., 3])
    finite = np.isfinite(rgba)
    weight[~(finite[..., 0] & finite[..., 1] & finite[..., 2] & finite[..., 3])] = 0
    weight[~mask] *= _OUTSIDE
    out = np.empty((*weight.shape, 7), np.float32)
    with np.errstate(invalid="ignore"):  # infinity times 0
        for channel in range(3):  # over an axis of three numpy takes four times as long
            np.multiply(rgba[..., channel], weight, out=out[..., channel])
            np.multiply(clipped[..., channel], weight, out=out[..., 4 + channel])
    out[..., 3] = weight
    out[weight == 0] = 0
    return out


def _read(read: Callable[[], np.ndarray], view: _View, mask: np.ndarray) -> np.ndarray:
    return view.image(read(), mask)


def _bilinear(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return (…, C) values of an image (H, W, C) at pixel coordinates (…, 2); 0 outside."""
    height, width = image.shape[:2]
    flat, size = image.reshape(height * width, -1), np.array([width, height])
    inside = ((places >= 0) & (places <= size)).all(axis=-1)  # False for NaN: beyond the lens's field
    at = np.clip(np.where(inside[..., None], places, 0) - 0.5, 0, size - 1)
    low = np.minimum(at.astype(np.int64), np.maximum(size - 2, 0))
    fraction = (at - low).astype(np.float32)
    first = low[..., 1] * width + low[..., 0]
    right, up = int(width > 1), width * int(height > 1)
    x, y = fraction[..., :1], fraction[..., 1:]
    values: np.ndarray = (flat[first] * (1 - x) + flat[first + right] * x) * (1 - y)
    values += (flat[first + up] * (1 - x) + flat[first + up + right] * x) * y
    return values * inside[..., None]


def _view(camera: Camera, framing: Framing) -> _View:
    count = math.ceil(1 / framing.scale - 1e-9)
    if framing.corners:
        target = rectified_camera(camera, cast(tuple[Point, ...], framing.corners), framing.scale)
        return _View(target, partial(_original_pixels, target, camera), count, upright=False)
    x, top, width, height = map(int, framing.crop or (0, 0, camera.width, camera.height))
    if min(x, top) < 0 or min(width, height) < MIN_SIDE or x + width > camera.width or top + height > camera.height:
        raise CaptureError(
            f"crop {x},{top},{width},{height}: is no part of pictures of {camera.width}×{camera.height} pixels; give"
            f" x, y, width and height from the upper left corner, at least {MIN_SIDE} pixels wide and high",
            "crop",
        )
    y = camera.height - top - height
    size = size_in_pixels(width, height, framing.scale)
    ratio = size[0] / width, size[1] / height
    centre = (camera.centre[0] - x) * ratio[0], (camera.centre[1] - y) * ratio[1]
    scale = camera.scale[0] * ratio[0], camera.scale[1] * ratio[1]
    target = replace(camera, width=size[0], height=size[1], scale=scale, centre=centre)
    return _View(target, lambda at: at / ratio + (x, y), count, (x, y, width, height) if framing.scale == 1 else None)


def _original_pixels(framed_camera: Camera, camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Return the pixel coordinates (…, 2) in ``camera`` of pixels (…, 2) of a rotated camera at the same position."""
    plane = (pixels - framed_camera.centre) / np.asarray(framed_camera.scale)
    world = np.concatenate([plane, np.full((*plane.shape[:-1], 1), -1.0)], axis=-1) @ framed_camera.matrix[:3, :3].T
    return camera.project(world + framed_camera.position)[0]


def _distance(camera: Camera, width: float) -> float:
    if not camera.perspective:
        raise CaptureError(
            "card_width: an orthographic camera shows the card equally wide at all distances; give world_width", "value"
        )
    return width * camera.scale[0] / camera.width
