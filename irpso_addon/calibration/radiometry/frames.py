"""Linear photographs and their corrections: dark frames, flat fields, white balance."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...capture.images.exif import SAME_STOPS
from ...capture.images.exr_header import is_exr
from ...capture.images.image import ImageRef, ImageStore
from ...capture.images.raw import is_raw
from ...core.errors import InputError
from .response import Response

FLAT_FLOOR = 0.1  # of the flat's mean: division by less would amplify noise more than tenfold
_LIT_PERCENTILE = 99.0  # percentile of frame − dark frame that must be positive
_CLIPPED_PATCH = 0.02  # of a patch's pixels


class TooDark(InputError):
    """A photograph is no brighter than its dark frame."""


@dataclass(frozen=True)
class Frame:
    """One photograph. rgb: (H, W, 3) float32, linear, row 0 at the bottom. weight: (H, W), 0 where clipped.

    high, low: (H, W), largest and smallest of a pixel's codes / largest code; of raw files of its colours, which may
    exceed 1. bits: 8 to 16, or 32 for floats. raw: of a raw file, whose weight is 0 where a photosite is saturated.
    """

    rgb: np.ndarray
    weight: np.ndarray
    high: np.ndarray
    low: np.ndarray
    bits: int
    raw: bool = False

    @property
    def curve_weight(self) -> np.ndarray:
        """Weight (H, W), also 0 at colours of raw files above 1, where no response curve is defined."""
        return np.where(self.high > 1, 0, self.weight)


def read_frame(
    store: ImageStore, image: ImageRef, response: Response | None = None, size: tuple[int, int] | None = None
) -> Frame:
    """Read a photograph, linearised by a response curve, or without one by its colour space or profile.

    With a curve, which ends at 1, colours of raw files above 1 have weight 0. size: required (width, height). Raises
    InputError if the file is unreadable, has another size, or holds floats and ``response`` is not None.
    """
    profile = None
    if is_exr(image.path):
        samples, bits = store.samples(image), 32
        codes = samples.rgba[..., :3]
    else:
        picture = store.picture(image)
        samples, bits, profile = store.samples_of(image, picture), picture.bits, picture.profile
        codes = picture.values[..., :3] if picture.values.shape[-1] >= 3 else picture.values[..., :1]
    if response is not None and bits == 32:
        raise InputError(f"{image}: holds linear floats, which have no response curve; omit --response")
    height, width = samples.rgba.shape[:2]
    if size is not None and (width, height) != size:
        raise InputError(
            f"{image}: is {width}×{height} pixels instead of {size[0]}×{size[1]}; all photographs, dark frames and"
            " flat fields of a camera must have one size, unscaled and uncropped"
        )
    weight, raw = samples.rgba[..., 3], is_raw(image.path)
    frame = Frame(samples.rgba[..., :3], weight, codes.max(axis=-1), codes.min(axis=-1), bits, raw)
    if response is None:
        return frame
    rgb = response(np.broadcast_to(codes, (*codes.shape[:2], 3)))
    return replace(frame, rgb=profile.in_rec709(rgb) if profile else rgb, weight=frame.curve_weight)


def read_codes(store: ImageStore, image: ImageRef) -> np.ndarray:
    """Return (H, W, 3) codes / largest code of a photograph, 0…1, row 0 at the bottom.

    Raises InputError for files of floats, which are linear.
    """
    picture = None if is_exr(image.path) else store.picture(image)
    if picture is None or picture.bits == 32:
        raise InputError(
            f"{image}: holds linear floats, which have no response curve; omit --grey-card, or give the camera's own"
            " files"
        )
    values = np.minimum(picture.values, 1)  # of raw files colours may lie above
    return values[..., :3] if values.shape[-1] >= 3 else np.repeat(values[..., :1], 3, axis=-1)


@dataclass(frozen=True)
class Dark:
    """Mean dark frames. levels: (exposure or None, (H, W, 3)) per exposure.

    scaled: other exposures are interpolated.
    """

    levels: tuple[tuple[float | None, np.ndarray], ...]
    scaled: bool = False

    def of(self, amount: float | None, where: str) -> np.ndarray:
        """Return the dark frame (H, W, 3) of an exposure (None: unknown).

        If ``scaled``, it is interpolated linearly between the dark frames of the two nearest exposures, or proportional
        to the exposure if there is only one. where: names the photograph. Raises InputError if no dark frame fits.
        """
        levels = sorted(((a, level) for a, level in self.levels if a is not None), key=lambda pair: pair[0])
        if amount is None and len(levels) > 1:
            raise InputError(
                f"{where}: its exposure is unknown, and the dark frames have several; give it an exposure as the"
                " photographs have it, or dark frames of one exposure"
            )
        if amount is None or not levels:
            return np.mean([level for _, level in self.levels], axis=0, dtype=np.float32)
        nearest = min(levels, key=lambda pair: abs(np.log2(pair[0] / amount)))
        if abs(np.log2(nearest[0] / amount)) < SAME_STOPS:
            return nearest[1]
        if not self.scaled:
            raise InputError(f"{where}: no dark frame has its exposure; photograph one, or use --scale-dark")
        if len(levels) == 1:
            return levels[0][1] * np.float32(amount / levels[0][0])
        (a, low), (b, high) = sorted(sorted(levels, key=lambda p: abs(np.log2(p[0] / amount)))[:2], key=lambda p: p[0])
        return low + (high - low) * np.float32((amount - a) / (b - a))


def mean_dark(frames: Iterable[tuple[float | None, np.ndarray]], scaled: bool = False) -> Dark:
    """Return the mean dark frame of each exposure. frames: (exposure or None, (H, W, 3) linear), read one by one."""
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
    """Return a frame minus its dark frame. Raises TooDark if less than 1 % of its pixels are brighter."""
    rgb = frame.rgb - dark
    if np.percentile(rgb.max(axis=-1), _LIT_PERCENTILE) <= 0:
        raise TooDark(f"{where}: is no brighter than the dark frame; check which files --dark names")
    return replace(frame, rgb=rgb)


@dataclass(frozen=True)
class Flat:
    """A flat field. field: (H, W, 3) float32, mean 1 in each channel. usable: (H, W) bool."""

    field: np.ndarray
    usable: np.ndarray


def mean_flat(frames: Iterable[Frame], floor: float = FLAT_FLOOR) -> Flat:
    """Return the flat field by photographs, less dark frames, of an even white surface; ``frames`` is read one by one.

    Each frame is divided by its mean, so exposures may differ. A pixel is unusable where one frame clips or the mean is
    below ``floor``. Raises InputError if more than half of the pixels are unusable.
    """
    field: np.ndarray = np.zeros(3, np.float32)
    usable = np.ones((), bool)
    for frame in frames:
        unclipped = frame.weight > 0
        usable = usable & unclipped
        if usable.mean() < 0.5:
            raise InputError(f"{1 - usable.mean():.0%} of the flat field is clipped; photograph it with less exposure")
        mean = frame.rgb[unclipped].mean(axis=0, dtype=np.float64)
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
    """Return a frame divided by a flat field; weight 0 where the flat field is unusable."""
    return replace(frame, rgb=frame.rgb / flat.field, weight=np.where(flat.usable, frame.weight, 0))


@dataclass(frozen=True)
class Patch:
    """A rectangle of a photograph, in pixels: x right, y down from the upper left corner."""

    x: int
    y: int
    width: int
    height: int
    reflectance: float | None = None

    def __str__(self) -> str:
        return f"{self.x},{self.y},{self.width},{self.height}"


def patch_mean(image: np.ndarray, weight: np.ndarray, patch: Patch, where: str) -> np.ndarray:
    """Return the mean (3,) of a patch of an image (H, W, 3), row 0 at the bottom, over pixels with weight.

    Raises InputError if the patch leaves the image or more than 2 % of it are clipped.
    """
    height, width = image.shape[:2]
    if patch.width < 1 or patch.height < 1 or not (0 <= patch.x <= width - patch.width):
        raise InputError(f"{where}: the patch {patch} is not inside its {width}×{height} pixels; write X,Y,W,H")
    if not 0 <= patch.y <= height - patch.height:
        raise InputError(f"{where}: the patch {patch} is not inside its {width}×{height} pixels; write X,Y,W,H")
    window = np.s_[height - patch.y - patch.height : height - patch.y, patch.x : patch.x + patch.width]
    unclipped = weight[window] > 0
    if (~unclipped).mean() > _CLIPPED_PATCH:
        raise InputError(f"{where}: {(~unclipped).mean():.0%} of the patch {patch} are clipped; expose it shorter")
    return image[window][unclipped].mean(axis=0, dtype=np.float64)


def white_gains(mean: np.ndarray, reflectance: float | None, where: str) -> np.ndarray:
    """Return gains (3,) that map a grey patch's mean (3,) to its green channel, or to its reflectance.

    Raises InputError if a channel is black.
    """
    if not (mean > 0).all():
        raise InputError(f"{where}: the white patch is black in a channel; choose a lit grey patch")
    return (mean[1] if reflectance is None else reflectance) / mean
