"""The four corners of a flat subject, found in a capture's photographs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...core.encode import srgb_from_linear
from ..bounds import without_bounds
from ..errors import CaptureError
from ..types import Capture
from .homography import homography, mapped
from .markers import seen_markers
from .rectangle import dominant, fitted, quadrilaterals
from .sheet import Sheet

Corners = tuple[tuple[float, float], ...]
_PICTURES = 9  # photographs that are read
_BRIGHT = 99.0  # percentile that is shown white
_APART = 0.006  # of the picture's diagonal: how far a photograph's own corners may lie from all the photographs' median
_AGREE = 0.5  # share of the photographs read
_REMEDY = "give them: --corners X1,Y1,…,X4,Y4, or mark them in the window"


@dataclass(frozen=True)
class Found:
    """corners: four (x, y), clockwise from the upper left one, in pixels from the picture's upper left corner.

    photographs: how many of those read agree. read: how many that is. sheet: of the markers, None for a rectangle.
    """

    corners: Corners
    photographs: int
    read: int
    sheet: Sheet | None = None

    @property
    def width(self) -> float | None:
        """The width of the rectangle in millimetres, as its sheet says; None without markers."""
        return None if self.sheet is None else self.sheet.field[0]

    def __str__(self) -> str:
        points = "  ".join(f"{x:.1f},{y:.1f}" for x, y in self.corners)
        by = "as the rectangle" if self.sheet is None else f"by {self.sheet.name}"
        return f"{points}, {by} in {self.photographs} of {self.read} photographs"


def find_corners(capture: Capture) -> Found:
    """Return the corners of the flat subject of one camera: the field of a printed sheet, or the dominant rectangle.

    Reads up to nine photographs. Raises CaptureError where neither shows, several could be meant or the photographs
    disagree, and InputError without OpenCV.
    """
    if len(capture.cameras) != 1:
        raise CaptureError(
            f"corners auto: capture '{capture.name}' has {len(capture.cameras)} cameras; it is for one", "corners"
        )
    count = len(capture.observations)
    numbers = sorted({round(k * (count - 1) / (_PICTURES - 1)) for k in range(_PICTURES)})
    pictures = [_radiance(capture, number) for number in numbers]
    codes = [display_codes(picture) for picture in pictures]
    height, width = codes[0].shape
    together = [display_codes(np.max(pictures, axis=0)), display_codes(np.median(pictures, axis=0))]
    found = _by_markers(codes, together) or _by_outline(codes, together, capture.name)
    outside = [f"{x:.0f},{y:.0f}" for x, y in found.corners if not (0 <= x <= width and 0 <= y <= height)]
    if outside:
        raise CaptureError(
            f"corners auto: the corner {outside[0]} of '{capture.name}' lies outside the photographs; show all of the"
            " card, or use crop",
            "corners",
        )
    return found


def display_codes(radiance: np.ndarray) -> np.ndarray:
    """Return (H, W) uint8 display values, row 0 at the TOP, of a grey radiance (H, W), row 0 at the bottom."""
    white = max(float(np.percentile(radiance, _BRIGHT)), 1e-9)
    return np.round(255 * srgb_from_linear(np.clip(radiance / white, 0, 1)))[::-1].astype(np.uint8)


def _radiance(capture: Capture, number: int) -> np.ndarray:
    """Return (H, W) grey of a photograph; 0 where it is not a number."""
    return np.nan_to_num(without_bounds(capture.observations[number].read())[..., :3].mean(axis=-1), posinf=0.0)


def _by_markers(codes: list[np.ndarray], together: list[np.ndarray]) -> Found | None:
    """Return the field's corners by all markers that a photograph or all of them together show."""
    each = [seen_markers(picture) for picture in codes]
    seen = [found for found in (*each, *map(seen_markers, together)) if found is not None]
    if not seen:
        return None
    sheet = max((found.sheet for found in seen), key=lambda sheet: sum(found.sheet == sheet for found in seen))
    same = [found for found in seen if found.sheet == sheet]
    by_number: dict[int, list[np.ndarray]] = {}
    for found in same:
        for k, number in enumerate(found.numbers):
            by_number.setdefault(number, []).append(found.pixels[4 * k : 4 * k + 4])
    plane = np.concatenate([sheet.markers[number] for number in by_number])
    pixels = np.concatenate([np.median(places, axis=0) for places in by_number.values()])
    corners = mapped(homography(plane, pixels), sheet.field_corners)
    agree = sum(found is not None and found.sheet == sheet for found in each)
    return Found(_points(corners), agree, len(codes), sheet)


def _by_outline(codes: list[np.ndarray], together: list[np.ndarray], name: str) -> Found:
    """Return the dominant rectangle of all photographs together, fitted again in each. Raises CaptureError."""
    outlines = [dominant(quadrilaterals(picture)) for picture in together]
    if any(rival for _, rival in outlines):
        raise CaptureError(f"corners auto: '{name}' shows several rectangles of about one size; {_REMEDY}", "corners")
    first = next((outline for outline, _ in outlines if outline is not None), None)
    if first is None:
        raise CaptureError(
            f"corners auto: '{name}' shows neither printed markers nor one rectangle whose four sides stand out;"
            f" {_REMEDY}",
            "corners",
        )
    own = [found for found in (fitted(picture, first) for picture in codes) if found is not None]
    diagonal = math.hypot(*codes[0].shape)
    middle = np.median(own, axis=0) if own else first
    near = [found for found in own if np.linalg.norm(found - middle, axis=1).max() < _APART * diagonal]
    if len(near) < _AGREE * len(codes):
        raise CaptureError(
            f"corners auto: a rectangle shows in '{name}', and only {len(near)} of {len(codes)} photographs agree on"
            f" it; {_REMEDY}",
            "corners",
        )
    return Found(_points(np.mean(near, axis=0)), len(near), len(codes))


def _points(corners: np.ndarray) -> Corners:
    return tuple((float(x), float(y)) for x, y in corners)
