"""Development of camera photographs to linear images, one per light.

Order: response curve, dark frame, flat field, exposure or merged brackets, white balance or colour matrix,
registration.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from ...capture.images.image import ImageRef, ImageStore
from ...capture.inspect.checks import middle_window
from ...core.errors import InputError
from ...core.steps import map_steps
from ..register import MIN_MOVE, find_shifts, moved_back, shift_steps
from .bursts import averaged
from .frames import Dark, Flat, Frame, divided_by, read_frame, without_dark
from .hdr import SATURATED, merge
from .response import Response

_CROP = 384  # pixels: longest side of the crop for registration


@dataclass(frozen=True)
class ExposureGroup:
    """The photographs of one light. name: for reports. images: one, a bracket, or a burst. camera: index.

    amounts: exposures of the images, or None without exposure correction; several images are then a burst. size:
    required (width, height).
    """

    name: str
    images: tuple[ImageRef, ...]
    amounts: tuple[float, ...] | None = None
    camera: int = 0
    size: tuple[int, int] | None = None


@dataclass(frozen=True)
class Corrections:
    """Corrections of photographs. reference: exposure that results are scaled to. gains: (3,) white balance.

    darks, flats: one per camera, or None. matrix: (3, 3), the camera's linear RGB to linear Rec. 709, or None.
    """

    response: Response | None = None
    darks: tuple[Dark | None, ...] = (None,)
    flats: tuple[Flat | None, ...] = (None,)
    reference: float = 1.0
    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)
    matrix: np.ndarray | None = None
    saturated: float = SATURATED
    align_brackets: bool = False


@dataclass(frozen=True)
class Developed:
    """One light's image. rgba: (H, W, 4) float32, linear radiance and weight. figures: for the report."""

    rgba: np.ndarray
    figures: dict = field(default_factory=dict)


def corrected(store: ImageStore, group: ExposureGroup, index: int, corrections: Corrections) -> Frame:
    """Return one image of a group: linear, minus its dark frame, divided by its flat field. Raises InputError."""
    image = group.images[index]
    frame = read_frame(store, image, corrections.response, group.size)
    dark, flat = corrections.darks[group.camera], corrections.flats[group.camera]
    if dark is not None:
        amount = None if group.amounts is None else group.amounts[index]
        frame = without_dark(frame, dark.of(amount, str(image)), str(image))
    return frame if flat is None else divided_by(frame, flat)


def developed(store: ImageStore, group: ExposureGroup, corrections: Corrections) -> Developed:
    """Return one light's image from its photographs. Raises InputError if one of them is unusable."""
    figures: dict = {"files": [image.path.name for image in group.images]}
    if group.amounts is None and len(group.images) > 1:
        read = partial(corrected, store, group, corrections=corrections)
        rgba, figures["burst_shifts"] = averaged(read, group.images, corrections.align_brackets)
    elif group.amounts is None:
        frame = corrected(store, group, 0, corrections)
        rgba = np.concatenate([frame.rgb, frame.weight[..., None]], axis=-1)
    else:
        frames = [corrected(store, group, i, corrections) for i in range(len(group.images))]
        amounts = [amount / corrections.reference for amount in group.amounts]
        figures["exposures"] = [round(amount, 6) for amount in amounts]
        if corrections.align_brackets and len(frames) > 1:
            frames, figures["bracket_shifts"] = _aligned(frames, amounts)
        rgba = merge(frames, amounts, corrections.saturated)
    rgba[..., :3] *= np.asarray(corrections.gains, np.float32)
    if corrections.matrix is not None:
        rgba[..., :3] = rgba[..., :3] @ corrections.matrix.T.astype(np.float32)
    not_finite = ~np.isfinite(rgba).all(axis=-1)
    rgba[not_finite] = 0
    weighted = rgba[..., 3] > 0
    figures["without_weight"] = round(float(1 - weighted.mean()), 6)
    # By noise about black or, with a matrix, colours outside Rec. 709; otherwise the dark frame is too bright.
    figures["negative"] = round(float((weighted & (rgba[..., :3] < 0).any(axis=-1)).mean()), 6)
    if not weighted.any():
        raise InputError(f"{group.images[0]}: all pixels are clipped in all exposures; expose less")
    rgba[..., :3] = np.maximum(rgba[..., :3], 0)
    return Developed(rgba.astype(np.float32), figures)


def _aligned(frames: list[Frame], amounts: Sequence[float]) -> tuple[list[Frame], list[list[float]]]:
    """Return the frames of a bracket, registered to the middle one, and their shifts, pixels."""
    window = middle_window(np.ones(frames[0].weight.shape, bool), _CROP)
    greys = [np.minimum(f.rgb.mean(axis=-1)[window], 1.0) / a for f, a in zip(frames, amounts, strict=True)]
    shifts = find_shifts(np.stack(greys), len(frames) // 2)
    result = []
    for frame, (right, up) in zip(frames, shifts.pixels, strict=True):
        if max(abs(right), abs(up)) < MIN_MOVE:
            result.append(frame)
            continue
        rgba = moved_back(np.concatenate([frame.rgb, frame.weight[..., None]], axis=-1), right, up)
        codes = np.stack([frame.high, frame.low, frame.low, np.ones_like(frame.low)], axis=-1)
        codes = moved_back(codes, right, up)
        result.append(replace(frame, rgb=rgba[..., :3], weight=rgba[..., 3], high=codes[..., 0], low=codes[..., 1]))
    return result, shifts.pixels.round(4).tolist()


def registration_steps(
    store: ImageStore,
    groups: Sequence[ExposureGroup],
    masks: Sequence[np.ndarray],
    corrections: Corrections,
    reference: int = 0,
) -> Generator[float, None, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the fraction done, 0…1; return shifts (K, 2), agreement (K,) and trusted (K,) of all groups.

    The reference of a camera's groups is group ``reference`` if it is one of them, else their first. masks: (H, W)
    bool, one per camera.
    """
    count = len(groups)
    pixels, agreement, trusted = np.zeros((count, 2)), np.full(count, np.nan), np.ones(count, bool)
    crops = []
    for k, group in enumerate(groups):
        yield 0.5 * k / count
        rgba = developed(store, group, corrections).rgba
        crops.append(rgba[(*middle_window(masks[group.camera], _CROP), slice(3))].mean(axis=-1))
    for camera in sorted({group.camera for group in groups}):
        own = [k for k, group in enumerate(groups) if group.camera == camera]
        steps = shift_steps(np.stack([crops[k] for k in own]), own.index(reference) if reference in own else 0)
        fraction = np.poly1d([0.5 * len(own) / count, 0.5 + 0.5 * own[0] / count])
        shifts = yield from map_steps(steps, fraction)
        pixels[own], agreement[own], trusted[own] = shifts.pixels, shifts.agreement, shifts.trusted
    return pixels, agreement, trusted
