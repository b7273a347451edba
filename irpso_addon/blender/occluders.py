"""Objects that stand beside a mesh: they hide it from cameras and lights, and are not recovered."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..geometry.surface.mesh import MeshData
from .mesh import read_attribute

WITH_SURFACE = frozenset({"MESH", "CURVE", "SURFACE", "FONT", "META"})  # types of objects that Blender makes meshes of


def with_occluders(mesh: MeshData, objects: Iterable[Any]) -> MeshData:
    """Return a mesh with the triangles of other objects in its way, modifiers of the viewport included.

    Raises InputError, with the object's name, where one has no surface or is hidden.
    """
    triangles = [_triangles(obj) for obj in objects]
    return replace(mesh, occluders=np.concatenate(triangles)) if triangles else mesh


def named_occluders(names: Iterable[str], subject: Any, option: str) -> list[Any]:
    """Return the objects of these names in the open scene. subject: the object that is recovered.

    option: the name of the setting, for errors. Raises InputError.
    """
    import bpy

    scene, objects = bpy.context.scene, []
    for name in dict.fromkeys(names):
        if name not in scene.objects:
            raise InputError(f"{option} {name}: there is no such object in scene '{scene.name}'; check the name")
        if scene.objects[name] == subject:
            raise InputError(
                f"{option} {name}: is the mesh that is recovered, which shades itself anyway; leave it out"
            )
        objects.append(scene.objects[name])
    return objects


def _triangles(obj: Any) -> np.ndarray:
    """Return (T, 3, 3) float32 the corners of an object's triangles, in the world."""
    import bpy

    if obj.type not in WITH_SURFACE:
        raise InputError(f"occluder '{obj.name}' is of type {obj.type}, which has no surface; leave it out")
    depsgraph = bpy.context.evaluated_depsgraph_get()
    evaluated = obj.evaluated_get(depsgraph)
    if not evaluated.is_evaluated:
        raise InputError(
            f"occluder '{obj.name}' is not in the active view layer or is hidden; show it in the viewport, or leave it"
            " out"
        )
    matrix = np.array(evaluated.matrix_world, np.float64)
    mesh = bpy.data.meshes.new_from_object(evaluated, depsgraph=depsgraph)
    try:
        mesh.calc_loop_triangles()
        corners = read_attribute(mesh.loop_triangles, "vertices", 3 * len(mesh.loop_triangles), np.int32)
        places = read_attribute(mesh.vertices, "co", 3 * len(mesh.vertices))
    finally:
        bpy.data.meshes.remove(mesh)
    if not len(corners):
        raise InputError(f"occluder '{obj.name}' has no faces; leave it out")
    world = places.reshape(-1, 3)[corners] @ matrix[:3, :3].T + matrix[:3, 3]
    if not np.isfinite(world).all():
        raise InputError(f"occluder '{obj.name}' has vertices that are not numbers; repair it, or leave it out")
    return world.reshape(-1, 3, 3).astype(np.float32)
