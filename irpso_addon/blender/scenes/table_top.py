"""Objects on a table in a dark room, in a temporary scene of their own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from ...capture.camera import Camera
from .true_surface import (
    PRINCIPLED,
    TrueMaps,
    blank_material,
    grid_quads,
    node_of,
    smooth_mesh,
    texture_node,
    true_material,
    wire_truths,
    write_aov,
)  # fmt: skip

SUBJECT = "subject"  # AOV: 1 on the relief
_OUTPUT = "ShaderNodeOutputMaterial"
_KINDS = ("objects", "meshes", "cameras", "lights", "materials", "images", "worlds", "scenes")
_ROOM = 0.003  # radiance of the dark room
_BLIND, _BLIND_RADIANCE = ((-900.0, 1300.0, 1500.0), 420.0, 620.0), 0.12  # a window behind a blind: place, size
_CLOTH = ((0.012, 0.013, 0.016), (0.034, 0.036, 0.042))
_STEEL = (0.80, 0.79, 0.77)


@contextmanager
def own_scene(name: str) -> Iterator[Any]:
    """Yield a new scene that no window shows; remove it and all data made meanwhile at the end."""
    import bpy

    before = {kind: set(getattr(bpy.data, kind)) for kind in _KINDS}
    try:
        yield bpy.data.scenes.new(name)
    finally:
        for kind in reversed(_KINDS):
            data = getattr(bpy.data, kind)
            for thing in set(data) - before[kind]:
                data.remove(thing)


def add_camera(scene: Any, camera: Camera) -> None:
    """Give the scene a perspective camera."""
    import bpy
    from mathutils import Matrix

    data = bpy.data.cameras.new("Camera")
    data.sensor_fit, data.sensor_width = "HORIZONTAL", 36.0
    data.lens = 36.0 * camera.scale[0] / camera.width
    data.clip_start, data.clip_end = 1.0, 1e5
    scene.camera = bpy.data.objects.new("Camera", data)
    scene.camera.matrix_world = Matrix(camera.matrix.tolist())
    scene.collection.objects.link(scene.camera)


def add_relief(scene: Any, height: np.ndarray, maps: TrueMaps, middle: tuple[float, float], half: float) -> None:
    """Put a square relief on the table: heights (N, N) at its grid points, its maps, the centre, half of its side."""
    count = len(height)
    along = np.linspace(0, 1, count)
    v, u = np.meshgrid(along, along, indexing="ij")
    surface = np.stack([middle[0] + half * (2 * u - 1), middle[1] + half * (2 * v - 1), height], axis=-1)
    # One more ring of vertices, on the table: the sides.
    rows = np.pad(np.arange(count), 1, mode="edge")
    walled = surface[rows[:, None], rows].copy()
    walled[[0, -1], :, 2] = walled[:, [0, -1], 2] = 0
    uv = np.stack([u, v], axis=-1)[rows[:, None], rows]
    made = smooth_mesh(scene, "relief", walled.reshape(-1, 3), grid_quads(count + 2, count + 2), uv.reshape(-1, 2))
    material = true_material(maps)
    one = material.node_tree.nodes.new("ShaderNodeValue")
    one.outputs[0].default_value = 1.0
    write_aov(material, SUBJECT, one.outputs[0])
    made.data.materials.append(material)


def add_print(
    scene: Any, picture: np.ndarray, middle: tuple[float, float], size: tuple[float, float], thickness: float
) -> None:
    """Put a matt card on the table; picture: (H, W, 3) linear reflectance, row 0 at the bottom."""
    across, up = np.array([-1, -1, 1, 1]), np.array([0, 0, 1, 1])
    x, y = (m + s / 2 * across for m, s in zip(middle, size, strict=True))
    grid = np.stack([*np.meshgrid(x, y), np.zeros((4, 4))], axis=-1)
    grid[1:3, 1:3, 2] = thickness
    uv = np.stack(np.meshgrid(up, up), axis=-1)
    made = smooth_mesh(scene, "print", grid.reshape(-1, 3), grid_quads(4, 4), uv.reshape(-1, 2))
    made.data.shade_flat()
    material, nodes = blank_material("print")
    diffuse = nodes.new("ShaderNodeBsdfDiffuse")
    link = material.node_tree.links.new
    link(texture_node(nodes, "print", picture, "Closest").outputs["Color"], diffuse.inputs["Color"])
    link(diffuse.outputs["BSDF"], node_of(nodes, _OUTPUT).inputs["Surface"])
    made.data.materials.append(material)


def add_ball(scene: Any, middle: np.ndarray, radius: float) -> None:
    """Put a polished steel ball on the table."""
    polar, around = np.meshgrid(np.linspace(0, np.pi, 193), np.linspace(0, 2 * np.pi, 385), indexing="ij")
    unit = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1)
    places = (np.asarray(middle) + radius * unit).reshape(-1, 3)
    quads = grid_quads(193, 385)[:, ::-1]
    made = smooth_mesh(scene, "ball", places, quads, np.zeros((len(places), 2)))
    material, nodes = blank_material("steel")
    shader = node_of(nodes, PRINCIPLED)
    shader.inputs["Base Color"].default_value = (*_STEEL, 1)
    shader.inputs["Metallic"].default_value, shader.inputs["Roughness"].default_value = 1.0, 0.06
    made.data.materials.append(material)


def add_room(scene: Any, size: float) -> None:
    """Give the scene a table with a dark cloth, ``size`` wide, and a dark room with a window behind a blind."""
    import bpy
    from mathutils import Matrix, Vector

    corners = size / 2 * np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
    cloth = smooth_mesh(scene, "cloth", corners, np.arange(4)[None], np.zeros((4, 2)))
    cloth.data.materials.append(_cloth())
    place, wide, tall = _BLIND
    corners = np.array([(-wide, -tall, 0), (wide, -tall, 0), (wide, tall, 0), (-wide, tall, 0)]) / 2
    blind = smooth_mesh(scene, "blind", corners, np.arange(4)[None], np.zeros((4, 2)))
    turned = Vector(place).to_track_quat("-Z", "Y").to_matrix().to_4x4()
    blind.matrix_world = Matrix.Translation(place) @ turned
    material, nodes = blank_material("blind")
    glow = nodes.new("ShaderNodeEmission")
    glow.inputs["Strength"].default_value = _BLIND_RADIANCE
    material.node_tree.links.new(glow.outputs["Emission"], node_of(nodes, _OUTPUT).inputs["Surface"])
    blind.data.materials.append(material)
    scene.world = bpy.data.worlds.new("room")
    scene.world.use_nodes = True
    background = node_of(scene.world.node_tree.nodes, "ShaderNodeBackground")
    background.inputs["Color"].default_value = (_ROOM, _ROOM, _ROOM, 1)


def _cloth() -> Any:
    """Return the material of a dark felt: mottled, and rough with fibres."""
    material, nodes = blank_material("cloth")
    link, shader = material.node_tree.links.new, node_of(nodes, PRINCIPLED)
    place = nodes.new("ShaderNodeTexCoord").outputs["Object"]
    mix = nodes.new("ShaderNodeMix")
    mix.data_type = "RGBA"
    factor, *_, first, second = [s for s in mix.inputs if s.enabled]
    first.default_value, second.default_value = ((*colour, 1) for colour in _CLOTH)
    fibres = nodes.new("ShaderNodeTexNoise")
    fibres.inputs["Scale"].default_value, fibres.inputs["Detail"].default_value = 0.6, 6.0
    fibres.inputs["Roughness"].default_value = 0.7
    bump = nodes.new("ShaderNodeBump")
    bump.inputs["Distance"].default_value, bump.inputs["Strength"].default_value = 1.2, 0.7
    link(place, fibres.inputs["Vector"])
    link(fibres.outputs[0], factor)
    link(fibres.outputs[0], bump.inputs["Height"])
    link(bump.outputs["Normal"], shader.inputs["Normal"])
    wool = nodes.new("ShaderNodeValue")
    wool.outputs[0].default_value = 0.95
    wire_truths(material, next(s for s in mix.outputs if s.enabled), wool.outputs[0])
    return material
