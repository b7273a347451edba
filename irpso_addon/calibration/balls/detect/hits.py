"""Test whether circles are balls, and measurement of the balls' outlines."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ....core.errors import InputError
from ..ball import SMALL, Ball, fit_ball, outline_of_circle
from ..mirror import reflected
from ..table import Table
from . import evidence
from .falloff import inverse_distance
from .outline import Outline, fitted, measured
from .pictures import Pictures
from .rim import on_rim
from .shadow import agreement, table_light

_MIN_SUPPORT = 0.3
_TESTED = 60  # outlines
_MIN_SHARE = 0.6  # of the photographs: each shows a light
_MIN_MOVED = 0.12
_MIN_FIT = 0.93
# Least agreement with the shadow: for a circle without visible edges; reduction if the whole outline is visible.
_SHADOW_OF_OUTLINE = {"mirror": (1.24, 0.52), "mirror on cloth": (0.82, 0.1), "matte": (0.9, 0.42)}
_CLOTH = 0.06  # of white: a darker table is black cloth
_DOUBT = 0.15  # additional agreement required if photographs show no light
PROMISING = 0.3  # least agreement with the shadow before the outline is refined
_MIRROR_SHARE = 0.85  # of the photographs: a mirror ball shows the lamp in all but one of seven
_SURE_SUPPORT, _SURE_SHARE, _SURE_MOVED, _SURE_FIT = 0.9, 0.8, 0.3, 0.98  # thresholds without a shadow
_STARTS = (0.85, 0.93, 1.0, 1.08, 1.2, 1.41)  # of the radius: the reflected horizon is a circle inside the outline
_SHADOW_STEPS = (0.06, 0.03, 0.015, 0.01)  # of the radius
_SCAN = (0.85, 1.08, 1.16, 1.25)  # of the radius
_HORIZONS = np.radians((0, 20, 40, 60))  # angles between the table's normal and the viewer
_CLIMBED = 2  # circles of one ball that are refined by the shadow
_NEAR = 0.005  # radii over distance: nearer lamps need directions to 1°, so the fit includes the table's light
_TABLES = 3  # steps, of 2.5°, of the table's normal of a matte ball
_MEASURABLE = 0.6  # of 15 pixels: the first circle may be too small by this factor
_SMALL_DOUBT = 0.12  # additional agreement for radii below 15 pixels; mirror on a bright table: falls to 0 at 20


@dataclass(frozen=True)
class Hit:
    """A candidate ball. outline, seen: in pixel coordinates of ``pictures``.

    clear: support of the outline fitted to edges, before the shadow refined it. shadow, inverse: as ``FoundBall``.
    """

    pictures: Pictures
    outline: Outline
    kind: str
    ball: Ball
    seen: evidence.Evidence
    clear: float
    shadow: float | None
    table: Table | None = None
    inverse: tuple[float, float] = (0.0, np.inf)

    @property
    def score(self) -> float:
        """Rank among hits: support plus twice the agreement with the shadow (0.5 if unknown)."""
        return self.outline.support + 2 * (0.5 if self.shadow is None else self.shadow)

    @property
    def circle(self) -> np.ndarray:
        """(3,) centre and radius of the outline, in pixels of the photographs."""
        middle = self.pictures.in_photograph(np.array([self.outline.x, self.outline.y]))
        return np.append(middle, self.outline.radius * self.pictures.block)


def distinct(outlines: Sequence[Outline], most: int = _TESTED) -> list[Outline]:
    """Return distinct outlines, best support first, at most ``most``."""
    selected: list[Outline] = []
    for outline in sorted(outlines, key=lambda o: -o.support):
        if outline.support < _MIN_SUPPORT or len(selected) == most:
            break
        if not any(_same_circle(outline, other) for other in selected):
            selected.append(outline)
    return selected


def _same_circle(one: Outline, other: Outline) -> bool:
    near = max(0.02 * other.radius, 0.3)
    return bool(np.hypot(one.x - other.x, one.y - other.y) < near and abs(one.radius - other.radius) < near)


def tested(pictures: Pictures, outline: Outline, kinds: Sequence[str], least: float) -> list[Hit]:
    """Return a hit for each kind of ball that an outline passes. least: agreement with the shadow."""
    try:
        ball = fit_ball(outline_of_circle(outline.x, outline.y, outline.radius), pictures.camera)
    except InputError:
        return []
    hits = []
    for kind in kinds:
        of_kind = evidence.of_mirror if kind == "mirror" else evidence.of_matte
        seen = of_kind(pictures.values, pictures.clipped, ball)
        if seen.share < _MIN_SHARE or seen.moved < _MIN_MOVED or seen.fit < _MIN_FIT:
            continue
        threshold = least if seen.share >= _SURE_SHARE else least + _DOUBT
        shadow_agrees = agreement(pictures.values, ball, seen.lights, noise=pictures.noise)
        if shadow_agrees is None:
            sure = seen.share >= _SURE_SHARE and seen.moved >= _SURE_MOVED and seen.fit >= _SURE_FIT
            if sure and outline.support >= _SURE_SUPPORT:
                hits.append(Hit(pictures, outline, kind, ball, seen, outline.support, None))
        elif shadow_agrees[0] >= threshold:
            hits.append(Hit(pictures, outline, kind, ball, seen, outline.support, *shadow_agrees))
    return hits


def improved_steps(
    pictures: Pictures, circle: np.ndarray, kind: str, whole: Pictures
) -> Generator[None, None, list[Hit]]:
    """Yield often; return the balls near a circle (3,) of the photographs.

    Edges must outline them and their shadows agree. whole: pictures of the whole table, for the lamps' distance. A
    mirror ball's circle maximises the agreement with the shadow: the rim of a mirror reflects what lies behind it, so
    the visible edge lies up to 3 % inside the outline; on black cloth it is that of the reflected cloth, up to a fifth
    inside.
    """
    x, y = (circle[:2] - pictures.origin) / pictures.block
    radius = circle[2] / pictures.block
    starts = [fitted(pictures.steady, x, y, radius)]
    for factor in _STARTS:
        yield
        starts.append(fitted(pictures.strong, x, y, factor * radius))
    outlines = distinct(starts)
    if kind == "mirror":
        outlines = [measured(pictures.steady, x, y, radius), *outlines]
    hits: list[Hit] = []
    for outline in outlines:
        yield
        hits += tested(pictures, outline, [kind], PROMISING)
    if kind == "mirror":
        best, hits = sorted(hits, key=lambda hit: -hit.score)[:_CLIMBED], []
        for hit in best:
            yield
            near = _with_distance(hit, whole)
            hits.append((yield from _measured_by_shadow(near)) if _measurable(near) else near)
    lit = [hit for hit in hits if hit.seen.share >= _MIN_SHARE]
    accepted = [hit for hit in lit if hit.shadow is None or hit.shadow >= _threshold(hit)]
    if kind == "mirror":
        return accepted
    placed = []
    for hit in accepted:
        yield
        hit = _with_distance(_measured_by_rim(hit), whole)
        if hit.table is not None and hit.inverse[0] > _NEAR:
            yield
            seen = evidence.on_table(hit.pictures.values, hit.pictures.clipped, hit.ball, hit.table, hit.inverse[0])
            hit = _with_distance(replace(hit, seen=seen), whole)
        placed.append(hit)
    return placed


def _measured_by_rim(hit: Hit) -> Hit:
    """Return a matte ball's hit with its outline measured at the rim, then its table by the shadow."""
    rim = on_rim(hit.pictures, hit.ball)
    if rim is not None:
        ball, points = rim
        seen = evidence.of_matte(hit.pictures.values, hit.pictures.clipped, ball)
        x, y = points.mean(axis=0).tolist()
        outline = Outline(x, y, ball.radius_px, hit.outline.support, points)
        hit = replace(hit, outline=outline, ball=ball, seen=seen)
    for _ in range(_TABLES if hit.table is not None else 0):
        agrees = agreement(hit.pictures.values, hit.ball, hit.seen.lights, hit.table, noise=hit.pictures.noise)
        hit = hit if agrees is None else replace(hit, table=agrees[1])
    return hit


