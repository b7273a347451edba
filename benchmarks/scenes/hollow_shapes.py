"""Shapes with interreflection: unwrapped meshes that face +z. All but the scan's parts are made in code."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector

from . import subjects

_MARGIN = 0.01  # of the UV square
_ISLAND = 0.2  # of the UV square: radius of a part of a scan
_Stroke = Sequence[tuple[float, float]]
_LETTERS: tuple[tuple[_Stroke, ...], ...] = (
    (((0.75, 1), (0, 1), (0, 0.5), (0.75, 0.5), (0.75, 0), (0, 0)),),
    (((0.4, 0), (0.4, 1)),),
    (((0, 0), (0, 1), (0.75, 1), (0.75, 0.5), (0, 0.5)),),
)
# Cubes of side 1: x, layer, z, degrees around the vertical.
_PILE = ((-0.7, 0, 0.1, 12), (0.62, 0, 0.35, -20), (0.05, 0, -0.85, 40), (-0.3, 1, -0.1, -28), (0.55, 1, -0.3, 35),
         (0.1, 2, -0.2, 8))  # fmt: skip


def bowl() -> bpy.types.Object:
    """Return a bowl that leans toward the viewer."""
    radius = (0.0, 0.3, 0.45, 0.75, 0.95, 1.02, 0.99, 0.96, 0.88, 0.68, 0.4, 0.15, 0.0)
    height = (-0.5, -0.5, -0.45, -0.2, 0.2, 0.5, 0.53, 0.5, 0.2, -0.15, -0.36, -0.4, -0.4)
    return _revolved(radius, height, 55.0)


def vase() -> bpy.types.Object:
    """Return a vase seen from above."""
    radius = (0.0, 0.4, 0.5, 0.65, 0.6, 0.42, 0.4, 0.5, 0.47, 0.44, 0.34, 0.36, 0.54, 0.58, 0.4, 0.0)
    height = (-1.0, -1.0, -0.9, -0.5, 0.0, 0.4, 0.6, 0.8, 0.83, 0.8, 0.6, 0.4, 0.0, -0.5, -0.85, -0.9)
    return _revolved(radius, height, 62.0)


def cloth(folds: float = 3.5, angles: tuple[float, float] = (40.0, 85.0)) -> bpy.types.Object:
    """Return a sheet in folds, deeper from above to below. angles: of the steepest parts there, degrees.

    A row is a sine-generated curve (Langbein & Leopold 1966): its direction is a sine of the length along it.
    """
    down, along = np.meshgrid(np.linspace(0, 1, 161), np.linspace(0, 1, 401), indexing="ij")
    steepest = np.radians(angles[0] + (angles[1] - angles[0]) * down)
    direction = steepest * np.sin(2 * np.pi * folds * along + 1.2 * np.sin(np.pi * down))
    length = 2.4 / along.shape[1]
    x, z = (length * np.cumsum(part, axis=1) for part in (np.cos(direction), np.sin(direction)))
    x, z = (part - part.mean(axis=1, keepdims=True) for part in (x, z))
    return subjects.finished(_sheet(np.stack([x, 1 - 2 * down, z], axis=-1), 0.8), turn=(np.radians(-20), 0, 0))


def coin() -> bpy.types.Object:
    """Return one side of a coin: a rim, letters and beads, with slopes of up to 52 degrees."""
    y, x = np.meshgrid(np.linspace(1, -1, 401), np.linspace(-1, 1, 401), indexing="ij")
    radius, size = np.hypot(x, y), 0.56
    raised = [np.abs(radius - 0.93) - 0.06]
    for middle, letter in zip((-0.44, 0.02, 0.48), _LETTERS, strict=True):
        raised += [size * _distance((x - middle) / size + 0.4, y / size + 0.5, stroke) - 0.07 for stroke in letter]
    for angle in np.radians((60, 90, 120, 240, 270, 300)):
        raised.append(np.hypot(x - 0.64 * np.cos(angle), y - 0.64 * np.sin(angle)) - 0.09)
    step = np.clip(0.5 - np.minimum.reduce(raised) / 0.14, 0, 1)
    points = np.stack([x, y, 0.12 * step * step * (3 - 2 * step)], axis=-1)
    return subjects.finished(_sheet(points, 0.95, radius < 1), turn=(np.radians(-15), 0, 0))


def cubes() -> bpy.types.Object:
    """Return a pile of cubes with a gap between layers."""
    corners = np.stack(np.meshgrid(*[(-0.5, 0.5)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    sides = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    points, faces = [], []
    for number, (x, layer, z, turn) in enumerate(_PILE):
        points.append(corners @ np.array(Matrix.Rotation(np.radians(turn), 3, "Y")).T + (x, 1.01 * layer, z))
        faces.append(sides + len(corners) * number)
    rows = len(_PILE)
    place, corner = np.arange(6 * rows)[:, None], np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    cell = np.stack(np.broadcast_arrays(*np.divmod(place, 6)), axis=-1)
    uv = (cell + 0.05 + 0.9 * corner) / (rows, 6)
    made = subjects.finished(
        _unwrapped(np.concatenate(points), np.concatenate(faces), uv), turn=(np.radians(38), np.radians(25), 0)
    )
    made.data.shade_flat()
    return made


def part_of_scan(path: Path, middle: Sequence[float], radius: float, turn: float) -> bpy.types.Object:
    """Return the part of an .obj file within a ball; its UVs fill the square. turn: around the vertical, degrees.

    Without faces elsewhere in the UVs: the inside of the mouth.
    """
    made = subjects.scan(path, 1)
    edited = bmesh.new()
    edited.from_mesh(made.data)
    layer = edited.loops.layers.uv.active
    place = {face: np.array(face.loops[0][layer].uv) for face in edited.faces}
    near = [face for face in place if (face.calc_center_median() - Vector(middle)).length <= radius]
    center = np.median([place[face] for face in near], axis=0)
    island = {face for face in near if np.linalg.norm(place[face] - center) < _ISLAND}
    bmesh.ops.delete(edited, geom=[face for face in place if face not in island], context="FACES")
    edited.to_mesh(made.data)
    edited.free()
    made = subjects.finished(made, turn=(0, np.radians(turn), 0))
    uv = np.empty((len(made.data.loops), 2), np.float32)
    made.data.uv_layers[0].data.foreach_get("uv", uv.ravel())
    _set_uv(made.data, (uv - uv.min(axis=0)) / np.ptp(uv, axis=0))
    return made


def _revolved(radius: tuple[float, ...], height: tuple[float, ...], tilt: float) -> bpy.types.Object:
    """Return a body of revolution. radius, height: of its profile. tilt: toward the viewer, degrees."""
    body = subjects.lathe(radius, height)
    _unwrap_lathed(body.data)
    return subjects.finished(body, turn=(np.radians(tilt), 0, 0))


def _unwrap_lathed(mesh: bpy.types.Mesh) -> None:
    """Give a lathed body texture coordinates: the angle, and the length along its profile."""
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    rings = points.reshape(-1, subjects.SEGMENTS, 3)
    profile = np.stack([np.hypot(rings[:, 0, 0], rings[:, 0, 2]), rings[:, 0, 1]], axis=-1)
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=-1))])
    corner = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corner)
    ring, segment = (part.reshape(-1, 4) for part in np.divmod(corner, subjects.SEGMENTS))
    around = segment / subjects.SEGMENTS
    around[(np.ptp(segment, axis=1) > 1)[:, None] & (segment == 0)] = 1.0  # the last faces end where the first begin
    _set_uv(mesh, np.stack([around, along[ring] / along[-1]], axis=-1))


def _sheet(points: np.ndarray, side: float, included: np.ndarray | None = None) -> bpy.types.Object:
    """Return a sheet of points (rows, columns, 3), from the top left. side: of the UVs' square. included: a mask."""
    rows, columns = points.shape[:2]
    number = np.arange(rows * columns).reshape(rows, columns)
    faces = np.stack([number[1:, :-1], number[1:, 1:], number[:-1, 1:], number[:-1, :-1]], axis=-1).reshape(-1, 4)
    if included is not None:
        faces = faces[included.ravel()[faces].all(axis=-1)]
        number, faces = np.unique(faces, return_inverse=True)
        faces = faces.reshape(-1, 4)
    row, column = np.divmod(number.ravel(), columns)
    uv = np.stack([column / (columns - 1), 1 - row / (rows - 1)], axis=-1)
    return _unwrapped(points.reshape(-1, 3)[number.ravel()], faces, side * uv[faces])


