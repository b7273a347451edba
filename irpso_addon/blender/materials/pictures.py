"""Cycles renders of a recovered material on its subject: an icon, and a turntable."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...capture.images.exr import read_exr
from ...core.encode import srgb_from_linear
from ..scenes import cycles, table_top
from ..scenes.true_surface import node_of
from .material import TAG

_SAMPLES = 32  # of a pixel
_CARD, _MESH = (0.0, -0.4, 1.0), (0.6, -1.0, 0.5)  # from the subject to the camera
_LAMP = (-0.45, 0.25, 1.0)  # in the camera's axes
_FRONT = (0.0, -0.01, 1.0)  # from straight above, the camera's vertical would not be the card's
# A card's tilt in radians in a turntable. Tilted by 0.24 toward the lamp, it reflects the lamp into the camera.
_TILT = 0.26
_SUN, _SKY = 0.06, 0.6  # half of the lamp's angle in radians; radiance of the zenith
_RIM = 1.04  # of the subject's extent
_EXPOSURE = 0.85


def icon(obj: Any, side: int) -> np.ndarray:
    """Return (side, side, 4) display values and coverage, row 0 at the bottom: an object as an asset browser shows it.

    A card is seen from above, a mesh from the side; under one lamp and a sky, so that metal has something to show.
    """
    from mathutils import Matrix

    return _pictures(obj, side, _CARD, [Matrix.Identity(3)])[0]


def turntable(obj: Any, side: int, count: int) -> list[np.ndarray]:
    """Return ``count`` pictures like ``icon`` of an object that moves while camera, lamp and sky stand still.

    A mesh turns once about its vertical, counterclockwise seen from above. A card faces the camera and tilts by _TILT
    to all sides in turn, counterclockwise from the right, so that highlights run over it.
    """
    from mathutils import Matrix, Vector

    angles = [2 * np.pi * number / count for number in range(count)]
    if TAG not in obj:
        return _pictures(obj, side, _MESH, [Matrix.Rotation(angle, 3, "Z") for angle in angles])
    axes = [Vector((-np.sin(angle), np.cos(angle), 0.0)) for angle in angles]
    return _pictures(obj, side, _FRONT, [Matrix.Rotation(_TILT, 3, axis) for axis in axes])


def _pictures(obj: Any, side: int, card_from: Sequence[float], rotations: Sequence[Any]) -> list[np.ndarray]:
    """Return the pictures of an object under rotations (3 × 3) about its middle, in a card's axes or the world's."""
    import bpy
    from mathutils import Matrix, Vector

    upright = Matrix.Identity(3) if TAG not in obj else obj.matrix_world.to_quaternion().to_matrix()
    axes = (upright @ Vector(card_from if TAG in obj else _MESH)).normalized().to_track_quat("Z", "Y").to_matrix()
    before = obj.matrix_world.copy()
    middle = before @ (sum((Vector(corner) for corner in obj.bound_box), Vector()) / 8)
    about = Matrix.Translation(middle)
    turns = [(upright @ rotation @ upright.transposed()).to_4x4() for rotation in rotations]
    placed = [about @ turn @ about.inverted() @ before for turn in turns]
    pictures = []
    temporary = tempfile.TemporaryDirectory(dir=bpy.app.tempdir)  # Blender also removes it when the process is ended
    with table_top.own_scene("IRPSO pictures") as scene, temporary as folder:
        # A copy: constraints, a parent or an animation would move the object away from the places given here.
        placeable = obj.copy()
        placeable.parent = None
        placeable.constraints.clear()
        placeable.animation_data_clear()
        placeable.hide_render = False
        scene.collection.objects.link(placeable)
        corners = [_extent(obj, axes, place) for place in placed]
        low, high = (np.array(ends) for ends in zip(*corners, strict=True))
        _add_camera(scene, axes, low.min(axis=0), high.max(axis=0))
        _add_sky(scene)
        lamp = cycles.only_lamp(scene, "SUN")
        lamp.data.angle = 2 * _SUN
        cycles.place_lamp(lamp, np.array(axes) @ np.array(_LAMP) / np.linalg.norm(_LAMP))
        cycles.set_up(scene, cycles.View(side, side, samples=_SAMPLES))
        rendered = Path(folder) / "picture.exr"
        for place in placed:
            placeable.matrix_world = place
            cycles.render_radiance(scene, rendered)
            pictures.append(_displayed(rendered))
    return pictures


def _displayed(path: Path) -> np.ndarray:
    (channels,) = read_exr(path).values()
    light = np.stack([channels[c] for c in "RGB"], axis=-1).astype(np.float64)
    alpha = np.clip(channels["A"].astype(np.float64), 0, 1)[..., None]
    shown = srgb_from_linear(np.clip(_EXPOSURE * light / np.maximum(alpha, 1e-3), 0, 1))
    return np.concatenate([shown, alpha], axis=-1)


def _add_camera(scene: Any, axes: Any, low: np.ndarray, high: np.ndarray) -> None:
    """Give the scene an orthographic camera with these axes, in columns, that a box along them fills."""
    import bpy
    from mathutils import Matrix, Vector

    size = max(float((high - low).max()), 1e-6)
    data = bpy.data.cameras.new("Camera")
    data.type, data.ortho_scale = "ORTHO", _RIM * float(max(*(high - low)[:2], 1e-6))
    data.clip_start, data.clip_end = 1e-3 * size, 10 * size
    place = axes @ Vector([*((low + high)[:2] / 2), high[2] + size])
    scene.camera = bpy.data.objects.new("Camera", data)
    scene.camera.matrix_world = Matrix.Translation(place) @ axes.to_4x4()
    scene.collection.objects.link(scene.camera)


def _extent(obj: Any, axes: Any, place: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return (3,) least and (3,) largest coordinates, along axes, of an object's evaluated mesh at a place (4 × 4)."""
    import bpy

    shown = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = shown.to_mesh()
    vertices = np.zeros(3 * max(len(mesh.vertices), 1), np.float32)
    mesh.vertices.foreach_get("co", vertices)
    shown.to_mesh_clear()
    along = axes.transposed()
    turned = vertices.reshape(-1, 3) @ np.array(along @ place.to_3x3()).T + np.array(along @ place.translation)
    return turned.min(axis=0), turned.max(axis=0)


def _add_sky(scene: Any) -> None:
    """Give the scene a sky that is bright above and dark below."""
    import bpy

    world = scene.world = bpy.data.worlds.new("Sky")
    if world.node_tree is None:  # since Blender 5.0 every world has one
        world.use_nodes = True
    tree = world.node_tree
    place, parts = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeSeparateXYZ")
    ramp = tree.nodes.new("ShaderNodeMapRange")
    ramp.inputs["From Min"].default_value, ramp.inputs["From Max"].default_value = -1.0, 1.0
    ramp.inputs["To Min"].default_value, ramp.inputs["To Max"].default_value = 0.0, _SKY
    tree.links.new(place.outputs["Generated"], parts.inputs["Vector"])
    tree.links.new(parts.outputs["Z"], ramp.inputs["Value"])
    background = node_of(tree.nodes, "ShaderNodeBackground")
    tree.links.new(ramp.outputs["Result"], background.inputs["Strength"])
