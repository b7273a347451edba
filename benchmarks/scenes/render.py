"""Photographs by Cycles under one light at a time, with an orthographic camera along −z, cached in files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from irpso_addon.blender.scenes.cycles import (
    View,
    only_lamp,
    place_lamp,
    read_radiance,
    read_seen_maps,
    render_maps,
    render_radiance,
    set_up,
)  # fmt: skip

_DISTANCE = 10.0  # of the camera from the origin


def empty_scene(view: View):
    """Empty Blender and return its scene, set up, with an orthographic camera; without world and lights."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    set_up(scene, view)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", view.world_width
    camera.location = (0, 0, _DISTANCE)
    scene.collection.objects.link(camera)
    scene.camera = camera
    return scene


def photographs(
    folder: Path, directions: np.ndarray, report: Callable[[int], None] | None = None, shadows: bool = True
) -> Iterator[np.ndarray]:
    """Yield (H, W, 3) float32 radiance, row 0 at the bottom, under each Sun of intensity 1; directions: (K, 3).

    shadows: whether they are cast. report: called with each number. Pictures in ``folder`` are not rendered again.
    """
    return _photographs(folder, directions, "SUN", report, shadows)


def photographs_near(folder: Path, places: np.ndarray, shadows: bool = True) -> Iterator[np.ndarray]:
    """Yield as ``photographs`` does under each point light; places: (K, 3).

    Their intensity is the square of their distance from the origin: the irradiance there is that of a Sun of 1.
    """
    return _photographs(folder, places, "POINT", None, shadows)


def _photographs(
    folder: Path, vectors: np.ndarray, kind: str, report: Callable[[int], None] | None, shadows: bool
) -> Iterator[np.ndarray]:
    for number, lamp in enumerate(lamps(vectors, kind)):
        lamp.data.use_shadow = shadows
        path = folder / f"light_{number:03d}.exr"
        if not path.exists():
            bpy.context.scene.cycles.seed = number  # else a pixel has the same noise under all lights
            render_radiance(bpy.context.scene, path)
        yield read_radiance(path)
        if report:
            report(number)


def truth(folder: Path) -> dict[str, np.ndarray]:
    """Return the true maps as the camera sees them (``read_seen_maps``)."""
    path = folder / "truth.exr"
    if not path.exists():
        render_maps(bpy.context.scene, path)
    return read_seen_maps(path)


def lamps(vectors: np.ndarray, kind: str = "SUN") -> Iterator[Any]:
    """Yield the scene's only lamp, a SUN or a POINT, at each of the vectors (K, 3), as bright as in ``photographs``."""
    lamp = only_lamp(bpy.context.scene, kind)
    for vector in vectors:
        place_lamp(lamp, vector)
        yield lamp