def _unwrapped(points: np.ndarray, faces: np.ndarray, uv: np.ndarray) -> bpy.types.Object:
    """Return an object in the open scene of points (V, 3), faces (F, 4) and the UVs of their corners (F, 4, 2)."""
    mesh = bpy.data.meshes.new("made")
    mesh.from_pydata(points.tolist(), [], faces.tolist())
    _set_uv(mesh, uv)
    made = bpy.data.objects.new("made", mesh)
    bpy.context.scene.collection.objects.link(made)
    return made


def _set_uv(mesh: bpy.types.Mesh, uv: np.ndarray) -> None:
    """Set the UVs (…, 2) in 0…1 of a mesh's corners."""
    layer = mesh.uv_layers[0] if mesh.uv_layers else mesh.uv_layers.new(name="UVMap")
    layer.data.foreach_set("uv", (_MARGIN + (1 - 2 * _MARGIN) * uv).astype(np.float32).ravel())


def _distance(x: np.ndarray, y: np.ndarray, stroke: _Stroke) -> np.ndarray:
    """Return the distance of points (x, y) to a polyline."""
    place, distances = np.stack([x, y], axis=-1), []
    for begin, end in zip(np.array(stroke, float), np.array(stroke[1:], float), strict=False):
        along = end - begin
        part = np.clip((place - begin) @ along / (along @ along), 0, 1)
        distances.append(np.linalg.norm(place - begin - part[..., None] * along, axis=-1))
    return np.minimum.reduce(distances)
