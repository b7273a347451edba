"""Lower bounds of clipped pixels, encoded in the sign of their weight.

A sample has a weight of 0…1. A lower bound has the negative weight −(b + w / 2): bits 1, 2 and 4 of b are the clipped
channels, w in (0, 1] is its weight as a bound. Code that tests for a weight above 0 skips bounds; shaders that use them
decode them (shaders/common/observation.glsl).
"""

from __future__ import annotations

import numpy as np

_BITS = np.array([1, 2, 4], np.float32)


def bounded(weight: np.ndarray, clipped: np.ndarray) -> np.ndarray:
    """Return (…) float32 weights that encode weights (…) in 0…1 and the clipped channels (…, 3) bool."""
    bits = clipped @ _BITS
    return np.where((bits > 0) & (weight > 0), -(bits + weight / 2), weight).astype(np.float32)


def weight_and_clipped(bounded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Decode ``bounded``: return (…) weights in 0…1 and the clipped channels (…, 3) bool."""
    weight = np.maximum(bounded, 0).astype(np.float32)
    clipped = np.zeros((*weight.shape, 3), bool)
    bounds = np.nonzero(bounded <= -1)  # few pixels are bounds: only these are decoded
    bits = (-bounded[bounds]).astype(np.int32)
    weight[bounds] = 2 * (-bounded[bounds] - bits)
    clipped[bounds] = (bits[:, None] & _BITS.astype(np.int32)) > 0
    return weight, clipped


def without_bounds(rgba: np.ndarray) -> np.ndarray:
    """Return (…, 4) with weight 0 for bounds."""
    return np.concatenate([rgba[..., :3], np.maximum(rgba[..., 3:], 0)], axis=-1)
