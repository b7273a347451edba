"""Warnings about what balls show: an unknown lens, unused balls, lamps that are nearer or farther than stated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...capture.camera import Camera
from ...capture.spec import ViewSpec
from .ball import Ball
from .detect.found import FoundBall, usable_balls
from .lights import Calibration

_PHONE, _TOLERATED = 65.0, 2.0  # degrees: field of view of a phone; tolerated error of lights
_RATIO = 1.6  # between the lamps' distance by their fall-off and the given one; a diameter for a radius makes it 2
# Of a ball's outline, to be sure of it. Of 10 mirror balls in Cycles with less, 6 give lights off by 1 to 8.4°; of 21
# with more, 2 by 2.3 and 2.7°.
_SEEN = 0.5
_FAR, _SIGNIFICANT = 5.0, 5.0  # image widths to a distant lamp; standard errors of a near one


def unknown_lens(view: ViewSpec, camera: Camera, balls: Sequence[Ball]) -> list[str]:
    """Return a warning if the lens is unknown and the balls lie far off the axis.

    An unknown lens is taken as orthographic. Its rays, and so the lights, are off by their angle to the axis.
    """
    if camera.perspective or view.lens:
        return []
    centres = np.array([ball.outline[:-1].mean(axis=0) for ball in balls])
    offset = np.linalg.norm(centres - (camera.width / 2, camera.height / 2), axis=-1).max() / (camera.width / 2)
    degrees = np.degrees(np.arctan(offset * np.tan(np.radians(_PHONE / 2))))
    if degrees < _TOLERATED:
        return []
    return [
        f"the field of view is unknown, so a very long lens is assumed; if it is a phone's ({_PHONE:.0f}° over the"
        f" width), the lights are off by about {degrees:.0f}°: give --fov"
    ]


def ball_warnings(balls: Sequence[FoundBall]) -> list[str]:
    """Return warnings about balls that the search found but that are unused, without shadow, or hardly visible."""
    used, warnings = usable_balls(balls) if balls else [], []
    for ball in balls:
        where = f"the {ball.kind} ball of radius {ball.radius:.0f} pixels that was found"
        if ball not in used:
            fault = "size" if ball.kind == used[0].kind else "kind"
            reason = f"of another {fault} than the surest one" if ball.exact else "too small for the search"
            warnings.append(f"{where} is left out: {reason}; to use it, give --ball")
        elif ball.shadow is None:
            warnings.append(f"{where} throws no visible shadow, which would confirm it; look at balls.png")
        elif ball.support < _SEEN:
            warnings.append(
                f"{where} shows {ball.support:.0%} of its outline, the rest follows from its shadow; look at balls.png"
            )
    return warnings


def near_lamps(
    balls: Sequence[FoundBall], result: Calibration, camera: Camera, radius: float | None, distance: float | None
) -> list[str]:
    """Return a warning if the light's fall-off over the table contradicts the result.

    That is so if lights are output as distant but fall off like near ones, or if radius and distance, in one unit,
    say another ratio by a factor of _RATIO or more.
    """
    if not balls or not usable_balls(balls):
        return []
    ball = usable_balls(balls)[0]
    inverse, error = ball.inverse
    if inverse * camera.width / ball.radius < 1 / _FAR or inverse < _SIGNIFICANT * error:
        return []
    seen = f"the light falls off over the table like that of lamps about {1 / inverse:.0f} ball radii away"
    if not result.near:
        return [
            f"{seen}; directions are those at the ball. For positions measure the distance and give --radius and"
            " --lamp-distance"
        ]
    if radius is None or distance is None:
        return []
    ratio = inverse * distance / radius
    if 1 / _RATIO < ratio < _RATIO:
        return []
    reason = "the two have different units, or the lamp's beam is narrow"
    if ratio < 1:
        reason = "the radius is half of the ball's diameter"
    return [
        f"{seen}, not {distance / radius:.0f}: {reason}; measure again and give --radius and --lamp-distance in"
        " one unit"
    ]
