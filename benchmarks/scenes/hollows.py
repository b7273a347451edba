"""Hollow bodies, rendered by Cycles with interreflection and without."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import bpy

from irpso_addon.blender.scenes.scene import camera_from_object
from irpso_addon.capture.types import Capture
from irpso_addon.capture.write import write_capture

from . import hollow_shapes, materials, render, subjects
from .lights import dome_lights
from .textured import BLEND, CAPTURE, NAME, save_blend, shots

LIGHTS = dome_lights(40, 60.0)
BOUNCES = 8
_FILL = 2.2  # of the picture's 2.4 world units


@dataclass(frozen=True)
class Hollow:
    """A body of one material. shape: function that puts it, unwrapped, into the open scene."""

    shape: Callable[[], bpy.types.Object]
    color: tuple[float, float, float]
    roughness: float = 0.5
    metallic: float = 0.0

    def build(self) -> None:
        """Put the body into the open scene, as large as the picture."""
        body = self.shape()
        body.name = NAME
        subjects.fit(body, _FILL, _FILL)

    @property
    def finish(self) -> materials.Finish:
        """Its material."""
        return materials.Finish((self.color, self.color), (self.roughness, self.roughness), self.metallic)


_WHITE, _GREY, _BLACK = ((albedo,) * 3 for albedo in (0.9, 0.5, 0.1))
_GLAZED, _SATIN = 0.15, 0.3  # roughness
HOLLOWS = {
    "bowl, 0.6": Hollow(hollow_shapes.bowl, (0.6, 0.6, 0.6)),
    "bowl, white": Hollow(hollow_shapes.bowl, _WHITE),
    "bowl, black": Hollow(hollow_shapes.bowl, _BLACK),
    "bowl, glazed": Hollow(hollow_shapes.bowl, (0.6, 0.6, 0.6), _GLAZED),
    "bowl, metal paint": Hollow(hollow_shapes.bowl, (0.7, 0.6, 0.4), 0.4, 1.0),
    "vase": Hollow(hollow_shapes.vase, (0.7, 0.5, 0.3)),
    "cloth": Hollow(hollow_shapes.cloth, _GREY, 0.8),
    "cloth, black satin": Hollow(hollow_shapes.cloth, _BLACK, _SATIN),
    "coin, metal paint": Hollow(hollow_shapes.coin, (0.7, 0.6, 0.4), 0.4, 1.0),
    "cubes, white": Hollow(hollow_shapes.cubes, _WHITE),
    "cubes, glazed": Hollow(hollow_shapes.cubes, _GREY, _GLAZED),
}


def head_parts(scan: Path) -> dict[str, Hollow]:
    """Return name → body: parts of the head. scan: its .obj file."""
    ear = partial(hollow_shapes.part_of_scan, scan, (0.08, -0.03, -0.075), 0.042, -80.0)
    mouth = partial(hollow_shapes.part_of_scan, scan, (0.0, -0.062, 0.03), 0.042, 0.0)
    return {"ear": Hollow(ear, _GREY), "mouth, glazed": Hollow(mouth, (0.9, 0.6, 0.5), _GLAZED)}


def photograph(name: str, body: Hollow, bounces: int, side: int, samples: int, cache: Path) -> Path:
    """Return the folder of a body's capture with ``bounces`` bounces of light, rendered if ``cache`` lacks it."""
    folder = cache / f"{name.replace(', ', '-').replace(' ', '-')}-{side}-{samples}-{bounces}"
    if not (folder / CAPTURE).exists():
        render.empty_scene(render.View(side, side, samples=samples, bounces=bounces, clamp=0.0, filter_glossy=0.0))
        body.build()
        save_blend(folder)
        bpy.data.objects[NAME].data.materials.append(materials.build(body.finish))
        mask = render.truth(folder / "seen")["coverage"] > 0.999
        camera = camera_from_object(bpy.context.scene.camera, side, side)
        taken = shots(render.photographs(folder / "seen", LIGHTS), LIGHTS)
        write_capture(Capture(name, taken, (camera,), (mask,)), folder / CAPTURE)
    return folder


def arguments(folder: Path, texels: int) -> tuple[object, ...]:
    """Return the arguments of ``recover`` besides the capture."""
    return "--blend", folder / BLEND, "--object", NAME, "--resolution", texels
