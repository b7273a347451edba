"""Normals in the world and in the object's own space, as Blender's Normal Map node takes them.

Measured in Cycles: the node's "Object Space" and "World Space" read 2c − 1 as the vector itself; "Blender Object Space"
and "Blender World Space" turn its Y and Z over first. The maps here are for the former.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .domain import GeometryBake

BLOCK = 1 << 18  # texels worked on at a time

Change = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def world_normals(bake: GeometryBake, normals: np.ndarray) -> np.ndarray:
    """Return (H, W, 3) float32 unit normals in world axes of normals (H, W, 3) in the solver's frame.

    On a card the world is its camera's own. Texels outside the coverage come back as (0, 0, 1).
    """
    return changed_normals(bake, normals, lambda texels, frames, given: np.einsum("nij,ni->nj", frames, given))


def changed_normals(bake: GeometryBake, normals: np.ndarray, change: Change) -> np.ndarray:
    """Return (H, W, 3) float32 unit vectors that ``change`` makes of normals (H, W, 3), block by block of N texels.

    change: of flat indices (N,), the solver's frames (N, 3, 3) and float64 normals (N, 3), returns (N, 3) of any
    length. Texels outside the coverage, and where nothing is left of a normal, come back as (0, 0, 1).
    """
    result = np.zeros((*bake.coverage.shape, 3), np.float32)
    result[..., 2] = 1
    texels = np.flatnonzero(bake.coverage)
    for start in range(0, len(texels), BLOCK):
        block = texels[start : start + BLOCK]
        given = np.asarray(normals, np.float64).reshape(-1, 3)[block]
        changed = change(block, bake.frames(np.unravel_index(block, bake.coverage.shape)), given)
        changed[~changed.any(axis=1)] = (0, 0, 1)
        result.reshape(-1, 3)[block] = unit(changed)
    return result


def object_normals(matrix: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return (…, 3) float32 unit normals in an object's axes of normals in the world's; matrix: (4, 4) object to world.

    A normal goes out by the inverse transpose, so it comes back by the transpose.
    """
    return unit(np.asarray(normals, np.float64) @ np.asarray(matrix, np.float64)[:3, :3]).astype(np.float32)


def turned(matrix: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return (…, 3) float32 unit normals turned from a camera's axes into the world's by its (4, 4) matrix."""
    return unit(np.asarray(normals, np.float64) @ np.asarray(matrix, np.float64)[:3, :3].T).astype(np.float32)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (…, 3) of length 1; those of length 0 stay."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)
