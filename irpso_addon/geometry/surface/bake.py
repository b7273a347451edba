"""Geometry bakes: the surface at each texel of a UV square, or at each pixel of a camera."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ...capture.camera import Camera
from ...core.errors import InputError
from ...gpu import context, raster
from ..domain import GeometryBake
from .lens import undistorted_frame
from .mesh import MeshData
from .slots import OPTION, overlapping_slots

# Largest share of covered texels in several triangles: tightly packed islands touch by rounding, without overlap.
OVERLAP_LIMIT = 0.005
_OVERLAP_SIZE = 1024  # side, in texels, of the square for the overlap test
_MAX_SIDE = 16384  # most texels drawn at once along a side, on every device
_BLOCK = 1024  # side, in texels, of the blocks for the coverage test
_NEAREST = 1e-4  # near plane, as a fraction of the farthest depth


@dataclass(frozen=True)
class SurfaceBake(GeometryBake):
    """A geometry bake of a mesh, with its triangles.

    face_normal: (H, W, 3) float32 unit normal of the flat triangle, on the shading normal's side.
    triangle: (H, W) int32 triangle number, −1 for none.
    """

    face_normal: np.ndarray
    triangle: np.ndarray


def surface_bake(bake: GeometryBake) -> SurfaceBake:
    """Return a bake as that of a mesh. Raises ValueError for a card's."""
    if not isinstance(bake, SurfaceBake):
        raise ValueError("the bake is not of a mesh")
    return bake


def bake_uv(mesh: MeshData, width: int, height: int, allow_overlap: bool = False) -> SurfaceBake:
    """Return the surface at each texel centre of the UV square, at any resolution.

    Tangents are orthogonal to the normals, so (t, sign · n × t, n) is an orthonormal frame: the solver's tangent space.
    Raises InputError, with the mesh's name, where more than 0.5 % of the covered texels lie in several triangles
    (unless allowed: then the last triangle counts).
    """
    if not allow_overlap:
        _refuse_overlap(mesh)
    return _in_blocks(mesh, _uv_places(mesh, width, height), width, height, nearest=False)


def _in_blocks(mesh: MeshData, places: np.ndarray, width: int, height: int, nearest: bool) -> SurfaceBake:
    """Return ``_bake``, drawn in parts where UDIM tiles side by side or photographs exceed a texture's size."""
    context.ensure()
    side = min(context.max_texture_size(), _MAX_SIDE)
    if max(width, height) <= side:
        return _bake(mesh, places, width, height, nearest)
    rows = []
    for y in range(0, height, side):
        blocks = [
            _bake(mesh, _moved(places, x, y), min(side, width - x), min(side, height - y), nearest)
            for x in range(0, width, side)
        ]
        rows.append(_joined(blocks, axis=1))
    return _joined(rows, axis=0)


def _moved(places: np.ndarray, x: int, y: int) -> np.ndarray:
    """Return places with the picture's lower left corner at pixel (x, y)."""
    return places - places[..., 3:] * np.array([x, y, 0, 0])


def _joined(parts: list[SurfaceBake], axis: int) -> SurfaceBake:
    names = [item.name for item in fields(SurfaceBake)]
    return SurfaceBake(**{name: np.concatenate([getattr(part, name) for part in parts], axis) for name in names})


def uv_coverage(mesh: MeshData, width: int, height: int) -> np.ndarray:
    """Return (H, W) bool: texels whose centre a triangle covers; computed in blocks, with little memory.

    Where an edge passes through a centre, the result may differ from ``bake_uv`` by rounding.
    """
    places = _uv_places(mesh, width, height)
    covered = np.zeros((height, width), bool)
    for y in range(0, height, _BLOCK):
        for x in range(0, width, _BLOCK):
            size = min(_BLOCK, width - x), min(_BLOCK, height - y)
            numbers = raster.triangle_numbers(_moved(places, x, y), *size, first=False)
            covered[y : y + _BLOCK, x : x + _BLOCK] = numbers > 0
    return covered


def bake_camera(mesh: MeshData, camera: Camera) -> SurfaceBake:
    """Return the nearest surface at the centre of each of a camera's pixels, back faces and occluders included.

    Triangles of occluders are numbered after those of the mesh, and have their flat normals and no texture coordinates;
    those farther away than the whole mesh are left out. A perspective camera's near plane is at 1e-4 of the mesh's
    farthest depth; an orthographic one sees its full direction.
    Triangles are drawn with straight edges: for a lens with distortion a camera without it is drawn, at the same scale,
    and each pixel takes that camera's nearest pixel.
    """
    if any(camera.distortion):
        plain, index = undistorted_frame(camera)
        return _picked(bake_camera(mesh, plain), index)
    return _in_blocks(mesh, _camera_places(mesh, camera), camera.width, camera.height, nearest=True)


def camera_triangles(mesh: MeshData, camera: Camera) -> np.ndarray:
    """Return (H, W) int32: the triangle numbers of ``bake_camera``, −1 for none. The camera has no distortion."""
    places = _camera_places(mesh, camera)
    return raster.nearest_triangles(places, camera.width, camera.height) - 1


def _picked(bake: SurfaceBake, index: np.ndarray) -> SurfaceBake:
    """Return a bake gathered from another by flat indices (H, W), −1 for an empty pixel."""
    empty = {"triangle": -1}
    arrays = {}
    for item in fields(SurfaceBake):
        values = getattr(bake, item.name)
        picked = values.reshape(-1, *values.shape[2:])[np.maximum(index, 0)]
        picked[index < 0] = empty.get(item.name, 0)
        arrays[item.name] = picked
    return SurfaceBake(**arrays)


