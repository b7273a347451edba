"""Relief of recovered normals: heights of a card, and detail above a mesh's own surface."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from ...capture.camera import Camera
from ...core.graph import connected
from ...core.steps import blocking
from ..surface.bake import SurfaceBake
from ..surface.footprint import texel_steps
from ..surface.mesh import MeshData
from .height import TEXELS, Height, card_slopes, integrate, integrate_steps, relief_from_log, tangent_slopes


def card_height_steps(camera: Camera, normals: np.ndarray, covered: np.ndarray) -> Generator[None, None, Height]:
    """Yield often; return the relief of a card in texels, toward the viewer; normals: (H, W, 3) in camera space.

    With a perspective camera heights are along its axis, relative to the mean depth, in texels at that depth.
    """
    slopes, weights = slopes_seen(camera, normals)
    yield
    values, steps = yield from integrate_steps(slopes, weights, covered)
    values = relief_from_log(values, camera.scale[0]) if camera.perspective else values
    return Height(values.astype(np.float32), covered, TEXELS, steps)


card_height = blocking("card_height", card_height_steps)


def slopes_seen(camera: Camera, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return slopes (H, W, 2) and weights (H, W), as ``card_slopes``, of a card's normals in camera space."""
    if not camera.perspective:
        return card_slopes(normals, camera.scale)
    rays = replace(camera, matrix=np.eye(4)).points()
    slopes, weights = card_slopes(normals, camera.scale, rays)
    if any(camera.distortion) and min(normals.shape[:2]) > 1:
        slopes = _through_lens(slopes, rays[..., :2] * camera.scale)
    return slopes, weights


def _through_lens(slopes: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return slopes (H, W, 2) per pixel of a lens from those per pixel of a camera without distortion.

    places: (H, W, 2) pixels in that camera, NaN where the lens shows nothing.
    """
    along = np.nan_to_num(np.stack(np.gradient(places, axis=(1, 0)), axis=-2))
    return np.einsum("hwka,hwa->hwk", along, np.nan_to_num(slopes))


def mesh_height(mesh: MeshData, bake: SurfaceBake, normals: np.ndarray, covered: np.ndarray) -> Height:
    """Return the relief on a mesh along its shading normals, in world units, of mean 0 in every UV island.

    normals: (H, W, 3) in the solver's frame. The relief comes from their tilt against the mesh's own normals: detail
    that is small against the mesh's bends. The mesh's own curvature is ignored.
    """
    along, torn = steps_along(mesh, bake)
    values, steps = integrate(*tangent_slopes(normals, along), covered & bake.coverage, torn)
    return Height(values.astype(np.float32), covered, "world", steps)


def steps_along(mesh: MeshData, bake: SurfaceBake) -> tuple[np.ndarray, np.ndarray]:
    """Return one texel's steps on the surface, and the neighbours in the UV square that are not neighbours on it.

    steps: (H, W, 2, 2) float32, [along x, along y][along the tangent, along the bitangent], in world units.
    torn: (H, W, 2) bool, where the texel and the next one along x, or along y, are of different UV islands.
    """
    height, width = bake.coverage.shape
    along = np.zeros((height, width, 2, 2), np.float32)
    inside = bake.coverage
    number = bake.triangle[inside]
    along[inside] = np.einsum("nij,nkj->nki", bake.frames(inside)[:, :2], texel_steps(mesh, width, height)[number])
    island = np.full((height, width), -1)
    island[inside] = uv_islands(mesh)[number]
    torn = np.zeros((height, width, 2), bool)
    torn[:, :-1, 0] = island[:, 1:] != island[:, :-1]
    torn[:-1, :, 1] = island[1:] != island[:-1]
    return along, torn


def uv_islands(mesh: MeshData) -> np.ndarray:
    """Return (T,) int component numbers of triangles that share corners in the world and in the UV square."""
    corners = np.concatenate([mesh.positions, mesh.uvs], axis=-1).reshape(-1, 5)
    corner = np.unique(corners, axis=0, return_inverse=True)[1].reshape(-1)
    triangle = np.repeat(np.arange(len(mesh.uvs)), 3)
    # Triangles and corners are nodes of one graph.
    joined = connected(len(mesh.uvs) + int(corner.max()) + 1, triangle, corner + len(mesh.uvs))
    return joined[: len(mesh.uvs)]
