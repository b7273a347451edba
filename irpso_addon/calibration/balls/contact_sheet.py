"""Contact sheet of a calibration: each ball with its highlight or terminator, and all lights on a dome."""

from __future__ import annotations

import numpy as np

from ..ball_calibration import Calibrated
from .ball import Ball, tangents, to_pixels
from .crops import BallView
from .lights import FoundLight
from .picture import BallTile, ball_sheet


def calibration_picture(calibrated: Calibrated) -> np.ndarray:
    """Return the sheet (H, W, 3), display values: each ball in each photograph, and all lights on a dome."""
    tiles = []
    result = calibrated.result
    lights = result.lights
    for number, (name, light) in enumerate(zip(calibrated.names, lights, strict=True)):
        tiles += [_tile(f"{number + 1} {name}", view, number, light, b) for b, view in enumerate(result.views)]
    located = [(light, next(s for s in light.sights if s is not None)) for light in lights if light.light is not None]
    balls = len(result.views)
    title = f"{len(located)} lights from {balls} {result.kind} {'ball' if balls == 1 else 'balls'}\n{result.how}"
    doubtful = [bool(light.warnings) for light, _ in located]
    return ball_sheet(tiles, np.array([sight.direction for _, sight in located]), doubtful, title)


def _tile(label: str, view: BallView, number: int, light: FoundLight, index: int) -> BallTile:
    sight = light.sights[index]
    mark = curve = None
    if sight is not None and np.isfinite(sight.pixel).all():
        mark = _in_tile(view, sight.pixel[None])[0]
    elif sight is not None:
        curve = _in_tile(view, _terminator(view.ball, sight.direction))
        mark = _in_tile(view, to_pixels(view.ball.camera, sight.point[None]))[0]
    outline = _in_tile(view, view.ball.outline)
    return BallTile(label, view.values[number], outline, mark, curve, bool(light.warnings))


def _in_tile(view: BallView, pixels: np.ndarray) -> np.ndarray:
    return (pixels - view.pixels[0, 0]) / view.block + 0.5


def _terminator(ball: Ball, direction: np.ndarray) -> np.ndarray:
    """Return pixel coordinates (N, 2) of the terminator, visible part first; hidden points lie at −10⁶."""
    across, upward = tangents(direction)
    phi = np.linspace(0, 2 * np.pi, 120)[:, None]
    normals = np.cos(phi) * across + np.sin(phi) * upward
    points = ball.centre + ball.radius * normals
    view = -points if ball.camera.perspective else np.broadcast_to((0.0, 0.0, 1.0), points.shape)
    hidden = (normals * view).sum(axis=-1) <= 0
    pixels = to_pixels(ball.camera, points)
    pixels[hidden] = -1e6
    start = int(np.argmax(hidden))
    return np.roll(pixels, -start, axis=0)
