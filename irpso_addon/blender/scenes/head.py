"""The demo's scene: a head (Blender's monkey), a camera and a sun."""

from __future__ import annotations

import math
from typing import Any

from ...capture.camera import Camera
from .scene import camera_from_object

NAME = "Suzanne"
_SUBDIVISIONS = 3
_LENS = 106.0  # millimetres: the head fills the frame without perspective distortion of the face
_DISTANCE = 8.6
_ASPECT = 1.2  # width over height of the image
_TURN, _TILT = 16.0, 4.0  # degrees: a three-quarter view shows more than a frontal one


def build_scene() -> Any:
    """Empty the open file, add head, camera and sun, and return the head's object."""
    import bpy
    from mathutils import Euler, Vector

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_monkey_add(size=2.0, calc_uvs=True)
    head = bpy.context.active_object
    head.name = head.data.name = NAME
    head.modifiers.new("Subdivision", "SUBSURF").levels = _SUBDIVISIONS
    head.modifiers["Subdivision"].render_levels = _SUBDIVISIONS
    head.data.shade_smooth()
    scene = bpy.context.scene
    turn = Euler((math.radians(90 - _TILT), 0, math.radians(_TURN)))
    toward = turn.to_matrix() @ Vector((0, 0, 1))
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.lens = _LENS
    camera.rotation_euler, camera.location = turn, toward * _DISTANCE
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.rotation_euler = Euler((math.radians(50), 0, math.radians(_TURN + 40)))
    sun.data.energy, sun.data.angle = math.pi, 0.02
    for obj in (camera, sun):
        scene.collection.objects.link(obj)
    scene.camera = camera
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 64
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_x, scene.render.resolution_y = round(900 * _ASPECT), 900
    scene.world = bpy.data.worlds.new("World")
    bpy.context.view_layer.update()
    return head


def scene_camera(height: int) -> Camera:
    """Return the scene's camera with an image ``height`` pixels high."""
    import bpy

    return camera_from_object(bpy.context.scene.camera, round(height * _ASPECT), height)
