"""Objects that stand beside a mesh: they hide it from cameras and lights, and are not recovered."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..geometry.surface.mesh import MeshData
from .mesh import read_attribute
from .objects import in_viewports

WITH_SURFACE = frozenset({"MESH", "CURVE", "SURFACE", "FONT", "META"})  # types of objects that Blender makes meshes of


def with_occluders(mesh: MeshData, objects: Sequence[Any], of_collection: bool = False) -> MeshData:
    """Return a mesh with the triangles of other objects in its way, with modifiers and instances of the viewport.

    of_collection: instancers without faces are left out, as of lights. Raises InputError, with the object's name, where
    one has no surface or is hidden.
    """
    if not objects:
        return mesh
    instances = _instances({obj.session_uid for obj in objects})
    triangles = [
        _triangles(obj, instances.get(obj.session_uid, []), needed=not (of_collection and obj.is_instancer))
        for obj in objects
    ]
    return replace(mesh, occluders=np.concatenate(triangles))


def can_occlude(obj: Any) -> bool:
    """Return whether an object may have a surface: its own, or instances of other objects."""
    return obj.type in WITH_SURFACE or obj.is_instancer


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


def _triangles(obj: Any, instances: Sequence[np.ndarray], needed: bool) -> np.ndarray:
    """Return (T, 3, 3) float32 the corners of an object's triangles, in the world.

    instances: their corners. needed: an object without triangles is refused.
    """
    import bpy

    if not can_occlude(obj):
        raise InputError(f"occluder '{obj.name}' is of type {obj.type}, which has no surface; leave it out")
    depsgraph = bpy.context.evaluated_depsgraph_get()
    evaluated = obj.evaluated_get(depsgraph)
    if not (evaluated.is_evaluated and in_viewports(obj)):
        raise InputError(
            f"occluder '{obj.name}' is not in the active view layer or is hidden; show it in the viewport, or leave it"
            " out"
        )
    parts = list(instances)
    if obj.type in WITH_SURFACE and (obj.show_instancer_for_viewport or not obj.is_instancer):
        matrix = np.array(evaluated.matrix_world, np.float64)
        mesh = bpy.data.meshes.new_from_object(evaluated, depsgraph=depsgraph)
        try:
            parts.insert(0, _placed(_corners(mesh), matrix))
        finally:
            bpy.data.meshes.remove(mesh)
    world = np.concatenate(parts) if parts else np.empty((0, 3))
    if needed and not len(world):
        raise InputError(f"occluder '{obj.name}' has no faces; leave it out")
    if not np.isfinite(world).all():
        raise InputError(f"occluder '{obj.name}' has vertices that are not numbers; repair it, or leave it out")
    return world.reshape(-1, 3, 3).astype(np.float32)


def _instances(wanted: set[int]) -> dict[int, list[np.ndarray]]:
    """Return session number → (3T, 3) corners of each instance that the viewport shows of these objects.

    Instances are of collections, vertices, faces, particles and geometry nodes. Blender lists none of metaballs.
    """
    import bpy

    found: dict[int, list[np.ndarray]] = {}
    shapes: dict[int, np.ndarray] = {}  # by the address of the evaluated data, which instances share
    for one in bpy.context.evaluated_depsgraph_get().object_instances:
        if not one.is_instance or not one.show_self or one.object.type not in WITH_SURFACE:
            continue
        owner = one.parent.original.session_uid
        if owner not in wanted:
            continue
        address = one.object.data.as_pointer()
        if address not in shapes:
            shapes[address] = _corners(one.object.to_mesh())
            one.object.to_mesh_clear()
        found.setdefault(owner, []).append(_placed(shapes[address], np.array(one.matrix_world, np.float64)))
    return found


def _corners(mesh: Any) -> np.ndarray:
    """Return (3T, 3) the corners of a mesh's triangles."""
    mesh.calc_loop_triangles()
    corners = read_attribute(mesh.loop_triangles, "vertices", 3 * len(mesh.loop_triangles), np.int32)
    return read_attribute(mesh.vertices, "co", 3 * len(mesh.vertices)).reshape(-1, 3)[corners]


def _placed(corners: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    return corners @ matrix[:3, :3].T + matrix[:3, 3]
