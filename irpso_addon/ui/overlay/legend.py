"""Caption of the displayed picture, and the legend of its false colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ...reflectance.model import ReflectanceModel
from ...results.false_color import COLORS
from ...results.scales import PERCENT, tick_text, ticks_to
from ...solver.views.display import Shown
from ..common.words import iface
from .layout import Rectangle
from .paint import DIM, SMALL, Painter

_BAR, _MIN_BAR, _WIDTH = 150.0, 70.0, 104.0  # bar's height and least height, panel's width, in pixels at scale 1
_BAR_SHARE = 0.3  # most height of the bar over that of the free space
_AROUND = 62.0  # height of the panel without the bar, in pixels at scale 1
_EDGE = 12.0  # from the panel's edge to its texts, in pixels at scale 1
_TICK = 15.0  # least distance of ticks, in pixels at scale 1


@dataclass(frozen=True)
class Scale:
    """Texts of a false-colour bar. top: the number beside its red end, in ``unit``."""

    title: str
    unit: str
    top: float


def caption(shown: Shown, names: Sequence[str], numbers: Sequence[int]) -> str:
    """Return a picture's caption. names: of the observations. numbers: of the observations, listed, from 0."""
    if shown.kind == "parameter":
        return _title_of(shown.parameter)
    if shown.kind == "error":
        return iface("Error")
    if shown.kind == "indirect":
        return iface("Indirect Light")
    if shown.kind == "confidence":
        return f"{_title_of(shown.parameter)}, {iface('Uncertainty')}"
    kind = iface("Render") if shown.kind == "render" else iface("Photograph")
    return f"{kind} {numbers[shown.observation] + 1}: {names[shown.observation]}"


def _title_of(parameter: str) -> str:
    """Return a parameter's name in the user's language."""
    return iface(bpy.path.display_name(parameter))


def scale_of(shown: Shown, model: ReflectanceModel) -> Scale | None:
    """Return the scale of a picture's false colours, None if it has none."""
    if shown.kind == "error":
        return Scale(iface("Error"), iface("% of white"), PERCENT * shown.limit)
    if shown.kind == "indirect":
        return Scale(iface("Indirect"), iface("% of the light"), PERCENT * shown.limit)
    if shown.kind != "confidence":
        return None
    title = _title_of(shown.parameter)
    if model.parameter(shown.parameter).is_normal:
        return Scale(title, iface("± degrees"), math.degrees(shown.limit))
    return Scale(title, iface("± one sigma"), shown.limit)


def legend_size(scale: float, free: Rectangle, widest: float = 0.0) -> tuple[float, float]:
    """Return width and height of the legend's panel in pixels; smaller in a region with little free space.

    widest: width of its longest text in pixels.
    """
    bar = max(_MIN_BAR, min(_BAR, _BAR_SHARE * free.height / scale))
    return max(_WIDTH * scale, widest + 2 * _EDGE * scale), (bar + _AROUND) * scale


def draw_legend(painter: Painter, area: Rectangle, meaning: Scale) -> None:
    """Draw a bar from blue (low) to red (high) with ticks, in an area of ``legend_size``."""
    s = painter.scale
    painter.panel(area)
    painter.text(meaning.title, area.x + _EDGE * s, area.top - 19 * s)
    painter.text(meaning.unit, area.x + _EDGE * s, area.top - 34 * s, DIM, SMALL)
    bar = Rectangle(area.x + _EDGE * s, area.y + 13 * s, 14 * s, area.height - _AROUND * s)
    painter.triangles(*ramp(bar))
    for tick in ticks_to(meaning.top, min(6, int(bar.height / (_TICK * s)))):
        y = bar.y + bar.height * tick / meaning.top
        painter.line((bar.right + 2 * s, y), (bar.right + 6 * s, y), DIM)
        text = tick_text(tick) + (" +" if math.isclose(tick, meaning.top) else "")
        painter.text(text, bar.right + 10 * s, y - 3.5 * s, size=SMALL)


def ramp(bar: Rectangle) -> tuple[np.ndarray, np.ndarray]:
    """Return triangles (3·T, 2) and colours (3·T, 4) of the false colours from the bar's bottom to its top."""
    levels = np.linspace(bar.y, bar.top, len(COLORS))
    colors = np.pad(COLORS, ((0, 0), (0, 1)), constant_values=1.0)
    points, shades = [], []
    for i in range(len(levels) - 1):
        for x, at in ((0, i), (1, i), (1, i + 1), (0, i), (1, i + 1), (0, i + 1)):
            points.append((bar.x + x * bar.width, levels[at]))
            shades.append(colors[at])
    return np.array(points), np.array(shades)
