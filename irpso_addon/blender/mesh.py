"""Reading a mesh out of Blender: triangles with their normals, tangents and texture coordinates."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..geometry.spaces import unit
from ..geometry.surface.mesh import MeshData, check_uvs
from ..geometry.surface.slots import slot_names
from ..geometry.surface.udim import lay_out

_TOGETHER = 8000  # most triangles for which Blender computes tangents in one thread
# Modifiers that repeat faces with their texture coordinates; a node group may.
_COPYING = {"ARRAY", "MIRROR", "SOLIDIFY", "SCREW", "PARTICLE_INSTANCE", "NODES"}


def extract_mesh(obj: Any, slots: Sequence[int] | None = None) -> MeshData:
    """Return the triangles of a mesh object in world space, with the modifiers of the viewport.

    Texture coordinates come from the active UV map (highlighted in Blender's list, not the one with the camera mark).
    Tangents are MikkTSpace of the triangles, as in Cycles, not of the quads. slots: material slots, None for all.
    Raises InputError, with the object's name, where there is no such surface or its UV map is unusable; ``bake_uv``
    detects overlaps.
    """
    import bpy

    if obj.type != "MESH":
        raise InputError(f"object '{obj.name}' is of type {obj.type}, not a mesh; name a mesh object")
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    if not evaluated.is_evaluated:
        raise InputError(f"object '{obj.name}' is not in the active view layer or is hidden; show it in the viewport")
    matrix = np.array(evaluated.matrix_world, np.float64)
    check_matrix(obj.name, matrix)
    mesh = new_evaluated_mesh(obj)
    try:
        corners = _local_triangles(obj.name, mesh, slot_names(obj), slots)
        corners["copied_by"] = tuple(m.name for m in obj.modifiers if m.type in _COPYING and m.show_viewport)
    finally:
        bpy.data.meshes.remove(mesh)
    return _to_world(obj.name, corners, matrix)


def new_evaluated_mesh(obj: Any) -> Any:
    """Return a new mesh of a mesh object with its modifiers and all its layers, with unfinished edits of Edit Mode."""
    import bpy

    if obj.data.is_editmode:
        obj.update_from_editmode()  # all layers come from the stored mesh, which Edit Mode otherwise writes at its end
    depsgraph = bpy.context.evaluated_depsgraph_get()
    evaluated = obj.evaluated_get(depsgraph)
    return bpy.data.meshes.new_from_object(evaluated, preserve_all_data_layers=True, depsgraph=depsgraph)


def check_matrix(name: str, matrix: np.ndarray) -> None:
    """Raise InputError where an object's matrix in the world (4, 4) flattens it."""
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3])) <= 1e-9 * max(lengths.max(), 1e-30) ** 3:
        raise InputError(f"object '{name}' has a scale of zero along an axis; set its scale or apply it")


def _local_triangles(name: str, mesh: Any, names: tuple[str, ...], slots: Sequence[int] | None) -> dict[str, Any]:
    """Return the corners' arrays in the object's own space."""
    if not len(mesh.polygons):
        raise InputError(f"mesh object '{name}' has no faces; choose one that has a surface")
    layer = mesh.uv_layers.active
    if layer is None:
        raise InputError(f"mesh object '{name}' has no UV map; unwrap it in Blender first")
    mesh.calc_loop_triangles()
    count = len(mesh.loop_triangles)
    vertices = read_attribute(mesh.loop_triangles, "vertices", 3 * count, np.int32)
    loops = read_attribute(mesh.loop_triangles, "loops", 3 * count, np.int32)
    coordinates = read_attribute(mesh.vertices, "co", 3 * len(mesh.vertices)).reshape(-1, 3)
    uvs = read_attribute(layer.uv, "vector", 2 * len(mesh.loops)).reshape(-1, 2)[loops].reshape(-1, 3, 2)
    positions = coordinates[vertices].reshape(-1, 3, 3)
    if not np.isfinite(positions).all():
        raise InputError(f"mesh object '{name}' has vertices that are not numbers; repair the mesh")
    # Blender draws faces of a missing slot with the last slot.
    materials = np.minimum(
        read_attribute(mesh.loop_triangles, "material_index", count, np.int32), max(len(names) - 1, 0)
    )
    solved = None if slots is None else np.isin(materials, np.asarray(slots, np.int32))
    if solved is not None and not solved.any():
        listed = ", ".join(f"'{names[slot]}'" for slot in slots)
        raise InputError(f"no face of '{name}' has the material slot {listed}; choose one that has faces")
    chosen = slice(None) if solved is None else solved
    check_uvs(name, layer.name, positions[chosen], uvs[chosen])
    tiles, placed = lay_out(f"UV map '{layer.name}' of '{name}'", uvs[chosen])
    places = placed if solved is None else np.zeros_like(uvs)
    places[chosen] = placed
    normals, of_tangents = shading_normals(mesh)
    return {
        "positions": positions,
        "normals": normals,
        "uvs": places,
        "tangents": _tangents(coordinates, vertices, of_tangents, uvs),
        "materials": materials,
        "uv_map": layer.name,
        "tiles": tiles,
        "slots": names,
        "solved": solved,
    }


