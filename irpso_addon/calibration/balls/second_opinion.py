"""Lights of a ball that calibration does not use, against those of the balls that it does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...capture.camera import Camera
from .detect.found import FoundBall
from .lights import FoundLight

_APART = 4.0  # degrees in the median; of a mirror and a matte ball that were both right, 2.3° at most, in Cycles
_OF_PARALLAX = 0.3  # near lamps seen from two places: what their distance may be off by


def contradiction(
    used: FoundBall, lights: Sequence[FoundLight], other: FoundBall, others: Sequence[FoundLight], camera: Camera
) -> str | None:
    """Return in words that two balls of different size show different lights, or None.

    lights, others: distant, of the same photographs, as seen from each ball. The direction of a near lamp differs from
    ball to ball by the parallax that its distance gives.
    """
    inverse, away = used.inverse[0], (other.centre - used.centre) / used.radius
    shift = inverse * np.asarray(camera.matrix, np.float64)[:3, :2] @ away
    angles = [
        _angle(np.asarray(one.light.vector) - shift, np.asarray(two.light.vector))
        for one, two in zip(lights, others, strict=True)
        if one.light is not None and two.light is not None
    ]
    allowed = _APART + _OF_PARALLAX * np.degrees(np.linalg.norm(shift))
    if not angles or np.median(angles) <= allowed:
        return None
    return (
        f"the {other.kind} ball of radius {other.radius:.0f} pixels shows the lights {np.median(angles):.0f}° (median)"
        f" away from where the {used.kind} ball shows them, so one of the two was measured wrong: look at balls.png,"
        " and give the outline of a ball with --ball"
    )


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    cosine = a @ b / (np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
