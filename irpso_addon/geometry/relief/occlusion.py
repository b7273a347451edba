"""Ambient occlusion of a relief: the part of an even sky that each texel sees (Zhukov, Iones & Kronin 1998)."""

from __future__ import annotations

import numpy as np

from .height import Height

_AZIMUTHS = 16
_DISTANCES = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 19, 22, 26, 30, 35, 42, 50, 60)  # texels


def open_sky(height: Height, wraps: bool = False) -> np.ndarray:
    """Return (H, W) float32 in 0…1: the share of the light of an even sky that reaches each texel, weighted by cosine.

    height: a card's, in texels. wraps: whether the relief repeats; if not, only its covered texels hide the sky. The
    horizon is searched in 16 directions, up to 60 texels away, around the normal of the heights.
    """
    values = np.where(height.covered, height.values, -np.inf).astype(np.float32)
    up, along = (_slope(height, axis, wraps) for axis in (0, 1))
    z = 1 / np.sqrt(1 + along**2 + up**2)
    total = np.zeros(values.shape)
    for azimuth in 2 * np.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS:
        uphill = along * np.cos(azimuth) + up * np.sin(azimuth)
        steepest = np.full(values.shape, -np.inf)
        for distance in _DISTANCES:
            x, y = round(distance * np.cos(azimuth)), round(distance * np.sin(azimuth))
            if abs(x) >= values.shape[1] or abs(y) >= values.shape[0]:
                break
            # Above the texel's own plane: rounding to whole texels (x, y) leaves the direction.
            rise = _moved(values, x, y, wraps) - height.values - (along * x + up * y)
            np.maximum(steepest, uphill + rise / np.hypot(x, y), out=steepest)
        toward = -z * uphill  # of the normal
        zenith = np.pi / 2 - np.arctan(steepest)
        zenith = np.minimum(zenith, np.pi / 2 + np.arctan(toward / z))  # below it the texel itself hides the sky
        total += toward * (zenith / 2 - np.sin(2 * zenith) / 4) + z * np.sin(zenith) ** 2 / 2
    return np.where(height.covered, np.clip(2 * total / _AZIMUTHS, 0, 1), 1).astype(np.float32)


def _slope(height: Height, axis: int, wraps: bool) -> np.ndarray:
    """Return (H, W) mean slopes to the covered neighbours along an axis; 0 without any."""
    values = np.where(height.covered, height.values, np.nan).astype(np.float64)
    x, y = (0, 1) if axis == 0 else (1, 0)
    steps = np.stack([_moved(values, x, y, wraps) - values, values - _moved(values, -x, -y, wraps)])
    finite = np.isfinite(steps)
    return np.where(finite, steps, 0).sum(axis=0) / np.maximum(finite.sum(axis=0), 1)


def _moved(values: np.ndarray, x: int, y: int, wraps: bool) -> np.ndarray:
    """Return at each texel the value x texels to the right and y up; −∞ beyond the border, unless it wraps."""
    moved = np.roll(values, (-y, -x), axis=(0, 1))
    if wraps:
        return moved
    rows, columns = values.shape
    moved[max(rows - y, 0) if y > 0 else 0 : rows if y > 0 else min(-y, rows)] = -np.inf
    moved[:, max(columns - x, 0) if x > 0 else 0 : columns if x > 0 else min(-x, columns)] = -np.inf
    return moved
