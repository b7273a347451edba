"""Draws the swarm of one texel: its particles as points in the search space, as in Fig. 2 of Nagano et al."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...core.encode import encode_normal, srgb_from_linear
from ...reflectance.model import Parameter, ReflectanceModel
from ...results.scales import tick_text
from ...solver.settings.resolve import prefit_model
from ...solver.views.texel_probe import Particles, component_names
from ..common.words import iface
from .layout import Rectangle
from .paint import DIM, HALO, SMALL, Painter

TRAIL = 12  # stored positions per particle
_AXES = ((0.98, 0.32, 0.36, 1.0), (0.55, 0.85, 0.22, 1.0), (0.36, 0.62, 1.0, 1.0))  # as Blender colours x, y and z
_BEST = (1.0, 0.84, 0.30, 1.0)
_LIGHT_RIM = (0.85, 0.85, 0.88, 0.8)
_LUMINANCE = (0.2126, 0.7152, 0.0722)  # Rec. 709, applied to display values: enough to separate dark from light
_GOAL = (1.0, 1.0, 1.0, 1.0)
_WIDTH, _HEIGHT = 264.0, 294.0  # pixels at scale 1
_KEY_LINE = 16.0  # distance of the key's lines in pixels at scale 1
_EMPTY = 56.0  # the height without a swarm
_TURN_SECONDS = 40.0  # seconds of work per turn of the box
_FIRST_AZIMUTH = 0.62  # first azimuth of the box, in radians
_ELEVATION = 0.38
_FAR, _NEAR = (1.0, 1.0, 1.0, 0.13), (1.0, 1.0, 1.0, 0.28)
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if np.abs(_CORNERS[a] - _CORNERS[b]).sum() == 1]


@dataclass(frozen=True)
class Axis:
    """One axis of the box: a searched component, its index in the particles' positions, and its range."""

    name: str
    index: int
    low: float
    high: float


class Trail:
    """The last TRAIL positions of a texel's particles. live: whether the swarm still searches."""

    def __init__(self) -> None:
        self.particles: Particles | None = None
        self.positions: deque[np.ndarray] = deque(maxlen=TRAIL)
        self.live = False
        self._texel: object = None

    def update(self, particles: Particles | None, of: object) -> None:
        """Add the particles read last, None if no swarm is searching. of: identity of the texel.

        Another texel, or particles with other components, clear the trail.
        """
        self.live = particles is not None
        if of != self._texel:
            self.particles, self._texel = None, of
            self.positions.clear()
        if particles is None:
            return
        if self.positions and particles.positions.shape != self.positions[-1].shape:
            self.positions.clear()
        if self.particles is not None and particles.names != self.particles.names:
            self.positions.clear()
        self.particles = particles
        if not (self.positions and np.array_equal(self.positions[-1], particles.positions)):
            self.positions.append(particles.positions)


def choose_axes(names: Sequence[str], chosen: Sequence[str], model: ReflectanceModel) -> list[Axis]:
    """Return at most three axes: the chosen components that are searched, then a colour's three, then the others."""
    colors = [p.name for p in model.parameters if p.components == 3 and not p.is_normal]
    color = next((c for c in colors if all(f"{c}.{part}" in names for part in "rgb")), None)
    default = [f"{color}.{part}" for part in "rgb"] if color else []
    order = dict.fromkeys([*(name for name in chosen if name in names), *default, *names])
    return [Axis(name, list(names).index(name), *_range(name, model)) for name in list(order)[:3]]


def in_box(axes: Sequence[Axis], values: np.ndarray) -> np.ndarray:
    """Return places (…, 3) in the unit box of values (…, n); 0 along missing axes."""
    places = np.zeros((*values.shape[:-1], 3))
    for i, axis in enumerate(axes):
        places[..., i] = (values[..., axis.index] - axis.low) / (axis.high - axis.low)
    return np.clip(places, 0, 1)


def view_of(azimuth: float, elevation: float) -> np.ndarray:
    """Return (3, 3) with rows right, up and toward the viewer, for a view of the box from above with z upright."""
    right = np.array([np.cos(azimuth), np.sin(azimuth), 0])
    toward = np.array([np.sin(azimuth) * np.cos(elevation), -np.cos(azimuth) * np.cos(elevation), np.sin(elevation)])
    return np.stack([right, np.cross(toward, right), toward])


