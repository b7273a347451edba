"""Normals between the solver's tangent frame and that of Blender's normal maps.

The solver's frame is orthonormal in world space. Cycles uses the interpolated tangent in object space, not at right
angles to the normal, and transforms the resulting normal to world space. On the coarse monkey the two differ by up to
20°, more on an object of unequal scale. After this conversion 99 % of the pixels agree with Cycles within 0.03° (4.2 to
5.2). EEVEE's frame is a third one: in world space, of quads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ...geometry.spaces import BLOCK, changed_normals, unit
from ...geometry.surface.bake import SurfaceBake
from ...geometry.surface.mesh import MeshData
from ...reflectance.model import ReflectanceModel

Change = Callable[[MeshData, SurfaceBake, np.ndarray], np.ndarray]


def to_blender(mesh: MeshData, bake: SurfaceBake, normals: np.ndarray) -> np.ndarray:
    """Return a normal map for Blender, (H, W, 3) float32 unit XYZ, from normals (H, W, 3) in the solver's frame.

    Texels outside the coverage become (0, 0, 1).
    """
    return _convert(mesh, bake, normals, _into_blender)


def from_blender(mesh: MeshData, bake: SurfaceBake, normals: np.ndarray) -> np.ndarray:
    """Return normals in the solver's frame, (H, W, 3) float32 unit, from a normal map for Blender: XYZ in −1…1."""
    return _convert(mesh, bake, normals, _into_solver)


def world_to_blender(mesh: MeshData, bake: SurfaceBake, texels: np.ndarray, world: np.ndarray) -> np.ndarray:
    """Return (N, 3) float32 unit XYZ of a normal map for Blender at covered texels, flat indices (N,).

    world: (N, 3) normals of any length in world axes.
    """
    result = np.zeros((len(texels), 3), np.float32)
    for start in range(0, len(texels), BLOCK):
        block = slice(start, start + BLOCK)
        frames = _blender_frames(mesh, bake, texels[block])
        axes = np.broadcast_to(np.eye(3), frames.shape)
        normals = bake.normal.reshape(-1, 3)[texels[block]].astype(np.float64)
        given = np.where(np.any(world[block] != 0, axis=-1, keepdims=True), world[block], normals)
        result[block] = unit(_into_blender(axes, frames, mesh.matrix[:3, :3], given))
    return result


def converted_normals(
    model: ReflectanceModel, values: Mapping[str, np.ndarray], mesh: MeshData, bake: SurfaceBake, change: Change
) -> dict[str, np.ndarray]:
    """Return maps with their normals converted by ``change``: ``to_blender`` or ``from_blender``."""
    return {
        name: change(mesh, bake, value) if model.parameter(name).is_normal and np.ndim(value) == 3 else value
        for name, value in values.items()
    }


def _into_blender(solver: np.ndarray, blender: np.ndarray, linear: np.ndarray, normals: np.ndarray) -> np.ndarray:
    world = np.einsum("nij,ni->nj", solver, normals)
    # Coordinates in tangent, bitangent and normal by Cramer's rule, up to a positive factor: lengths cancel, and a
    # collapsed frame is harmless.
    tangent, bitangent, normal = blender.transpose(1, 0, 2)
    across = np.stack([np.cross(bitangent, normal), np.cross(normal, tangent), np.cross(tangent, bitangent)], axis=1)
    side = np.sign(np.einsum("ni,ni->n", across[:, 2], normal))[:, None]
    return side * np.einsum("nij,nj->ni", across, world @ linear)


def _into_solver(solver: np.ndarray, blender: np.ndarray, linear: np.ndarray, normals: np.ndarray) -> np.ndarray:
    world = np.einsum("nij,ni->nj", blender, normals) @ np.linalg.inv(linear)
    return np.einsum("nij,nj->ni", solver, world)


def _convert(mesh: MeshData, bake: SurfaceBake, normals: np.ndarray, change) -> np.ndarray:
    linear = mesh.matrix[:3, :3]
    return changed_normals(
        bake, normals, lambda texels, frames, local: change(frames, _blender_frames(mesh, bake, texels), linear, local)
    )


def _blender_frames(mesh: MeshData, bake: SurfaceBake, texels: np.ndarray) -> np.ndarray:
    """Return (N, 3, 3) rows tangent, bitangent, normal in object space, with the lengths that Cycles uses."""
    linear = mesh.matrix[:3, :3]
    number = bake.triangle.ravel()[texels]
    weights = _corner_weights(mesh.uvs[number].astype(np.float64), bake.uv.reshape(-1, 2)[texels])[..., None]
    normal = (unit(mesh.normals[number] @ linear) * weights).sum(axis=1)
    if _normals_are_unit():
        normal = unit(normal)
    corners = mesh.tangents[number].astype(np.float64)
    tangent = (unit(corners[..., :3] @ np.linalg.inv(linear).T) * weights).sum(axis=1)
    sign = bake.tangent.reshape(-1, 4)[texels, 3:] * np.sign(np.linalg.det(linear))
    return np.stack([tangent, sign * np.cross(normal, tangent), normal], axis=1)


def _normals_are_unit() -> bool:
    """Return whether Cycles normalises the interpolated normal first: since 5.1."""
    import bpy

    return bpy.app.version >= (5, 1, 0)


def _corner_weights(uvs: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Return (N, 3) barycentric weights of texture coordinates (N, 2) in triangles (N, 3, 2)."""
    edges, place = uvs[:, 1:] - uvs[:, :1], uv - uvs[:, 0]
    area = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    area = np.where(area == 0, np.inf, area)
    second = (place[:, 0] * edges[:, 1, 1] - place[:, 1] * edges[:, 1, 0]) / area
    third = (edges[:, 0, 0] * place[:, 1] - edges[:, 0, 1] * place[:, 0]) / area
    return np.stack([1 - second - third, second, third], axis=1)
