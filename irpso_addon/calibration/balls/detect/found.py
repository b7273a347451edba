"""Balls that the search found, and their selection for calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ....capture.camera import Camera
from ..ball import Ball, fit_ball
from ..table import Table

_CENTRE_ERROR, _RADIUS_ERROR = 0.004, 0.008  # of the radius: standard errors by shadows, on tables rendered by Cycles
_RIM_CENTRE, _RIM_RADIUS = 0.002, 0.004  # of the radius: standard errors by a matte ball's rim
_SHADOW_DISTANCE = 1.5  # radii from ball to shadow: a near lamp widens the shadow by this times ``inverse``
_UNKNOWN = 0.02  # deviation of radius over distance if the fall-off does not give it
_SAME_SIZE = 1.15  # largest ratio of radii


@dataclass(frozen=True, eq=False)
class FoundBall:
    """A ball in the photographs. points: (N, 2) pixel coordinates on its outline, row 0 at the bottom.

    support: fraction of its outline with a visible edge. shadow: correlation, −1…1, of the darkness around it with its
    predicted shadow, or None if nothing around it is lit. exact: its radius was 15 pixels or more where it was
    measured; lights of smaller ones may be off by 20°. inverse: the ball's radius over the lamps' distance, 0 for
    distant ones, and its standard error. table: below it, or None if its shadow is not visible.
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
        """(2,) pixel coordinates of the outline's centre."""
        return (self.points.max(axis=0) + self.points.min(axis=0)) / 2


def usable_balls(balls: Sequence[FoundBall]) -> list[FoundBall]:
    """Return the exact balls for calibration: mirror, else matte ones, of about the size of the first (surest)."""
    kind = "mirror" if any(ball.exact and ball.kind == "mirror" for ball in balls) else "matte"
    same = [ball for ball in balls if ball.exact and ball.kind == kind]
    return [ball for ball in same if 1 / _SAME_SIZE < ball.radius / same[0].radius < _SAME_SIZE]


def known_tables(balls: Sequence[FoundBall]) -> tuple[Table, ...]:
    """Return the table below each ball; () if any is unknown."""
    tables = tuple(ball.table for ball in balls if ball.table is not None)
    return tables if len(tables) == len(balls) else ()


def as_ball(detected: FoundBall, camera: Camera, name: str, radius: float | None) -> Ball:
    """Return a found ball as a Ball in camera axes. radius: in world units, or None."""
    ball = fit_ball(detected.points, camera, name, radius)
    if detected.kind == "mirror" and detected.shadow is not None:
        radius_error = np.hypot(_RADIUS_ERROR, _SHADOW_DISTANCE * min(detected.inverse[1], _UNKNOWN))
        return replace(ball, error_px=(_CENTRE_ERROR * ball.radius_px, float(radius_error) * ball.radius_px))
    if detected.kind == "matte":
        centre, radius_error = np.maximum(ball.error_px, np.array([_RIM_CENTRE, _RIM_RADIUS]) * ball.radius_px).tolist()
        return replace(ball, error_px=(centre, radius_error))
    return ball
