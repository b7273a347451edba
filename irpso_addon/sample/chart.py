"""The colour chart as an image: patches on black card. Plain numpy."""

from __future__ import annotations

import numpy as np

from ..calibration.radiometry.colour_chart import COLUMNS, ROWS, patch_colours
from .layout import CHART_MARGIN, PATCH, PITCH

_BLACK = 0.018  # reflectance of the card
_TEXELS = 4  # per millimetre
WIDE = (ROWS - 1) * PITCH + PATCH + 2 * CHART_MARGIN  # millimetres
TALL = (COLUMNS - 1) * PITCH + PATCH + 2 * CHART_MARGIN


def chart_picture() -> np.ndarray:
    """Return (H, W, 3) linear reflectance, row 0 at the bottom, WIDE × TALL millimetres, rotated as in ``layout``."""
    x = (np.arange(round(WIDE * _TEXELS)) + 0.5) / _TEXELS - CHART_MARGIN
    y = (np.arange(round(TALL * _TEXELS)) + 0.5) / _TEXELS - CHART_MARGIN
    row, column = np.clip((x // PITCH).astype(int), 0, ROWS - 1), np.clip((y // PITCH).astype(int), 0, COLUMNS - 1)
    inside_x, inside_y = ((p >= 0) & (p - PITCH * n < PATCH) for p, n in ((x, row), (y, column)))
    in_patch = (inside_y[:, None] & inside_x)[..., None]
    return np.where(in_patch, patch_colours()[row[None, :], column[:, None]], _BLACK)
