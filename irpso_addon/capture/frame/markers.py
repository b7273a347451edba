"""Detects the markers of a printed board in a photograph."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...core.opencv import opencv
from .board import BOARDS, DICTIONARY, Board
from .homography import homography, mapped

_MIN_MARKERS = 2  # markers: eight corners
_SMALL = 900  # pixels of the longer side: smaller pictures are enlarged
_OFF = 0.01  # largest reprojection error of a corner, of the picture's diagonal


@dataclass(frozen=True)
class Seen:
    """Markers of one board in one photograph. numbers: of the markers, each with four successive corners.

    plane: (M, 2) millimetres on the board. pixels: (M, 2) from the picture's UPPER left corner, to the right and down.
    """

    board: Board
    plane: np.ndarray
    pixels: np.ndarray
    numbers: tuple[int, ...]


def seen_markers(codes: np.ndarray) -> Seen | None:
    """Return the markers of the board with the most; None for fewer than two, or if they do not lie in one plane.

    codes: (H, W) uint8, display values, row 0 at the TOP. Raises InputError without OpenCV.
    """
    cv2 = opencv("finding printed markers")
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    settings.adaptiveThreshWinSizeMax = 53
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARY))
    height, width = codes.shape
    factor = 2 if max(height, width) < _SMALL else 1  # the corner refinement searches five pixels around
    enlarged = cv2.resize(codes, (width * factor, height * factor), interpolation=cv2.INTER_CUBIC)
    corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary, settings).detectMarkers(enlarged)
    if numbers is None:
        return None
    # OpenCV's origin is the centre of the first pixel.
    by_number = {
        int(number): (places[0].astype(float) + 0.5) / factor
        for number, places in zip(numbers.ravel(), corners, strict=True)
    }
    board = max(BOARDS, key=lambda board: len(by_number.keys() & board.markers.keys()))
    shared = sorted(by_number.keys() & board.markers.keys())
    if len(shared) < _MIN_MARKERS:
        return None
    plane = np.concatenate([board.markers[number] for number in shared])
    pixels = np.concatenate([by_number[number] for number in shared])
    errors = np.linalg.norm(mapped(homography(plane, pixels), plane) - pixels, axis=1)
    if errors.max() > _OFF * math.hypot(*codes.shape):
        return None  # not a flat board, or other markers of the same numbers
    return Seen(board, plane, pixels, tuple(shared))
