"""``Frames``: reduced frames of one camera; and the findings of comparing them."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..images.linearise import Samples
from ..types import Capture
from . import checks

_THUMBNAIL, _CROP = 256, 512  # pixels: longest side of a frame's thumbnail and of its crop
_MIN_SIDE = 16  # pixels: shortest side of a thumbnail, of images of that many
_COMPARED = 64  # pixels: longest side of the images that are compared pair by pair
_MEMORY = 96 << 20  # bytes for all crops together, and for all thumbnails; checks need about twice that again
_IDENTICAL, _SIMILAR = 0.0, 0.002  # relative RMS; frames of lights 2° apart differ by more than 1 %
_UNLIT = 0.01  # of the frames' median brightness: noise alone
_CLIPPED = 0.02  # of the masked pixels of all frames: more are a finding


@dataclass(frozen=True)
class Finding:
    """A fault of a capture, with the remedy. severity: "error" if a recovery cannot use the capture.

    goal: the one of sufficiency.GOALS that it obstructs, "" for all.
    """

    code: str
    message: str
    goal: str = ""
    severity: Literal["warning", "error"] = "warning"


@dataclass
class Frames:
    """Thumbnails and crops of one camera's frames, in grey radiance.

    box: rows and columns that are looked at; mask: of these. factors: reduction of the thumbnails' rows and columns.
    window: rows and columns of the crops. indices: of the observations. clipped: part of each frame's masked pixels.
    """

    box: tuple[slice, slice]
    mask: np.ndarray
    factors: tuple[int, int]
    window: tuple[slice, slice]
    names: list[str]
    indices: list[int]
    thumbnails: list[np.ndarray]
    crops: list[np.ndarray]
    clipped: list[float]


def frames_of(capture: Capture, index: int, part: bool = False) -> Frames:
    """Return empty Frames of a camera, reduced so that the crops of all cameras take at most 96 MB.

    part: look at the rectangle around the mask alone, as where a small part of the photographs is used.
    """
    mask = capture.masks[index]
    box = tuple(_extent(mask.any(axis=axis)) if part else slice(None) for axis in (1, 0))
    mask = mask[box]
    count = max(1, sum(observation.camera == index for observation in capture.observations))
    affordable = max(16, int((_MEMORY / len(capture.cameras) / count / 4) ** 0.5))
    factors = _factors(mask.shape, min(_THUMBNAIL, affordable))
    return Frames((box[0], box[1]), mask, factors, checks.middle_window(mask, min(_CROP, affordable)),
                  [], [], [], [], [])  # fmt: skip


def _extent(covered: np.ndarray) -> slice:
    places = np.flatnonzero(covered)
    return slice(int(places[0]), int(places[-1]) + 1)


def add_frame(frames: Frames, index: int, name: str, samples: Samples) -> Iterator[Finding]:
    """Add one frame's thumbnail and crop to ``frames``; yield the findings of this frame alone."""
    grey, mask, box = samples.rgba[frames.box][..., :3].mean(axis=-1), frames.mask, frames.box
    frames.names.append(name)
    frames.indices.append(index)
    frames.thumbnails.append(shrunk(grey, frames.factors))
    frames.crops.append(grey[frames.window].copy())
    frames.clipped.append(float(samples.clipped[box][mask].mean()))
    bad, negative = int(samples.not_finite[box][mask].sum()), int(samples.negative[box][mask].sum())
    if bad:
        message = f"{name}: {counted(bad, 'pixel is', 'pixels are')} not a number; they get weight 0, render it again"
        yield Finding("not_finite", message)
    if negative:
        message = f"{name}: {counted(negative, 'pixel is', 'pixels are')} negative; check how it was exported"
        yield Finding("negative", message)
    if not (grey[mask] > 0).any():
        yield Finding("image_black", f"{name}: is all black; take it and its light out of the list")


