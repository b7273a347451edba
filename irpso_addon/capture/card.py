"""The card in its camera's view: distance, size, middle, and the lights that reach it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .camera import Camera
from .errors import CaptureError
from .types import Capture


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
