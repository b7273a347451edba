"""Photographs made linear, and what is taken off and divided out: dark frames, flat fields, white balance."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...capture.images.exr_header import is_exr
from ...capture.images.image import ImageRef, ImageStore
from ...capture.images.linearise import samples_of_picture
from ...core.errors import InputError
from .response import Response

SAME_STOPS = 1 / 6  # stops: exposures nearer than half of a camera's third are the same setting
FLAT_FLOOR = 0.1  # of the flat's mean: below it noise would be multiplied tenfold
_LIT = 99.0  # percentile of a frame that must be above its dark frame
_CLIPPED_PATCH = 0.02  # of a patch's pixels


@dataclass(frozen=True)
class Frame:
    """One photograph. rgb: (H, W, 3) float32, linear, row 0 at the bottom. weight: (H, W), 0 where it is clipped.

    high, low: (H, W), the largest and the smallest of a pixel's codes / largest code. bits: 8, 16, or 32 for floats.
    """

    rgb: np.ndarray
    weight: np.ndarray
    high: np.ndarray
    low: np.ndarray
    bits: int


def read_frame(
    store: ImageStore, image: ImageRef, response: Response | None = None, size: tuple[int, int] | None = None
) -> Frame:
    """Return a photograph, made linear by a response curve or, without one, as its colour space says.

    size: (width, height) that it must have. Raises InputError where it cannot be read, is of another size, or is one
    of floats and a response is given.
    """
    if is_exr(image.path):
        found, bits = store.samples(image), 32
        codes = found.rgba[..., :3]
    else:
        picture = store.picture(image)
        found, bits = samples_of_picture(picture, image.colour_space), picture.bits
        codes = picture.values[..., :3] if picture.values.shape[-1] >= 3 else picture.values[..., :1]
    if response is not None and bits == 32:
        raise InputError(f"{image}: holds linear floats, which have no response curve; take --response out")
    height, width = found.rgba.shape[:2]
    if size is not None and (width, height) != size:
        raise InputError(
            f"{image}: is {width}×{height} pixels where {size[0]}×{size[1]} are wanted; all photographs, dark frames"
            " and flat fields of a camera must be of one size, unscaled and uncropped"
        )
    rgb = found.rgba[..., :3] if response is None else response(np.broadcast_to(codes, (*codes.shape[:2], 3)))
    return Frame(rgb, found.rgba[..., 3], codes.max(axis=-1), codes.min(axis=-1), bits)


@dataclass(frozen=True)
class Dark:
    """Mean dark frames. levels: (exposure or None, (H, W, 3)) of each exposure.

    scaled: whether those of other exposures are made of them.
    """

    levels: tuple[tuple[float | None, np.ndarray], ...]
    scaled: bool = False

    def of(self, amount: float | None, where: str) -> np.ndarray:
        """Return (H, W, 3), what to take off a frame of this exposure (None: unknown).

        Scaled, it lies on the straight line through the dark frames of the two nearest exposures, or grows with the
        exposure where there is but one. Raises InputError, naming ``where``, where no dark frame is of this exposure.
        """
        known = sorted(((a, level) for a, level in self.levels if a is not None), key=lambda pair: pair[0])
        if amount is None or not known:
            return np.mean([level for _, level in self.levels], axis=0, dtype=np.float32)
        nearest = min(known, key=lambda pair: abs(np.log2(pair[0] / amount)))
        if abs(np.log2(nearest[0] / amount)) < SAME_STOPS:
            return nearest[1]
        if not self.scaled:
            raise InputError(
                f"{where}: no dark frame has its exposure; take one, or let --scale-dark make it of the others"
            )
        if len(known) == 1:
            return known[0][1] * np.float32(amount / known[0][0])
        (a, low), (b, high) = sorted(sorted(known, key=lambda p: abs(np.log2(p[0] / amount)))[:2], key=lambda p: p[0])
        return low + (high - low) * np.float32((amount - a) / (b - a))


def mean_dark(frames: Iterable[tuple[float | None, np.ndarray]], scaled: bool = False) -> Dark:
    """Return the means of dark frames (exposure or None, (H, W, 3) linear), one for each exposure, read one by one."""
    groups: list[tuple[float | None, list[Any]]] = []  # exposure, [sum, count]
    for amount, rgb in frames:
        for other, total in groups:
            if amount is other or (amount and other and abs(np.log2(amount / other)) < SAME_STOPS):
                total[0] = total[0] + rgb
                total[1] += 1
                break
        else:
            groups.append((amount, [rgb.astype(np.float32), 1]))
    return Dark(tuple((amount, total / np.float32(count)) for amount, (total, count) in groups), scaled)


def without_dark(frame: Frame, dark: np.ndarray, where: str) -> Frame:
    """Return a frame less its dark frame. Raises InputError where next to nothing of it is brighter than that."""
    rgb = frame.rgb - dark
    if np.percentile(rgb.max(axis=-1), _LIT) <= 0:
        raise InputError(f"{where}: is no brighter than the dark frame; check which files --dark names")
    return Frame(rgb, frame.weight, frame.high, frame.low, frame.bits)


@dataclass(frozen=True)
class Flat:
    """What to divide by. field: (H, W, 3) float32 of mean 1 in each channel. usable: (H, W) bool."""

    field: np.ndarray
    usable: np.ndarray


def mean_flat(frames: Iterable[Frame], floor: float = FLAT_FLOOR) -> Flat:
    """Return the flat field of photographs of something evenly white, less their dark frames, read one by one.

    Each is divided by its own mean first, so that their exposures may differ. Not usable is what is clipped in one of
    them, or below ``floor`` times the mean. Raises InputError where that is more than half.
    """
    field: np.ndarray = np.zeros(3, np.float32)
    usable = np.ones((), bool)
    for frame in frames:
        seen = frame.weight > 0
        usable = usable & seen
        if usable.mean() < 0.5:
            raise InputError(f"{1 - usable.mean():.0%} of the flat field is clipped; photograph it with less exposure")
        mean = frame.rgb[seen].mean(axis=0, dtype=np.float64)
        if not (mean > 0).all():
            raise InputError("the flat field is black in a channel; check which files --flat names")
        field = field + frame.rgb / mean.astype(np.float32)
    field = field / field[usable].mean(axis=0, dtype=np.float64).astype(np.float32)
    usable = usable & (field > floor).all(axis=-1)
    if usable.mean() < 0.5:
        raise InputError(f"{1 - usable.mean():.0%} of the flat field is black; check which files --flat names")
    field = field / field[usable].mean(axis=0, dtype=np.float64).astype(np.float32)
    return Flat(np.where(usable[..., None], field, 1).astype(np.float32), usable)


def divided_by(frame: Frame, flat: Flat) -> Frame:
    """Return a frame divided by a flat field; where that is not usable the weight is 0."""
    return Frame(frame.rgb / flat.field, np.where(flat.usable, frame.weight, 0), frame.high, frame.low, frame.bits)


@dataclass(frozen=True)
class Patch:
    """A rectangle of a photograph, in pixels as picture viewers count: x right, y down from the upper left corner."""

    x: int
    y: int
    width: int
    height: int
    reflectance: float | None = None

    def __str__(self) -> str:
        return f"{self.x},{self.y},{self.width},{self.height}"


def patch_mean(image: np.ndarray, weight: np.ndarray, patch: Patch, where: str) -> np.ndarray:
    """Return the mean (3,) of a patch of (H, W, 3), row 0 at the bottom, over pixels with a weight.

    Raises InputError where it is not inside the image, or 2 % of it are clipped.
    """
    height, width = image.shape[:2]
    if patch.width < 1 or patch.height < 1 or not (0 <= patch.x <= width - patch.width):
        raise InputError(f"{where}: the patch {patch} is not inside its {width}×{height} pixels; write X,Y,W,H")
    if not 0 <= patch.y <= height - patch.height:
        raise InputError(f"{where}: the patch {patch} is not inside its {width}×{height} pixels; write X,Y,W,H")
    part = np.s_[height - patch.y - patch.height : height - patch.y, patch.x : patch.x + patch.width]
    good = weight[part] > 0
    if (~good).mean() > _CLIPPED_PATCH:
        raise InputError(f"{where}: {(~good).mean():.0%} of the patch {patch} are clipped; expose it shorter")
    return image[part][good].mean(axis=0, dtype=np.float64)


def white_gains(mean: np.ndarray, reflectance: float | None, where: str) -> np.ndarray:
    """Return the factors (3,) that make a grey patch's mean (3,) neutral, as bright as its green; or its reflectance.

    Raises InputError where a channel is black.
    """
    if not (mean > 0).all():
        raise InputError(f"{where}: the white patch is black in a channel; choose a lit, grey place")
    return (mean[1] if reflectance is None else reflectance) / mean
