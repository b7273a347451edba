"""Renders by Cycles: a scene's settings, its one lamp, radiance to files, and the maps that the camera sees."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...capture.images.exr import read_exr
from ..operators import cycles_operator
from .light_units import point_power, sun_strength
from .true_surface import TRUTHS

_SUN_DISTANCE = 10.0  # from the origin; a Sun's irradiance is the same at any distance


@dataclass(frozen=True)
class View:
    """Render settings. width, height: pixels. world_width: of an orthographic picture. samples: per pixel and light.

    bounces: of light paths.
    clamp: the largest radiance that a path's indirect part may add, 0 for any: without it single pixels burn out.
    filter_glossy: Cycles' Filter Glossy, which lowers noise, and the light that lobes reflect after a bounce. denoise:
    by OpenImageDenoise, guided by albedo and normal: for surfaces that are lit more indirectly than by the lamp.
    """

    width: int
    height: int
    world_width: float = 2.4
    samples: int = 16
    bounces: int = 4
    clamp: float = 4.0
    filter_glossy: float = 0.5
    denoise: bool = False


def set_up(scene: Any, view: View) -> None:
    """Give a scene the render settings of a view; its camera stays unchanged."""
    scene.render.engine = "CYCLES"
    scene.render.film_transparent = True
    scene.render.resolution_x, scene.render.resolution_y = view.width, view.height
    scene.render.resolution_percentage = 100
    cycles = scene.cycles
    cycles.device, cycles.samples, cycles.use_denoising = "CPU", view.samples, view.denoise
    if view.denoise:  # Debian's Blender 4.3 has no denoiser
        cycles.denoiser, cycles.denoising_input_passes = "OPENIMAGEDENOISE", "RGB_ALBEDO_NORMAL"
    cycles.use_adaptive_sampling = False
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = view.bounces
    cycles.sample_clamp_indirect = view.clamp
    cycles.blur_glossy = view.filter_glossy


def only_lamp(scene: Any, kind: str, radius: float = 0.0) -> Any:
    """Return the scene's one lamp, a SUN or a POINT; others are removed. radius: of a POINT."""
    import bpy

    for lamp in [thing for thing in scene.objects if thing.type == "LIGHT"]:
        bpy.data.objects.remove(lamp)
    data = bpy.data.lights.new("Lamp", kind)
    if kind == "SUN":
        data.angle = 0
    else:
        data.shadow_soft_size = radius
    lamp = bpy.data.objects.new("Lamp", data)
    scene.collection.objects.link(lamp)
    return lamp


def place_lamp(lamp: Any, vector: np.ndarray, bright_at: float | None = None) -> None:
    """Turn a Sun to a direction, or put a point light at a place; its irradiance is π, a Sun's everywhere.

    bright_at: the distance from a point light where it is π; by default that of the origin.
    """
    from mathutils import Matrix, Vector

    toward = Vector([float(v) for v in vector])
    if lamp.data.type == "POINT":
        lamp.matrix_world = Matrix.Translation(toward)
        lamp.data.energy = point_power(toward.length_squared if bright_at is None else bright_at**2)
        return
    lamp.data.energy = sun_strength(1.0)
    lamp.matrix_world = Matrix.Translation(_SUN_DISTANCE * toward) @ toward.to_track_quat("Z", "Y").to_matrix().to_4x4()


def render_radiance(scene: Any, path: Path) -> None:
    """Render the scene to an EXR, whole or not at all. Its data are kept for the next render.

    Only for pictures under a lamp: kept data lack AOVs that are new, and where the first picture of a scene had no lamp
    all that follow it have a white sky of radiance 1 (Blender 5.0.1).
    """
    _render(scene, path, "OPEN_EXR", persistent=True)


def read_radiance(path: Path) -> np.ndarray:
    """Return (H, W, 3) float32, row 0 at the bottom, of what ``render_radiance`` wrote."""
    (channels,) = read_exr(path).values()
    return np.stack([channels[c] for c in "RGB"], axis=-1).astype(np.float32)


def render_maps(scene: Any, path: Path, more: tuple[str, ...] = ()) -> None:
    """Render to an EXR the normals and TRUTHS that the scene's materials write. more: further AOVs, of values."""
    layer = scene.view_layers[0]
    layer.use_pass_normal = True
    for name in (*TRUTHS, *more):
        aov = layer.aovs.add()
        aov.name, aov.type = name, "COLOR" if name == "base_color" else "VALUE"
    _render(scene, path, "OPEN_EXR_MULTILAYER")
    while layer.aovs:
        layer.aovs.remove(layer.aovs[0])
    layer.use_pass_normal = False


def read_seen_maps(path: Path, more: tuple[str, ...] = ()) -> dict[str, np.ndarray]:
    """Return what ``render_maps`` wrote, row 0 at the bottom: coverage (H, W), normal and base_color (H, W, 3), others.

    Normals are in the camera's axes, of length 1 where coverage is above 0.
    """
    # Blender 5 writes a part for each pass, earlier ones a single part; channels carry the layer's name in both.
    channels_of = {
        name.partition(".")[2]: value.astype(np.float32)
        for channels in read_exr(path).values()
        for name, value in channels.items()
    }
    normal = np.stack([channels_of[f"Normal.{c}"] for c in "XYZ"], axis=-1)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-8)
    maps = {"coverage": channels_of["Combined.A"], "normal": normal}
    maps["base_color"] = np.stack([channels_of[f"base_color.{c}"] for c in "RGB"], axis=-1)
    for name in (*TRUTHS[1:], *more):
        maps[name] = next(value for key, value in channels_of.items() if key.startswith(f"{name}."))
    return maps


def _render(scene: Any, path: Path, kind: str, persistent: bool = False) -> None:
    import bpy

    scene.render.use_persistent_data = persistent
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.stem}.exr")
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):  # Blender 5 needs the medium before the format
        settings.media_type = "MULTI_LAYER_IMAGE" if kind.endswith("MULTILAYER") else "IMAGE"
    settings.file_format, settings.color_depth, settings.exr_codec = kind, "16", "ZIP"
    if kind.endswith("MULTILAYER"):
        settings.color_depth = "32"
    scene.render.filepath = str(partial)
    with cycles_operator():
        bpy.ops.render.render(write_still=True, scene=scene.name)
    os.replace(partial, path)
