"""Rays cast at a mesh by Blender's bounding volume hierarchy."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from ..core.steps import blocking
from ..geometry.light.light_transport import Cast
from ..geometry.surface.mesh import MeshData

_CHUNK = 1 << 14  # triangles: some hundredths of a second


def ray_caster_steps(mesh: MeshData) -> Generator[None, None, Cast]:
    """Yield often; return a function of origins (N, 3) and directions (N, 3): the triangle (N,) int first hit by each
    ray, −1 for none, and its place (N, 3) float32. Triangles of occluders are numbered after those of the mesh.
    """
    from mathutils.bvhtree import BVHTree

    # Triangles of a chunk share their corners: the lists that Blender wants are half as large, and rays meet them
    # sooner.
    corners = np.ascontiguousarray(mesh.opaque, np.float32).reshape(-1, 3).view("V12").ravel()
    places: list[list[float]] = []
    triangles: list[list[int]] = []
    for start in range(0, len(corners), 3 * _CHUNK):
        own, corner = np.unique(corners[start : start + 3 * _CHUNK], return_inverse=True)
        triangles += (corner.reshape(-1, 3) + len(places)).tolist()
        places += own.view(np.float32).reshape(-1, 3).tolist()
        yield
    tree = BVHTree.FromPolygons(places, triangles)
    del places, triangles
    yield

    def cast(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        triangle = np.full(len(origins), -1, np.int32)
        place = np.zeros((len(origins), 3), np.float32)
        for number, ray in enumerate(zip(origins.tolist(), directions.tolist(), strict=True)):
            where, _, index, _ = tree.ray_cast(*ray)
            if index is not None:
                triangle[number], place[number] = index, where
        return triangle, place

    return cast


ray_caster = blocking("ray_caster", ray_caster_steps)
