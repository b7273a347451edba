"""Reading a mesh out of Blender: triangles with their normals, tangents and texture coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InputError

# Texture coordinates this far outside the unit square are rounding, not intent.
_UV_ROUNDING = 1e-5
# More of the surface than this without area in the UV map is a fault of the map.
_DEGENERATE_LIMIT = 0.005


@dataclass(frozen=True)
class MeshData:
    """T triangles, by corner, in world units and world axes; all float32.

    positions: (T, 3, 3). normals: (T, 3, 3) unit, as Blender shades (custom and sharp ones included). tangents:
    (T, 3, 4) unit MikkTSpace tangent and the bitangent's sign. uvs: (T, 3, 2) in 0…1. materials: (T,) int32 slot.
    uv_map: the name of the UV map the texture coordinates and tangents are of. matrix: (4, 4) float64 object to world.
    """

    name: str
    positions: np.ndarray
    normals: np.ndarray
    tangents: np.ndarray
    uvs: np.ndarray
    materials: np.ndarray
    uv_map: str
    matrix: np.ndarray


def extract_mesh(obj: Any) -> MeshData:
    """Return the triangles of a mesh object, modifiers applied as the viewport shows them, in world space.

    Texture coordinates come from the active UV map (the one highlighted in Blender's list, not the one with the camera
    mark). Tangents are MikkTSpace of the triangles rather than of the quads, as Cycles has them. Raises InputError, by
    the object's name, where there is no such surface or its UV map cannot hold one; overlaps are found by ``bake_uv``.
    """
    import bpy

    if obj.type != "MESH":
        raise InputError(f"object '{obj.name}' is of type {obj.type}, not a mesh; name a mesh object")
    depsgraph = bpy.context.evaluated_depsgraph_get()
    evaluated = obj.evaluated_get(depsgraph)
    if not evaluated.is_evaluated:
        raise InputError(f"object '{obj.name}' is not in the active view layer or is hidden; show it in the viewport")
    matrix = np.array(evaluated.matrix_world, np.float64)
    _check_matrix(obj.name, matrix)
    mesh = bpy.data.meshes.new_from_object(evaluated, preserve_all_data_layers=True, depsgraph=depsgraph)
    try:
        corners = _local_triangles(obj.name, mesh)
    finally:
        bpy.data.meshes.remove(mesh)
    return _to_world(obj.name, corners, matrix)


def _check_matrix(name: str, matrix: np.ndarray) -> None:
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3])) <= 1e-9 * max(lengths.max(), 1e-30) ** 3:
        raise InputError(f"object '{name}' has a scale of zero along an axis; set its scale or apply it")


def _local_triangles(name: str, mesh: Any) -> dict[str, Any]:
    """Return the corners' arrays in the object's own space."""
    if not len(mesh.polygons):
        raise InputError(f"mesh object '{name}' has no faces; choose one that has a surface")
    layer = mesh.uv_layers.active
    if layer is None:
        raise InputError(f"mesh object '{name}' has no UV map; unwrap it in Blender first")
    mesh.calc_loop_triangles()
    count = len(mesh.loop_triangles)
    vertices = _read(mesh.loop_triangles, "vertices", 3 * count, np.int32)
    loops = _read(mesh.loop_triangles, "loops", 3 * count, np.int32)
    coordinates = _read(mesh.vertices, "co", 3 * len(mesh.vertices)).reshape(-1, 3)
    uvs = _read(layer.uv, "vector", 2 * len(mesh.loops)).reshape(-1, 2)[loops].reshape(-1, 3, 2)
    positions = coordinates[vertices].reshape(-1, 3, 3)
    if not np.isfinite(positions).all():
        raise InputError(f"mesh object '{name}' has vertices that are not numbers; repair the mesh")
    check_uvs(name, layer.name, positions, uvs)
    normals = _read(mesh.corner_normals, "vector", 3 * len(mesh.loops)).reshape(-1, 3)[loops].reshape(-1, 3, 3)
    return {
        "positions": positions,
        "normals": normals,
        "uvs": uvs,
        "tangents": _tangents(coordinates, vertices, normals, uvs),
        "materials": _read(mesh.loop_triangles, "material_index", count, np.int32),
        "uv_map": layer.name,
    }


def _read(collection: Any, attribute: str, size: int, kind: type = np.float32) -> np.ndarray:
    values = np.empty(size, kind)
    collection.foreach_get(attribute, values)
    return values


def _tangents(coordinates: np.ndarray, vertices: np.ndarray, normals: np.ndarray, uvs: np.ndarray) -> np.ndarray:
    """Return (T, 3, 4) MikkTSpace tangents and signs of triangles, computed by Blender on a passing mesh of them."""
    import bpy

    count = len(uvs)
    mesh = bpy.data.meshes.new("irpso tangents")
    try:
        mesh.vertices.add(len(coordinates))
        mesh.vertices.foreach_set("co", coordinates.ravel())
        mesh.loops.add(3 * count)
        mesh.loops.foreach_set("vertex_index", vertices)
        mesh.polygons.add(count)
        mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * count, 3, dtype=np.int32))
        mesh.update(calc_edges=True)
        # Not kept in a variable: the next call adds a layer, and would leave it pointing at freed memory.
        mesh.uv_layers.new(name="irpso").uv.foreach_set("vector", uvs.ravel())
        mesh.normals_split_custom_set(normals.reshape(-1, 3))
        mesh.calc_tangents(uvmap="irpso")
        tangents = _read(mesh.loops, "tangent", 9 * count).reshape(-1, 3, 3)
        signs = _read(mesh.loops, "bitangent_sign", 3 * count).reshape(-1, 3, 1)
    finally:
        bpy.data.meshes.remove(mesh)
    return np.concatenate([tangents, signs], axis=-1)


def _to_world(name: str, corners: dict[str, Any], matrix: np.ndarray) -> MeshData:
    linear = matrix[:3, :3]
    normals = corners["normals"] @ np.linalg.inv(linear)
    tangents = corners["tangents"][..., :3] @ linear.T
    # A mirrored object turns n × t over, so the sign follows.
    signs = corners["tangents"][..., 3:] * np.sign(np.linalg.det(linear))
    return MeshData(
        name=name,
        positions=(corners["positions"] @ linear.T + matrix[:3, 3]).astype(np.float32),
        normals=_unit(normals).astype(np.float32),
        tangents=np.concatenate([_unit(tangents), signs], axis=-1).astype(np.float32),
        uvs=corners["uvs"],
        materials=corners["materials"],
        uv_map=corners["uv_map"],
        matrix=matrix,
    )


def _unit(vectors: np.ndarray) -> np.ndarray:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(lengths > 0, lengths, 1.0)


def check_uvs(name: str, uv_map: str, positions: np.ndarray, uvs: np.ndarray) -> None:
    """Raise InputError where (T, 3, 2) texture coordinates leave the unit square or hold no area for the surface."""
    where = f"UV map '{uv_map}' of '{name}'"
    if not np.isfinite(uvs).all():
        raise InputError(f"{where} holds values that are not numbers; unwrap the mesh again")
    outside = ((uvs < -_UV_ROUNDING) | (uvs > 1 + _UV_ROUNDING)).any(axis=(1, 2))
    if outside.any():
        (u0, v0), (u1, v1) = uvs.min(axis=(0, 1)), uvs.max(axis=(0, 1))
        raise InputError(
            f"{where} leaves the unit square in {outside.sum()} of {len(uvs)} triangles"
            f" (u {u0:.4g} to {u1:.4g}, v {v0:.4g} to {v1:.4g}); pack its islands into the square"
        )
    edges = (positions[:, 1:] - positions[:, :1]).astype(np.float64)
    surface = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=-1)
    flat = (uvs[:, 1:] - uvs[:, :1]).astype(np.float64)
    area = np.abs(flat[:, 0, 0] * flat[:, 1, 1] - flat[:, 0, 1] * flat[:, 1, 0])
    if not surface.sum() > 0:
        raise InputError(f"the faces of '{name}' have no area; choose a mesh that has a surface")
    # A millionth of a texel of the largest bake (16384²): no bake draws it.
    lost = surface[area < 1e-14].sum() / surface.sum()
    if lost > _DEGENERATE_LIMIT:
        raise InputError(
            f"{where} gives no area to {100 * lost:.3g} % of the surface (collapsed faces); unwrap the mesh again"
        )
