"""Draws panels, text and lines over a region, in pixels, at the user's interface scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import blf
import numpy as np

from ...gpu.viewport import Drawing
from .layout import Rectangle

# Light text on a dark backing is legible with Blender's dark and light themes and over any picture.
BACKING = (0.055, 0.055, 0.065, 0.90)  # windows blend in linear light: over white the result is 0.29
TEXT = (0.93, 0.93, 0.94, 1.0)
DIM = (0.93, 0.93, 0.94, 0.62)
GRID = (1.0, 1.0, 1.0, 0.10)
AXIS = (1.0, 1.0, 1.0, 0.38)
HALO = (0.03, 0.03, 0.04, 0.9)  # around coloured marks, for bright pictures
SIZE, SMALL = 11.0, 10.0  # points, like Blender's labels
_FONT = 0  # Blender's own
_CORNER = 5.0  # radius of a panel's corners, in pixels at scale 1
_CORNER_STEPS = 5
_CHIP, _PAD = 21.0, 7.0  # a chip's height and side margins, in pixels at scale 1

Colors = Sequence[float] | np.ndarray  # (4,) or (N, 4)


class Painter:
    """Collects shapes and text in pixels of the region; ``flush`` draws the shapes in order, then the text.

    scale: the user's interface scale, which multiplies widths, sizes and radii. Positions are in pixels.
    """

    def __init__(self, drawing: Drawing, scale: float):
        self._drawing, self.scale = drawing, scale
        self._shapes: list[_Shapes] = []
        self._texts: list[tuple[str, float, float, Sequence[float], float]] = []

    def panel(self, area: Rectangle) -> None:
        """Draw a translucent backing with round corners."""
        self.triangles(rounded(area, _CORNER * self.scale), BACKING)

    def triangles(self, points: np.ndarray, colors: Colors) -> None:
        """Draw triangles (3·T, 2)."""
        self._add("triangles", 0.0, points, colors)

    def line(self, begin: Sequence[float], end: Sequence[float], color: Sequence[float], width: float = 1.0) -> None:
        """Draw one line."""
        self.lines(np.array([[begin, end]], np.float64), color, width)

    def lines(self, points: np.ndarray, colors: Colors, width: float = 1.0) -> None:
        """Draw lines (N, 2, 2); one colour, or one for each of the 2·N points."""
        self._add("lines", width, points, colors)

    def curve(self, points: np.ndarray, color: Sequence[float], width: float = 1.5) -> None:
        """Draw a polyline through points (N, 2)."""
        self.lines(np.stack([points[:-1], points[1:]], axis=1), color, width)

    def dots(self, points: np.ndarray, colors: Colors, size: float) -> None:
        """Draw discs around points (N, 2)."""
        self._add("dots", size, points, colors)

    def rings(self, points: np.ndarray, color: Sequence[float], radius: float, width: float = 1.5) -> None:
        """Draw circles around points (N, 2)."""
        angles = np.linspace(0, 2 * np.pi, 25)
        around = np.stack([np.cos(angles), np.sin(angles)], axis=-1) * radius * self.scale
        strips = np.reshape(points, (-1, 1, 1, 2)) + np.stack([around[:-1], around[1:]], axis=1)[None]
        self.lines(strips.reshape(-1, 2, 2), color, width)

    def text(
        self, text: str, x: float, y: float, color: Sequence[float] = TEXT, size: float = SIZE, align: str = "left"
    ) -> None:
        """Write a line of text with its base at y. x: its "left" end, "centre" or "right" end, by ``align``."""
        if align != "left":
            x -= self.width(text, size) * (0.5 if align == "centre" else 1.0)
        self._texts.append((text, x, y, color, size))

    def width(self, text: str, size: float = SIZE) -> float:
        """Return the width of a line of text in pixels."""
        blf.size(_FONT, size * self.scale)
        return blf.dimensions(_FONT, text)[0]

    def chip(self, text: str, x: float, y: float, align: str = "left") -> None:
        """Write a line of text on its own backing. y: the backing's lower edge."""
        width, height = self.chip_size(text)
        x -= {"left": 0.0, "centre": width / 2, "right": width}[align]
        self.panel(Rectangle(x, y, width, height))
        self.text(text, x + _PAD * self.scale, y + 6.5 * self.scale)

    def chip_size(self, text: str) -> tuple[float, float]:
        """Return width and height of a chip in pixels."""
        return self.width(text) + 2 * _PAD * self.scale, _CHIP * self.scale

    def flush(self) -> None:
        """Draw the collected shapes and text."""
        for shapes in self._shapes:
            points, colors = np.concatenate(shapes.points), np.concatenate(shapes.colors)
            if shapes.kind == "triangles":
                self._drawing.draw_triangles2d(points, colors)
            elif shapes.kind == "lines":
                self._drawing.draw_lines(points, colors, shapes.width * self.scale)
            else:
                self._drawing.draw_points(points, colors, shapes.width * self.scale)
        for text, x, y, color, size in self._texts:
            blf.size(_FONT, size * self.scale)
            blf.color(_FONT, *color)
            blf.position(_FONT, round(x), round(y), 0)
            blf.draw(_FONT, text)
        self._shapes.clear()
        self._texts.clear()

    def _add(self, kind: str, width: float, points: np.ndarray, colors: Colors) -> None:
        """Collect shapes. Successive ones alike share a draw call: about sixty calls cost 20 ms per redraw."""
        points = np.reshape(points, (-1, 2))
        if not len(points):
            return
        if not self._shapes or (self._shapes[-1].kind, self._shapes[-1].width) != (kind, width):
            self._shapes.append(_Shapes(kind, width))
        self._shapes[-1].points.append(points)
        self._shapes[-1].colors.append(np.broadcast_to(np.asarray(colors, np.float64), (len(points), 4)))


@dataclass
class _Shapes:
    """Shapes of one kind and width: lists of (N, 2) points and (N, 4) colours."""

    kind: str
    width: float
    points: list[np.ndarray] = field(default_factory=list)
    colors: list[np.ndarray] = field(default_factory=list)


def rounded(area: Rectangle, radius: float) -> np.ndarray:
    """Return (3·T, 2) triangles of a rectangle with round corners."""
    radius = min(radius, area.width / 2, area.height / 2)
    middles = [
        (area.right - radius, area.top - radius), (area.x + radius, area.top - radius),
        (area.x + radius, area.y + radius), (area.right - radius, area.y + radius),
    ]  # fmt: skip
    angles = np.linspace(0, np.pi / 2, _CORNER_STEPS + 1)
    outline = np.concatenate([
        np.array(middle) + radius * np.stack([np.cos(a), np.sin(a)], axis=-1)
        for middle, a in zip(middles, (angles + quarter * np.pi / 2 for quarter in range(4)), strict=True)
    ])  # fmt: skip
    centre = np.broadcast_to([(area.x + area.right) / 2, (area.y + area.top) / 2], outline.shape)
    return np.stack([centre, outline, np.roll(outline, -1, axis=0)], axis=1).reshape(-1, 2)
