"""Photographs of meshes with UVs and true maps: captures for the command line, and pictures under unseen lights."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import bpy
import numpy as np

from irpso_addon.blender.images import decode
from irpso_addon.blender.scenes.scene import camera_from_object
from irpso_addon.blender.scenes.true_surface import TrueMaps, true_material
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.capture.write import write_capture
from irpso_addon.core.encode import linear_from_srgb

from . import render, subjects
from .resample import resampled

NAME = "Subject"
CAPTURE, BLEND = "capture", "scene.blend"
_DISTANCE = 6.0  # of the perspective camera
_FILL = 0.94  # of the picture that the subject may span
# The head comes without a roughness map: the shinier its specular map, the smoother.
_HEAD_ROUGHNESS = (0.65, 0.45)


@dataclass(frozen=True)
class TexturedScene:
    """A subject. mesh: makes it. maps: function (texels, detail) → true maps (``resampled``). note: for pages."""

    mesh: Callable
    maps: Callable[[int, int], TrueMaps]
    note: str = ""


def scene_table(data: Path) -> dict[str, TexturedScene]:
    """Return name → scene from a folder with ``materials`` (ambientCG) and ``head_leeperrysmith``."""
    head = data / "head_leeperrysmith"
    scan = partial(subjects.scan, head / "LeePerrySmith.obj", 1)
    rock, moss = (partial(cc0_maps, data / "materials" / name) for name in ("rock", "mossyrock"))
    authored = "roughness authored from the specular map: {:g} − {:g} · specular".format(*_HEAD_ROUGHNESS)
    return {
        "monkey_rock": TexturedScene(subjects.monkey, rock),
        "monkey_mossyrock": TexturedScene(subjects.monkey, moss),
        "head_rock": TexturedScene(scan, rock),
        "head_mossyrock": TexturedScene(scan, moss),
        "head_own": TexturedScene(scan, partial(head_maps, head), authored),
    }


def cc0_maps(folder: Path, size: int, detail: int) -> TrueMaps:
    """Return the maps of an ambientCG material."""
    albedo, normal, roughness = (_pixels(folder / f"{name}.jpg") for name in ("albedo", "normal", "roughness"))
    return _true_maps(linear_from_srgb(albedo), normal, roughness[..., 0], size, detail)


def head_maps(folder: Path, size: int, detail: int) -> TrueMaps:
    """Return the head's own colours and normals, and a roughness authored from its specular map."""
    names = ("Map-COL", "Infinite-Level_02_Tangent_SmoothUV", "Map-SPEC")
    colour, normal, shine = (_pixels(folder / f"{name}.jpg") for name in names)
    roughness = _HEAD_ROUGHNESS[0] - _HEAD_ROUGHNESS[1] * shine[..., 0]
    return _true_maps(linear_from_srgb(colour), normal, roughness, size, detail)


def prepare(scene: TexturedScene, view: render.View, folder: Path) -> None:
    """Empty Blender, put subject and camera into it, and save them as ``folder``'s .blend file, unless it has one."""
    render.empty_scene(view)
    data = bpy.context.scene.camera.data
    data.type, data.angle = "PERSP", 2 * np.arctan(view.world_width / 2 / _DISTANCE)
    bpy.context.scene.camera.location = (0, 0, _DISTANCE)
    subject = scene.mesh()
    subject.name = NAME
    subjects.fit(subject, _FILL * view.world_width, _FILL * view.world_width * view.height / view.width)
    bpy.context.view_layer.update()
    save_blend(folder)


def save_blend(folder: Path) -> None:
    """Save the open scene as the folder's .blend file, unless it has one."""
    if not (folder / BLEND).exists():
        folder.mkdir(parents=True, exist_ok=True)
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / BLEND), copy=True, check_existing=False)


def photograph(
    truth: TrueMaps, view: render.View, folder: Path, directions: np.ndarray, unseen: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Write the capture into ``folder``; return the pictures under the unseen lights (K, H, W, 3) and the mask (H, W).

    Call ``prepare`` first. Pictures in the folder are not rendered again.
    """
    bpy.data.objects[NAME].data.materials.append(true_material(truth))
    mask = render.truth(folder / "seen")["coverage"] > 0.999
    radiances = list(render.photographs(folder / "seen", directions))
    if not (folder / CAPTURE).exists():
        camera = camera_from_object(bpy.context.scene.camera, view.width, view.height)
        write_capture(Capture(folder.name, shots(radiances, directions), (camera,), (mask,)), folder / CAPTURE)
    return np.stack(list(render.photographs(folder / "unseen", unseen))), mask


def shots(pictures: Iterable[np.ndarray], directions: np.ndarray) -> tuple[Observation, ...]:
    """Return the observations of pictures (H, W, 3) under distant lights of intensity 1, (K, 3) directions."""
    return tuple(
        Observation(f"light {n}", partial(opaque, picture), Light(tuple(map(float, direction))))
        for n, (picture, direction) in enumerate(zip(pictures, directions, strict=True))
    )


def photograph_result(blend: Path, view: render.View, folder: Path, unseen: np.ndarray) -> np.ndarray:
    """Return pictures (K, H, W, 3) of a recovery's .blend file under the unseen lights."""
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    render.set_up(bpy.context.scene, view)
    return np.stack(list(render.photographs(folder, unseen)))


def opaque(image: np.ndarray) -> np.ndarray:
    """Return (H, W, 4), colours (H, W, 3) with weight 1."""
    return np.concatenate([image, np.ones((*image.shape[:2], 1), np.float32)], axis=-1)


def linear_picture(path: Path) -> np.ndarray:
    """Return (H, W, 3) linear values of an sRGB picture."""
    return linear_from_srgb(_pixels(path))


def _pixels(path: Path) -> np.ndarray:
    return decode(path).values[..., :3].astype(np.float64)


def _true_maps(colour: np.ndarray, normal: np.ndarray, roughness: np.ndarray, size: int, detail: int) -> TrueMaps:
    vectors = resampled(2 * normal - 1, size, detail)
    vectors[..., 2] = np.maximum(vectors[..., 2], 0.05)
    vectors /= np.linalg.norm(vectors, axis=-1, keepdims=True)
    return TrueMaps(resampled(colour, size, detail), vectors, resampled(roughness, size, detail))
