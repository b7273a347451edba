"""The report of a calibration by balls."""

from __future__ import annotations

from typing import Any

import numpy as np

from .ball_calibration import Calibrated
from .balls.ball import Ball
from .balls.detect.found import FoundBall
from .balls.mirror import Sight


def report_of(calibrated: Calibrated) -> dict[str, Any]:
    """Return the table of report.json, without the list of files."""
    result = calibrated.result
    balls = [
        {
            "name": view.ball.name,
            "centre": [float(v) for v in view.ball.centre],
            "radius": view.ball.radius,
            "radius_px": round(view.ball.radius_px, 3),
            "outline_error_px": [round(v, 4) for v in view.ball.error_px],
            "circle": _circle(view.ball),
        }
        for view in result.views
    ]
    lights = []
    for name, light in zip(calibrated.names, result.lights, strict=True):
        row: dict[str, Any] = {"name": name, "warnings": list(light.warnings)}
        if light.light is not None:
            row["direction" if light.light.distant else "position"] = list(light.light.vector)
            row["intensity"] = list(light.light.intensity)
            row["error_degrees"] = round(light.error, 4)
        if light.distance_error is not None:
            row["distance_error"] = round(light.distance_error, 4)
        row["balls"] = [None if s is None else [float(v) for v in s.direction] for s in light.sights]
        height = result.views[0].ball.camera.height
        row["highlights"] = [_highlight(sight, height) for sight in light.sights]
        lights.append(row)
    return {
        "kind": result.kind,
        "asked": {
            "lights": calibrated.request.lights,
            "radius": calibrated.radius,
            "distance": calibrated.request.distance,
            "albedo": calibrated.request.albedo,
        },
        "near": result.near,
        "how": result.how,
        "camera": "perspective" if result.views[0].ball.camera.perspective else "orthographic",
        **({"card_distance": round(calibrated.card_distance, 6)} if result.near else {}),
        "bounce": [round(float(v), 4) for v in result.bounce],
        "balls": balls,
        **(
            {"found": [_found_row(ball, calibrated) for ball in calibrated.found_balls]}
            if calibrated.found_balls
            else {}
        ),
        "lights": lights,
        "warnings": list(calibrated.warnings),
    }


def _circle(ball: Ball) -> list[float]:
    """Return x, y and radius of a ball's outline as a circle; pixels count from the upper left corner."""
    points = ball.outline[:-1]
    x, y = (points.max(axis=0) + points.min(axis=0)) / 2
    return [round(float(v), 2) for v in (x, ball.camera.height - y, np.ptp(points, axis=0).mean() / 2)]


def _highlight(sight: Sight | None, height: int) -> list[float] | None:
    """Return the pixel of a mirror ball's highlight; pixels count from the upper left corner."""
    if sight is None or not np.isfinite(sight.pixel).all():
        return None
    return [round(float(sight.pixel[0]), 2), round(float(height - sight.pixel[1]), 2)]


def _found_row(ball: FoundBall, calibrated: Calibrated) -> dict[str, Any]:
    """Return the report's row of a found ball; pixels count from the upper left corner."""
    x, y = ball.centre
    height = calibrated.result.views[0].ball.camera.height
    return {
        "kind": ball.kind,
        "circle": [round(float(v), 2) for v in (x, height - y, ball.radius)],
        "outline_seen": round(ball.support, 3),
        "shadow_correlation": None if ball.shadow is None else round(ball.shadow, 3),
        "radius_over_lamp_distance": [round(v, 5) if np.isfinite(v) else None for v in ball.inverse],
    }
