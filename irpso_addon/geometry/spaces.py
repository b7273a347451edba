"""Normals in the world and in the object's own space, as Blender's Normal Map node takes them.

Measured in Cycles: the node's "Object Space" and "World Space" read 2c − 1 as the vector itself; "Blender Object Space"
and "Blender World Space" turn its Y and Z over first. The maps here are for the former.
"""

from __future__ import annotations

import numpy as np

from .domain import GeometryBake

_BLOCK = 1 << 18  # texels worked on at a time


def world_normals(bake: GeometryBake, normals: np.ndarray) -> np.ndarray:
    """Return (H, W, 3) float32 unit normals in world axes of normals (H, W, 3) in the solver's frame.

    On a card the world is its camera's own. Texels outside the coverage come back as (0, 0, 1).
    """
    result = np.zeros((*bake.coverage.shape, 3), np.float32)
    result[..., 2] = 1
    texels = np.flatnonzero(bake.coverage)
    for start in range(0, len(texels), _BLOCK):
        block = texels[start : start + _BLOCK]
        given = np.asarray(normals, np.float64).reshape(-1, 3)[block]
        frames = bake.frames(np.unravel_index(block, bake.coverage.shape))
        result.reshape(-1, 3)[block] = _unit(np.einsum("nij,ni->nj", frames, given))
    return result


def object_normals(matrix: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return (…, 3) float32 unit normals in an object's axes of normals in the world's; matrix: (4, 4) object to world.

    A normal goes out by the inverse transpose, so it comes back by the transpose.
    """
    return _unit(np.asarray(normals, np.float64) @ np.asarray(matrix, np.float64)[:3, :3]).astype(np.float32)


def turned(matrix: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return (…, 3) float32 unit normals turned from a camera's axes into the world's by its (4, 4) matrix."""
    return _unit(np.asarray(normals, np.float64) @ np.asarray(matrix, np.float64)[:3, :3].T).astype(np.float32)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)
