"""Comparison of the lights of the balls in use with those of a ball of the other kind."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...capture.camera import Camera
from .detect.found import FoundBall
from .lights import FoundLight

_APART = 4.0  # degrees, median; correct mirror and matte balls differ by at most 2.3° (rendered by Cycles)
_OF_PARALLAX = 0.3  # relative error of the lamps' distance, from which the parallax follows


def contradiction(
    used: FoundBall, lights: Sequence[FoundLight], other: FoundBall, others: Sequence[FoundLight], camera: Camera
) -> str | None:
    """Return a warning if two balls show different lights, else None.

    lights, others: distant lights of the same photographs, from each ball. The directions of a near lamp differ by its
    parallax between the balls, which is subtracted.
    """
    inverse, offset = used.inverse[0], (other.centre - used.centre) / used.radius
    shift = inverse * np.asarray(camera.matrix, np.float64)[:3, :2] @ offset
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
