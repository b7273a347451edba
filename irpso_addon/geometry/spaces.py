"""Normals in world and object space, for Blender's Normal Map node.

Measured in Cycles: the node's "Object Space" and "World Space" read 2c − 1 as the vector; "Blender Object Space" and
"Blender World Space" flip its Y and Z first. These maps are for the former.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .domain import GeometryBake

BLOCK = 1 << 18  # texels processed at a time

Change = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def world_normals(bake: GeometryBake, normals: np.ndarray) -> np.ndarray:
    """Return (H, W, 3) float32 unit normals in world axes from normals (H, W, 3) in the solver's frame.

    A card's world is its camera's frame. Texels outside the coverage become (0, 0, 1).
    """
    return changed_normals(bake, normals, lambda texels, frames, local: np.einsum("nij,ni->nj", frames, local))


def changed_normals(bake: GeometryBake, normals: np.ndarray, change: Change) -> np.ndarray:
    """Apply ``change`` to normals (H, W, 3) in blocks of N texels; return (H, W, 3) float32 unit vectors.

    change: takes flat indices (N,), the solver's frames (N, 3, 3) and float64 normals (N, 3), returns (N, 3) of any
    length. Texels outside the coverage or with a zero result become (0, 0, 1).
    """
    result = np.zeros((*bake.coverage.shape, 3), np.float32)
    result[..., 2] = 1
    texels = np.flatnonzero(bake.coverage)
    for start in range(0, len(texels), BLOCK):
        block = texels[start : start + BLOCK]
        local = np.asarray(normals, np.float64).reshape(-1, 3)[block]
        changed = change(block, bake.frames(np.unravel_index(block, bake.coverage.shape)), local)
        changed[~changed.any(axis=1)] = (0, 0, 1)
        result.reshape(-1, 3)[block] = unit(changed)
    return result


def object_normals(matrix: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return (…, 3) float32 unit normals in object axes from normals in world axes; matrix: (4, 4) object to world.

    Object to world is the inverse transpose, so world to object is the transpose.
    """
    return unit(np.asarray(normals, np.float64) @ np.asarray(matrix, np.float64)[:3, :3]).astype(np.float32)


def turned(matrix: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return (…, 3) float32 unit normals in world axes from normals in camera axes; matrix: (4, 4) camera to world."""
    return unit(np.asarray(normals, np.float64) @ np.asarray(matrix, np.float64)[:3, :3].T).astype(np.float32)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (…, 3) normalised; zero vectors stay."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)
