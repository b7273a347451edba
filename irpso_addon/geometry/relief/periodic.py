"""Periodic heights from periodic normals (Frankot & Chellappa 1988)."""

from __future__ import annotations

import numpy as np

from .height import TEXELS, Height

_MIN_NZ = 0.1  # steeper normals count as 84°


def periodic_height(normals: np.ndarray) -> Height:
    """Return the periodic relief of normals (H, W, 3) that repeat across opposite borders: least squares of slopes.

    In texels, toward the normal, mean 0. The mean slope, which is not periodic, is dropped.
    """
    height, width = normals.shape[:2]
    z = np.maximum(normals[..., 2], _MIN_NZ).astype(np.float64)
    along, up = (np.fft.fft2(-normals[..., k] / z) for k in (0, 1))
    x, y = 2 * np.pi * np.fft.fftfreq(width)[None], 2 * np.pi * np.fft.fftfreq(height)[:, None]
    square = x**2 + y**2
    square[0, 0] = 1.0
    spectrum = -1j * (x * along + y * up) / square
    spectrum[0, 0] = 0.0
    return Height(np.fft.ifft2(spectrum).real.astype(np.float32), np.ones((height, width), bool), TEXELS)
