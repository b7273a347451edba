"""A stroke alphabet of our own: pictures carry text wherever the program runs, without fonts, windows or GPU.

Blender's blf draws through a GPU context (and into images only since 5.0), so it is not to be had on every door.
Letters are geometric: circles and straight lines on a grid where capitals are 7 high, small letters 5, and the
baseline is 0. A glyph is its strokes, parted by ``;``; a stroke is a chain of points ``x,y`` and of elliptic arcs
``@centre x,centre y,radius x,radius y,from,to`` in degrees, counter-clockwise where the second angle is larger.
"""

from __future__ import annotations

import math
from functools import cache

CAPITAL_HEIGHT = 7.0
STROKE = 0.86  # width of a stroke, in grid units
_SPACING = 1.85  # between the inked parts of two glyphs: one stroke and some air
_ARC_STEP = 12.0  # degrees; a chord then leaves its arc by 0.5 % of the radius

_GLYPHS = {
    " ": "",
    "!": "0.3,7 0.3,2.3;@0.3,0.2,0.14,0.14,0,360",
    '"': "0,7 0,5;1.6,7 1.6,5",
    "#": "1.4,6.6 0.8,0.4;3.6,6.6 3,0.4;0,4.6 4.4,4.6;0,2.4 4.4,2.4",
    "$": "@2.1,5,1.9,1.4,35,270 @2.1,2.1,2,1.5,90,-145;2.1,7.4 2.1,-0.4",
    "%": "@1.2,5.6,1.2,1.4,0,360;@4.8,1.4,1.2,1.4,0,360;4.9,7 1.1,0",
    "&": "4.9,0 1,4.5 @1.9,5.6,1.3,1.4,210,-30 3,4.7 @1.9,1.8,1.9,1.8,125,300 4.8,3",
    "'": "0,7 0,5",
    "(": "@2.6,2.9,2.6,5,130,230",
    ")": "@-1,2.9,2.6,5,-50,50",
    "*": "1.6,6.8 1.6,3.8;0.3,6.05 2.9,4.55;0.3,4.55 2.9,6.05",
    "+": "2,5 2,1;0,3 4,3",
    ",": "0.5,0.4 0.1,-1.2",
    "-": "0,2.7 2.2,2.7",
    ".": "@0.2,0.2,0.14,0.14,0,360",
    "/": "0,-0.6 3,7.4",
    "0": "@2.2,3.5,2.2,3.5,90,450",
    "1": "0.6,5.7 2.5,7 2.5,0",
    "2": "@2.2,4.9,2.1,2.1,165,-38 0.1,0 4.4,0",
    "3": "@2.1,5.3,1.8,1.7,150,-90 @2.1,1.8,2.2,1.8,90,-152",
    "4": "3.4,0 3.4,7 0,2 4.6,2",
    "5": "4,7 0.8,7 0.45,3.9 @2.1,2.3,2.25,2.3,132,-148",
    "6": "3.4,7 0.4,3.54 @2.2,2.25,2.2,2.25,145,505",
    "7": "0.1,7 4.3,7 1.5,0",
    "8": "@2.2,5.35,1.75,1.65,90,450;@2.2,1.85,2.2,1.85,90,450",
    "9": "1,0 4,3.46 @2.2,4.75,2.2,2.25,-35,325",
    ":": "@0.2,4.5,0.14,0.14,0,360;@0.2,0.4,0.14,0.14,0,360",
    ";": "@0.5,4.5,0.14,0.14,0,360;0.5,0.4 0.1,-1.2",
    "<": "3.6,5 0.2,3 3.6,1",
    "=": "0,4 4,4;0,2 4,2",
    ">": "0.2,5 3.6,3 0.2,1",
    "?": "@1.9,5.2,1.8,1.8,165,-60 1.9,2.3;@1.9,0.2,0.14,0.14,0,360",
    "@": "@3.4,3,1.4,1.5,0,360;4.8,4.5 4.8,2 @5.7,2.2,0.9,0.9,190,360 @3.4,3,3.3,3.6,0,310",
    "A": "0,0 2.8,7 5.6,0;0.95,2.4 4.65,2.4",
    "B": "0,0 0,7 2.3,7 @2.3,5.35,1.75,1.65,90,-90 0,3.7 2.5,3.7 @2.5,1.85,2.1,1.85,90,-90 0,0",
    "C": "@3.4,3.5,3.4,3.5,48,312",
    "D": "0,0 0,7 1.7,7 @1.7,3.5,3.4,3.5,90,-90 0,0",
    "E": "4,7 0,7 0,0 4,0;0,3.7 3.5,3.7",
    "F": "4,7 0,7 0,0;0,3.6 3.4,3.6",
    "G": "@3.4,3.5,3.4,3.5,48,360 3.9,3.5",
    "H": "0,7 0,0;5,7 5,0;0,3.7 5,3.7",
    "I": "0.2,7 0.2,0",
    "J": "2.9,7 2.9,1.7 @1.4,1.7,1.5,1.7,0,-160",
    "K": "0,7 0,0;4.5,7 0,2.7;1.6,4.2 4.8,0",
    "L": "0,7 0,0 3.7,0",
    "M": "0,0 0,7 3.1,1.6 6.2,7 6.2,0",
    "N": "0,0 0,7 5,0 5,7",
    "O": "@3.5,3.5,3.5,3.5,90,450",
    "P": "0,0 0,7 2.4,7 @2.4,5.1,2,1.9,90,-90 0,3.2",
    "Q": "@3.5,3.5,3.5,3.5,90,450;4.4,2 6.6,-0.4",
    "R": "0,0 0,7 2.4,7 @2.4,5.15,2,1.85,90,-90 0,3.3;2.3,3.3 4.8,0",
    "S": "@2.2,5.3,1.9,1.7,38,270 @2.2,1.8,2.2,1.8,90,-148",
    "T": "0,7 5,7;2.5,7 2.5,0",
    "U": "0,7 0,2.4 @2.4,2.4,2.4,2.4,180,360 4.8,7",
    "V": "0,7 2.7,0 5.4,7",
    "W": "0,7 1.9,0 3.8,6.4 5.7,0 7.6,7",
    "X": "0,7 4.8,0;4.6,7 0.2,0",
    "Y": "0,7 2.5,3.3 5,7;2.5,3.3 2.5,0",
    "Z": "0.2,7 4.6,7 0,0 4.8,0",
    "[": "1.6,7.6 0,7.6 0,-1.4 1.6,-1.4",
    "\\": "0,7.4 3,-0.6",
    "]": "0,7.6 1.6,7.6 1.6,-1.4 0,-1.4",
    "^": "0,4.6 1.6,7 3.2,4.6",
    "_": "0,-1 4.4,-1",
    "`": "0,7.2 1.2,6",
    "a": "@2.2,2.5,2.2,2.5,0,360;4.4,5 4.4,0",
    "b": "0,7.4 0,0;@2.2,2.5,2.2,2.5,0,360",
    "c": "@2.4,2.5,2.4,2.5,48,312",
    "d": "@2.2,2.5,2.2,2.5,0,360;4.4,7.4 4.4,0",
    "e": "0.1,2.6 4.6,2.6 @2.35,2.5,2.3,2.5,3,312",
    "f": "@2.7,5.9,1.5,1.5,75,180 1.2,0;0,4.8 2.7,4.8",
    "g": "@2.2,2.5,2.2,2.5,0,360;4.4,5 4.4,-0.3 @2.3,-0.3,2.1,1.9,0,-148",
    "h": "0,7.4 0,0;0,2.7 @2,2.9,2,2.1,180,0 4,0",
    "i": "0.2,5 0.2,0;@0.2,6.8,0.14,0.14,0,360",
    "j": "1.1,5 1.1,-0.6 @-0.1,-0.6,1.2,1.4,0,-85;@1.1,6.8,0.14,0.14,0,360",
    "k": "0,7.4 0,0;3.7,5 0,1.8;1.3,2.9 4,0",
    "l": "0.2,7.4 0.2,0",
    "m": "0,5 0,0;0,3 @1.6,3.1,1.6,1.9,180,0 3.2,0;3.2,3 @4.8,3.1,1.6,1.9,180,0 6.4,0",
    "n": "0,5 0,0;0,2.7 @2,2.9,2,2.1,180,0 4,0",
    "o": "@2.4,2.5,2.4,2.5,90,450",
    "p": "0,5 0,-2.1;@2.2,2.5,2.2,2.5,0,360",
    "q": "@2.2,2.5,2.2,2.5,0,360;4.4,5 4.4,-2.1",
    "r": "0,5 0,0;0,2.6 @1.9,2.8,1.9,2.2,180,68",
    "s": "@1.75,3.75,1.55,1.25,38,270 @1.75,1.25,1.75,1.25,90,-148",
    "t": "1.2,6.6 1.2,1.3 @2.4,1.3,1.2,1.3,180,285;0,4.9 2.7,4.9",
    "u": "0,5 0,2 @2,2,2,2,180,360;4,5 4,0",
    "v": "0,5 2.1,0 4.2,5",
    "w": "0,5 1.55,0 3.1,4.7 4.65,0 6.2,5",
    "x": "0,5 3.9,0;3.7,5 0.2,0",
    "y": "0,5 2.15,0.1;4.3,5 1.3,-2.1",
    "z": "0.1,5 3.8,5 0,0 4,0",
    "{": "2,7.6 @2,6.6,1,1,90,180 1,4 @0,4,1,0.9,0,-90 @0,2.2,1,0.9,90,0 1,-0.4 @2,-0.4,1,1,180,270",
    "|": "0.2,7.6 0.2,-1.4",
    "}": "0,7.6 @0,6.6,1,1,90,0 1,4 @2,4,1,0.9,180,270 @2,2.2,1,0.9,90,180 1,-0.4 @0,-0.4,1,1,0,-90",
    "~": "0,2.6 @1.1,2.6,1.1,0.9,160,10 @3.2,3,1.1,0.9,190,350",
    "°": "@1,6,1,1,0,360",
    "±": "2,5.6 2,2;0,3.8 4,3.8;0,0.4 4,0.4",
    "×": "0.4,4.6 3.6,1.4;3.6,4.6 0.4,1.4",
    "–": "0,2.7 3.6,2.7",
    "·": "@0.3,3,0.14,0.14,0,360",
    "−": "0,3 3.6,3",
}

