"""Merge of exposure brackets to one image of linear radiance.

Each frame's x = t·X + noise gives x / t with a variance of (t·X + k) / t², from shot noise and read noise; the optimal
weights are the inverse variances (Granados et al. 2010; Hasinoff, Durand and Freeman 2010). X in the weights is the
first estimate Σx / Σt; the frame's own x would favour frames in which noise made the pixel dark.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .frames import Frame

# Read noise² / gain, with the largest code as 1: 5 electrons of read noise at a full well of 30 000 electrons.
_READ = 5.0**2 / 30_000
SATURATED = 0.98  # of the largest code: sensors become nonlinear before they clip, and JPEG rings around clipped areas
# Of the largest code, by bits: one or two code steps. A threshold on noisy values would favour bright noise, so files
# of 16 bits and more use the weights alone, which are near zero for such pixels.
_BLACK = {8: 2.5 / 255}


def merge(frames: Sequence[Frame], amounts: Sequence[float], saturated: float = SATURATED) -> np.ndarray:
    """Merge a bracket to (H, W, 4) float32: radiance at an exposure of 1, and weight.

    amounts: exposures, above 0. saturated: code / largest code from which pixels are excluded, of raw files only if it
    is below 0.98; the shortest frame keeps all unclipped pixels. Nearly black pixels of 8-bit files are excluded if a
    longer frame shows them. A pixel without a usable frame has weight 0 and the shortest frame's value, a lower bound.
    """
    order = np.argsort(amounts)
    usable = np.stack([_usable(frames[i], saturated if rank else np.inf) for rank, i in enumerate(order)])
    dark = np.stack([frames[i].low <= _BLACK.get(frames[i].bits, -np.inf) for i in order])
    longest = len(order) - 1 - usable[::-1].argmax(axis=0)
    usable &= ~dark | (np.arange(len(order))[:, None, None] == longest)
    light: np.ndarray = np.zeros(3, np.float32)
    time, total = light, light
    for i, use in zip(order, usable, strict=True):
        light = light + np.where(use[..., None], frames[i].rgb, 0)
        time = time + use[..., None] * np.float32(amounts[i])
    estimate = np.maximum(light / np.where(time > 0, time, 1), 0)
    light = np.zeros(3, np.float32)
    for i, use in zip(order, usable, strict=True):
        weight = np.where(use[..., None], 1 / (estimate + np.float32(_READ / amounts[i])), 0)
        light = light + np.where(use[..., None], frames[i].rgb, 0) * weight
        total = total + np.float32(amounts[i]) * weight
    shortest = frames[order[0]]
    unusable = ~usable.any(axis=0)
    bound = np.nan_to_num(shortest.rgb, posinf=0, neginf=0) / np.float32(amounts[order[0]])
    merged = np.where(unusable[..., None], bound, light / np.where(total > 0, total, 1))
    weight = np.max([np.where(u, f.weight, 0) for u, f in zip(usable, (frames[i] for i in order), strict=True)], axis=0)
    return np.concatenate([merged, weight[..., None]], axis=-1).astype(np.float32)


def _usable(frame: Frame, saturated: float) -> np.ndarray:
    """Return bool (H, W): pixels with weight, below saturation. Float files with values above 1 do not saturate.

    Of raw files the weight tells where photosites saturate, which a strong colour does not: only a lower limit than
    the usual one applies.
    """
    unlimited = (frame.raw and saturated >= SATURATED) or (frame.bits == 32 and frame.high.max(initial=0) > 1 + 1e-4)
    return (frame.weight > 0) & (unlimited | (frame.high < saturated))