def _measurable(hit: Hit) -> bool:
    """Return whether the shadow may refine the circle: a table is known and the ball not too small to be used."""
    return hit.table is not None and hit.outline.radius > _MEASURABLE * SMALL


def _threshold(hit: Hit) -> float:
    """Return the least agreement with the shadow; the clearer the edges of the outline, the lower.

    Shadows of other objects and near lamps lower the agreement of balls. On black cloth a mirror ball has few edges; on
    a bright table a shiny object that is nearly round reaches 0.87. The lights of a small circle fit many shadows.
    """
    bright = _bright_table(hit)
    least, clear = _SHADOW_OF_OUTLINE[hit.kind if hit.kind == "matte" or bright else "mirror on cloth"]
    doubtful = hit.seen.share < (_SURE_SHARE if hit.kind == "matte" else _MIRROR_SHARE)
    small = 4 - 3 * hit.outline.radius / SMALL if hit.kind == "mirror" and bright else float(hit.outline.radius < SMALL)
    return least - clear * hit.clear + doubtful * _DOUBT + float(np.clip(small, 0, 1)) * _SMALL_DOUBT


def _bright_table(hit: Hit) -> bool:
    """Return whether the table is brighter than black cloth."""
    return table_light(hit.pictures.values, hit.ball) > _CLOTH


