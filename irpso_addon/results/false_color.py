"""Colour map of errors: blue is low, red is high, as in the figures of Nagano et al."""

from __future__ import annotations

import numpy as np

UNCOVERED = (0.150, 0.150, 0.156)

# (N, 3) display values at equal steps, linear between them.
# Lightness (OKLab) rises from deep blue to yellow at two thirds and falls slightly to red: equal steps of error look
# about equal, and the highest errors stand out by hue and saturation, not by glare.
COLORS = np.array([
    (0.130, 0.145, 0.420), (0.130, 0.300, 0.690), (0.110, 0.500, 0.800), (0.140, 0.660, 0.700), (0.400, 0.760, 0.480),
    (0.730, 0.810, 0.320), (0.970, 0.760, 0.230), (0.960, 0.520, 0.170), (0.880, 0.270, 0.150), (0.720, 0.070, 0.120),
])  # fmt: skip


def false_color(error: np.ndarray, maximum: float, covered: np.ndarray | None = None) -> np.ndarray:
    """Return (H, W, 3) float32 display values of an error (H, W): blue at 0, red at ``maximum`` and above.

    Uncovered and NaN texels are dark grey.
    """
    error = np.asarray(error, np.float64)
    visible = np.isfinite(error) if covered is None else np.isfinite(error) & covered
    place = np.clip(np.where(visible, error, 0) / (maximum if maximum > 0 else 1.0), 0, 1) * (len(COLORS) - 1)
    knots = np.arange(len(COLORS))
    colors = np.stack([np.interp(place, knots, COLORS[:, c]) for c in range(3)], axis=-1)
    return np.where(visible[..., None], colors, UNCOVERED).astype(np.float32)
