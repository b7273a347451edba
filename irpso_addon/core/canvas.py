"""Drawing with Pillow: anti-aliased lines, text in Pillow's own font or in Blender's, images, bars."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont, ImageFont

BACKGROUND = (0.106, 0.106, 0.110)
PANEL = (0.150, 0.150, 0.156)
GRID = (0.235, 0.235, 0.243)
TEXT = (0.88, 0.88, 0.88)
FAINT = (0.62, 0.62, 0.63)

Color = Sequence[float]
_SCALE = 4  # lines are drawn larger by this and reduced: ImageDraw has no anti-aliasing
_CAPITAL = 0.70  # height of capitals over font size, of Pillow's font (Aileron)
_GLYPHS = str.maketrans({"×": "x", "–": "-", "—": "-", "−": "-", "·": ".", "→": "to", "σ": "sigma"})  # not in the font
_BLENDERS = ("Inter.woff2", "Noto Sans CJK Regular.woff2", "DejaVuSansMono.woff2")  # for letters that it lacks


class Canvas:
    """An RGB sheet of display (sRGB-encoded) values in 0…1; x to the right and y DOWN from the upper left corner."""

    def __init__(self, width: int, height: int, color: Color = BACKGROUND):
        from PIL import Image, ImageDraw

        self._sheet = Image.new("RGB", (width, height), _code(color))
        self._draw = ImageDraw.Draw(self._sheet)

    def result(self) -> np.ndarray:
        """Return (H, W, 3) float32 in steps of 1 / 255, row 0 at the bottom."""
        return np.asarray(self._sheet, np.float32)[::-1] / 255

    def rectangle(self, x: int, y: int, width: int, height: int, color: Color) -> None:
        """Fill whole pixels."""
        self._draw.rectangle((x, y, x + width - 1, y + height - 1), _code(color))

    def frame(self, x: int, y: int, width: int, height: int, color: Color = GRID) -> None:
        """Draw a one-pixel frame around an area."""
        self._draw.rectangle((x - 1, y - 1, x + width, y + height), outline=_code(color))

    def image(self, x: int, y: int, image: np.ndarray) -> None:
        """Place (H, W, 3) display values, row 0 at the bottom, with its upper left corner at (x, y)."""
        from PIL import Image

        codes = np.rint(np.clip(image[::-1], 0, 1) * 255).astype(np.uint8)
        self._sheet.paste(Image.fromarray(codes), (x, y))

    def lines(self, strokes: Iterable[Sequence[tuple[float, float]] | np.ndarray], width: float, color: Color) -> None:
        """Draw polylines with round joints; crossings are as dark as the rest."""
        from PIL import Image, ImageDraw

        points = [np.asarray(stroke, np.float64) for stroke in strokes if len(stroke)]
        if not points:
            return
        corners, reach = np.concatenate(points), width / 2 + 1
        left, top = np.floor(corners.min(axis=0) - reach).astype(int).tolist()
        right, bottom = np.ceil(corners.max(axis=0) + reach).astype(int).tolist()
        ink = Image.new("L", ((right - left) * _SCALE, (bottom - top) * _SCALE))
        pen = ImageDraw.Draw(ink)
        for stroke in points:
            pen.line(((stroke - (left, top)) * _SCALE).ravel().tolist(), 255, round(width * _SCALE), joint="curve")
        self._sheet.paste(_code(color), (left, top), ink.reduce(_SCALE))

    def ring(self, x: float, y: float, radius: float, width: float, color: Color) -> None:
        """Draw a circle."""
        angles = np.linspace(0, 2 * np.pi, 49)
        self.lines([np.stack([x + radius * np.cos(angles), y + radius * np.sin(angles)], -1)], width, color)

    def text(self, x: float, y: float, text: str, height: float, color: Color = TEXT, align: float = 0.0) -> None:
        """Write a line with its baseline at y; align 0, 0.5 or 1 puts x at its left end, middle or right end.

        height: of the capitals, in pixels.
        """
        anchor = {0.0: "ls", 0.5: "ms", 1.0: "rs"}[align]
        text, font = _legible(text, height)
        self._draw.text((round(x), round(y)), text, _code(color), font, anchor)

    def text_upward(self, x: float, y: float, text: str, height: float, color: Color = TEXT) -> None:
        """Write a line that reads from bottom to top, centred on y, its baseline at x."""
        from PIL import Image, ImageDraw

        (text, font), line = _legible(text, height), round(2 * height)
        ink = Image.new("L", (round(font.getlength(text)) + 2, line))
        ImageDraw.Draw(ink).text((1, 1.5 * height), text, 255, font, "ls")
        place = round(x - 1.5 * height), round(y - ink.width / 2)
        self._sheet.paste(_code(color), place, ink.transpose(Image.Transpose.ROTATE_90))


def _legible(text: str, height: float) -> tuple[str, FreeTypeFont | ImageFont]:
    """Return the text and a font that has its letters; where none has them all, letters become codes as \\u771f."""
    font, spelled = _font(height), text.translate(_GLYPHS)
    if not (lacking := _lacking(font, spelled)):
        return spelled, font
    if bpy := sys.modules.get("bpy"):
        folder = Path(bpy.utils.system_resource("DATAFILES", path="fonts"))
        for path in filter(Path.is_file, (folder / name for name in _BLENDERS)):
            with suppress(OSError):  # a FreeType without WOFF2
                if not _lacking(_font(height, path), text):
                    return text, _font(height, path)
    for letter in lacking:
        spelled = spelled.replace(letter, letter.encode("ascii", "backslashreplace").decode("ascii"))
    return spelled, font


def _lacking(font: FreeTypeFont | ImageFont, text: str) -> set[str]:
    """Return the letters that the font draws as it draws U+FFFF, which is no character."""
    letters = {letter for letter in text if not letter.isascii()}
    return {letter for letter in letters if _mask(font, letter) == _mask(font, "\uffff")}


def _mask(font: FreeTypeFont | ImageFont, letter: str) -> tuple[tuple[int, int], bytes]:
    mask = font.getmask(letter)
    return mask.size, bytes(mask)


@cache
def _font(height: float, path: Path | None = None) -> FreeTypeFont | ImageFont:
    from PIL import ImageFont

    size = height / _CAPITAL
    return ImageFont.load_default(size) if path is None else ImageFont.truetype(path, size)


def _code(color: Color) -> tuple[int, ...]:
    return tuple(round(255 * value) for value in color)
