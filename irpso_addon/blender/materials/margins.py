"""Maps for Blender materials: normals and grain in Blender's tangent frames, and margins filled across seams.

A renderer interpolates between texels, so at an island's edge it reads outside the island. The margin holds the values
of the seam's other side, so both sides interpolate toward the same values.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...core.encode import nearest_covered
from ...geometry.seams.seams import SeamMap
from ...geometry.spaces import unit, world_normals
from ...geometry.surface.bake import SurfaceBake
from ...geometry.surface.mesh import MeshData
from ...results.maps import Maps
from .tangent_frames import blender_axes, changed_grains, grains_of, maps_to_blender, solver_axes, world_to_blender

# Least bilinear weight of the solved texels among the four around a place on the other side.
_MIN_WEIGHT = 0.05


def blender_maps(maps: Maps, mesh: MeshData, bake: SurfaceBake, seams: SeamMap | None) -> Maps:
    """Return maps with normals and grain in the frames of Blender's nodes, and their margin past seams filled.

    maps: in the solver's frames. seams: of the domain; None leaves the margins unfilled.
    """
    values = maps_to_blender(maps.model, maps.values, mesh, bake)
    maps, solved = replace(maps, values=values, tiles=mesh.tiles, wrapped=True), maps
    if seams is None or maps.solved.all() or not maps.solved.any():
        return maps
    place, beside, taps, weights = _across(seams, maps.solved)
    turns = _turns(bake, taps, weights, beside)
    normal = maps.model.normal
    world = world_normals(bake, solved.values[normal]) if normal in values else bake.normal
    across = world.reshape(-1, 3)[taps].astype(np.float64)
    normals = unit(np.einsum("nij,nt,ntj->ni", turns, weights, across))
    margins = {}
    for p in maps.model.parameters:
        if p.is_normal and p.name in values:
            margins[p.name] = world_to_blender(mesh, bake, beside, normals)
        elif p.name in values:
            texels = np.asarray(values[p.name], np.float32).reshape(-1, p.components)
            margins[p.name] = np.einsum("nt,ntc->nc", weights, texels[taps])
    if (found := grains_of(maps.model, solved.values, maps.solved.shape)) is not None:
        names, grains = found
        source = solver_axes(bake, taps.ravel(), across.reshape(-1, 3)).reshape(*taps.shape, 2, 3)
        source = np.einsum("nij,ntaj->ntai", turns, source)
        target = blender_axes(mesh, bake, beside, normals)[:, None]
        mean = (weights * changed_grains(grains.ravel()[taps], source, target)).sum(axis=1)
        margins |= dict(zip(names, np.stack([mean.real, mean.imag])[..., None], strict=True))
    filled = {}
    for name, margin_values in margins.items():
        filled[name] = np.array(values[name], np.float32)
        filled[name].reshape(-1, margin_values.shape[-1])[place] = margin_values
    margin = np.zeros(maps.solved.shape, bool)
    margin.ravel()[place] = True
    return replace(maps, values={**values, **filled}, margin=margin)


def _turns(bake: SurfaceBake, taps: np.ndarray, weights: np.ndarray, beside: np.ndarray) -> np.ndarray:
    """Return (M, 3, 3) rotations of world vectors, as the surface turns from their place to the texel beside.

    A normal map holds the tilt from the surface normal, and outside the edge a renderer uses the edge's normal: an
    unrotated normal would tilt too far, across a crease by the crease's angle.
    """
    surface = bake.normal.reshape(-1, 3).astype(np.float64)
    a, b = unit(np.einsum("nt,ntc->nc", weights, surface[taps])), surface[beside]
    # Rodrigues' formula for the smallest rotation from a to b; for opposite vectors, any of them.
    cosine, axis = (a * b).sum(axis=-1)[:, None, None], np.cross(a, b)
    cross = np.cross(axis[:, None], np.eye(3)).transpose(0, 2, 1)
    along = axis[:, :, None] * axis[:, None, :] / np.maximum(1 + cosine, 1e-6)
    return cosine * np.eye(3) + cross + along


def _across(seams: SeamMap, covered: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return M texels past seams, the covered texel beside each, and their interpolation on the other side.

    All are flat indices. The last two are (M, 4) texels and (M, 4) weights that sum to 1.
    """
    height, width = covered.shape
    row, column, near_row, near_column = nearest_covered(covered)
    chart = seams.chart[near_row, near_column].astype(np.int64)
    least = int(seams.chart.min())
    count = int(seams.chart.max()) - least + 1
    inside = ((seams.place >= 0) & (seams.place < (width, height))).all(axis=1)
    known = (
        (seams.place[inside, 1].astype(np.int64) * width + seams.place[inside, 0]) * count + seams.of[inside] - least
    )
    key = (row.astype(np.int64) * width + column) * count + chart - least
    entry = np.minimum(np.searchsorted(known, key), max(len(known) - 1, 0))
    is_known = known[entry] == key if len(known) else np.zeros(len(key), bool)
    entry = np.flatnonzero(inside)[entry[is_known]]
    place, beside = (row * width + column)[is_known], (near_row * width + near_column)[is_known]

    at = seams.at[entry].astype(np.float64) - 0.5
    first = np.floor(at).astype(np.int64)
    fraction = at - first
    other = seams.island.ravel()[seams.target[entry]]
    taps, weights = np.zeros((len(at), 4), np.int64), np.zeros((len(at), 4))
    for t, (dx, dy) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1))):
        x, y = first[:, 0] + dx, first[:, 1] + dy
        within = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        texel = np.where(within, y * width + x, 0)
        usable = within & covered.ravel()[texel] & (seams.island.ravel()[texel] == other)
        share = np.abs(1 - dx - fraction[:, 0]) * np.abs(1 - dy - fraction[:, 1])
        taps[:, t], weights[:, t] = np.where(usable, texel, 0), np.where(usable, share, 0)
    total = weights.sum(axis=1, keepdims=True)
    alone = (total[:, 0] < _MIN_WEIGHT) & covered.ravel()[seams.target[entry]]
    taps[alone] = seams.target[entry][alone, None]
    weights[alone], total[alone] = 0.25, 1.0
    valid = total[:, 0] >= _MIN_WEIGHT
    return place[valid], beside[valid], taps[valid], weights[valid] / total[valid]