def overlap(mesh: MeshData, size: int = _OVERLAP_SIZE) -> float:
    """Return the share of the UV square's covered texels that lie in several triangles, 0…1.

    A UDIM tile has size × size texels.
    """
    return _shared(*_first_and_last(mesh, size))


def _first_and_last(mesh: MeshData, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and the last triangle over each texel, from 1; 0 for none. UDIM tiles are stacked in rows."""
    places = _uv_places(mesh, size * len(mesh.tiles), size)
    numbers = [
        [raster.triangle_numbers(_moved(places, x, 0), size, size, first) for first in (True, False)]
        for x in range(0, size * len(mesh.tiles), size)
    ]
    first, last = (np.concatenate(part) for part in zip(*numbers, strict=True))
    return first, last


def _shared(first: np.ndarray, last: np.ndarray) -> float:
    return float((first != last).sum() / max((last > 0).sum(), 1))


def _refuse_overlap(mesh: MeshData) -> None:
    first, last = _first_and_last(mesh, _OVERLAP_SIZE)
    shared = _shared(first, last)
    if shared > OVERLAP_LIMIT:
        where = f"UV map '{mesh.uv_map}' of '{mesh.name}' overlaps itself over {100 * shared:.3g} % of its texels"
        if slots := overlapping_slots(mesh.materials, first, last):
            names = ", ".join(f"'{mesh.slots[slot]}'" if slot < len(mesh.slots) else str(slot) for slot in slots)
            raise InputError(
                f"{where}, because the material slots {names} share it; recover them one by one ({OPTION}), or unwrap"
                " them side by side"
            )
        if mesh.copied_by and _repeated(mesh, first, last):
            names = " or ".join(f"'{name}'" for name in mesh.copied_by)
            raise InputError(
                f"{where}, because modifier {names} makes copies that share it; switch that off in the viewport until"
                " the maps are kept, or apply it and unwrap the mesh again"
            )
        raise InputError(f"{where}; unwrap the mesh without overlaps")


def _repeated(mesh: MeshData, first: np.ndarray, last: np.ndarray) -> bool:
    """Return whether most overlaps are of triangles with identical texture coordinates."""
    shared = first != last
    corners = mesh.uvs[..., 0] + 1j * mesh.uvs[..., 1]
    one, other = (np.sort(corners[numbers[shared] - 1], axis=-1) for numbers in (first, last))
    return bool((one == other).all(axis=-1).mean() > 0.5)


def _bake(mesh: MeshData, places: np.ndarray, width: int, height: int, nearest: bool) -> SurfaceBake:
    corners = {name: getattr(mesh, name) for name in ("positions", "normals", "tangents", "uvs")}
    if beside := len(places) - len(mesh.positions):
        rest = {name: np.zeros((beside, *values.shape[1:]), np.float32) for name, values in corners.items()}
        rest["positions"] = mesh.occluders
        corners = {name: np.concatenate([values, rest[name]]) for name, values in corners.items()}
    drawn = raster.rasterize(places, corners, width, height, nearest)
    return SurfaceBake(
        position=drawn["position"][..., :3].copy(),
        normal=drawn["normal"][..., :3].copy(),
        tangent=drawn["tangent"],
        coverage=drawn["position"][..., 3] > 0.5,
        uv=drawn["uv"][..., :2].copy(),
        face_normal=drawn["face"][..., :3].copy(),
        triangle=drawn["face"][..., 3].astype(np.int32) - 1,
    )


def _check_count(mesh: MeshData) -> None:
    """Raise InputError where mesh and occluders have more triangles than can be told apart."""
    own, beside = len(mesh.positions), len(mesh.occluders)
    if own + beside > raster.MAX_TRIANGLES:
        objects = f"'{mesh.name}' has {own} triangles" + (f", its occluders {beside}" if beside else "")
        raise InputError(
            f"{objects}; the limit is {raster.MAX_TRIANGLES} in all: reduce them with a Decimate modifier or a lower"
            " Subdivision level" + (", or choose fewer occluders" if beside else "")
        )


def _uv_places(mesh: MeshData, width: int, height: int) -> np.ndarray:
    _check_count(mesh)
    places = np.zeros((*mesh.uvs.shape[:2], 4))
    places[..., :2] = mesh.texel_uvs * np.array([width, height], np.float64)
    places[..., 3] = 1.0
    return places


def _camera_places(mesh: MeshData, camera: Camera) -> np.ndarray:
    """Return (T + M, 3, 4) a camera's pixel coordinates x·w, y·w, depth·w (depth in −1…1) and w, occluders last."""
    _check_count(mesh)
    inverse = np.linalg.inv(np.asarray(camera.matrix, np.float64))
    local = mesh.opaque.astype(np.float64) @ inverse[:3, :3].T + inverse[:3, 3]
    depth = -local[..., 2]
    w = depth if camera.perspective else np.ones_like(depth)
    plane = local[..., :2] * np.asarray(camera.scale) + w[..., None] * np.asarray(camera.centre)
    # What lies behind the mesh, or behind a camera with perspective, hides none of it.
    nearest, farthest = float(depth.min()), float(depth[: len(mesh.positions)].max())
    if camera.perspective:
        nearest, farthest = max(nearest, 0.0), max(farthest, 1e-30)
    margin = 1e-3 * max(farthest - nearest, 1e-6 * abs(farthest), 1e-30)  # against rounding at the planes
    near, far = nearest - margin, farthest + margin
    if camera.perspective:
        near = max(near, _NEAREST * far)
        clip = ((far + near) * depth - 2 * far * near) / (far - near)
    else:
        clip = (2 * depth - far - near) / (far - near)
    return np.concatenate([plane, clip[..., None], w[..., None]], axis=-1)