def shading_normals(mesh: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return two (T, 3, 3) float32 normals of the loop triangles' corners in the object's space, as Cycles has them.

    The first shade, the second make tangents. Without custom normals, and before 5.1 without sharp edges on a mesh with
    smooth faces, Cycles takes the normals of vertices on smooth faces and that of each triangle on others. Blender's
    corner normals there are those of polygons. Since 5.1 a mesh with smooth faces has corner normals, but its flat
    faces have tangents of the triangles' normals. (Measured on 4.2, 5.0 and 5.2.)
    """
    import bpy

    count = len(mesh.loop_triangles)
    loops = read_attribute(mesh.loop_triangles, "loops", 3 * count, np.int32).reshape(-1, 3)
    corners = read_attribute(mesh.corner_normals, "vector", 3 * len(mesh.loops)).reshape(-1, 3)[loops]
    is_smooth = read_attribute(mesh.polygons, "use_smooth", len(mesh.polygons), bool)
    if is_smooth.all():
        return corners, corners
    has_corner_normals = bpy.app.version >= (5, 1, 0)
    is_sharp = has_corner_normals or read_attribute(mesh.edges, "use_edge_sharp", len(mesh.edges), bool).any()
    vertices = read_attribute(mesh.loop_triangles, "vertices", 3 * count, np.int32).reshape(-1, 3)
    at_vertices = read_attribute(mesh.vertex_normals, "vector", 3 * len(mesh.vertices)).reshape(-1, 3)[vertices]
    by_corner = mesh.has_custom_normals or (is_smooth.any() and is_sharp)
    flat = read_attribute(mesh.loop_triangles, "normal", 3 * count).reshape(-1, 1, 3)
    flat = np.where(flat.any(axis=2, keepdims=True), flat, corners)  # a triangle without area has none
    polygons = read_attribute(mesh.loop_triangles, "polygon_index", count, np.int32)
    of_faces = np.where(is_smooth[polygons][:, None, None], corners if by_corner else at_vertices, flat)
    shading = corners if by_corner else of_faces
    return shading, of_faces if has_corner_normals else shading


def mesh_with_normals(name: str, coordinates: np.ndarray, triangles: np.ndarray, normals: np.ndarray) -> Any:
    """Return a new Blender mesh of triangles (T, 3) of vertices (V, 3), with custom normals (T, 3, 3) float32.

    A vertex becomes one for each of its normals. Around one vertex, Blender would make one of normals that differ by
    less than about 1°, and MikkTSpace would join their corners.
    """
    keys = np.column_stack([triangles.reshape(-1).astype(np.int32), (normals.reshape(-1, 3) + 0.0).view(np.int32)])
    vertices, corners = np.unique(keys, axis=0, return_inverse=True)
    mesh = mesh_of_faces(name, coordinates.reshape(-1, 3)[vertices[:, 0]], corners.reshape(-1, 3))
    mesh.normals_split_custom_set(normals.reshape(-1, 3))
    return mesh


def read_attribute(collection: Any, attribute: str, size: int, kind: type = np.float32) -> np.ndarray:
    """Return (size,) the values of an attribute of all elements of a Blender collection."""
    values = np.empty(size, kind)
    collection.foreach_get(attribute, values)
    return values


def _tangents(coordinates: np.ndarray, vertices: np.ndarray, normals: np.ndarray, uvs: np.ndarray) -> np.ndarray:
    """Return (T, 3, 4) MikkTSpace tangents and signs of triangles, computed by Blender on temporary meshes.

    A large mesh is computed in parts. Each has all triangles around its corners, on which a tangent depends: above
    about 10 000 triangles Blender uses threads, and the last bits differ from run to run.
    """
    triangles = vertices.reshape(-1, 3)
    if len(triangles) <= _TOGETHER:
        return _tangents_together(coordinates, triangles, normals, uvs)
    # By place: Mikkelsen welds corners by coordinates, not by vertex.
    _, places = np.unique(coordinates.reshape(-1, 3), axis=0, return_inverse=True)
    corners = places.reshape(-1)[triangles]
    result = np.empty((len(triangles), 3, 4), np.float32)
    for own in _parts(coordinates.reshape(-1, 3)[triangles].mean(axis=1), np.arange(len(triangles))):
        around = np.zeros(places.max() + 1, bool)
        around[corners[own]] = True
        with_ring = np.flatnonzero(around[corners].any(axis=1))
        tangents = _tangents_together(coordinates, triangles[with_ring], normals[with_ring], uvs[with_ring])
        result[own] = tangents[np.searchsorted(with_ring, own)]
    return result


def _parts(middles: np.ndarray, chosen: np.ndarray) -> Iterator[np.ndarray]:
    """Yield compact parts of triangles, from repeated halving across the longest side; indices ascend."""
    if len(chosen) <= _TOGETHER // 2:
        yield np.sort(chosen)
        return
    places = middles[chosen]
    order = np.argsort(places[:, np.ptp(places, axis=0).argmax()], kind="stable")
    half = len(chosen) // 2
    yield from _parts(middles, chosen[order[:half]])
    yield from _parts(middles, chosen[order[half:]])


def mesh_of_faces(name: str, vertices: np.ndarray, faces: np.ndarray) -> Any:
    """Return a new Blender mesh of vertices (V, 3) and faces (F, N) of N corners each."""
    import bpy

    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", vertices.astype(np.float32).ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", faces.astype(np.int32).ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, faces.shape[1], dtype=np.int32))
    mesh.update(calc_edges=True)
    return mesh


def _tangents_together(
    coordinates: np.ndarray, triangles: np.ndarray, normals: np.ndarray, uvs: np.ndarray
) -> np.ndarray:
    import bpy

    count = len(uvs)
    mesh = mesh_with_normals("irpso tangents", coordinates, triangles, normals)
    try:
        # Not kept in a variable: the next call adds a layer and frees the memory it would point to.
        mesh.uv_layers.new(name="irpso").uv.foreach_set("vector", uvs.ravel())
        mesh.calc_tangents(uvmap="irpso")
        tangents = read_attribute(mesh.loops, "tangent", 9 * count).reshape(-1, 3, 3)
        signs = read_attribute(mesh.loops, "bitangent_sign", 3 * count).reshape(-1, 3, 1)
    finally:
        bpy.data.meshes.remove(mesh)
    return np.concatenate([tangents, signs], axis=-1)


def _to_world(name: str, corners: dict[str, Any], matrix: np.ndarray) -> MeshData:
    linear = matrix[:3, :3]
    normals = corners["normals"] @ np.linalg.inv(linear)
    tangents = corners["tangents"][..., :3] @ linear.T
    # A mirrored object flips n × t, so the sign flips.
    signs = corners["tangents"][..., 3:] * np.sign(np.linalg.det(linear))
    return MeshData(
        name=name,
        matrix=matrix,
        **corners
        | {
            "positions": (corners["positions"] @ linear.T + matrix[:3, 3]).astype(np.float32),
            "normals": unit(normals).astype(np.float32),
            "tangents": np.concatenate([unit(tangents), signs], axis=-1).astype(np.float32),
        },
    )
