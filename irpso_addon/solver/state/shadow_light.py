"""Indirect light at a texel, as spherical harmonics of the lamp's direction in the texel's own frame.

shaders/prefit/shadow_light.glsl estimates the coefficients from the texel's shadows.
"""

from __future__ import annotations

import numpy as np

from .separation_record import HARMONICS


def harmonics(vectors: np.ndarray) -> np.ndarray:
    """Return (…, 9) the real spherical harmonics to order 2, up to constants, of unit vectors (…, 3)."""
    x, y, z = (vectors[..., axis] for axis in range(3))
    return np.stack([np.ones_like(x), x, y, z, x * y, x * z, y * z, x * x - y * y, 3 * z * z - 1], axis=-1)


def light_of(vectors: np.ndarray, coefficients: np.ndarray, chroma: np.ndarray) -> np.ndarray:
    """Return (K, T, 3): indirect radiance over irradiance/π at T texels, under lights at vectors (K, T or 1, 3).

    coefficients: (T, 9) of ``harmonics``, for the mean of the channels. chroma: (T, 3).
    """
    basis = harmonics(vectors)
    total = basis[..., 0] * coefficients[:, 0]
    for order in range(1, HARMONICS):
        total = total + basis[..., order] * coefficients[:, order]
    return np.maximum(total, 0)[..., None] * (3 * chroma)
