"""A sheet to draw on in numpy: anti-aliased lines and text, images, bars."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from . import lettering

BACKGROUND = (0.106, 0.106, 0.110)
PANEL = (0.150, 0.150, 0.156)
GRID = (0.235, 0.235, 0.243)
TEXT = (0.88, 0.88, 0.88)
FAINT = (0.62, 0.62, 0.63)

Color = Sequence[float]


class Canvas:
    """An RGB sheet of display (sRGB-encoded) values in 0…1; x to the right and y DOWN from the upper left corner."""

    def __init__(self, width: int, height: int, color: Color = BACKGROUND):
        self.pixels = np.empty((height, width, 3), np.float32)
        self.pixels[:] = color

    def result(self) -> np.ndarray:
        """Return (H, W, 3) float32, row 0 at the bottom."""
        return np.clip(self.pixels[::-1], 0, 1)

    def rectangle(self, x: int, y: int, width: int, height: int, color: Color) -> None:
        """Fill whole pixels."""
        self.pixels[max(y, 0) : y + height, max(x, 0) : x + width] = color

    def frame(self, x: int, y: int, width: int, height: int, color: Color = GRID) -> None:
        """Draw a one-pixel frame around an area."""
        for left, top, w, h in (
            (x - 1, y - 1, width + 2, 1), (x - 1, y + height, width + 2, 1),
            (x - 1, y, 1, height), (x + width, y, 1, height),
        ):  # fmt: skip
            self.rectangle(left, top, w, h, color)

    def image(self, x: int, y: int, image: np.ndarray) -> None:
        """Place (H, W, 3) display values, row 0 at the bottom, with its upper left corner at (x, y)."""
        height, width = image.shape[:2]
        self.pixels[y : y + height, x : x + width] = image[::-1]

    def lines(self, strokes: Iterable[Sequence[tuple[float, float]]], width: float, color: Color) -> None:
        """Draw chains of points with round ends and joints; where they cross, the ink is not laid on twice."""
        strokes = [np.asarray(stroke, np.float32) for stroke in strokes if len(stroke)]
        if not strokes:
            return
        every = np.concatenate(strokes)
        reach = width / 2 + 1
        rows, columns = self.pixels.shape[:2]
        x0, y0 = np.maximum(np.floor(every.min(axis=0) - reach).astype(int), 0)
        x1, y1 = np.minimum(np.ceil(every.max(axis=0) + reach).astype(int) + 1, (columns, rows))
        if x0 >= x1 or y0 >= y1:
            return
        ink = np.zeros((y1 - y0, x1 - x0), np.float32)
        for stroke in strokes:
            ends = stroke[1:] if len(stroke) > 1 else stroke
            for start, end in zip(stroke, ends, strict=False):
                _ink_segment(ink, start - (x0, y0), end - (x0, y0), width)
        area = self.pixels[y0:y1, x0:x1]
        area += ink[..., None] * (np.asarray(color, np.float32) - area)

    def ring(self, x: float, y: float, radius: float, width: float, color: Color) -> None:
        """Draw a circle."""
        angles = np.linspace(0, 2 * np.pi, 49)
        self.lines([np.stack([x + radius * np.cos(angles), y + radius * np.sin(angles)], -1)], width, color)

    def text(self, x: float, y: float, text: str, height: float, color: Color = TEXT, align: float = 0.0) -> None:
        """Write a line with its baseline at y; align 0, 0.5 or 1 puts x at its left end, middle or right end.

        height: of the capitals, in pixels.
        """
        left = round(x - align * lettering.text_width(text, height))
        width = max(lettering.STROKE * height / lettering.CAPITAL_HEIGHT, 1.0)
        strokes = lettering.text_strokes(text, height)
        self.lines([[(left + px, y - py) for px, py in stroke] for stroke in strokes], width, color)

    def text_upward(self, x: float, y: float, text: str, height: float, color: Color = TEXT) -> None:
        """Write a line that reads from bottom to top, centred on y, its baseline at x."""
        bottom = round(y + lettering.text_width(text, height) / 2)
        width = max(lettering.STROKE * height / lettering.CAPITAL_HEIGHT, 1.0)
        strokes = lettering.text_strokes(text, height)
        self.lines([[(x - py, bottom - px) for px, py in stroke] for stroke in strokes], width, color)


def _ink_segment(ink: np.ndarray, start: np.ndarray, end: np.ndarray, width: float) -> None:
    """Raise ``ink`` to the coverage of one round-ended segment; pixel centres lie at +0.5."""
    reach = width / 2 + 1
    x0, y0 = np.maximum(np.floor(np.minimum(start, end) - reach).astype(int), 0)
    x1 = min(int(np.ceil(max(start[0], end[0]) + reach)) + 1, ink.shape[1])
    y1 = min(int(np.ceil(max(start[1], end[1]) + reach)) + 1, ink.shape[0])
    if x0 >= x1 or y0 >= y1:
        return
    px = np.arange(x0, x1, dtype=np.float32)[None, :] + 0.5 - start[0]
    py = np.arange(y0, y1, dtype=np.float32)[:, None] + 0.5 - start[1]
    dx, dy = end - start
    length2 = dx * dx + dy * dy
    along = np.clip((px * dx + py * dy) / length2, 0, 1) if length2 > 0 else np.zeros_like(px * py)
    distance = np.hypot(px - along * dx, py - along * dy)
    np.maximum(ink[y0:y1, x0:x1], np.clip(width / 2 + 0.5 - distance, 0, 1), out=ink[y0:y1, x0:x1])
