"""Panels, text and lines over a region, in pixels, at the user's interface scale."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import blf
import numpy as np

from ...gpu.viewport import Drawing
from .layout import Rectangle

# A dark backing with light text reads on Blender's dark and light themes and on any picture.
BACKING = (0.055, 0.055, 0.065, 0.80)
TEXT = (0.93, 0.93, 0.94, 1.0)
DIM = (0.93, 0.93, 0.94, 0.62)
GRID = (1.0, 1.0, 1.0, 0.10)
AXIS = (1.0, 1.0, 1.0, 0.38)
HALO = (0.03, 0.03, 0.04, 0.9)  # around coloured marks, for bright pictures
SIZE, SMALL = 11.0, 10.0  # points, as Blender's own labels have
_FONT = 0  # Blender's own
_CORNER = 5.0  # radius of a panel's corners, in pixels at scale 1
_CORNER_STEPS = 5


class Painter:
    """Draws in pixels of the region. scale: the user's interface scale; lengths are given in pixels already."""

    def __init__(self, drawing: Drawing, scale: float):
        self.drawing, self.scale = drawing, scale

    def panel(self, area: Rectangle) -> None:
        """Draw a translucent backing with round corners."""
        self.drawing.draw_triangles2d(rounded(area, _CORNER * self.scale), BACKING)

    def line(self, begin: Sequence[float], end: Sequence[float], color: Sequence[float], width: float = 1.0) -> None:
        """Draw a line; its width is scaled."""
        self.lines(np.array([[begin, end]], np.float64), color, width)

    def lines(self, points: np.ndarray, colors: Sequence[float] | np.ndarray, width: float = 1.0) -> None:
        """Draw lines (N, 2, 2); one colour, or one for each of the 2·N points."""
        if len(points):
            self.drawing.draw_lines(np.reshape(points, (-1, 2)), colors, width * self.scale)

    def curve(self, points: np.ndarray, color: Sequence[float], width: float = 1.5) -> None:
        """Draw one line through points (N, 2); of a single one, a dot."""
        if len(points) > 1:
            self.drawing.draw_lines(points, color, width * self.scale, strip=True)
        elif len(points):
            self.dots(points, color, 2 * width)

    def dots(self, points: np.ndarray, colors: Sequence[float] | np.ndarray, size: float) -> None:
        """Draw discs; their size is scaled."""
        if len(points):
            self.drawing.draw_points(points, colors, size * self.scale)

    def rings(self, points: np.ndarray, color: Sequence[float], radius: float, width: float = 1.5) -> None:
        """Draw circles around points (N, 2); radius and width are scaled."""
        if len(points):
            angles = np.linspace(0, 2 * np.pi, 25)
            around = np.stack([np.cos(angles), np.sin(angles)], axis=-1) * radius * self.scale
            strips = np.asarray(points)[:, None, None] + np.stack([around[:-1], around[1:]], axis=1)[None]
            self.lines(strips.reshape(-1, 2, 2), color, width)

    def text(
        self, text: str, x: float, y: float, color: Sequence[float] = TEXT, size: float = SIZE, align: str = "left"
    ) -> None:
        """Write a line with its base at y, x being its left end, its middle ("centre") or its right end."""
        with _font(size * self.scale):
            width = blf.dimensions(_FONT, text)[0]
            x -= {"left": 0.0, "centre": width / 2, "right": width}[align]
            blf.color(_FONT, *color)
            blf.position(_FONT, round(x), round(y), 0)
            blf.draw(_FONT, text)

    def width(self, text: str, size: float = SIZE) -> float:
        """Return how wide a line of text is, in pixels."""
        with _font(size * self.scale):
            return blf.dimensions(_FONT, text)[0]

    def chip(self, text: str, x: float, y: float, align: str = "left") -> None:
        """Write a line on a small backing of its own, y being the backing's lower edge."""
        pad = 7 * self.scale
        width = self.width(text) + 2 * pad
        x -= {"left": 0.0, "centre": width / 2, "right": width}[align]
        self.panel(Rectangle(x, y, width, CHIP * self.scale))
        self.text(text, x + pad, y + 6.5 * self.scale)


CHIP = 21.0  # a chip's height, in pixels at scale 1


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


@contextmanager
def _font(size: float) -> Iterator[None]:
    """Set the size of Blender's font, which every drawing of text in Blender sets for itself."""
    blf.size(_FONT, size)
    yield
