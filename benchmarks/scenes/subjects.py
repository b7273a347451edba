"""Meshes of the subjects: made in code, Blender's monkey, and scans. Each faces +z, upright along +y."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import bmesh
import bpy
import numpy as np

SEGMENTS = 256  # around a lathed body: its facets are well below a pixel


def ball():
    """Return a sphere."""
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=7, radius=1)
    return finished(bpy.context.object)


def monkey(levels: int = 3):
    """Return Blender's monkey, ``levels`` times subdivided."""
    bpy.ops.mesh.primitive_monkey_add()
    return finished(bpy.context.object, levels, turn=(-np.pi / 2, 0, 0))


def scan(path: str | Path, levels: int = 2):
    """Return the mesh of an .obj file with axes x right, y up, z to the viewer."""
    bpy.ops.wm.obj_import(filepath=str(path), forward_axis="Y", up_axis="Z")
    made = bpy.context.object
    made.data.materials.clear()
    return finished(made, levels)


def pot():
    """Return a bumpy vase with two handles."""
    height = np.array([-1.0, -1.0, -0.95, -0.7, -0.3, 0.1, 0.45, 0.65, 0.8, 0.95, 1.0, 0.95, 0.7])
    radius = np.array([0.0, 0.35, 0.42, 0.62, 0.78, 0.76, 0.56, 0.4, 0.36, 0.44, 0.42, 0.36, 0.28])

    def bumps(y, around):
        return 1 + 0.035 * np.sin(9 * around) * np.sin(11 * y) * np.exp(-((y / 0.7) ** 4))

    body = lathe(radius, height, bumps)
    handles = []
    for side in (-1, 1):
        bpy.ops.mesh.primitive_torus_add(
            major_radius=0.3, minor_radius=0.07, major_segments=128, minor_segments=48, location=(0.72 * side, 0.35, 0)
        )
        handles.append(bpy.context.object)
    return finished(_joined([body, *handles]), turn=(np.radians(15), np.radians(20), 0))


def goblet():
    """Return a goblet that leans toward the viewer, open bowl in view."""
    height = np.array([-1.0, -1.0, -0.96, -0.9, -0.6, -0.3, -0.15, 0.1, 0.5, 1.0, 1.03, 1.0, 0.5, 0.15, 0.0, -0.03])
    radius = np.array([0.0, 0.5, 0.52, 0.25, 0.09, 0.11, 0.3, 0.58, 0.68, 0.74, 0.71, 0.68, 0.62, 0.5, 0.25, 0.0])
    return finished(lathe(radius, height), turn=(np.radians(42), 0, np.radians(-6)))


def harvest():
    """Return a bowl of fruit-like bodies with shadows and interreflection; their materials are by ``set_surface``."""
    height = np.array([-0.75, -0.75, -0.6, -0.2, 0.05, 0.1, 0.05, -0.2, -0.5, -0.62])
    radius = np.array([0.0, 0.5, 0.75, 1.05, 1.25, 1.22, 1.18, 0.98, 0.6, 0.0])
    bowl = lathe(radius, height)
    set_surface(bowl, (0.55, 0.42, 0.3), 0.45, 0.0)
    parts = [bowl]
    rng = np.random.default_rng(5)
    places = [(-0.55, 0.0, 0.35), (0.1, -0.05, 0.55), (0.65, 0.0, 0.2), (-0.2, 0.3, -0.2), (0.45, 0.35, -0.35),
              (-0.65, 0.1, -0.35), (0.05, 0.55, 0.2)]  # fmt: skip
    surfaces = [((0.7, 0.08, 0.05), 0.2, 0.0), ((0.8, 0.55, 0.08), 0.5, 0.0), ((0.25, 0.5, 0.1), 0.35, 0.0),
             ((0.9, 0.6, 0.3), 0.35, 1.0), ((0.3, 0.08, 0.3), 0.15, 0.0), ((0.75, 0.75, 0.7), 0.6, 0.0),
             ((0.6, 0.62, 0.65), 0.45, 1.0)]  # fmt: skip
    for place, surface in zip(places, surfaces, strict=True):
        bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=6, radius=rng.uniform(0.3, 0.42), location=place)
        parts.append(bpy.context.object)
        parts[-1].scale = (1, rng.uniform(0.8, 1.2), 1)
        set_surface(parts[-1], *surface)
    bpy.ops.mesh.primitive_torus_add(
        major_radius=0.32, minor_radius=0.11, major_segments=128, minor_segments=48, location=(-0.25, 0.45, 0.45),
        rotation=(0.9, 0.5, 0),
    )  # fmt: skip
    set_surface(bpy.context.object, (0.1, 0.25, 0.6), 0.25, 0.0)
    return finished(_joined([*parts, bpy.context.object]), turn=(np.radians(38), 0, 0))