def box_pixels(places: np.ndarray, view: np.ndarray, area: Rectangle) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels (…, 2) of places (…, 3) in the unit box, and their depth toward the viewer (larger is nearer).

    The box fits into the area at every turn about its upright axis.
    """
    turned = (np.asarray(places) - 0.5) @ view.T
    # The corners are √½ from the upright axis, which gives their largest height in the view.
    rise = 0.5 * view[1, 2] + np.sqrt(0.5) * np.sqrt(max(0.0, 1 - view[1, 2] ** 2))
    size = min(area.width / np.sqrt(2), area.height / (2 * rise))
    centre = np.array([area.x + area.width / 2, area.y + area.height / 2])
    return centre + size * turned[..., :2], turned[..., 2]


def swarm_size(scale: float, trail: Trail) -> tuple[float, float]:
    """Return width and height of the panel in pixels. Without a swarm the panel is low."""
    return _WIDTH * scale, (_HEIGHT if trail.particles is not None else _EMPTY) * scale


def goal_place(axes: Sequence[Axis], parameter: Parameter, value: np.ndarray) -> np.ndarray | None:
    """Return the place (3,) in the box of a true value (components,), None if an axis has another parameter."""
    names = component_names(parameter)
    if not axes or not all(axis.name in names for axis in axes):
        return None
    return in_box([replace(axis, index=names.index(axis.name)) for axis in axes], value)


def draw_swarm(
    painter: Painter,
    area: Rectangle,
    title: str,
    color: Sequence[float],
    trail: Trail,
    axes: Sequence[Axis],
    seconds: float,
    goal: np.ndarray | None,
) -> None:
    """Draw the box, the particles with trails and personal bests, the global best, and the goal.

    color: of the probe. seconds: time of the search, which turns the box. goal: (3,) place in the box, None if unknown.
    """
    s, particles = painter.scale, trail.particles
    painter.panel(area)
    painter.dots(np.array([[area.x + 15 * s, area.top - 16 * s]]), color, 8)
    painter.text(title, area.x + 24 * s, area.top - 20 * s)
    if particles is None:
        painter.text(iface("No swarm is searching it"), area.x + 24 * s, area.top - 40 * s, DIM, SMALL)
        return
    if not trail.live:
        painter.text(iface("the last swarm"), area.x + 24 * s, area.top - 36 * s, DIM, SMALL)
    lines = _draw_key(painter, area, goal is not None)
    inside = area.inset(26 * s, (44 + _KEY_LINE * (lines - 1)) * s, 26 * s, 52 * s)
    view = view_of(_FIRST_AZIMUTH + 2 * np.pi * seconds / _TURN_SECONDS, _ELEVATION) if len(axes) == 3 else np.eye(3)
    _draw_box(painter, axes, view, inside, area)
    places = in_box(axes, np.stack(trail.positions))
    colors = particle_colors(axes, particles.positions, color)
    path, depth = box_pixels(places, view, inside)
    _draw_trails(painter, path, colors)
    bests, _ = box_pixels(in_box(axes, particles.bests[np.isfinite(particles.fitness)]), view, inside)
    painter.rings(bests, (1.0, 1.0, 1.0, 0.55), 5.5, 1.0)
    order = np.argsort(depth[-1])
    painter.dots(path[-1][order], _rims(colors[order]), 8.5)
    painter.dots(path[-1][order], colors[order], 6.5)
    best = in_box(axes, particles.global_best)
    _draw_best(painter, best, view, inside)
    if goal is not None:
        _draw_goal(painter, box_pixels(goal, view, inside)[0])


def particle_colors(axes: Sequence[Axis], positions: np.ndarray, color: Sequence[float]) -> np.ndarray:
    """Return (m, 4) colours: with axes of a colour or a normal, the particle's colour in the map, else the probe's."""
    parts = [axis.name.rpartition(".")[2] for axis in axes]
    values = positions[:, [axis.index for axis in axes]]
    if parts == list("rgb"):
        return np.pad(srgb_from_linear(np.clip(values, 0, 1)), ((0, 0), (0, 1)), constant_values=1.0)
    if parts == list("xyz"):
        return np.pad(encode_normal(values), ((0, 0), (0, 1)), constant_values=1.0)
    return np.tile(np.float64(color), (len(positions), 1))


def _rims(colors: np.ndarray) -> np.ndarray:
    """Return (m, 4) colours of the particles' rims: light for dark particles, dark for light ones."""
    dark = colors[:, :3] @ _LUMINANCE < 0.35
    return np.where(dark[:, None], _LIGHT_RIM, HALO)


def _range(name: str, model: ReflectanceModel) -> tuple[float, float]:
    """Return the range of a component of the model, or of the prefit's model."""
    parameter_name, _, part = name.partition(".")
    for parameter in (*model.parameters, *prefit_model().parameters):
        if parameter.name == parameter_name:
            return (0.0, 1.0) if parameter.is_normal and part == "z" else parameter.range  # it faces the viewer
    return 0.0, 1.0


