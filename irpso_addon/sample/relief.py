"""The tile: relief and materials as functions of position. Plain numpy, millimetres.

The origin is the tile's centre, x to the right, y up. Shapes are signed distances, negative inside; each adds a dome to
the height and has a material: clay, glaze or gold.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..core.waves import wave_values

HALF = 100.0  # half of the tile's side
THICKNESS = 10.0  # of the tile's field, above the table
_ROUNDED = 3.0  # radius of the tile's edge
_RIM, _BAND, _ROPE = 7.0, 19.0, 27.0  # inner borders, as distances from the tile's edge
_BEADS = 17.4  # distance between beads of the band
_FOOT = 0.06  # smoothing of a dome's foot, of its width: glaze fills sharp corners
_SOFT = 0.35  # half-width of the transition between two materials

_CLAY = ((0.50, 0.25, 0.14), (0.40, 0.18, 0.10))
_TURQUOISE = ((0.11, 0.42, 0.38), (0.015, 0.17, 0.19))
_COBALT = ((0.025, 0.07, 0.33), (0.010, 0.025, 0.16))
_IVORY = ((0.76, 0.67, 0.47), (0.60, 0.29, 0.06))
_GREEN = ((0.13, 0.32, 0.06), (0.03, 0.15, 0.05))
_RED = ((0.38, 0.035, 0.025), (0.22, 0.015, 0.015))
_GOLD = ((0.94, 0.69, 0.31), (0.87, 0.59, 0.24))


@dataclass(frozen=True)
class Tile:
    """The tile's surface at positions of shape (…). height: millimetres above the table.

    base_color: (…, 3) linear. roughness, metallic: (…) in 0…1.
    """

    height: np.ndarray
    base_color: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray


@dataclass(frozen=True)
class _Shape:
    """One raised shape. distance: millimetres, negative inside. width: from edge to crest. rise: height of the crest.

    tint: 0…1 from the first colour to the second.
    """

    distance: np.ndarray
    width: float
    rise: np.ndarray | float
    colours: tuple[tuple[float, ...], tuple[float, ...]]
    tint: np.ndarray
    kind: str = "glaze"


def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the height of the surface above the table at positions (…) on the tile, in millimetres."""
    return tile(x, y).height


def tile(x: np.ndarray, y: np.ndarray) -> Tile:
    """Return the surface at positions (…), in float64; both coordinates lie in ±HALF."""
    x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    places = np.stack([x, y, np.zeros_like(x)], axis=-1)
    slow, fine, grain, hammered = (wave_values(places, length, n) for n, length in enumerate((40, 11, 2.5, 6.5)))
    shapes = list(_shapes(x, y))
    nearest = np.min([shape.distance for shape in shapes], axis=0)
    pool = np.exp(-np.maximum(nearest, 0) / 4)  # glaze runs off raised shapes and gathers at their feet
    colour = _mixed(*_TURQUOISE, np.clip(0.35 + 0.5 * pool + 0.2 * slow, 0, 1)[..., None])
    clay, gold = np.zeros_like(x), np.zeros_like(x)
    relief = THICKNESS - _edge_depth(_edge(x, y))
    for shape in shapes:
        inside = _step(-shape.distance)
        relief = relief + shape.rise * _dome(-shape.distance / shape.width)
        tint = np.clip(shape.tint + 0.08 * fine, 0, 1)[..., None]
        colour = _mixed(colour, _mixed(*shape.colours, tint), inside[..., None])
        clay = clay + inside * (float(shape.kind == "clay") - clay)
        gold = gold + inside * (float(shape.kind == "gold") - gold)
    colour = colour * (1 + 0.07 * grain * clay + 0.03 * hammered * gold)[..., None]
    relief = relief + (1 - clay) * (0.12 * slow + 0.04 * fine) + 0.03 * clay * grain + 0.035 * gold * hammered
    glossy = _mixed(0.16 + 0.025 * np.tanh(slow), 0.38 + 0.05 * np.tanh(hammered), gold)
    roughness = _mixed(glossy, 0.85 + 0.04 * np.tanh(grain), clay)
    return Tile(relief, np.clip(colour, 0, 1), roughness, gold)


