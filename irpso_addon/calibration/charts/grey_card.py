"""Finds the grey card in a linear photograph: the one even, neutral quadrilateral. OpenCV finds outlines."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...core.errors import InputError
from ...core.opencv import opencv
from ..radiometry.colour_difference import lab_of_linear
from ..radiometry.frames import Patch
from .quads import quads_of
from .search import EXPOSURES, as_shown, reduced

_LEAST, _MOST = 0.04, 0.6  # of the picture's longer side: a card's shorter side, and its longer one
_BORDER = 2.0  # pixels: what reaches the frame may go on outside
_INNER = 0.7  # of a quadrilateral, about its middle: what is measured
_EVEN = 0.06  # deviation of the logarithm of the light, a slope over the card taken off
_CLIPPED = 0.02  # of the pixels
_NEUTRAL = 12.0  # chroma in CIELAB at the lightness of a grey card, as the file has it
_GREY = 0.184  # luminance of that lightness, L* = 50
_DARK = 0.03  # of the picture's white: darker things tell no tint
_PATCH = 0.25  # of the shorter side: half the side of the square that a person would give


class SeveralGreys(InputError):
    """A photograph shows several things that may be the grey card."""


def find_grey_card(rgba: np.ndarray, where: str) -> Patch | None:
    """Return a square on the grey card of a linear photograph (H, W, 4), row 0 at the bottom; None if it shows none.

    The card is even, has four corners, and is neutral as the file has its colours. Raises SeveralGreys where several
    things are all that; InputError where OpenCV is not installed.
    """
    small, factor = reduced(rgba, "the search for a grey card")
    found: list[np.ndarray] = []
    for exposure in EXPOSURES:
        quads = quads_of(as_shown(small, exposure), _MOST)
        for corners in sorted(quads, key=_area, reverse=True):
            if _is_card(small, corners) and not any(_holds(other, corners.mean(axis=0)) for other in found):
                found.append(corners)
    patches = [_patch(corners * factor) for corners in found]
    if len(patches) > 1:
        places = ", ".join(str(patch) for patch in patches[:6])
        raise SeveralGreys(
            f"{where}: {len(patches)} things may be the grey card, at {places}; give the one that is, as X,Y,W,H"
        )
    return patches[0] if patches else None


def _is_card(rgba: np.ndarray, corners: np.ndarray) -> bool:
    """Return whether a quadrilateral (4, 2), from the upper left corner, is large, whole, even and neutral."""
    height, width = rgba.shape[:2]
    if min(_sides(corners)) < _LEAST * max(width, height):
        return False
    if not ((corners > _BORDER) & (corners < np.array((width, height)) - _BORDER)).all():
        return False
    inside = _mask(corners.mean(axis=0) + _INNER * (corners - corners.mean(axis=0)), (height, width))
    pixels = rgba[::-1][inside]
    if (pixels[:, 3] <= 0).mean() > _CLIPPED or not (light := pixels[:, :3].mean(axis=0)).min() > 0:
        return False
    white = np.percentile(rgba[..., :3].mean(axis=-1), 99.5)
    if light.mean() < _DARK * white:
        return False
    y, x = np.nonzero(inside)
    logs = np.log(np.maximum(pixels[:, :3].mean(axis=-1), 1e-6))
    plane = np.column_stack([x, y, np.ones(len(x))])
    rest = logs - plane @ np.linalg.lstsq(plane, logs, rcond=None)[0]
    if rest.std() > _EVEN:
        return False
    _, a, b = lab_of_linear(light * _GREY / (light @ (0.2126, 0.7152, 0.0722)))
    return bool(np.hypot(a, b) < _NEUTRAL)


def _mask(corners: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return (H, W) bool, row 0 at the top: the inside of a convex quadrilateral."""
    cv = opencv("the search for a grey card")
    inside = np.zeros(shape, np.uint8)
    cv.fillConvexPoly(inside, np.rint(corners - 0.5).astype(np.int32), 1)
    return inside > 0


def _sides(corners: np.ndarray) -> Iterator[float]:
    yield from np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).tolist()


def _area(corners: np.ndarray) -> float:
    x, y = corners.T
    return abs(float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum()))


def _holds(corners: np.ndarray, point: np.ndarray) -> bool:
    """Return whether a point lies in a quadrilateral whose corners go clockwise on the screen."""
    ways, away = np.roll(corners, -1, axis=0) - corners, point - corners
    return bool((ways[:, 0] * away[:, 1] - ways[:, 1] * away[:, 0] > 0).all())


def _patch(corners: np.ndarray) -> Patch:
    half = _PATCH * min(_sides(corners))
    x, y = corners.mean(axis=0) - half
    side = max(1, round(2 * half))
    return Patch(round(x), round(y), side, side)
