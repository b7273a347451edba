"""Brackets merged to one image of linear radiance.

Each frame's x = t·X + noise gives x / t with a variance of (t·X + k) / t², shot noise and the noise of reading; the
mean with the inverse variances as weights is the best that can be had (Granados et al. 2010; Hasinoff, Durand and
Freeman 2010). X in the weights is the first estimate Σx / Σt and not the frame's own x, which would favour the frames
in which noise made the pixel dark.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

# Read noise² / gain, with the largest code as 1: 5 electrons of read noise at a full well of 30 000 electrons.
_READ = 5.0**2 / 30_000
SATURATED = 0.98  # of the largest code: sensors bend before they clip, and JPEG rings about what is clipped
BLACK = 2 / 255  # of the largest code: darker is cut off or a few steps of an 8-bit file


def merge(
    frames: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], amounts: Sequence[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return (H, W, 3) float32 radiance for an exposure of 1, and (H, W) bool: pixels that no frame shows.

    frames: linear (H, W, 3) and (H, W) bool twice: too bright, and too dark, to be used. amounts: exposures.
    A pixel that is too dark in all frames takes the longest that is not too bright. One that is too bright in all gets
    the shortest frame's value, a lower bound.
    """
    order = np.argsort(amounts)
    height, width = frames[0][0].shape[:2]
    usable = np.stack([~frames[i][1] for i in order])
    dark = np.stack([frames[i][2] for i in order])
    # The longest exposure that is not clipped shows a dark pixel best, however dark it is there.
    longest = len(order) - 1 - usable[::-1].argmax(axis=0)
    rank = np.arange(len(order))[:, None, None]
    usable &= ~dark | (rank == longest)
    light, time = np.zeros((height, width, 3)), np.zeros((height, width, 1))
    for i, use in zip(order, usable, strict=True):
        light += np.where(use[..., None], frames[i][0], 0)
        time += use[..., None] * amounts[i]
    unseen = ~usable.any(axis=0)
    first = np.maximum(light / np.where(time > 0, time, 1), 0)
    light[:], total = 0, np.zeros((height, width, 3))
    for i, use in zip(order, usable, strict=True):
        t = amounts[i]
        weight = np.where(use[..., None], t / (t * first + _READ), 0)
        light += np.where(use[..., None], frames[i][0], 0) * weight
        total += t * weight
    shortest = frames[order[0]][0] / amounts[order[0]]
    merged = np.where(unseen[..., None], shortest, light / np.where(total > 0, total, 1))
    return merged.astype(np.float32), unseen
