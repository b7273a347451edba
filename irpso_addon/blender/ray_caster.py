"""Rays cast at a mesh by Blender's bounding volume hierarchy."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..geometry.surface.mesh import MeshData


def ray_caster(mesh: MeshData) -> Any:
    """Return a function of origins (N, 3) and directions (N, 3): the triangle (N,) int first hit by each ray, −1 for
    none, and its place (N, 3) float32. Triangles of occluders are numbered after those of the mesh.
    """
    from mathutils.bvhtree import BVHTree

    # Triangles share their corners: the lists that Blender wants are half as large, and rays meet them sooner.
    corners = np.ascontiguousarray(mesh.opaque, np.float32).reshape(-1, 3).view("V12").ravel()
    places, corner = np.unique(corners, return_inverse=True)
    tree = BVHTree.FromPolygons(places.view(np.float32).reshape(-1, 3).tolist(), corner.reshape(-1, 3).tolist())

    def cast(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        triangle = np.full(len(origins), -1, np.int32)
        place = np.zeros((len(origins), 3), np.float32)
        for number, ray in enumerate(zip(origins.tolist(), directions.tolist(), strict=True)):
            where, _, index, _ = tree.ray_cast(*ray)
            if index is not None:
                triangle[number], place[number] = index, where
        return triangle, place

    return cast
