"""Searches the four corners of a flat subject in a capture's photographs."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass
from itertools import count

import numpy as np

from ...core.encode import srgb_from_linear
from ...core.steps import blocking, map_steps
from ..bounds import without_bounds
from ..errors import CaptureError
from ..types import Capture
from .board import Board
from .homography import homography, mapped
from .markers import Seen, seen_markers
from .rectangle import dominant, fitted, quadrilaterals

Corners = tuple[tuple[float, float], ...]
_PICTURES = 9  # most photographs to read
_READ = 0.5  # fraction of the work done after reading
_BRIGHT = 99.0  # percentile of radiance that becomes white
_APART = 0.006  # of the diagonal: largest distance of a photograph's corners from the median of all photographs
_AGREE = 0.5  # least share of the photographs read that must agree
_REMEDY = "give them: --corners X1,Y1,…,X4,Y4, or mark them in the window"


@dataclass(frozen=True)
class DetectedCorners:
    """corners: four (x, y), clockwise from the upper left one, in pixels from the picture's upper left corner.

    photographs: number that agree, of ``read`` photographs. board: of the markers, None for a rectangle.
    """

    corners: Corners
    photographs: int
    read: int
    board: Board | None = None

    @property
    def width(self) -> float | None:
        """Width of the board's field in millimetres; None without markers."""
        return None if self.board is None else self.board.field[0]

    def __str__(self) -> str:
        points = "  ".join(f"{x:.1f},{y:.1f}" for x, y in self.corners)
        by = "as the rectangle" if self.board is None else f"by {self.board.name}"
        return f"{points}, {by} in {self.photographs} of {self.read} photographs"


def evenly_spaced(number: int, most: int) -> list[int]:
    """Return at most so many of 0 … number − 1, evenly spaced from the first to the last."""
    return sorted({round(k * (number - 1) / max(most - 1, 1)) for k in range(most)})


def corner_steps(capture: Capture) -> Generator[float, None, DetectedCorners]:
    """Return the corners of the flat subject of one camera: the field of a marker board, or the dominant rectangle.

    Yields the fraction done. Reads up to nine photographs. Raises CaptureError where neither shows, several could be
    meant or the photographs disagree, and InputError without OpenCV.
    """
    if len(capture.cameras) != 1:
        raise CaptureError(
            f"corners auto: capture '{capture.name}' has {len(capture.cameras)} cameras; it is for one", "corners"
        )
    numbers = evenly_spaced(len(capture.observations), _PICTURES)
    pictures = []
    for done, number in enumerate(numbers):
        yield _READ * done / len(numbers)
        pictures.append(_radiance(capture, number))
    yield _READ
    codes = [display_codes(picture) for picture in pictures]
    height, width = codes[0].shape
    combined = [display_codes(np.max(pictures, axis=0)), display_codes(np.median(pictures, axis=0))]
    total, searched = 2 * (len(codes) + len(combined)), count(1)
    search = _search_steps(codes, combined, capture.name)
    result = yield from map_steps(search, lambda _: _READ + (1 - _READ) * next(searched) / total)
    outside = [f"{x:.0f},{y:.0f}" for x, y in result.corners if not (0 <= x <= width and 0 <= y <= height)]
    if outside:
        raise CaptureError(
            f"corners auto: the corner {outside[0]} of '{capture.name}' lies outside the photographs; show all of the"
            " card, or use crop",
            "corners",
        )
    return result


find_corners = blocking("find_corners", corner_steps)


def display_codes(radiance: np.ndarray) -> np.ndarray:
    """Return (H, W) uint8 display values, row 0 at the TOP, of a grey radiance (H, W), row 0 at the bottom."""
    white = max(float(np.percentile(radiance, _BRIGHT)), 1e-9)
    return np.round(255 * srgb_from_linear(np.clip(radiance / white, 0, 1)))[::-1].astype(np.uint8)


def _radiance(capture: Capture, number: int) -> np.ndarray:
    """Return (H, W) grey of a photograph; 0 where it is not a number."""
    return np.nan_to_num(without_bounds(capture.observations[number].read())[..., :3].mean(axis=-1), posinf=0.0)


def _search_steps(
    codes: list[np.ndarray], combined: list[np.ndarray], name: str
) -> Generator[None, None, DetectedCorners]:
    """Yield before searching each picture; return the corners by markers, else by the outline."""
    markers = []
    for picture in (*codes, *combined):
        yield
        markers.append(seen_markers(picture))
    if any(seen is not None for seen in markers):
        return _by_markers(markers[: len(codes)], markers[len(codes) :])
    return (yield from _by_outline(codes, combined, name))


def _by_markers(single: list[Seen | None], combined: list[Seen | None]) -> DetectedCorners:
    """Return the field's corners from the markers of single photographs and of combined pictures."""
    detections = [one for one in (*single, *combined) if one is not None]
    board = max((one.board for one in detections), key=lambda board: sum(one.board == board for one in detections))
    same = [one for one in detections if one.board == board]
    by_number: dict[int, list[np.ndarray]] = {}
    for one in same:
        for k, number in enumerate(one.numbers):
            by_number.setdefault(number, []).append(one.pixels[4 * k : 4 * k + 4])
    plane = np.concatenate([board.markers[number] for number in by_number])
    pixels = np.concatenate([np.median(places, axis=0) for places in by_number.values()])
    corners = mapped(homography(plane, pixels), board.field_corners)
    agree = sum(one is not None and one.board == board for one in single)
    return DetectedCorners(_points(corners), agree, len(single), board)


def _by_outline(
    codes: list[np.ndarray], combined: list[np.ndarray], name: str
) -> Generator[None, None, DetectedCorners]:
    """Return the mean of the combined pictures' dominant rectangle, fitted to each photograph. Raises CaptureError."""
    outlines = []
    for picture in combined:
        yield
        outlines.append(dominant(quadrilaterals(picture)))
    if any(rival for _, rival in outlines):
        raise CaptureError(f"corners auto: '{name}' shows several rectangles of about one size; {_REMEDY}", "corners")
    first = next((outline for outline, _ in outlines if outline is not None), None)
    if first is None:
        raise CaptureError(
            f"corners auto: '{name}' shows neither printed markers nor one rectangle whose four sides stand out;"
            f" {_REMEDY}",
            "corners",
        )
    fits = []
    for picture in codes:
        yield
        if (corners := fitted(picture, first)) is not None:
            fits.append(corners)
    diagonal = math.hypot(*codes[0].shape)
    middle = np.median(fits, axis=0) if fits else first
    close = [corners for corners in fits if np.linalg.norm(corners - middle, axis=1).max() < _APART * diagonal]
    if len(close) < _AGREE * len(codes):
        raise CaptureError(
            f"corners auto: a rectangle shows in '{name}', and only {len(close)} of {len(codes)} photographs agree on"
            f" it; {_REMEDY}",
            "corners",
        )
    return DetectedCorners(_points(np.mean(close, axis=0)), len(close), len(codes))


def _points(corners: np.ndarray) -> Corners:
    return tuple((float(x), float(y)) for x, y in corners)
