"""The 24-patch colour chart: the order of its patches and their published colours.

Values: the chart's maker, "Colorimetric values for ColorChecker family of targets", sRGB of 8 bits under D65; the same
in D. Pascale, "RGB coordinates of the Macbeth ColorChecker", BabelColor 2006.
"""

from __future__ import annotations

import numpy as np

from ...core.encode import linear_from_srgb

COLUMNS, ROWS = 6, 4
# Row by row from the upper left corner of a chart whose grey row lies at the bottom.
PATCHES = {
    "dark skin": (115, 82, 68), "light skin": (194, 150, 130), "blue sky": (98, 122, 157),
    "foliage": (87, 108, 67), "blue flower": (133, 128, 177), "bluish green": (103, 189, 170),
    "orange": (214, 126, 44), "purplish blue": (80, 91, 166), "moderate red": (193, 90, 99),
    "purple": (94, 60, 108), "yellow green": (157, 188, 64), "orange yellow": (224, 163, 46),
    "blue": (56, 61, 150), "green": (70, 148, 73), "red": (175, 54, 60),
    "yellow": (231, 199, 31), "magenta": (187, 86, 149), "cyan": (8, 133, 161),
    "white": (243, 243, 242), "neutral 8": (200, 200, 200), "neutral 6.5": (160, 160, 160),
    "neutral 5": (122, 122, 121), "neutral 3.5": (85, 85, 85), "black": (52, 52, 52),
}  # fmt: skip


def patch_colours() -> np.ndarray:
    """Return the patches' linear Rec. 709 reflectance (ROWS, COLUMNS, 3) float64, upper row first."""
    return linear_from_srgb(np.array(list(PATCHES.values()), np.float64) / 255).reshape(ROWS, COLUMNS, 3)
