"""Circles that prove to be balls: their test, and the measurement of their place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ....core.errors import InputError
from ..ball import Ball, fit_ball, outline_of_circle
from ..mirror import reflected
from . import evidence
from .falloff import inverse_distance
from .outline import Outline, fitted
from .pictures import Pictures
from .shadow import Table, agreement

_LEAST_SUPPORT = 0.3
_TESTED = 60
_LEAST_SHARE = 0.6  # of the photographs: each shows a light
_LEAST_MOVED = 0.12
_LEAST_FIT = 0.93
_LEAST_SHADOW = 0.75
_DOUBT = 0.15  # more agreement with the shadow, where photographs show no light
PROMISING = 0.3  # agreement with the shadow that a better outline may raise
_SURE_SUPPORT, _SURE_SHARE, _SURE_MOVED, _SURE_FIT = 0.9, 0.8, 0.3, 0.98  # without a shadow
_STARTS = (0.85, 0.93, 1.0, 1.08, 1.2, 1.41)  # of the radius: a mirrored horizon is a circle inside the outline
_SHADOW_STEPS = (0.03, 0.015, 0.01)  # of the radius


@dataclass(frozen=True)
class Hit:
    """A ball in ``pictures``, whose pixel coordinates its outline and evidence have."""

    pictures: Pictures
    outline: Outline
    kind: str
    ball: Ball
    seen: evidence.Evidence
    shadow: float | None
    table: Table | None = None
    inverse: tuple[float, float] = (0.0, np.inf)

    @property
    def score(self) -> float:
        """How sure the ball is."""
        return self.outline.support + 2 * (0.5 if self.shadow is None else self.shadow)

    @property
    def circle(self) -> np.ndarray:
        """(3,) centre and radius of the outline, in pixels of the photographs."""
        middle = self.pictures.in_photograph(np.array([self.outline.x, self.outline.y]))
        return np.append(middle, self.outline.radius * self.pictures.block)


def distinct(outlines: Sequence[Outline]) -> list[Outline]:
    """Return the best supported outlines, each circle once."""
    kept: list[Outline] = []
    for outline in sorted(outlines, key=lambda o: -o.support):
        if outline.support < _LEAST_SUPPORT or len(kept) == _TESTED:
            break
        if not any(_same(outline, other) for other in kept):
            kept.append(outline)
    return kept


def _same(one: Outline, other: Outline) -> bool:
    near = max(0.02 * other.radius, 0.3)
    return bool(np.hypot(one.x - other.x, one.y - other.y) < near and abs(one.radius - other.radius) < near)


def tested(pictures: Pictures, outline: Outline, kinds: Sequence[str], least: float) -> list[Hit]:
    """Return a hit for each kind of ball that an outline may be of."""
    try:
        ball = fit_ball(outline_of_circle(outline.x, outline.y, outline.radius), pictures.camera)
    except InputError:
        return []
    hits = []
    for kind in kinds:
        of_kind = evidence.of_mirror if kind == "mirror" else evidence.of_matte
        seen = of_kind(pictures.values, pictures.clipped, ball)
        if seen.share < _LEAST_SHARE or seen.moved < _LEAST_MOVED or seen.fit < _LEAST_FIT:
            continue
        wanted = least if seen.share >= _SURE_SHARE else least + _DOUBT
        shadow_agrees = agreement(pictures.values, ball, seen.lights)
        if shadow_agrees is None:
            sure = seen.share >= _SURE_SHARE and seen.moved >= _SURE_MOVED and seen.fit >= _SURE_FIT
            if sure and outline.support >= _SURE_SUPPORT:
                hits.append(Hit(pictures, outline, kind, ball, seen, None))
        elif shadow_agrees[0] >= wanted:
            hits.append(Hit(pictures, outline, kind, ball, seen, *shadow_agrees))
    return hits


def improved(pictures: Pictures, circle: np.ndarray, kind: str) -> list[Hit]:
    """Return the hits near a circle (3,) of the photographs that edges outline, where their shadow agrees."""
    x, y = (circle[:2] - pictures.origin) / pictures.block
    radius = circle[2] / pictures.block
    old = fitted(pictures.steady, x, y, radius)
    outlines = distinct([old, *(fitted(pictures.strong, x, y, factor * radius) for factor in _STARTS)])
    return [better for outline in outlines for better in tested(pictures, outline, [kind], _LEAST_SHADOW)]


def measured(hit: Hit, whole: Pictures) -> Hit:
    """Return a hit with the lamps' distance, and for a mirror ball with the circle at which its shadow agrees best.

    whole: pictures of all the table. A mirror shows at its rim what lies behind it, so that the visible edge lies up to
    3 % inside the outline. The shadow is as wide as the ball, and wider under near lamps. One coordinate after the
    other moves to the top of a parabola.
    """
    if hit.table is None:
        return hit
    pictures = hit.pictures
    ball = replace(hit.ball, camera=whole.camera, radius_px=hit.ball.radius_px * pictures.block / whole.block)
    hit = replace(hit, inverse=inverse_distance(whole.values, whole.clipped, ball, hit.seen.lights, hit.table))
    if hit.kind != "mirror":
        return hit
    circle, table, inverse = np.array([hit.outline.x, hit.outline.y, hit.outline.radius]), hit.table, hit.inverse[0]
    for step in _SHADOW_STEPS:
        for axis in (2, 0, 1, 2):
            moves = step * hit.outline.radius * np.arange(-1, 2)
            heights = []
            for move in moves:
                x, y, radius = circle + move * np.eye(3)[axis]
                ball = fit_ball(outline_of_circle(x, y, radius), pictures.camera, measured=False)
                lights = _from_centre(ball, hit.seen.pixels, inverse)
                agrees = agreement(pictures.values, ball, lights, table, hit.ball, inverse)
                heights.append((-1.0, table) if agrees is None else agrees)
            low, middle, high = (height for height, _ in heights)
            bend = 2 * middle - low - high
            circle[axis] += np.clip(0.5 * (high - low) / bend, -1, 1) * moves[2] if bend > 0 else 0.0
            table = max(heights, key=lambda h: h[0])[1]
    x, y, radius = circle.tolist()
    outline = Outline(x, y, radius, hit.outline.support, outline_of_circle(x, y, radius))
    return replace(hit, outline=outline, shadow=max(height for height, _ in heights))


def _from_centre(ball: Ball, pixels: np.ndarray, inverse: float) -> np.ndarray:
    """Return the unit directions (K, 3), from a mirror ball's centre, to lamps that it shows at pixels (K, 2)."""
    point, direction, _ = reflected(ball, pixels)
    direction = direction + inverse * (point - ball.centre) / ball.radius
    return direction / np.linalg.norm(direction, axis=-1, keepdims=True)
