"""The distance of a card, and checks of the units of near lights: positions and intensities."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from .camera import Camera
from .errors import CaptureError
from .types import Capture

# In subject sizes: from here a lamp is like a distant light; its direction changes by 0.6° over the subject.
_FAR = 100.0
# Accepted range of the photographs' radiance over that of a white card facing the lights; includes lens and albedo.
_BRIGHTEST, _DARKEST = 10.0, 1e-3
_WIDE, _NARROW = 120.0, 1.0  # degrees over the image's width: beyond these, a wrong unit is likely

Problem = tuple[str, str]  # code, and a sentence with the remedy


def card_depth(capture: Capture) -> float:
    """Return the distance of a card from its camera, along the camera's axis.

    No image depends on it under distant lights; it is 1 if unknown. Raises CaptureError if lights are near and the
    capture has no ``card_distance``.
    """
    if capture.card_distance is not None:
        return capture.card_distance
    if near_lights(capture):
        raise CaptureError(
            f"capture '{capture.name}': its lights have positions, so a flat card needs its distance from the camera,"
            " in their unit; set card_distance in capture.toml, or --distance",
            "card_distance",
        )
    return 1.0


def near_lights(capture: Capture) -> bool:
    """Return whether some lights have positions."""
    return any(not observation.light.distant for observation in capture.observations)


def card_size(camera: Camera, distance: float) -> tuple[float, float]:
    """Return width and height of the visible part of a card, in the unit of ``distance``."""
    plane_distance = distance if camera.perspective else 1.0
    return plane_distance * camera.width / camera.scale[0], plane_distance * camera.height / camera.scale[1]


def lens_problems(camera: Camera) -> Iterator[Problem]:
    """Yield a problem if a camera's field of view is implausible, as with millimetres in place of pixels."""
    angle = 2 * np.degrees(np.arctan(0.5 * camera.width / camera.scale[0]))
    if camera.perspective and not _NARROW < angle < _WIDE:
        yield (
            "lens",
            f"shows {angle:.3g}° over its width, which few lenses do; focal_length_px is in pixels (millimetres /"
            " sensor width × image width), fov_degrees in degrees",
        )


def card_problems(capture: Capture) -> Iterator[Problem]:
    """Yield the problems of near lights of a card: behind it, or too far away."""
    camera, distance = capture.cameras[0], card_depth(capture)
    world = np.array([o.light.vector for o in capture.observations if not o.light.distant], np.float64)
    lights = (world - camera.position) @ camera.matrix[:3, :3]
    behind = int((lights[:, 2] <= -distance).sum())
    if behind:
        yield (
            "light_behind",
            f"{behind} of {len(lights)} near lights lie behind the card, which is {distance:g} from the camera; check"
            " the unit of card_distance and of the positions, and that z is toward the viewer",
        )
    size = max(card_size(camera, distance))
    card_widths = float(np.median(np.linalg.norm(lights - card_middle(camera, distance), axis=1))) / size
    if card_widths > _FAR:
        yield (
            "light_far",
            f"near lights lie {card_widths:.0f} card widths away, as far as distant ones; check that card_distance and"
            " positions are in one unit",
        )


def camera_problems(capture: Capture) -> Iterator[Problem]:
    """Yield a problem if near lights and several cameras around the subject differ in scale."""
    cameras = capture.cameras
    positions, axes = (np.array([getattr(camera, name) for camera in cameras]) for name in ("position", "backward"))
    projections = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    # The subject is at the point nearest to all axes; parallel axes have none.
    if np.linalg.cond(projections.sum(axis=0)) > 1e6:
        return
    subject = np.linalg.solve(projections.sum(axis=0), (projections @ positions[:, :, None]).sum(axis=0))[:, 0]
    lights = np.array([o.light.vector for o in capture.observations if not o.light.distant])
    distance = np.median(np.linalg.norm(positions - subject, axis=1))
    spread = np.median(np.linalg.norm(lights - lights.mean(axis=0), axis=1))
    if len(lights) > 1 and not distance / _FAR < spread < distance * _FAR:
        yield (
            "light_unit",
            f"near lights are spread over {spread:.3g}, and cameras are {distance:.3g} from the subject; check that"
            " positions of lights and cameras are in one unit, with cameras_matrix for cameras of another program",
        )


def strength_problems(capture: Capture, brightness: np.ndarray) -> Iterator[Problem]:
    """Yield a problem if the intensities of near lights contradict the brightness of the photographs.

    brightness: (K,) as of ``frames.brightest``: radiance of each observation's bright pixels, NaN for none.
    """
    near = np.array([not observation.light.distant for observation in capture.observations])
    irradiance = lights_at_card(capture)[1]
    ratio = float(np.nanmedian((brightness / irradiance)[near])) if np.isfinite(brightness[near]).any() else 1.0
    if not _DARKEST < ratio < _BRIGHTEST:
        yield (
            "light_strength",
            f"photographs are {ratio:.3g} times as bright as a white card under these near lights; give light_intensity"
            " at distance 1 in the unit of the positions: the one at the card times the distance squared",
        )


def lights_at_card(capture: Capture) -> tuple[np.ndarray, np.ndarray]:
    """Return the lights at a card's middle: (K, 3) unit directions to them in the camera's axes, and irradiance/π.

    The irradiance, (K,), is the mean of the channels on a plane that faces the light.
    """
    camera = capture.cameras[0]
    near = np.array([not observation.light.distant for observation in capture.observations])
    toward = np.array([observation.light.vector for observation in capture.observations], np.float64)
    toward = (toward - near[:, None] * camera.position) @ camera.matrix[:3, :3]
    if near.any():
        toward[near] -= card_middle(camera, card_depth(capture))
    distances = np.linalg.norm(toward, axis=1)
    power = np.array([np.mean(observation.light.intensity) for observation in capture.observations])
    return toward / distances[:, None], power / np.where(near, distances, 1.0) ** 2


def card_middle(camera: Camera, distance: float) -> np.ndarray:
    """Return (3,) the middle of a card's picture in the camera's axes; without the lens's distortion."""
    plain = replace(camera, matrix=np.eye(4), distortion=())
    corners = plain.points(distance)[[0, -1], [0, -1]]
    return corners.mean(axis=0)