def lathe(radius: Sequence[float], height: Sequence[float], bumps: Callable | None = None):
    """Return a body of revolution around y through points (radius, height), smoothed by Catmull and Rom's spline.

    bumps: function of (height, angle) that returns factors of the radius.
    """
    r, y = (_spline(np.asarray(values, float), 16) for values in (radius, height))
    around = np.linspace(0, 2 * np.pi, SEGMENTS, endpoint=False)
    scale = np.ones((len(r), SEGMENTS)) if bumps is None else bumps(y[:, None], around[None])
    rings = np.maximum(r, 1e-4)[:, None] * scale
    tall = np.broadcast_to(y[:, None], rings.shape)
    vertices = np.stack([rings * np.sin(around), tall, rings * np.cos(around)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(len(r) - 1), np.arange(SEGMENTS), indexing="ij")
    after = (j + 1) % SEGMENTS
    corners = (i * SEGMENTS + j, i * SEGMENTS + after, (i + 1) * SEGMENTS + after, (i + 1) * SEGMENTS + j)
    mesh = bpy.data.meshes.new("lathe")
    mesh.from_pydata(vertices.tolist(), [], np.stack(corners, axis=-1).reshape(-1, 4).tolist())
    made = bpy.data.objects.new("lathe", mesh)
    bpy.context.scene.collection.objects.link(made)
    return made


def set_surface(obj, colour: tuple[float, float, float], roughness: float, metallic: float) -> None:
    """Store a part's material in attributes of its vertices, "tint", "rough" and "metal", which materials read."""
    count = len(obj.data.vertices)
    tint = np.tile(np.float32([*colour, 1]), count)
    obj.data.attributes.new("tint", "FLOAT_COLOR", "POINT").data.foreach_set("color", tint)
    for name, value in (("rough", roughness), ("metal", metallic)):
        attribute = obj.data.attributes.new(name, "FLOAT", "POINT")
        attribute.data.foreach_set("value", np.full(count, value, np.float32))


def fit(obj, width: float, height: float) -> None:
    """Centre an object on the z axis and scale it to lie inside ``width`` × ``height`` as seen along z."""
    points = np.empty(3 * len(obj.data.vertices), np.float32)
    obj.data.vertices.foreach_get("co", points)
    points = points.reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    scale = min(width / (high[0] - low[0]), height / (high[1] - low[1]))
    obj.data.vertices.foreach_set("co", ((points - (low + high) / 2) * scale).ravel())
    obj.data.update()


def _spline(values: np.ndarray, steps: int) -> np.ndarray:
    """Return the spline of Catmull & Rom (1974) through ``values``, ``steps`` points for each span."""
    padded = np.concatenate([[2 * values[0] - values[1]], values, [2 * values[-1] - values[-2]]])
    a, b, c, d = (padded[i : i + len(values) - 1, None] for i in range(4))
    t = np.arange(steps) / steps
    curve = b + t * (c - a) / 2 + t**2 * (a - 2.5 * b + 2 * c - d / 2) + t**3 * (1.5 * (b - c) + (d - a) / 2)
    return np.append(curve.ravel(), values[-1])


def _joined(parts: Sequence):
    bpy.ops.object.select_all(action="DESELECT")
    for part in parts:
        part.select_set(True)
    bpy.context.view_layer.objects.active = parts[0]
    bpy.ops.object.join()
    return bpy.context.object


def finished(obj, levels: int = 0, turn: tuple[float, float, float] = (0, 0, 0)):
    """Subdivide and turn an object, recompute its normals, shade it smooth; return it, without modifiers."""
    bpy.ops.object.select_all(action="DESELECT")
    obj.select_set(True)
    bpy.context.view_layer.objects.active = obj
    if levels:
        modifier = obj.modifiers.new("smooth", "SUBSURF")
        modifier.levels = levels
        bpy.ops.object.modifier_apply(modifier=modifier.name)
    obj.rotation_euler = [a + b for a, b in zip(obj.rotation_euler, turn, strict=True)]
    bpy.ops.object.transform_apply(location=True, rotation=True, scale=True)
    edited = bmesh.new()
    edited.from_mesh(obj.data)
    bmesh.ops.recalc_face_normals(edited, faces=edited.faces)
    edited.to_mesh(obj.data)
    edited.free()
    obj.data.shade_smooth()
    return obj
