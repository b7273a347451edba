"""Photographs by Cycles: one Sun at a time, an orthographic camera along −z, pictures kept between runs."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

from irpso_addon.blender.scenes.light_units import point_power, sun_strength
from irpso_addon.capture.images.exr import read_exr

from .materials import TRUTHS

_DISTANCE = 10.0  # of the camera and the lamp from the origin


@dataclass(frozen=True)
class View:
    """width, height: pixels. world_width: of the picture. samples: for each pixel and light. bounces: of light paths.

    clamp: the largest radiance that a path's indirect part may add, 0 for any: without it single pixels burn out.
    filter_glossy: Cycles' Filter Glossy, which lowers noise, and the light that lobes reflect after a bounce. denoise:
    by OpenImageDenoise, guided by albedo and normal, for what is lit by other surfaces more than by the lamp.
    """

    width: int
    height: int
    world_width: float = 2.4
    samples: int = 16
    bounces: int = 4
    clamp: float = 4.0
    filter_glossy: float = 0.5
    denoise: bool = False


def empty_scene(view: View):
    """Empty Blender and return its scene, set up, with an orthographic camera: no world, no light yet."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    set_up(scene, view)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", view.world_width
    camera.location = (0, 0, _DISTANCE)
    scene.collection.objects.link(camera)
    scene.camera = camera
    return scene


def set_up(scene, view: View) -> None:
    """Give a scene the settings to be photographed with; its camera stays as it is."""
    scene.render.engine = "CYCLES"
    scene.render.film_transparent = True
    scene.render.resolution_x, scene.render.resolution_y = view.width, view.height
    scene.render.resolution_percentage = 100
    cycles = scene.cycles
    cycles.device, cycles.samples, cycles.use_denoising = "CPU", view.samples, view.denoise
    cycles.denoiser, cycles.denoising_input_passes = "OPENIMAGEDENOISE", "RGB_ALBEDO_NORMAL"
    cycles.use_adaptive_sampling = False
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = view.bounces
    cycles.sample_clamp_indirect = view.clamp
    cycles.blur_glossy = view.filter_glossy


def photographs(
    folder: Path, directions: np.ndarray, report: Callable[[int], None] | None = None, shadows: bool = True
) -> Iterator[np.ndarray]:
    """Yield (H, W, 3) float32 radiance, row 0 at the bottom, under each Sun of intensity 1; directions: (K, 3).

    shadows: whether light is blocked by what stands in its way. Pictures that ``folder`` holds are not rendered again.
    """
    return _photographs(folder, directions, "SUN", report, shadows)


def photographs_near(folder: Path, places: np.ndarray, shadows: bool = True) -> Iterator[np.ndarray]:
    """Yield as ``photographs`` does under each point light; places: (K, 3).

    Their intensity is the square of their distance from the origin, where they shine as bright as a Sun of 1.
    """
    return _photographs(folder, places, "POINT", None, shadows)


def _photographs(
    folder: Path, vectors: np.ndarray, kind: str, report: Callable[[int], None] | None, shadows: bool
) -> Iterator[np.ndarray]:
    for number, lamp in enumerate(lamps(vectors, kind)):
        lamp.data.use_shadow = shadows
        path = folder / f"light_{number:03d}.exr"
        if not path.exists():
            _render(path, "OPEN_EXR", persistent=True)
        (channels,) = read_exr(path).values()
        yield np.stack([channels[c] for c in "RGB"], axis=-1).astype(np.float32)
        if report:
            report(number)


def truth(folder: Path) -> dict[str, np.ndarray]:
    """Return the maps as the camera sees them, row 0 at the bottom: coverage (H, W), normal, and the TRUTHS (H, W, 3).

    Normals are in the camera's axes, of length 1 where coverage is above 0.
    """
    path = folder / "truth.exr"
    if not path.exists():
        layer = bpy.context.view_layer
        layer.use_pass_normal = True
        for name in TRUTHS:
            aov = layer.aovs.add()
            aov.name, aov.type = name, "COLOR" if name == "base_color" else "VALUE"
        _render(path, "OPEN_EXR_MULTILAYER")
        while layer.aovs:
            layer.aovs.remove(layer.aovs[0])
        layer.use_pass_normal = False
    # Blender 5 writes a part for each pass, earlier ones a single part; channels carry the layer's name in both.
    found = {
        name.partition(".")[2]: value.astype(np.float32)
        for channels in read_exr(path).values()
        for name, value in channels.items()
    }
    normal = np.stack([found[f"Normal.{c}"] for c in "XYZ"], axis=-1)
    coverage = found["Combined.A"]
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-8)
    maps = {"coverage": coverage, "normal": normal}
    maps["base_color"] = np.stack([found[f"base_color.{c}"] for c in "RGB"], axis=-1)
    for name in ("roughness", "metallic"):
        maps[name] = next(value for key, value in found.items() if key.startswith(f"{name}."))
    return maps


def lamps(vectors: np.ndarray, kind: str = "SUN") -> Iterator[Any]:
    """Yield the scene's one lamp, a SUN or a POINT, at each of the vectors (K, 3), as bright as ``photographs`` say."""
    lamp = _only_lamp(kind)
    for vector in vectors:
        _place(lamp, vector)
        yield lamp


def _only_lamp(kind: str):
    """Return the scene's one lamp, of that kind and without extent."""
    for lamp in [thing for thing in bpy.context.scene.objects if thing.type == "LIGHT"]:
        bpy.data.objects.remove(lamp)
    data = bpy.data.lights.new("Lamp", kind)
    if kind == "SUN":
        data.angle = 0
    else:
        data.shadow_soft_size = 0
    lamp = bpy.data.objects.new("Lamp", data)
    bpy.context.scene.collection.objects.link(lamp)
    return lamp


def _place(lamp, vector: np.ndarray) -> None:
    """Turn a Sun to a direction, or put a point light at a place, as bright as ``photographs`` say."""
    toward = Vector([float(v) for v in vector])
    if lamp.data.type == "POINT":
        lamp.matrix_world = Matrix.Translation(toward)
        lamp.data.energy = point_power(toward.length_squared)
        return
    lamp.data.energy = sun_strength(1.0)
    lamp.matrix_world = Matrix.Translation(_DISTANCE * toward) @ toward.to_track_quat("Z", "Y").to_matrix().to_4x4()


def _render(path: Path, kind: str, persistent: bool = False) -> None:
    """Render to a file, whole or not at all. persistent: keep the scene for the next render that asks so too.

    Only for pictures under lamps: kept data lack AOVs that are new, and where the first picture of a scene had no lamp
    all that follow it have a white sky of radiance 1 (Blender 5.0.1).
    """
    bpy.context.scene.render.use_persistent_data = persistent
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.stem}.exr")
    settings = bpy.context.scene.render.image_settings
    if hasattr(settings, "media_type"):  # Blender 5 asks for the medium before the format
        settings.media_type = "MULTI_LAYER_IMAGE" if kind.endswith("MULTILAYER") else "IMAGE"
    settings.file_format, settings.color_depth, settings.exr_codec = kind, "16", "ZIP"
    if kind.endswith("MULTILAYER"):
        settings.color_depth = "32"
    bpy.context.scene.render.filepath = str(partial)
    bpy.ops.render.render(write_still=True)
    os.replace(partial, path)