def _with_distance(hit: Hit, whole: Pictures) -> Hit:
    """Return a hit with the lamps' distance; unchanged if its table is unknown."""
    if hit.table is None:
        return hit
    size = hit.ball.radius_px * hit.pictures.block / whole.block
    ball = replace(hit.ball, camera=whole.camera, radius_px=size)
    return replace(hit, inverse=inverse_distance(whole.values, whole.clipped, ball, hit.seen.lights, hit.table))


def _scanned(hit: Hit) -> Generator[None, None, Hit]:
    """Yield often; return a hit with the circle, of a few, and the table, of all, at which its shadow agrees best."""
    candidates = [hit]
    x, y, radius = hit.outline.x, hit.outline.y, hit.outline.radius
    circles = [(x, y, factor * radius) for factor in _SCAN]
    if not _bright_table(hit):
        circles += _around_horizon(hit)
    for x, y, radius in circles:
        yield
        ball, agrees = _agreement_at(hit, x, y, radius)
        if agrees is not None:
            outline = measured(hit.pictures.steady, x, y, radius)
            candidates.append(replace(hit, outline=outline, ball=ball, shadow=agrees[0], table=agrees[1]))
    return max(candidates, key=lambda h: h.shadow or 0.0)


def _around_horizon(hit: Hit) -> list[tuple[float, float, float]]:
    """Return circles x, y, radius of mirror balls that reflect a table's horizon at a hit's circle.

    Viewed at an angle t from the table's normal, a ball shows the horizon at sin(45° + t / 2) of its radius toward the
    normal, and at sin(45° − t / 2) on the other side. On black cloth this is the clearest circle.
    """
    table = hit.table
    projected = np.zeros(2) if table is None else table.up[:2]
    length = float(np.linalg.norm(projected))
    toward = projected / length if length > 0 else projected
    circles = []
    for tilt in _HORIZONS:
        far, near = np.sin(np.pi / 4 + tilt / 2), np.sin(np.pi / 4 - tilt / 2)
        radius = 2 * hit.outline.radius / (far + near)
        x, y = np.array([hit.outline.x, hit.outline.y]) - radius * (far - near) / 2 * toward
        circles.append((float(x), float(y), float(radius)))
    return circles


def _measured_by_shadow(hit: Hit) -> Generator[None, None, Hit]:
    """Yield often; return a mirror ball's hit with the circle at which its shadow agrees best.

    The shadow is as wide as the ball, and wider under near lamps. Coordinate descent: each step moves one coordinate to
    the vertex of a parabola.
    """
    hit = yield from _scanned(hit)
    circle, table = np.array([hit.outline.x, hit.outline.y, hit.outline.radius]), hit.table
    for step in _SHADOW_STEPS:
        for axis in (2, 0, 1, 2):
            yield
            moves = step * hit.outline.radius * np.arange(-1, 2)
            agreements = []
            for move in moves:
                x, y, radius = circle + move * np.eye(3)[axis]
                _, agrees = _agreement_at(hit, x, y, radius, table, hit.ball)
                agreements.append((-1.0, table) if agrees is None else agrees)
            low, middle, high = (height for height, _ in agreements)
            curvature = 2 * middle - low - high
            circle[axis] += np.clip(0.5 * (high - low) / curvature, -1, 1) * moves[2] if curvature > 0 else 0.0
            table = max(agreements, key=lambda h: h[0])[1]
    x, y, radius = circle.tolist()
    outline = Outline(x, y, radius, hit.outline.support, outline_of_circle(x, y, radius))
    ball = fit_ball(outline.points, hit.pictures.camera, measured=False)
    seen = evidence.of_mirror(hit.pictures.values, hit.pictures.clipped, ball, None if table is None else table.up)
    return replace(hit, outline=outline, seen=seen, shadow=max(height for height, _ in agreements), table=table)


def _agreement_at(
    hit: Hit, x: float, y: float, radius: float, table: Table | None = None, around: Ball | None = None
) -> tuple[Ball, tuple[float, Table] | None]:
    """Return a hit's ball at another circle, and its best agreement with the shadow: for tables near one, or all."""
    ball = fit_ball(outline_of_circle(x, y, radius), hit.pictures.camera, measured=False)
    lights = _from_centre(ball, hit.seen.pixels, hit.inverse[0])
    return ball, agreement(hit.pictures.values, ball, lights, table, around, hit.inverse[0], hit.pictures.noise)


def _from_centre(ball: Ball, pixels: np.ndarray, inverse: float) -> np.ndarray:
    """Return unit directions (K, 3) from a mirror ball's centre to lamps that it reflects at pixels (K, 2)."""
    point, direction, _ = reflected(ball, pixels)
    direction = direction + inverse * (point - ball.centre) / ball.radius
    return direction / np.linalg.norm(direction, axis=-1, keepdims=True)
