"""Search for the grey card in a linear photograph: the one even, neutral quadrilateral; needs OpenCV."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...core.errors import InputError
from ...core.opencv import opencv
from ..radiometry.colour_difference import lab_of_linear
from ..radiometry.frames import Patch
from .quads import quads_of
from .search import EXPOSURES, as_shown, reduced

_MIN_SIDE, _MAX_SIDE = 0.04, 0.6  # of the image's longer side: least shorter side, and most longer side, of a card
_BORDER = 2.0  # pixels: a card nearer to the edge of the image may continue outside
_INNER = 0.7  # of a quadrilateral, about its centre: the measured part
_MAX_UNEVEN = 0.06  # standard deviation of the log radiance about a plane
_CLIPPED = 0.02  # of the pixels
_MAX_CHROMA = 12.0  # chroma in CIELAB, scaled to the lightness of a grey card, in the file's colours
_GREY = 0.184  # luminance of that lightness, L* = 50
_DARK = 0.03  # of the image's white: the tint of darker objects is uncertain
_PATCH = 0.25  # of the shorter side: half the side of the resulting square


class SeveralGreys(InputError):
    """A photograph shows several things that may be the grey card."""


def find_grey_card(rgba: np.ndarray, where: str) -> Patch | None:
    """Return a square on the grey card of a linear photograph (H, W, 4), row 0 at the bottom; None if it shows none.

    The card is even, has four corners, and is neutral in the file's colours. Raises SeveralGreys if several objects
    are; InputError if OpenCV is not installed.
    """
    small, factor = reduced(rgba, "the search for a grey card")
    cards: list[np.ndarray] = []
    for exposure in EXPOSURES:
        quads = quads_of(as_shown(small, exposure), _MAX_SIDE)
        for corners in sorted(quads, key=_area, reverse=True):
            if _is_card(small, corners) and not any(_contains(other, corners.mean(axis=0)) for other in cards):
                cards.append(corners)
    patches = [_patch(corners * factor) for corners in cards]
    if len(patches) > 1:
        places = ", ".join(str(patch) for patch in patches[:6])
        raise SeveralGreys(
            f"{where}: {len(patches)} things may be the grey card, at {places}; give the one that is, as X,Y,W,H"
        )
    return patches[0] if patches else None


def _is_card(rgba: np.ndarray, corners: np.ndarray) -> bool:
    """Return whether a quadrilateral (4, 2), from the upper left corner, is large, whole, even and neutral."""
    height, width = rgba.shape[:2]
    if min(_sides(corners)) < _MIN_SIDE * max(width, height):
        return False
    if not ((corners > _BORDER) & (corners < np.array((width, height)) - _BORDER)).all():
        return False
    inside = _mask(corners.mean(axis=0) + _INNER * (corners - corners.mean(axis=0)), (height, width))
    pixels = rgba[::-1][inside]
    if (pixels[:, 3] <= 0).mean() > _CLIPPED or not (mean := pixels[:, :3].mean(axis=0)).min() > 0:
        return False
    white = np.percentile(rgba[..., :3].mean(axis=-1), 99.5)
    if mean.mean() < _DARK * white:
        return False
    y, x = np.nonzero(inside)
    logs = np.log(np.maximum(pixels[:, :3].mean(axis=-1), 1e-6))
    plane = np.column_stack([x, y, np.ones(len(x))])
    residual = logs - plane @ np.linalg.lstsq(plane, logs, rcond=None)[0]
    if residual.std() > _MAX_UNEVEN:
        return False
    _, a, b = lab_of_linear(mean * _GREY / (mean @ (0.2126, 0.7152, 0.0722)))
    return bool(np.hypot(a, b) < _MAX_CHROMA)


def _mask(corners: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return bool (H, W), row 0 at the top: the inside of a convex quadrilateral."""
    cv = opencv("the search for a grey card")
    inside = np.zeros(shape, np.uint8)
    cv.fillConvexPoly(inside, np.rint(corners - 0.5).astype(np.int32), 1)
    return inside > 0


def _sides(corners: np.ndarray) -> Iterator[float]:
    yield from np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).tolist()


def _area(corners: np.ndarray) -> float:
    x, y = corners.T
    return abs(float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum()))


def _contains(corners: np.ndarray, point: np.ndarray) -> bool:
    """Return whether a point lies in a quadrilateral whose corners go clockwise on the screen."""
    sides, offsets = np.roll(corners, -1, axis=0) - corners, point - corners
    return bool((sides[:, 0] * offsets[:, 1] - sides[:, 1] * offsets[:, 0] > 0).all())


def _patch(corners: np.ndarray) -> Patch:
    half = _PATCH * min(_sides(corners))
    x, y = corners.mean(axis=0) - half
    side = max(1, round(2 * half))
    return Patch(round(x), round(y), side, side)