_BLANK_WIDTH = 1.6
_DIGIT_WIDTH = 4.6  # one width for all figures, so that columns of numbers line up

Stroke = tuple[tuple[float, float], ...]


@cache
def glyph(letter: str) -> tuple[tuple[Stroke, ...], float, float]:
    """Return the strokes of a letter, its left edge and its width, in grid units; unknown letters are a box."""
    strokes = tuple(_stroke(text) for text in _GLYPHS.get(letter, "0,0 0,7 4,7 4,0 0,0").split(";") if text)
    if not strokes:
        return (), 0.0, _BLANK_WIDTH
    xs = [x for stroke in strokes for x, _ in stroke]
    if letter.isdigit() and letter.isascii():
        return strokes, (min(xs) + max(xs) - _DIGIT_WIDTH) / 2, _DIGIT_WIDTH
    return strokes, min(xs), max(xs) - min(xs)


def text_width(text: str, height: float) -> float:
    """Return the length of a line in pixels, where ``height`` is the height of its capitals in pixels."""
    if not text:
        return 0.0
    return (sum(glyph(c)[2] + _SPACING for c in text) - _SPACING + STROKE) * height / CAPITAL_HEIGHT


def text_strokes(text: str, height: float) -> list[Stroke]:
    """Return the strokes of a line in pixels, y up, its baseline at 0 and its ink starting at x = 0."""
    scale, x, result = height / CAPITAL_HEIGHT, STROKE / 2, []
    for letter in text:
        strokes, left, width = glyph(letter)
        result += [tuple(((x + px - left) * scale, py * scale) for px, py in stroke) for stroke in strokes]
        x += width + _SPACING
    return result


def _stroke(text: str) -> Stroke:
    points: list[tuple[float, float]] = []
    for token in text.split():
        numbers = [float(n) for n in token.lstrip("@").split(",")]
        if not token.startswith("@"):
            points.append((numbers[0], numbers[1]))
            continue
        x, y, radius_x, radius_y, start, end = numbers
        steps = max(2, math.ceil(abs(end - start) / _ARC_STEP))
        for i in range(steps + 1):
            angle = math.radians(start + (end - start) * i / steps)
            points.append((x + radius_x * math.cos(angle), y + radius_y * math.sin(angle)))
    return tuple(points)
