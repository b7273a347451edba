"""Drawing of the contact sheet: tiles of balls and the dome of lights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core.canvas import BACKGROUND, FAINT, GRID, TEXT, Canvas
from ...core.encode import srgb_from_linear

_TILE, _GAP, _MARGIN, _HEAD = 96, 6, 20, 52
_COLUMNS, _MAX_TILES = 8, 64
_DOME = 180  # radius, pixels
_LABEL = 8.0
_LETTERS = 13  # of a label over a tile
_MARK, _OUTLINE, _BAD = (1.0, 0.35, 0.30), (0.45, 0.70, 1.0), (0.98, 0.80, 0.30)


@dataclass(frozen=True)
class BallTile:
    """One ball in one photograph. image: (h, w, 3) linear, row 0 at the bottom. doubtful: there is a warning.

    Coordinates count from the image's lower left corner, 0…w and 0…h. outline: (N, 2). curve: (N, 2) the terminator, or
    None. mark: (2,) the highlight, or the point of a matte ball that faces the light, or None.
    """

    label: str
    image: np.ndarray
    outline: np.ndarray
    mark: np.ndarray | None
    curve: np.ndarray | None = None
    doubtful: bool = False


def ball_sheet(tiles: Sequence[BallTile], directions: np.ndarray, doubtful: Sequence[bool], title: str) -> np.ndarray:
    """Return the contact sheet (H, W, 3), display values, row 0 at the bottom.

    directions: (K, 3) unit, from ball to light, in camera axes, drawn on a dome seen from the camera; rings are 30°,
    60° and 90° off it, lights behind the ball lie outside. At most 64 tiles are shown. title: one line or two.
    """
    selected = [tiles[i] for i in np.unique(np.linspace(0, len(tiles) - 1, min(len(tiles), _MAX_TILES)).astype(int))]
    columns = min(_COLUMNS, max(4, math.ceil(math.sqrt(len(selected)))))
    rows = -(-len(selected) // columns)
    left = _MARGIN * 2 + columns * (_TILE + _GAP)
    side = 2 * _DOME + 4 * _MARGIN
    height = _HEAD + max(rows * (_TILE + _GAP + 12), side) + _MARGIN
    canvas = Canvas(left + side, height, BACKGROUND)
    for row, line in enumerate(title.splitlines()):
        canvas.text(_MARGIN, 20 + 18 * row, line, 10.0 if row == 0 else _LABEL, FAINT if row else TEXT)
    for number, tile in enumerate(selected):
        row, column = divmod(number, columns)
        _draw_tile(canvas, _MARGIN + column * (_TILE + _GAP), _HEAD + row * (_TILE + _GAP + 12), tile)
    _draw_dome(canvas, left + side / 2 - _MARGIN, _HEAD + side / 2, directions, doubtful)
    return canvas.result()


def _short(label: str) -> str:
    """Return a label's number and the end of its photograph's name: names differ at their ends."""
    number, _, name = label.partition(" ")
    return label if len(label) <= _LETTERS else f"{number} …{Path(name).stem[len(number) + 2 - _LETTERS :]}"


def _draw_tile(canvas: Canvas, x: int, y: int, tile: BallTile) -> None:
    height, width = tile.image.shape[:2]
    scale = _TILE / max(height, width)
    rows = np.minimum((np.arange(round(height * scale)) / scale).astype(int), height - 1)
    columns = np.minimum((np.arange(round(width * scale)) / scale).astype(int), width - 1)
    bright = max(float(np.percentile(tile.image, 99.5)), 1e-6)
    small = srgb_from_linear(np.clip(tile.image[rows][:, columns] / bright, 0, 1))
    canvas.image(x, y, small)
    bottom = y + len(rows)

    def to_canvas(places: np.ndarray) -> np.ndarray:
        return np.stack([x + places[:, 0] * scale, bottom - places[:, 1] * scale], axis=-1)

    def visible_parts(places: np.ndarray) -> list[np.ndarray]:
        inside = ((places >= 0) & (places <= (width, height))).all(axis=-1)
        starts = np.flatnonzero(np.diff(inside)) + 1
        parts = zip(np.split(to_canvas(places), starts), np.split(inside, starts), strict=True)
        return [part for part, visible in parts if visible[0]]

    canvas.lines(visible_parts(tile.outline), 1.0, _OUTLINE)
    if tile.curve is not None:
        canvas.lines(visible_parts(tile.curve), 1.2, _MARK)
    if tile.mark is not None:
        px, py = to_canvas(tile.mark[None])[0]
        canvas.lines([[(px - 6, py), (px - 2, py)], [(px + 2, py), (px + 6, py)],
                      [(px, py - 6), (px, py - 2)], [(px, py + 2), (px, py + 6)]], 1.4, _MARK)  # fmt: skip
    canvas.text(x, y + _TILE + 10, _short(tile.label), _LABEL, _BAD if tile.doubtful or tile.mark is None else FAINT)


def _draw_dome(canvas: Canvas, x: float, y: float, directions: np.ndarray, doubtful: Sequence[bool]) -> None:
    """Draw directions; the radius is proportional to the angle from the viewer."""
    for degrees in (30, 60, 90):
        canvas.ring(x, y, _DOME * degrees / 120, 1.0, GRID)
        canvas.text(x + 3, y - _DOME * degrees / 120 - 3, f"{degrees}°", _LABEL, FAINT)
    canvas.lines([[(x - _DOME, y), (x + _DOME, y)], [(x, y - _DOME), (x, y + _DOME)]], 1.0, GRID)
    canvas.text(x + _DOME + 4, y + 4, "x", _LABEL, FAINT)
    canvas.text(x, y - _DOME - 6, "y", _LABEL, FAINT, 0.5)
    for number, (direction, bad) in enumerate(zip(directions, doubtful, strict=True)):
        angle = np.degrees(np.arccos(np.clip(direction[2], -1, 1)))
        flat = np.hypot(*direction[:2])
        radial = _DOME * min(angle / 120, 1.0) / max(flat, 1e-9)
        px, py = x + direction[0] * radial, y - direction[1] * radial
        canvas.ring(px, py, 3.0, 2.0, _BAD if bad else TEXT)
        if len(directions) <= _MAX_TILES:
            canvas.text(px + 6, py - 3, str(number + 1), _LABEL, FAINT)