def _draw_box(painter: Painter, axes: Sequence[Axis], view: np.ndarray, inside: Rectangle, panel: Rectangle) -> None:
    used = np.array([i < len(axes) for i in range(3)])
    pixels, depth = box_pixels(_CORNERS * used, view, inside)
    farthest = int(np.argmin(depth))
    for behind in (True, False):
        edges = [edge for edge in _EDGES if (farthest in edge) == behind and 0 not in edge]
        painter.lines(pixels[np.array(edges, int).reshape(-1, 2)], _FAR if behind else _NEAR)
    middle = pixels.mean(axis=0)
    for i, axis in enumerate(axes):
        end = pixels[[4, 2, 1][i]]
        painter.line(pixels[0], end, _AXES[i], 1.4)
        outward = (end - middle) / max(np.linalg.norm(end - middle), 1e-9)
        text, (x, y) = f"{'XYZ'[i]}  {_axis_text(axis)}", end + outward * 9 * painter.scale
        width, rim = painter.width(text, SMALL), 8 * painter.scale
        x -= 0 if outward[0] > 0.35 else width if outward[0] < -0.35 else width / 2
        x = min(max(x, panel.x + rim), panel.right - rim - width)
        painter.text(text, x, y - (10 if outward[1] < 0 else 0) * painter.scale, _AXES[i], SMALL)


def _draw_trails(painter: Painter, path: np.ndarray, colors: np.ndarray) -> None:
    """Draw the trails. path: (times, m, 2) pixels, oldest first. colors: (m, 4)."""
    times, count = path.shape[:2]
    if times < 2:
        return
    fade = np.linspace(0.0, 0.75, times)
    shades = np.broadcast_to(colors, (times, count, 4)) * np.pad(fade[:, None, None], ((0, 0), (0, 0), (3, 0)),
                                                                 constant_values=1.0)  # fmt: skip
    ends = np.stack([path[:-1], path[1:]], axis=2), np.stack([shades[:-1], shades[1:]], axis=2)
    painter.lines(ends[0].reshape(-1, 2, 2), ends[1].reshape(-1, 4), 1.3)


def _draw_best(painter: Painter, place: np.ndarray, view: np.ndarray, area: Rectangle) -> None:
    """Draw a star, and a line down to the floor, which shows its depth in the box."""
    ends, _ = box_pixels(np.stack([place, place * [1, 1, 0]]), view, area)
    painter.line(ends[0], ends[1], (*_BEST[:3], 0.45))
    painter.dots(ends[1:], (*_BEST[:3], 0.6), 3)
    painter.triangles(star(ends[0], 9.5 * painter.scale), HALO)
    painter.triangles(star(ends[0], 7 * painter.scale), _BEST)


def _draw_goal(painter: Painter, at: np.ndarray) -> None:
    painter.rings(at[None], HALO, 9, 3.5)
    painter.rings(at[None], _GOAL, 9, 1.6)
    reach = 13 * painter.scale
    cross = at + reach * np.array([[[-1, 0], [-0.5, 0]], [[0.5, 0], [1, 0]], [[0, -1], [0, -0.5]], [[0, 0.5], [0, 1]]])
    painter.lines(cross, _GOAL, 1.4)


def _draw_key(painter: Painter, area: Rectangle, with_goal: bool) -> int:
    """Draw the key at the panel's bottom; return its number of lines, 2 where the language's words need them."""
    s = painter.scale
    left, y = area.x + 15 * s, area.y + 14 * s
    x = left
    entries = [iface("particle"), iface("its best"), iface("best of all"), *([iface("goal")] if with_goal else [])]
    widths, right = [painter.width(text, SMALL) + 9 * s for text in entries], area.right - 8 * s
    lines = 2 if left + sum(widths) + 17 * s * (len(entries) - 1) > right else 1
    y += (lines - 1) * _KEY_LINE * s
    for i, (text, width) in enumerate(zip(entries, widths, strict=True)):
        if x > left and x + width > right:
            x, y = left, y - _KEY_LINE * s
        at = np.array([[x, y]])
        if i == 0:
            painter.dots(at, DIM, 6.5)
        elif i == 1:
            painter.rings(at, (1.0, 1.0, 1.0, 0.7), 4.0, 1.0)
        elif i == 2:
            painter.triangles(star(at[0], 6 * s), _BEST)
        else:
            painter.rings(at, _GOAL, 4.5, 1.5)
        painter.text(text, x + 9 * s, y - 3.5 * s, DIM, SMALL)
        x += width + 17 * s
    return lines


def star(at: np.ndarray, radius: float) -> np.ndarray:
    """Return (3·T, 2) triangles of a five-pointed star around a point."""
    angles = np.pi / 2 + np.arange(10) * np.pi / 5
    radii = radius * np.where(np.arange(10) % 2 == 0, 1.0, 0.45)
    outline = at + radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return np.stack([np.broadcast_to(at, outline.shape), outline, np.roll(outline, -1, axis=0)], axis=1).reshape(-1, 2)


def _axis_text(axis: Axis) -> str:
    parameter, _, part = axis.name.partition(".")
    words = f"{iface(bpy.path.display_name(parameter))} {part.upper()}".strip()
    return f"{words} {tick_text(axis.low)} … {tick_text(axis.high)}" if (axis.low, axis.high) != (0.0, 1.0) else words