def _shapes(x: np.ndarray, y: np.ndarray) -> Iterator[_Shape]:
    """Yield the shapes, each on top of the previous ones: frame, leaves, petals, rings and beads."""
    edge, flat = _edge(x, y), np.full_like(x, 0.5)
    along = np.where(np.abs(x) > np.abs(y), y, x)
    band = np.abs(edge - (_RIM + _BAND) / 2) - (_BAND - _RIM) / 2
    yield _Shape(edge - _RIM, _RIM, 0.4, _CLAY, flat, "clay")
    yield _Shape(band, (_BAND - _RIM) / 2, 1.3, _COBALT, np.clip(1 + band / 3, 0, 1))
    across = (edge - (_BAND + _ROPE) / 2) / ((_ROPE - _BAND) / 2)
    twist = 1.7 + 0.3 * np.cos(2 * np.pi * (along / 8.7 + 0.4 * across))
    yield _Shape((np.abs(across) - 1) * (_ROPE - _BAND) / 2, (_ROPE - _BAND) / 2, twist, _GOLD, flat, "gold")
    apart = along - _BEADS * np.round(along / _BEADS)
    yield _Shape(np.hypot(apart, edge - (_RIM + _BAND) / 2) - 3.9, 3.9, 1.7, _GOLD, flat, "gold")
    for turn, count, middle, length, width, rise, vein, colours, kind in (
        (45.0, 4, 86.0, 15.0, 8.5, 1.6, 0.5, _CLAY, "clay"),
        (22.5, 8, 52.5, 17.5, 8.5, 2.2, 0.55, _GREEN, "glaze"),
        (0.0, 8, 33.5, 17.5, 10.5, 3.0, 0.4, _IVORY, "glaze"),
    ):
        u, v = _folded(x, y, turn, count)
        distance = _lens(u - middle, v, length, width)
        crease = rise * (1 - vein * np.exp(-((v / 1.3) ** 2)))
        tint = np.clip(0.5 - (u - middle) / length, 0, 1) if kind == "glaze" else flat
        yield _Shape(distance, 0.8 * width, crease, colours, tint, kind)
    u, v = _folded(x, y, 0.0, 8)
    yield _Shape(np.hypot(u - 58.5, v) - 4.6, 4.6, 2.2, _GOLD, flat, "gold")
    around = np.hypot(x, y)
    yield _Shape(around - 11.0, 11.0, 3.2, _RED, np.clip(around / 11, 0, 1))
    yield _Shape(np.abs(around - 14.0) - 4.2, 4.2, 2.2, _GOLD, flat, "gold")


def _edge(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return HALF - np.maximum(np.abs(x), np.abs(y))


def _edge_depth(edge: np.ndarray) -> np.ndarray:
    """Return the depth of the rounded edge below the field: a quarter of a circle."""
    reach = np.clip(1 - edge / _ROUNDED, 0, 1)
    return _ROUNDED * (1 - np.sqrt(1 - reach**2))


def _folded(x: np.ndarray, y: np.ndarray, turn: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates along and across the nearest of ``count`` rays from the centre, the first at ``turn``°."""
    sector = 2 * np.pi / count
    angle = np.arctan2(y, x) - np.radians(turn)
    angle = angle - sector * np.round(angle / sector)
    around = np.hypot(x, y)
    return around * np.cos(angle), around * np.sin(angle)


def _lens(u: np.ndarray, v: np.ndarray, length: float, width: float) -> np.ndarray:
    """Return the signed distance to a lens of two arcs; length, width: from its centre to its tips, its sides."""
    radius = (length**2 + width**2) / (2 * width)
    return np.hypot(u, np.abs(v) + radius - width) - radius


def _dome(depth: np.ndarray) -> np.ndarray:
    """Return the height at relative depth: 0 outside, 1 from depth 1 on; the foot is smoothed over _FOOT."""
    soft = _FOOT * np.logaddexp(0, depth / _FOOT)
    return 1 - np.maximum(1 - soft, 0) ** 2


def _step(depth: np.ndarray) -> np.ndarray:
    share = np.clip(depth / (2 * _SOFT) + 0.5, 0, 1)
    return share**2 * (3 - 2 * share)


def _mixed(a: ArrayLike, b: ArrayLike, share: np.ndarray) -> np.ndarray:
    return (1 - share) * np.asarray(a, np.float64) + share * np.asarray(b, np.float64)
