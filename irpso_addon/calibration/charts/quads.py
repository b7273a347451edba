"""Even quadrilaterals in an image: regions without edges whose outline has four corners."""

from __future__ import annotations

from collections.abc import Iterator
from types import ModuleType

import numpy as np

from ...core.opencv import opencv

_SIZES = (1.0, 0.5, 0.25)  # of the image: reduction removes edges inside large patches of sharp photographs
_EDGES = (5.0, 9.0, 16.0, 30.0)  # codes per pixel: steeper pixels are edges
_MIN_SIDE, _MAX_SIDE = 5.0, 0.2  # of a quadrilateral's side: pixels, and fraction of the image's longer side
_MIN_IMAGE_SIDE = 300  # pixels: least longer side of a reduced image
_FILLED = 0.85  # area of the region over that of its convex hull
_QUAD = (0.85, 1.2)  # area of the quadrilateral over that of the hull
_OBLONG = 4.0  # most longer side over shorter


def quads_of(picture: np.ndarray, most: float = _MAX_SIDE) -> np.ndarray:
    """Return the corners (N, 4, 2), clockwise on the screen, of even quadrilaterals in an image (H, W, 3) uint8.

    Pixels count from the upper left corner; row 0 is at the top. A patch may be found several times. most: largest
    longer side, as a fraction of the image's.
    """
    cv = opencv("the search for charts")
    quads = []
    for size in _SIZES:
        height, width = (round(side * size) for side in picture.shape[:2])
        if size < 1 and max(height, width) < _MIN_IMAGE_SIDE:
            break
        resized = picture if size == 1 else cv.resize(picture, (width, height), interpolation=cv.INTER_AREA)
        steep = _steepness(cv, resized)
        for edge in _EDGES:
            quads += [corners / size for corners in _even_quads(cv, steep <= edge, most)]
    return np.array(quads).reshape(-1, 4, 2)


def _steepness(cv: ModuleType, picture: np.ndarray) -> np.ndarray:
    """Return the largest slope (H, W) of the three channels, in codes per pixel."""
    smooth = cv.GaussianBlur(picture, (3, 3), 0).astype(np.float32)
    slopes = [cv.Sobel(smooth, cv.CV_32F, *axis, ksize=3, scale=1 / 8) for axis in ((1, 0), (0, 1))]
    return np.hypot(*slopes).max(axis=-1)


def _even_quads(cv: ModuleType, even: np.ndarray, most: float) -> Iterator[np.ndarray]:
    """Yield corners (4, 2) of connected even regions that are quadrilaterals; edges shorten each by about a pixel."""
    largest = most * max(even.shape)
    outlines, _ = cv.findContours(even.astype(np.uint8), cv.RETR_CCOMP, cv.CHAIN_APPROX_NONE)
    for outline in outlines:
        _, (across, along), _ = cv.minAreaRect(outline)
        short, long = sorted((across, along))
        if short < _MIN_SIDE or long > largest or long > _OBLONG * short:
            continue
        hull = cv.convexHull(outline)
        area = cv.contourArea(hull)
        if cv.contourArea(outline) < _FILLED * area:
            continue
        perimeter = cv.arcLength(hull, True)
        for tolerance in (0.03, 0.05, 0.08, 0.12):
            corners = cv.approxPolyDP(hull, tolerance * perimeter, True)
            if len(corners) <= 4:
                break
        if len(corners) == 4 and _QUAD[0] < cv.contourArea(corners) / area < _QUAD[1]:
            corners = corners[:, 0].astype(np.float64) + 0.5
            yield corners if _clockwise(corners) else corners[::-1]


def _clockwise(corners: np.ndarray) -> bool:
    """Return whether corners go clockwise on the screen, where y points down."""
    x, y = corners.T
    return bool((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() > 0)
