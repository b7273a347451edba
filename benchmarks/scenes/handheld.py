"""Handheld photographs of cards with a phone's flash, by Cycles: JPEG with EXIF, and the truth.

Lengths are millimetres. The card lies in the plane z = 0 around the origin, on a printed marker board or on bare
paper.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import bpy
import numpy as np

from irpso_addon.blender.scenes import cycles, table_top
from irpso_addon.blender.scenes.true_surface import TrueMaps, grid_quads, smooth_mesh, true_material
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.frame.board import PAPERS, board_of, board_picture
from irpso_addon.capture.images.exif import focal_in_pixels
from irpso_addon.core.files import new_folder
from irpso_addon.sample.photograph import developed, write_photograph
from irpso_addon.sample.relief import HALF, THICKNESS, tile

from .textured import cc0_maps

CARD = 120.0  # width and height
BOARD = board_of("A4", 8)
SIZE, FOCAL_35MM = (400, 300), 30
OFFSET = np.array([14.0, 9.0, 0.0])  # of the flash from the lens, in the camera's axes
BEAM = 2.0  # exponent of the cosine in the flash's falloff
_RADIUS = 2.0  # of the flash
_TEXELS = 256
_PAPER, _INK = 0.8, 0.04  # reflectances
_SAMPLES, _BOUNCES = 6, 1
_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
_RELIEF = 0.6 * CARD / 200  # of the tile's heights

Subject = Callable[[], tuple[TrueMaps, np.ndarray | None]]


def subjects(data: Path) -> dict[str, Subject]:
    """Return name → true maps, and heights of a relief or None. ``tile`` is for tuning, the others for reports."""

    def scanned(name: str) -> tuple[TrueMaps, None]:
        return cc0_maps(data / "materials" / name, _TEXELS, _TEXELS), None

    return {"tile": _tile, "rock": partial(scanned, "rock"), "mossyrock": partial(scanned, "mossyrock")}


def _tile() -> tuple[TrueMaps, np.ndarray]:
    along = np.linspace(-HALF, HALF, _TEXELS + 1)
    middles = (along[1:] + along[:-1]) / 2
    painted = tile(*np.meshgrid(middles, middles))
    heights = (tile(*np.meshgrid(along, along)).height - THICKNESS) * _RELIEF
    return TrueMaps(painted.base_color, None, painted.roughness, painted.metallic), heights


def poses(count: int, seed: int) -> list[np.ndarray]:
    """Return (4, 4) matrices of cameras around the card: tilted by 3° to 50°, 260 to 400 mm away."""
    random = np.random.default_rng(seed)
    matrices = []
    for k in range(count):
        tilt = np.radians(3 + 47 * np.sqrt((k + 0.5) / count))
        around = k * _GOLDEN_ANGLE + random.uniform(-0.2, 0.2)
        direction = np.array([np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), np.cos(tilt)])
        aim = np.array([*random.uniform(-15, 15, 2), 0.0])
        backward = direction
        up = np.array([*(np.array([0, 1.0]) + random.uniform(-0.4, 0.4, 2)), 0.0])
        right = np.cross(up, backward)
        right /= np.linalg.norm(right)
        matrix = np.eye(4)
        matrix[:3, :3] = np.stack([right, np.cross(backward, right), backward], axis=-1)
        matrix[:3, 3] = aim + random.uniform(260, 400) * direction
        matrices.append(matrix)
    return matrices


def photograph(name: str, subject: Subject, markers: bool, folder: Path, count: int = 32, seed: int = 0) -> None:
    """Write ``photographs/`` and ``truth.npz`` into a new folder.

    The truth: matrices (K, 4, 4), focal (pixels), lamps (K, 3), beam, strength (intensity of the flash) and the maps.
    """
    maps, heights = subject()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    cycles.set_up(scene, cycles.View(*SIZE, samples=_SAMPLES, bounces=_BOUNCES, clamp=1.0))
    _build(scene, maps, heights, markers)
    focal = focal_in_pixels(FOCAL_35MM, *SIZE)
    matrices = poses(count, seed)
    cameras = [Camera(*SIZE, (focal, focal), (SIZE[0] / 2, SIZE[1] / 2), matrix) for matrix in matrices]
    lamps = np.array([matrix[:3, :3] @ OFFSET + matrix[:3, 3] for matrix in matrices])
    lamp = cycles.only_lamp(scene, "POINT", _RADIUS)
    with new_folder(folder) as made:
        (made / "photographs").mkdir()
        pictures = []
        for camera, place in zip(cameras, lamps, strict=True):
            table_top.add_camera(scene, camera)
            cycles.place_lamp(lamp, place, 300.0)
            cycles.render_radiance(scene, made / "seen.exr")
            pictures.append(cycles.read_radiance(made / "seen.exr") * _beam(camera, place)[..., None])
        (made / "seen.exr").unlink()
        gain = 0.95 / np.percentile(np.stack(pictures)[..., 1], 99)
        for number, picture in enumerate(pictures):
            path = made / "photographs" / f"IMG_{number + 1:04d}.jpg"
            write_photograph(path, developed(picture * gain, seed * 1000 + number), FOCAL_35MM)
        np.savez_compressed(
            made / "truth.npz", matrices=matrices, focal=focal, lamps=lamps, beam=BEAM, strength=gain * 300.0**2,
            base_color=maps.base_color, roughness=maps.roughness,
            normal=_normals(heights) if maps.normal is None else maps.normal,
        )  # fmt: skip


def _normals(heights: np.ndarray) -> np.ndarray:
    """Return (N, N, 3) unit normals at the cell centres of a grid of heights (N + 1, N + 1)."""
    step = CARD / (len(heights) - 1)
    up, across = np.gradient((heights[1:, 1:] + heights[:-1, 1:] + heights[1:, :-1] + heights[:-1, :-1]) / 4, step)
    normal = np.stack([-across, -up, np.ones_like(up)], axis=-1)
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def _beam(camera: Camera, place: np.ndarray) -> np.ndarray:
    """Return (H, W): the flash's relative intensity toward the pixels' points of the plane z = 0."""
    toward = camera.points(1.0) - camera.position
    points = camera.position - toward * (camera.position[2] / toward[..., 2:])
    away = points - place
    cosine = -(away @ camera.backward) / np.linalg.norm(away, axis=-1)
    return np.clip(cosine, 0, 1) ** BEAM


def _build(scene, maps: TrueMaps, heights: np.ndarray | None, markers: bool) -> None:
    """Put the paper and the card into the scene."""
    ink = np.asarray(board_picture(BOARD, 120).convert("L"), float)[::-1] / 255 if markers else np.ones((2, 2))
    paper = (_INK + (_PAPER - _INK) * ink)[..., None].repeat(3, axis=-1)
    table_top.add_print(scene, paper, (0.0, 0.0), PAPERS[BOARD.paper], 0.01)
    count = 2 if heights is None else len(heights)
    along = np.linspace(0, 1, count)
    v, u = np.meshgrid(along, along, indexing="ij")
    height = np.zeros((2, 2)) if heights is None else heights
    surface = np.stack([CARD * (u - 0.5), CARD * (v - 0.5), height + 0.05], axis=-1)
    made = smooth_mesh(
        scene, "card", surface.reshape(-1, 3), grid_quads(count, count), np.stack([u, v], -1).reshape(-1, 2)
    )
    made.data.materials.append(true_material(maps))
