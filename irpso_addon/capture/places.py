"""The distance of a card, and checks of the units of near lights: positions and intensities."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from .camera import Camera
from .errors import CaptureError
from .types import Capture

# A lamp this many subject sizes away lights it like a distant one: its direction changes by 0.6° over the subject.
_FAR = 100.0
# How much brighter or darker than a white card that faces the lights the photographs may be, lens and albedo included.
_BRIGHTEST, _DARKEST = 10.0, 1e-3
_WIDE, _NARROW = 120.0, 1.0  # degrees over the image's width: a wider or narrower lens is a number in another unit

Problem = tuple[str, str]  # a short name, and a sentence with the remedy


def card_depth(capture: Capture) -> float:
    """Return the distance of a card from its camera, along the camera's axis.

    Under distant lights no image depends on it, and an unknown distance is 1. Raises CaptureError if lights are near
    and the capture has no ``card_distance``.
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
    """Return width and height of the visible part of a card at a distance."""
    reach = distance if camera.perspective else 1.0
    return reach * camera.width / camera.scale[0], reach * camera.height / camera.scale[1]


def lens_problems(camera: Camera) -> Iterator[Problem]:
    """Yield a problem if no lens has a camera's angle, as with millimetres in place of pixels."""
    angle = 2 * np.degrees(np.arctan(0.5 * camera.width / camera.scale[0]))
    if camera.perspective and not _NARROW < angle < _WIDE:
        yield (
            "lens",
            f"shows {angle:.3g}° over its width, which few lenses do; focal_length_px is in pixels (millimetres /"
            " sensor width × image width), fov_degrees in degrees",
        )


def card_problems(capture: Capture) -> Iterator[Problem]:
    """Yield the problems of near lights of a card at a known distance."""
    camera, distance = capture.cameras[0], card_depth(capture)
    world = np.array([o.light.vector for o in capture.observations if not o.light.distant], np.float64)
    places = (world - camera.position) @ camera.matrix[:3, :3]
    behind = int((places[:, 2] <= -distance).sum())
    if behind:
        yield (
            "light_behind",
            f"{behind} of {len(places)} near lights lie behind the card, which is {distance:g} from the camera; check"
            " the unit of card_distance and of the positions, and that z is toward the viewer",
        )
    size = max(card_size(camera, distance))
    far = float(np.median(np.linalg.norm(places - card_middle(camera, distance), axis=1))) / size
    if far > _FAR:
        yield (
            "light_far",
            f"near lights lie {far:.0f} card widths away, as far as distant ones; check that card_distance and"
            " positions are in one unit",
        )


def camera_problems(capture: Capture) -> Iterator[Problem]:
    """Yield a problem if near lights are not at the scale of several cameras around the subject."""
    cameras = capture.cameras
    positions, axes = (np.array([getattr(camera, name) for camera in cameras]) for name in ("position", "backward"))
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    # The point nearest to all axes is the subject's position; parallel cameras have none.
    if np.linalg.cond(across.sum(axis=0)) > 1e6:
        return
    middle = np.linalg.solve(across.sum(axis=0), (across @ positions[:, :, None]).sum(axis=0))[:, 0]
    lights = np.array([o.light.vector for o in capture.observations if not o.light.distant])
    reach = np.median(np.linalg.norm(positions - middle, axis=1))
    spread = np.median(np.linalg.norm(lights - lights.mean(axis=0), axis=1))
    if len(lights) > 1 and not reach / _FAR < spread < reach * _FAR:
        yield (
            "light_unit",
            f"near lights are spread over {spread:.3g}, and cameras are {reach:.3g} from the subject; check that"
            " positions of lights and cameras are in one unit, with cameras_matrix for cameras of another program",
        )


def strength_problems(capture: Capture, brightness: np.ndarray) -> Iterator[Problem]:
    """Yield a problem if the intensities of near lights contradict the brightness of the photographs.

    brightness: (K,) radiance of a bright pixel of each observation, NaN for none.
    """
    near = np.array([not observation.light.distant for observation in capture.observations])
    irradiance = at_card(capture)[1]
    ratio = float(np.nanmedian((brightness / irradiance)[near])) if np.isfinite(brightness[near]).any() else 1.0
    if not _DARKEST < ratio < _BRIGHTEST:
        yield (
            "light_strength",
            f"photographs are {ratio:.3g} times as bright as a white card under these near lights; give light_intensity"
            " at distance 1 in the unit of the positions: the one at the card times the distance squared",
        )


def at_card(capture: Capture) -> tuple[np.ndarray, np.ndarray]:
    """Return the lights at a card's middle: (K, 3) unit directions to them in the camera's axes, and irradiance/π.

    The irradiance, (K,), is the mean of the channels on a plane that faces the light.
    """
    camera = capture.cameras[0]
    near = np.array([not observation.light.distant for observation in capture.observations])
    toward = np.array([observation.light.vector for observation in capture.observations], np.float64)
    toward = (toward - near[:, None] * camera.position) @ camera.matrix[:3, :3]
    if near.any():
        toward[near] -= card_middle(camera, card_depth(capture))
    far = np.linalg.norm(toward, axis=1)
    power = np.array([np.mean(observation.light.intensity) for observation in capture.observations])
    return toward / far[:, None], power / np.where(near, far, 1.0) ** 2


def card_middle(camera: Camera, distance: float) -> np.ndarray:
    """Return (3,) the middle of a card's picture in the camera's axes; without the lens's distortion."""
    plain = replace(camera, matrix=np.eye(4), distortion=())
    corners = plain.points(distance)[[0, -1], [0, -1]]
    return corners.mean(axis=0)
