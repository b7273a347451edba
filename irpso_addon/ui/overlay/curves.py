"""Draws probed texels: rings on the subject and error curves, as in Fig. 4 of Nagano et al."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...gpu.viewport import Drawing
from ...results.preview import MARK_COLORS
from ...results.scales import PERCENT, tick_text
from ..common.words import iface
from ..session.probes import Probe
from ..session.recovery import Session
from .flat import flat_place
from .layout import Rectangle
from .paint import AXIS, DIM, GRID, HALO, SMALL, TEXT, Painter
from .place import Placement, circle, pixel_size, to_pixels, transformed
from .plot import curve_plot

_MEAN_COLOR = (0.80, 0.80, 0.82, 1.0)
_WIDTH, _HEIGHT = 420.0, 196.0  # pixels at scale 1
_MIN_SIZE = (290.0, 140.0)
_SHARE = (0.42, 0.36)  # most width and height of the panel over those of the free space
_LIST_WIDTH = 136.0  # width of the list with names and last errors, in pixels at scale 1
_LIFT = 0.3  # a ring's height above the surface over its radius
_RING = 7.0  # radius of a ring on the subject, in pixels at scale 1


def color_of(probe: Probe) -> tuple[float, float, float, float]:
    """Return a probe's colour in display values, the same as in a result's pictures."""
    return (*MARK_COLORS[probe.slot], 1.0)


def draw_rings(
    drawing: Drawing, running: Session, placement: Placement, perspective: np.ndarray, size: tuple[float, float],
    scale: float,
) -> None:  # fmt: skip
    """Draw a ring of constant size in pixels on the surface around every probed texel."""
    bake = running.domain.bake
    rims, points, colors = [], [], []
    for probe in running.probes:
        point = transformed(placement.frame, bake.position[probe.row, probe.column][None])[0]
        normal = placement.directions(bake.normal[probe.row, probe.column][None].astype(np.float64))[0]
        radius = _RING * scale * pixel_size(perspective, point, size)
        if radius > 0:
            # Raised, because a curved surface could hide a flat ring.
            rim = circle(point + _LIFT * radius * normal, normal, radius)
            rims.append(np.stack([rim[:-1], rim[1:]], axis=1).reshape(-1, 3))
            points.append(point)
            colors.append(color_of(probe))
    if rims:
        lines, shades = np.concatenate(rims), np.repeat(colors, len(rims[0]), axis=0)
        drawing.draw_lines(lines, HALO, 5 * scale, perspective, depth=True)
        drawing.draw_lines(lines, shades, 2.4 * scale, perspective, depth=True)
        drawing.draw_points(np.array(points), np.array(colors), 3.5 * scale, perspective, depth=True)


def name_rings(
    painter: Painter, running: Session, placement: Placement, perspective: np.ndarray, size: tuple[float, float]
) -> None:
    """Write every probe's number beside its ring, if the surface faces the viewer there."""
    bake = running.domain.bake
    for probe in running.probes:
        point = transformed(placement.frame, bake.position[probe.row, probe.column][None])[0]
        normal = placement.directions(bake.normal[probe.row, probe.column][None].astype(np.float64))[0]
        ends = np.stack([point, point + pixel_size(perspective, point, size) * normal])
        clip = ends @ perspective[:, :3].T + perspective[:, 3]
        if clip[0, 3] > 0 and clip[1, 2] / clip[1, 3] < clip[0, 2] / clip[0, 3]:
            _name_ring(painter, probe, to_pixels(perspective, point[None], size)[0][0])


def _name_ring(painter: Painter, probe: Probe, at: np.ndarray) -> None:
    painter.chip(str(probe.number), at[0] + (_RING + 4) * painter.scale, at[1] + 2 * painter.scale)


def draw_flat_rings(painter: Painter, areas: Sequence[Rectangle], running: Session) -> None:
    """Draw the rings over a flat map with one UDIM tile per area."""
    shape = running.domain.shape
    for probe in running.probes:
        at = flat_place(areas, shape, probe.row, probe.column)[None]
        painter.rings(at, HALO, _RING, 4.5)
        painter.rings(at, color_of(probe), _RING, 2.2)
        painter.dots(at, color_of(probe), 3)
        _name_ring(painter, probe, at[0])


def curves_size(scale: float, free: Rectangle) -> tuple[float, float]:
    """Return width and height of the panel in pixels; smaller in a region with little free space."""
    width = max(_MIN_SIZE[0], min(_WIDTH, _SHARE[0] * free.width / scale))
    height = max(_MIN_SIZE[1], min(_HEIGHT, _SHARE[1] * free.height / scale))
    return width * scale, height * scale


def draw_curves(painter: Painter, area: Rectangle, running: Session) -> None:
    """Plot the mean error and the probed texels' errors over the iterations, in an area of ``curves_size``."""
    s = painter.scale
    series = [(iface("Mean"), _MEAN_COLOR, running.history)]
    for probe in sorted(running.probes, key=lambda probe: probe.number):
        series.append((f"{probe.number}:  {probe.column}, {probe.row}", color_of(probe), probe.curve))
    plot = curve_plot(
        area.inset(46 * s, 32 * s, _LIST_WIDTH * s, 34 * s),
        [[(iteration, PERCENT * error) for iteration, error in curve] for _, _, curve in series],
    )
    painter.panel(area)
    painter.text(iface("Error, % of white"), area.x + 12 * s, area.top - 20 * s)
    _draw_axes(painter, plot, area)
    for (_, color, _), points in reversed(list(zip(series, plot.curves, strict=True))):
        painter.curve(points, color, 1.7)
        painter.dots(points[-1:], color, 4.5)
    x, y = area.right - (_LIST_WIDTH - 12) * s, plot.area.top - 5 * s
    for name, color, curve in series:
        painter.dots(np.array([[x, y + 3.5 * s]]), color, 7)
        painter.text(name, x + 9 * s, y, TEXT, SMALL)
        if curve:
            painter.text(tick_text(float(f"{PERCENT * curve[-1][1]:.2g}")), area.right - 10 * s, y, DIM, SMALL, "right")
        y -= 17 * s


def _draw_axes(painter: Painter, plot, area: Rectangle) -> None:
    s, inside = painter.scale, plot.area
    levels = np.array([[(inside.x, y), (inside.right, y)] for y, _ in plot.y_ticks]).reshape(-1, 2, 2)
    painter.lines(levels, GRID)
    painter.lines(np.array([[(inside.x - 3 * s, y), (inside.x, y)] for y in plot.minor]).reshape(-1, 2, 2), AXIS)
    painter.line((inside.x, inside.y), (inside.x, inside.top), AXIS)
    painter.line((inside.x, inside.y), (inside.right, inside.y), AXIS)
    for y, text in plot.y_ticks:
        painter.line((inside.x - 5 * s, y), (inside.x, y), AXIS)
        painter.text(text, inside.x - 8 * s, y - 3.5 * s, DIM, SMALL, "right")
    for x, text in plot.x_ticks:
        painter.line((x, inside.y - 4 * s), (x, inside.y), AXIS)
        painter.text(text, x, inside.y - 16 * s, DIM, SMALL, "centre")
    painter.text(iface("Iteration"), area.right - 10 * s, inside.y - 16 * s, DIM, SMALL, "right")
