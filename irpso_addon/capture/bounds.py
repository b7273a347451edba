"""Bounds in place of samples: what a clipped pixel still tells, kept in the sign of its weight.

A weight of 0…1 is a sample's. A negative one, −(b + w / 2), is that of a lower bound: bits 1, 2 and 4 of b are the
channels that are clipped, w in (0, 1] is what it would weigh. So whatever asks for a weight above 0 passes it over, and
the shaders that know of bounds read it (shaders/common/observation.glsl).
"""

from __future__ import annotations

import numpy as np

_BITS = np.array([1, 2, 4], np.float32)


def bounded(weight: np.ndarray, clipped: np.ndarray) -> np.ndarray:
    """Return (…) float32 weights, of (…) in 0…1, that tell which channels (…, 3) bool are clipped."""
    bits = clipped @ _BITS
    return np.where((bits > 0) & (weight > 0), -(bits + weight / 2), weight).astype(np.float32)


def weight_and_clipped(bounded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what ``bounded`` was made of: (…) weights in 0…1 and (…, 3) bool."""
    below = np.maximum(-bounded, 0)
    bits = below.astype(np.int32)
    clipped = (bits[..., None] & _BITS.astype(np.int32)) > 0
    return np.where(bits > 0, 2 * (below - bits), np.maximum(bounded, 0)).astype(np.float32), clipped


def without_bounds(rgba: np.ndarray) -> np.ndarray:
    """Return (…, 4) of which bounds weigh nothing."""
    return np.concatenate([rgba[..., :3], np.maximum(rgba[..., 3:], 0)], axis=-1)
