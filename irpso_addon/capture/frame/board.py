"""Marker boards to print: ArUco markers around an empty field of known size (Garrido-Jurado et al. 2014).

The markers' numbers identify the board, and with it the field's size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...core.errors import InputError
from ...core.files import check_unused, replacing_file
from ...core.opencv import opencv

if TYPE_CHECKING:
    from PIL import Image

DICTIONARY = "DICT_4X4_50"
PAPERS = {"A4": (210.0, 297.0), "letter": (215.9, 279.4)}  # millimetres
SIDE = 24.0  # of a marker, millimetres
_EDGE = 10.0  # millimetres from the paper's edge to a marker
_QUIET = 6.0  # millimetres of white around a marker
_APART = 5.0  # millimetres between points of Board.white
_DPI = 600
_INCH = 25.4  # millimetres
_RULER, _CAPTION = 50.0, 14.0  # millimetres: width and height, at the left of the lower edge
_SUFFIXES = (".png", ".pdf")


@dataclass(frozen=True)
class Board:
    """A marker board. Its origin is the middle of the field, x to the right and y up; the unit is the millimetre.

    paper: a key of PAPERS. count: of markers. first: number of the first marker; the others follow.
    """

    paper: str
    count: int
    first: int

    @property
    def field(self) -> tuple[float, float]:
        """Width and height of the field, in millimetres."""
        width, height = PAPERS[self.paper]
        inset = 2 * (_EDGE + SIDE + _QUIET)
        return round(width - inset, 1), round(height - inset, 1)

    @property
    def name(self) -> str:
        """Name of the board in messages."""
        return f"{self.count} markers on {self.paper}"

    @property
    def markers(self) -> dict[int, np.ndarray]:
        """Number → (4, 2) corners of each marker, clockwise from its upper left one, in millimetres."""
        width, height = PAPERS[self.paper]
        x, y = width / 2 - _EDGE - SIDE / 2, height / 2 - _EDGE - SIDE / 2
        middles = [(-x, y), (x, y), (x, -y), (-x, -y), (0, y), (x, 0), (0, -y), (-x, 0)]
        offsets = np.array([(-1, 1), (1, 1), (1, -1), (-1, -1)]) * SIDE / 2
        return {self.first + k: offsets + middle for k, middle in enumerate(middles[: self.count])}

    @property
    def field_corners(self) -> np.ndarray:
        """(4, 2) corners of the field, clockwise from its upper left one, in millimetres."""
        return np.array([(-1, 1), (1, 1), (1, -1), (-1, -1)]) * np.array(self.field) / 2

    @property
    def white(self) -> np.ndarray:
        """(N, 2) points on unprinted paper, between the markers of each long and short side, in millimetres."""
        corners = [np.mean(points, axis=0) for points in list(self.markers.values())[:4]]
        middles = np.array([
            (1 - share) * corners[k] + share * corners[(k + 1) % 4] for k in range(4) for share in (0.28, 0.72)
        ])  # fmt: skip
        offsets = _APART * np.array([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)])
        points = (middles[:, None] + offsets).reshape(-1, 2)
        printed = (points[:, 0] < 0) & (points[:, 1] < _EDGE - PAPERS[self.paper][1] / 2 + _CAPTION)
        return points[~printed]


BOARDS = tuple(
    Board(paper, count, first)
    for paper, count, first in (("A4", 4, 0), ("A4", 8, 4), ("letter", 4, 12), ("letter", 8, 16))
)


def board_of(paper: str, count: int) -> Board:
    """Return the board of a paper and a number of markers. Raises InputError where there is none."""
    for board in BOARDS:
        if (board.paper.lower(), board.count) == (paper.lower(), count):
            return board
    raise InputError(
        f"there is no marker board with {count} markers on {paper}; choose 4 or 8, on {' or '.join(PAPERS)}"
    )


def write_board(board: Board, path: Path) -> None:
    """Write a marker board to print at its true size: .pdf or .png of 600 dots an inch. Raises InputError."""
    if path.suffix.lower() not in _SUFFIXES:
        raise InputError(f"{path}: is neither .pdf nor .png; name the file so")
    check_unused(path, "choose another name for -o")
    picture = board_picture(board, _DPI)
    with replacing_file(path) as partial:
        if path.suffix.lower() == ".pdf":
            picture.save(partial, "PDF", resolution=_DPI, title=", ".join(_caption(board)))
        else:
            picture.save(partial, "PNG", dpi=(_DPI, _DPI))


def board_picture(board: Board, dpi: float) -> Image.Image:
    """Return the board as a Pillow picture of one bit a pixel. dpi: dots an inch."""
    from PIL import Image, ImageDraw, ImageFont

    cv2 = opencv("a marker board")
    scale = dpi / _INCH
    width, height = PAPERS[board.paper]
    picture = Image.new("1", (round(width * scale), round(height * scale)), 1)
    draw = ImageDraw.Draw(picture)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARY))

    def place(point: Sequence[float] | np.ndarray) -> tuple[int, int]:
        return round((point[0] + width / 2) * scale), round((height / 2 - point[1]) * scale)

    for number, corners in board.markers.items():
        (left, top), (right, low) = place(corners[0]), place(corners[2])
        bits = cv2.aruco.generateImageMarker(dictionary, number, 6)
        picture.paste(Image.fromarray(bits).resize((right - left, low - top), Image.Resampling.NEAREST), (left, top))
    for corner in board.field_corners:  # ticks that point away from the field
        for axis in (0, 1):
            end = corner.copy()
            end[axis] += np.sign(corner[axis]) * _QUIET / 2
            draw.line((*place(corner), *place(end)), 0, max(1, round(0.2 * scale)))
    font = ImageFont.load_default(2.4 * scale)
    middle = -(width / 2 - _EDGE - SIDE / 2) / 2  # between two markers of the lower edge
    base = _EDGE - height / 2
    draw.line((*place((middle - _RULER / 2, base)), *place((middle + _RULER / 2, base))), 0, max(1, round(0.3 * scale)))
    for number, text in enumerate(reversed(_caption(board))):
        draw.text(place((middle, base + 2.0 + 4.0 * number)), text, 0, font, "ms")
    return picture


def _caption(board: Board) -> tuple[str, ...]:
    across, down = board.field
    return f"IRPSO, {board.name}", f"field {across:g} x {down:g} mm", f"print at 100 %: the line is {_RULER:g} mm"
