"""Checks of units: fields of view, positions and intensities of near lights, distances of cards."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..camera import Camera
from ..card import card_depth, card_middle, card_size, lights_at_card
from ..types import Capture

# In subject sizes: from here a lamp is like a distant light; its direction changes by 0.6° over the subject.
_FAR = 100.0
# Accepted range of the photographs' radiance over that of a white card facing the lights; includes lens and albedo.
_BRIGHTEST, _DARKEST = 10.0, 1e-3
_WIDE, _NARROW = 120.0, 1.0  # degrees over the image's width: beyond these, a wrong unit is likely

Problem = tuple[str, str]  # code, and a sentence with the remedy


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
