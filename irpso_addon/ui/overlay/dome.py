"""Draws the capture's cameras and lights: distant lights on a dome around the subject, near ones at their position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...capture.camera import Camera
from ...gpu.viewport import Drawing
from .place import Placement, circle, to_pixels, transformed

FITTED = 1.7  # the dome's radius over the subject's
_RAY = 0.10  # length of a light's ray over its distance to the subject
_FAINTEST = 0.35  # display value of the weakest light's brightest channel
_GUIDE = (0.50, 0.52, 0.58, 0.50)  # a grey that is visible on dark and on light themes
_CAMERA = (0.80, 0.82, 0.88, 0.75)
_CURRENT = (1.0, 0.86, 0.45, 1.0)
_FRUSTUM = 0.16  # depth of a drawn camera over its distance to the subject
_SIZE, _SMALL = 6.5, 2.5  # a light's disc, in pixels at scale 1
_RIM = (0.05, 0.05, 0.06, 0.9)
_GAMMA = 1 / 2.2


@dataclass(frozen=True)
class Dome:
    """Lights to draw, in world space.

    places: (K, 3). distant: (K,) bool. colors: (K, 3) display values. axis: (3,) mean direction of the distant lights.
    half: whether all these lie on its side. radius: of the dome, 0 without distant lights. centre: (3,).
    """

    places: np.ndarray
    distant: np.ndarray
    colors: np.ndarray
    axis: np.ndarray
    half: bool
    radius: float
    centre: np.ndarray


def dome_of(lights: np.ndarray, intensities: np.ndarray, placement: Placement, radius: float = 0.0) -> Dome:
    """Return the dome of a Domain's lights (K, 4). radius: in world units, 0 fits the subject."""
    radius = radius or FITTED * placement.radius
    distant = lights[:, 3] == 0
    directions = placement.directions(np.asarray(lights[:, :3], np.float64))
    places = np.where(
        distant[:, None], placement.centre + radius * directions, transformed(placement.frame, lights[:, :3])
    )  # fmt: skip
    toward = directions[distant]
    mean = toward.mean(axis=0) if len(toward) else np.zeros(3)
    axis = mean / np.linalg.norm(mean) if np.linalg.norm(mean) > 1e-3 else np.array([0.0, 0.0, 1.0])
    half = bool(len(toward)) and bool((toward @ axis > -0.05).all())
    colors = light_colors(intensities)
    return Dome(places, distant, colors, axis, half, radius if len(toward) else 0.0, placement.centre)


def light_colors(intensities: np.ndarray) -> np.ndarray:
    """Return (K, 3) display values of intensities (K, 3): each light's hue, with its relative strength."""
    intensities = np.maximum(np.asarray(intensities, np.float64), 0)
    peak = intensities.max(axis=1)
    level = _FAINTEST + (1 - _FAINTEST) * (peak / max(peak.max(), 1e-30)) ** _GAMMA
    return level[:, None] * (intensities / np.maximum(peak, 1e-30)[:, None]) ** _GAMMA


def guide_lines(dome: Dome) -> list[np.ndarray]:
    """Return lines (N, 3) that show the dome's shape: its rim and two arcs."""
    if not dome.radius:
        return []
    rim = circle(dome.centre, dome.axis, dome.radius)
    first = rim[0] - dome.centre
    second = np.cross(dome.axis, first)
    angles = (np.linspace(-0.5, 0.5, 41) if dome.half else np.linspace(-1, 1, 81)) * np.pi
    arcs = [
        dome.centre + np.outer(np.sin(angles), side) + np.outer(np.cos(angles), dome.radius * dome.axis)
        for side in (first, second)
    ]
    return [rim, *arcs]


