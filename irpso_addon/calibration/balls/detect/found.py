"""Balls that a search found, and their use for calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ....capture.camera import Camera
from ..ball import Ball, fit_ball
from ..table import Table

_CENTRE_ERROR, _RADIUS_ERROR = 0.004, 0.008  # of the radius: what shadows give, measured on tables rendered by Cycles
_RIM_CENTRE, _RIM_RADIUS = 0.002, 0.004  # and what a matte ball's rim gives
_REACH = 1.5  # radii from the ball to its shadow: there the shadow of a near lamp is as much wider
_UNKNOWN = 0.02  # deviation of radius over distance, where the light's fall-off does not show it
_SIZES = 1.15  # ratio of the radii of balls of one size


@dataclass(frozen=True, eq=False)
class FoundBall:
    """A ball in the photographs. points: (N, 2) pixel coordinates on its outline, row 0 at the bottom.

    support: fraction of its outline where an edge shows. shadow: correlation of the darkness around the ball with the
    shadow that it would throw, or None where nothing around it is lit. exact: its outline was measured where its radius
    is 15 pixels or more; a smaller one's lights may be off by 20°. inverse: the ball's radius over the lamps' distance,
    0 for distant ones, and its standard error. table: below it, or None where its shadow does not show.
    """

    kind: str
    points: np.ndarray
    radius: float
    support: float
    shadow: float | None
    exact: bool = True
    inverse: tuple[float, float] = (0.0, np.inf)
    table: Table | None = None

    @property
    def centre(self) -> np.ndarray:
        """(2,) pixel coordinates."""
        return (self.points.max(axis=0) + self.points.min(axis=0)) / 2


def of_one_kind(found: Sequence[FoundBall]) -> list[FoundBall]:
    """Return the exact balls that calibration uses: mirror before matte ones, and of these the size of the surest."""
    kind = "mirror" if any(ball.exact and ball.kind == "mirror" for ball in found) else "matte"
    same = [ball for ball in found if ball.exact and ball.kind == kind]
    return [ball for ball in same if 1 / _SIZES < ball.radius / same[0].radius < _SIZES]


def tables_of(found: Sequence[FoundBall]) -> tuple[Table, ...]:
    """Return the table below each ball, or none where one is unknown."""
    tables = tuple(ball.table for ball in found if ball.table is not None)
    return tables if len(tables) == len(found) else ()


def as_ball(found: FoundBall, camera: Camera, name: str, radius: float | None) -> Ball:
    """Return a found ball, placed. radius: in world units, or None."""
    ball = fit_ball(found.points, camera, name, radius)
    if found.kind == "mirror" and found.shadow is not None:
        across = np.hypot(_RADIUS_ERROR, _REACH * min(found.inverse[1], _UNKNOWN))
        return replace(ball, error_px=(_CENTRE_ERROR * ball.radius_px, float(across) * ball.radius_px))
    if found.kind == "matte":
        centre, across = np.maximum(ball.error_px, np.array([_RIM_CENTRE, _RIM_RADIUS]) * ball.radius_px).tolist()
        return replace(ball, error_px=(centre, across))
    return ball