def _factors(shape: tuple[int, ...], longest: int) -> tuple[int, int]:
    """Return factors that reduce (rows, columns) to at most ``longest`` pixels; they differ only for narrow strips."""
    factor = -(-max(shape) // longest)
    rows, columns = (min(factor, max(1, side // _MIN_SIDE)) for side in shape)
    return rows, columns


def shrunk(image: np.ndarray, factors: tuple[int, int]) -> np.ndarray:
    """Return an image reduced by whole factors by averaging; drops incomplete blocks at the end."""
    rows, columns = (side // factor for side, factor in zip(image.shape, factors, strict=True))
    down, across = factors
    return image[: rows * down, : columns * across].reshape(rows, down, columns, across).mean(axis=(1, 3))


def brightness(frames: Frames) -> str:
    """Return the range of mean radiances and the clipped fraction, as text."""
    means = [float(thumbnail.mean()) for thumbnail in frames.thumbnails]
    return f"frame means {min(means):.4g} to {max(means):.4g}, {np.mean(frames.clipped):.2%} clipped"


def frame_steps(frames: Frames, intensities: np.ndarray) -> Generator[None, None, list[Finding]]:
    """Compare the frames of one camera under lights of ``intensities`` (N,), NaN behind the subject."""
    shifts = yield from checks.shift_steps(np.stack(frames.crops))
    if max(frames.factors) > 1:
        coarse = yield from checks.shift_steps(np.stack(frames.thumbnails))
        coarse *= frames.factors[::-1]
        shifts = np.where(np.abs(coarse).max(axis=1, keepdims=True) > np.abs(shifts).max(axis=1, keepdims=True),
                          coarse, shifts)  # fmt: skip
    yield
    return list(_frame_findings(frames, intensities, shifts))


def _frame_findings(frames: Frames, intensities: np.ndarray, shifts: np.ndarray) -> Iterator[Finding]:
    names = frames.names
    if np.mean(frames.clipped) > _CLIPPED:
        worst = int(np.argmax(frames.clipped))
        yield Finding(
            "clipped",
            f"{names[worst]}: {frames.clipped[worst]:.1%} of its pixels are clipped, brighter than the file"
            f" can hold ({np.mean(frames.clipped):.1%} of all images'); take the photographs with a shorter exposure",
        )
    bright = _bright(frames) / intensities
    usual = np.nanmedian(bright) if np.isfinite(bright).any() else 0
    for k in np.flatnonzero((bright > 0) & (bright < _UNLIT * usual))[:5]:  # exact zeros are said already
        yield Finding(
            "image_black",
            f"{names[k]}: has {bright[k] / usual:.1%} of the other photographs' light; if its lamp did not"
            " fire, take it and its light out of the list",
        )
    thumbnails = np.stack(frames.thumbnails)
    small = [shrunk(thumbnail, _factors(thumbnail.shape, _COMPARED)) for thumbnail in thumbnails]
    for i, j, difference in checks.similar_frames(np.stack(small), _SIMILAR)[:5]:
        code, word = ("image_same", "is") if difference <= _IDENTICAL else ("image_similar", "is nearly")
        message = f"{names[j]}: {word} the same image as {names[i]} (difference {difference:.2%})"
        yield Finding(code, message + "; check for a frame copied twice")
    moved = np.flatnonzero(shifts.any(axis=1))
    for k in moved[:5]:
        yield Finding(
            "shifted",
            f"{names[k]}: is shifted by {shifts[k][0]:+d} px right, {shifts[k][1]:+d} px up against the others"
            f" ({counted(len(moved), 'frame is', 'frames are')}); irpso develop --register moves frames back",
        )


def brightest(frames: Frames, capture: Capture) -> np.ndarray:
    """Return (K,) the 99th percentile of radiance of each observation in the mask; NaN of unreadable ones."""
    bright = np.full(len(capture.observations), np.nan)
    bright[frames.indices] = _bright(frames)
    return bright


def _bright(frames: Frames) -> np.ndarray:
    """Return (N,) the 99th percentile of radiance of each frame in the mask; NaN for a mask of less than a pixel."""
    mask = shrunk(frames.mask.astype(float), frames.factors) > 0.5
    parts = [np.percentile(thumbnail[mask], 99) if mask.any() else np.nan for thumbnail in frames.thumbnails]
    return np.array(parts, np.float64)


def counted(number: int, one: str, many: str) -> str:
    """Return a number and ``one`` for 1, else ``many``."""
    return f"{number} {one if number == 1 else many}"