def frustum(camera: Camera, frame: np.ndarray, depth: float) -> np.ndarray:
    """Return lines (N, 2, 3) in world space of a camera's field of view, with a small triangle on its upper side.

    frame: (4, 4) from the capture's world to Blender's. depth: of the drawn frustum, in the capture's units.
    """
    x = (np.array([0, camera.width, camera.width, 0]) - camera.centre[0]) / camera.scale[0]
    y = (np.array([0, 0, camera.height, camera.height]) - camera.centre[1]) / camera.scale[1]
    reach = depth if camera.perspective else 1.0
    corners = np.stack([x * reach, y * reach, np.full(4, -depth if camera.perspective else 0.0)], axis=-1)
    width, height = corners[1, 0] - corners[0, 0], corners[2, 1] - corners[1, 1]
    middle = (corners[2] + corners[3]) / 2 + [0, 0.06 * height, 0]
    roof = np.array([middle - [0.2 * width, 0, 0], middle + [0.2 * width, 0, 0], middle + [0, 0.22 * height, 0]])
    lines = [(corners[i], corners[(i + 1) % 4]) for i in range(4)] + [(roof[i], roof[(i + 1) % 3]) for i in range(3)]
    if camera.perspective:
        lines += [(np.zeros(3), corner) for corner in corners]
    else:
        lines.append((corners.mean(axis=0), corners.mean(axis=0) - [0, 0, depth]))
    return transformed(frame, transformed(camera.matrix, np.array(lines)))


def over_subject(
    places: np.ndarray, corners: np.ndarray, perspective: np.ndarray, size: tuple[float, float]
) -> np.ndarray:
    """Return (K,) bool: whether world points (K, 3) project into the bounding rectangle of corners (N, 3)."""
    pixels, in_front = to_pixels(perspective, corners, size)
    if not in_front.all():
        return np.zeros(len(places), bool)
    at, _ = to_pixels(perspective, places, size)
    return ((at >= pixels.min(axis=0)) & (at <= pixels.max(axis=0))).all(axis=1)


def draw_lights(
    drawing: Drawing, dome: Dome, current: int, over: np.ndarray, perspective: np.ndarray, scale: float
) -> None:
    """Draw the lights with short rays, and the whole ray of the current one. current: negative for none.

    over: (K,) bool, the lights in front of the subject: drawn small, without a ray, to keep the subject visible.
    """
    guides = [np.stack([line[:-1], line[1:]], axis=1).reshape(-1, 3) for line in guide_lines(dome)]
    if guides:
        drawing.draw_lines(np.concatenate(guides), _GUIDE, scale, perspective, depth=True)
    if 0 <= current < len(dome.places):  # drawn first, so that it gives the light's disc a rim
        ray = np.stack([dome.places[current], dome.centre])
        colors = np.array([_CURRENT, (*_CURRENT[:3], 0.25)])
        drawing.draw_lines(ray, colors, 1.8 * scale, perspective, depth=True)
        drawing.draw_points(ray[:1], _CURRENT, 15 * scale, perspective, depth=True)
    colors = np.concatenate([dome.colors, np.ones((len(dome.colors), 1))], axis=1)
    for chosen, size in ((over, _SMALL), (~over, _SIZE)):
        drawing.draw_points(dome.places[chosen], _RIM, (size + 2.5) * scale, perspective, depth=True)
        drawing.draw_points(dome.places[chosen], colors[chosen], size * scale, perspective, depth=True)
    places, colors = dome.places[~over], colors[~over]
    stubs = np.stack([places, places + _RAY * (dome.centre - places)], axis=1).reshape(-1, 3)
    faded = np.stack([colors, colors * [1, 1, 1, 0]], axis=1).reshape(-1, 4)
    drawing.draw_lines(stubs, faded, scale, perspective, depth=True)


def draw_cameras(
    drawing: Drawing, cameras: list[Camera], current: int, placement: Placement, perspective: np.ndarray, scale: float
) -> None:
    """Draw the cameras, whose matrices are in the domain's frame. Of several, the current one is brighter."""
    for index, camera in enumerate(cameras):
        place = transformed(placement.frame, camera.position[None])[0]
        unit = np.linalg.norm(placement.frame[:3, 0])
        depth = _FRUSTUM * max(np.linalg.norm(place - placement.centre), placement.radius) / max(unit, 1e-30)
        lines = frustum(camera, placement.frame, depth).reshape(-1, 3)
        bright = index == current and len(cameras) > 1
        color, width = (_CURRENT, 1.8) if bright else (_CAMERA, 1.2)
        drawing.draw_lines(lines, color, width * scale, perspective, depth=True)
