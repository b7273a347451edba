"""Selection of sharp frames under different lights from a video of a lamp that is carried around."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..capture.inspect.checks import middle_window
from ..capture.inspect.frames import shrunk
from ..core.errors import InputError
from .register import find_shifts

MAX_COMPARED = 600  # most frames of a video that are compared
MIN_FRAMES = 3  # frames of different light in a capture
_SIDE, _CROP = 48, 384  # pixels: longest side of a small frame; of the crop that is registered
_DENSE = 4  # sampled pixels along a side of the block that is averaged to a pixel of a small frame
_DARK = 0.25  # of the median brightness: below, the lamp is off, or the video fades
# Relative RMS of the square roots of normalised radiance. Lights 2° apart differ by 0.005, 15° apart by 0.04 and more.
_SAME_LIGHT, _ONE_LIGHT = 0.01, 0.03
_ALIKE = 0.5  # of a frame's difference from the chosen ones: closer neighbours in time may replace it
_MOVED, _MAX_MOVED = 2.0, 0.1  # pixels; fraction of the frames


@dataclass(frozen=True)
class Look:
    """Descriptor of a frame. small: (h, w) square root of radiance / mean. brightness: mean linear radiance.

    sharpness: mean absolute Laplacian of the middle / its mean.
    """

    small: np.ndarray
    brightness: float
    sharpness: float


def describe_frame(codes: np.ndarray, linearised: Callable[[np.ndarray], np.ndarray]) -> Look:
    """Return the descriptor of a frame (H, W, 3). linearised: codes to radiance, applied to a part of the pixels."""
    step = max(1, max(codes.shape) // (_DENSE * _SIDE))
    small = _shrunk(linearised(codes[::step, ::step]).mean(axis=-1), _SIDE)
    middle = linearised(codes[middle_window(np.ones(codes.shape[:2], bool), _CROP)]).mean(axis=-1)
    curvature = np.abs(
        4 * middle[1:-1, 1:-1] - middle[:-2, 1:-1] - middle[2:, 1:-1] - middle[1:-1, :-2] - middle[1:-1, 2:]
    )
    return Look(
        np.sqrt(np.maximum(small, 0) / max(float(small.mean()), 1e-9)),
        float(small.mean()),
        float(curvature.mean() / max(float(middle.mean()), 1e-9)),
    )


def chosen_frames(looks: Sequence[Look], count: int, where: str) -> list[int]:
    """Return the indices, in order, of at most ``count`` frames whose lights differ most.

    Farthest-point selection (Gonzalez 1985); each chosen frame is replaced by the sharpest of its neighbours in time
    with nearly the same light, with a preference for a lamp at rest. Dark frames are excluded. where: names the video
    in errors. Raises InputError if fewer than three lights differ.
    """
    bright = np.array([look.brightness for look in looks])
    usable = bright > _DARK * np.median(bright)
    small = np.stack([look.small.ravel() for look in looks])
    quality = _quality(small, np.array([look.sharpness for look in looks]))
    differences = _rms(small - small[usable].mean(axis=0)) if usable.any() else np.zeros(len(small))
    chosen: list[int] = []
    while len(chosen) < min(count, len(looks)):
        nearest = int(np.where(usable, differences, -1).argmax())
        gap = float(differences[nearest])
        if chosen and gap < (_ONE_LIGHT if len(chosen) < MIN_FRAMES else _SAME_LIGHT):
            break
        free = usable & ~np.isin(np.arange(len(looks)), chosen)
        best = _substitute(small, nearest, _ALIKE * gap, quality, free)
        distances = _rms(small - small[best])
        differences = np.minimum(differences, distances) if chosen else distances
        chosen.append(best)
    if len(chosen) < MIN_FRAMES:
        raise InputError(
            f"{where}: shows {len(chosen)} light{'s' * (len(chosen) > 1)}, too few for a recovery; carry the lamp"
            " around the subject while you film"
        )
    return sorted(chosen)


def check_camera(frames: Sequence[np.ndarray], where: str) -> int:
    """Return how many of the linear grey frames (H, W) are shifted by more than 2 pixels.

    Crops of the middle are registered at full size, and, for large shifts, whole frames at reduced size. Raises
    InputError if more than a tenth of the frames is shifted.
    """
    shape = frames[0].shape
    window, factor = middle_window(np.ones(shape, bool), _CROP), -(-max(shape) // _CROP)
    moved = np.zeros(len(frames))
    for stack, scale in ((np.stack([frame[window] for frame in frames]), 1),
                         (np.stack([_shrunk(frame, _CROP) for frame in frames]), factor)):  # fmt: skip
        shifts = find_shifts(stack, len(frames) // 2)
        moved = np.maximum(moved, np.abs(scale * shifts.pixels).max(axis=1) * shifts.trusted)
    count = int((moved > _MOVED).sum())
    if count > _MAX_MOVED * len(frames):
        raise InputError(
            f"{where}: the camera moves: {count} of {len(frames)} frames are shifted, by up to {moved.max():.0f}"
            " pixels; put it on a tripod and move the lamp alone"
        )
    return count


def _quality(small: np.ndarray, sharpness: np.ndarray) -> np.ndarray:
    """Return the sharpness (K,), reduced where the light changes fast, which blurs highlights and shadows."""
    before, after = np.roll(small, 1, axis=0), np.roll(small, -1, axis=0)
    before[0], after[-1] = small[0], small[-1]
    speed = _rms(after - before)
    return sharpness / (1 + speed / max(float(np.median(speed)), 1e-9))


def _substitute(small: np.ndarray, index: int, reach: float, quality: np.ndarray, free: np.ndarray) -> int:
    """Return the best frame of the run about ``index`` whose light differs by at most ``reach``, or a neighbour."""
    similar = _rms(small - small[index]) <= reach
    similar[max(index - 1, 0) : index + 2] = True
    similar &= free
    first, last = index, index
    while first > 0 and similar[first - 1]:
        first -= 1
    while last < len(small) - 1 and similar[last + 1]:
        last += 1
    return first + int(quality[first : last + 1].argmax())


def _rms(rows: np.ndarray) -> np.ndarray:
    return np.sqrt((rows.astype(np.float64) ** 2).mean(axis=-1))


def _shrunk(grey: np.ndarray, longest: int) -> np.ndarray:
    """Average an image (H, W) over blocks to a longest side of at most ``longest``."""
    factor = -(-max(grey.shape) // longest)
    height, width = grey.shape
    return shrunk(grey, (min(factor, height), min(factor, width)))
