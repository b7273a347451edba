"""Hollow bodies, photographed by Cycles with all the light that they throw on themselves, and with none."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from irpso_addon.blender.scenes.scene import camera_from_object
from irpso_addon.capture.types import Capture
from irpso_addon.capture.write import write_capture

from . import materials, render, subjects
from .lights import dome_lights
from .textured import BLEND, CAPTURE, NAME, save_blend, shots

LIGHTS = dome_lights(40, 60.0)
_BOUNCES = 8
_FILL = 2.2  # of the picture's 2.4 world units
_MARGIN = 0.01  # of the UV square


@dataclass(frozen=True)
class Hollow:
    """A body of revolution, turned toward the camera, of one colour. radius, height: of its profile. tilt: degrees."""

    radius: tuple[float, ...]
    height: tuple[float, ...]
    tilt: float
    color: tuple[float, float, float]
    roughness: float = 0.5
    metallic: float = 0.0

    def build(self) -> None:
        """Put the body, unwrapped, into the open scene."""
        body = subjects.lathe(self.radius, self.height)
        _unwrap(body.data)
        body = subjects.finished(body, turn=(np.radians(self.tilt), 0, 0))
        body.name = NAME
        subjects.fit(body, _FILL, _FILL)

    @property
    def finish(self) -> materials.Finish:
        """What it is made of."""
        return materials.Finish((self.color, self.color), (self.roughness, self.roughness), self.metallic)


_BOWL = (
    (0.0, 0.3, 0.45, 0.75, 0.95, 1.02, 0.99, 0.96, 0.88, 0.68, 0.4, 0.15, 0.0),
    (-0.5, -0.5, -0.45, -0.2, 0.2, 0.5, 0.53, 0.5, 0.2, -0.15, -0.36, -0.4, -0.4),
    55.0,
)
_VASE = (
    (0.0, 0.4, 0.5, 0.65, 0.6, 0.42, 0.4, 0.5, 0.47, 0.44, 0.34, 0.36, 0.54, 0.58, 0.4, 0.0),
    (-1.0, -1.0, -0.9, -0.5, 0.0, 0.4, 0.6, 0.8, 0.83, 0.8, 0.6, 0.4, 0.0, -0.5, -0.85, -0.9),
    62.0,
)
_WHITE, _BLACK = (0.9,) * 3, (0.1,) * 3
HOLLOWS = {
    "bowl, 0.6": Hollow(*_BOWL, (0.6, 0.6, 0.6)),
    "bowl, white": Hollow(*_BOWL, _WHITE),
    "bowl, black": Hollow(*_BOWL, _BLACK),
    "bowl, glazed": Hollow(*_BOWL, (0.6, 0.6, 0.6), 0.15),
    "bowl, metal paint": Hollow(*_BOWL, (0.7, 0.6, 0.4), 0.4, 1.0),
    "vase": Hollow(*_VASE, (0.7, 0.5, 0.3)),
}


def photograph(name: str, side: int, samples: int, cache: Path) -> tuple[Path, Path]:
    """Return the folders of a body's captures with all bounces and with none, rendered where ``cache`` lacks them."""
    folders = []
    for bounces in (_BOUNCES, 0):
        folder = cache / f"{name.replace(', ', '-').replace(' ', '-')}-{side}-{samples}-{bounces}"
        folders.append(folder)
        if (folder / CAPTURE).exists():
            continue
        render.empty_scene(render.View(side, side, samples=samples, bounces=bounces, clamp=0.0, filter_glossy=0.0))
        HOLLOWS[name].build()
        save_blend(folder)
        bpy.data.objects[NAME].data.materials.append(materials.build(HOLLOWS[name].finish))
        mask = render.truth(folder / "seen")["coverage"] > 0.999
        camera = camera_from_object(bpy.context.scene.camera, side, side)
        taken = shots(render.photographs(folder / "seen", LIGHTS), LIGHTS)
        write_capture(Capture(name, taken, (camera,), (mask,)), folder / CAPTURE)
    return folders[0], folders[1]


def arguments(folder: Path, texels: int) -> tuple[object, ...]:
    """Return the arguments of ``recover`` besides the capture."""
    return "--blend", folder / BLEND, "--object", NAME, "--resolution", texels


def _unwrap(mesh: bpy.types.Mesh) -> None:
    """Give a lathed body texture coordinates: the angle, and the length along its profile."""
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    rings = points.reshape(-1, subjects.SEGMENTS, 3)
    profile = np.stack([np.hypot(rings[:, 0, 0], rings[:, 0, 2]), rings[:, 0, 1]], axis=-1)
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=-1))])
    corner = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corner)
    ring, segment = (part.reshape(-1, 4) for part in np.divmod(corner, subjects.SEGMENTS))
    around = segment / subjects.SEGMENTS
    around[(np.ptp(segment, axis=1) > 1)[:, None] & (segment == 0)] = 1.0  # the last faces end where the first begin
    uv = _MARGIN + (1 - 2 * _MARGIN) * np.stack([around, along[ring] / along[-1]], axis=-1)
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", uv.astype(np.float32).ravel())
