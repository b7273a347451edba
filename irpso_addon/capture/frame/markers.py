"""Markers of a printed marker board in photographs, and the plane that they lie in."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...core.opencv import opencv
from .board import BOARDS, DICTIONARY, Board
from .homography import homography, mapped

_FEWEST = 2  # markers: eight corners on two places of the board
_SMALL = 900  # pixels of the longer side below which a picture is enlarged
_OFF = 0.01  # of the picture's diagonal: how far a corner may lie from where the others say it is


@dataclass(frozen=True)
class Seen:
    """Markers of one board in one photograph. plane: (M, 2) millimetres on the board. pixels: (M, 2) in the photograph,

    from its UPPER left corner, to the right and down. numbers: of the markers, each with four corners in a row.
    """

    board: Board
    plane: np.ndarray
    pixels: np.ndarray
    numbers: tuple[int, ...]


def seen_markers(codes: np.ndarray) -> Seen | None:
    """Return the markers of the board that most are of; None where fewer than two show.

    codes: (H, W) uint8, display values, row 0 at the TOP. Raises InputError without OpenCV.
    """
    cv2 = opencv("finding printed markers")
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    settings.adaptiveThreshWinSizeMax = 53
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARY))
    height, width = codes.shape
    larger = 2 if max(height, width) < _SMALL else 1  # its search for corners looks five pixels around
    shown = cv2.resize(codes, (width * larger, height * larger), interpolation=cv2.INTER_CUBIC)
    corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary, settings).detectMarkers(shown)
    if numbers is None:
        return None
    # OpenCV's pixels count from the middle of the first one.
    found = {
        int(number): (places[0].astype(float) + 0.5) / larger
        for number, places in zip(numbers.ravel(), corners, strict=True)
    }
    board = max(BOARDS, key=lambda board: len(found.keys() & board.markers.keys()))
    shared = sorted(found.keys() & board.markers.keys())
    if len(shared) < _FEWEST:
        return None
    plane = np.concatenate([board.markers[number] for number in shared])
    pixels = np.concatenate([found[number] for number in shared])
    off = np.linalg.norm(mapped(homography(plane, pixels), plane) - pixels, axis=1)
    if off.max() > _OFF * math.hypot(*codes.shape):
        return None  # not a flat board, or other markers of the same numbers
    return Seen(board, plane, pixels, tuple(shared))
