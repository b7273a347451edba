"""Photographs of a subject from all sides: several cameras, each with its own distant or near lights."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from irpso_addon.blender.scenes.scene import camera_from_object
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.capture.write import write_capture

from . import render
from .lights import dome_lights
from .textured import opaque

DISTANCE = 6.0  # of the cameras from the subject's middle
NEAR = 3.0  # distance of the near lights: on a face 1.2 wide their irradiance is uneven
_WIDEST = 60.0  # degrees of a camera's lights off its axis
# Degrees to the right of the front and up from the horizon: first the front, then its sides, then all the way round.
_VIEWS = ((0, 0), (45, 15), (-45, 15), (90, -10), (-90, -10), (135, 20), (-135, 20), (180, 0))
_UNSEEN_VIEWS = ((22, 8), (-66, 4))
_UNSEEN_LIGHTS = 5


@dataclass(frozen=True)
class Shot:
    """A camera, as a unit direction (3,) from the subject, and its lights (K, 3): directions, or positions if near."""

    camera: np.ndarray
    lights: np.ndarray
    near: bool = False

    @property
    def name(self) -> str:
        """The name of its folder."""
        return f"{'near' if self.near else 'view'}-{'_'.join(f'{v:+.3f}' for v in self.camera)}"


def shots(cameras: int, lights: int, near: bool = False) -> list[Shot]:
    """Return the first ``cameras`` views (up to 8), each with ``lights`` lights of its own around its axis."""
    result = []
    for number, (right, up) in enumerate(_VIEWS[:cameras]):
        axis = _direction(right, up)
        dome = dome_lights(lights, _WIDEST) @ _turned(2 * np.pi * number / len(_VIEWS)).T
        result.append(Shot(axis, (NEAR if near else 1.0) * dome @ _frame(axis).T, near))
    return result


def unseen_shots() -> list[Shot]:
    """Return views between those of ``shots``, with their own distant lights."""
    axes = [_direction(*angles) for angles in _UNSEEN_VIEWS]
    return [Shot(axis, dome_lights(_UNSEEN_LIGHTS, 50.0) @ _frame(axis).T) for axis in axes]


def pictures(folder: Path, shot: Shot) -> Iterator[np.ndarray]:
    """Yield (H, W, 3) radiance of the open scene from the shot's camera under each light; cached in the folder."""
    set_camera(shot)
    yield from (render.photographs_near if shot.near else render.photographs)(folder / shot.name, shot.lights)


def set_camera(shot: Shot) -> None:
    """Move the scene's camera to the shot's position, upright and toward the subject."""
    axis = Vector([float(v) for v in shot.camera])
    turn = Matrix([[float(v) for v in row] for row in _frame(shot.camera)]).to_4x4()
    bpy.context.scene.camera.matrix_world = Matrix.Translation(DISTANCE * axis) @ turn
    bpy.context.view_layer.update()


def write(folder: Path, name: str, shots: list[Shot], every: int, view: render.View) -> Path:
    """Write a capture of every ``every``-th light of the shots into folder/name, unless it exists; return its path.

    Pictures are read from the folder, or rendered into it.
    """
    target = folder / name
    if target.exists():
        return target
    cameras, masks, observations = [], [], []
    for number, shot in enumerate(shots):
        radiances = list(pictures(folder, shot))
        masks.append(render.truth(folder / shot.name)["coverage"] > 0.999)
        cameras.append(camera_from_object(bpy.context.scene.camera, view.width, view.height))
        for at in range(number % every, len(shot.lights), every):
            vector = shot.lights[at]
            light = Light(tuple(map(float, vector)), (float(vector @ vector),) * 3, distant=not shot.near)
            read = partial(opaque, radiances[at])
            observations.append(Observation(f"view {number}, light {at}", read, light, number))
    write_capture(Capture(name, tuple(observations), tuple(cameras), tuple(masks)), target, half=True)
    return target


def _direction(right: float, up: float) -> np.ndarray:
    """Return the unit direction (3,) at degrees to the right of +z and up to +y."""
    a, b = np.radians(right), np.radians(up)
    return np.array([np.sin(a) * np.cos(b), np.sin(b), np.cos(a) * np.cos(b)])


def _frame(axis: np.ndarray) -> np.ndarray:
    """Return (3, 3), columns right, up and backward, of a camera in direction ``axis``, upright along +y."""
    right = np.cross((0.0, 1.0, 0.0), axis)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(axis, right), axis], axis=-1)


def _turned(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
