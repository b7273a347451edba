"""UV seams: which texels are neighbours on the surface though the UV map has cut them apart.

A mesh's UV map falls into islands: triangles that share edges in it. Where an edge of the surface is cut, so that two
islands (or two sides of one) have it at different places, what lies beyond the edge on the one side is what lies within
it on the other: the triangle there, unfolded into the plane of this one. A place past a border has as neighbour the
texel that lies there on the surface; past a border of the surface itself there is none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from .edges import SeamEdges, seam_edges
from .gaps import beyond_pieces, charts_of, known_directly, pieces_of
from .places import Covered, places_beyond, texel_at

if TYPE_CHECKING:
    from ..surface.mesh import MeshData

# Texels past a border for which neighbours are known: as far as a prior of the shipped presets looks (2^4).
SEAM_REACH = 16
# Up to this halo a tile looks which places its texels reach; past it nearly all that are known are.
LOOKED_FOR = 4


@dataclass(frozen=True)
class SeamMap:
    """Neighbours past borders, of W×H texels.

    island: (H, W) int32 number of the island a covered texel lies on, −1 where none. chart: (H, W) int32 the part of
    the UV map that it looks from: its island, or beside a gap in that a number from −2 downward. A texel sees those of
    its own chart, and from such a part those whose chart is its island, where they lie; all others are told:
    place: (N, 2) int32 x, y, some outside the domain, as the chart ``of`` (N,) sees them. target: (N,) int64 the texel
    that lies there on the surface: y·W + x, or W·H + its number in the ghosts. at: (N, 2) float32 exactly where, in
    texels of the whole domain. They are sorted by y, x and chart. reach: how many texels past a border places are
    known. edges: what it was made from.

    A tile has an ghosts: M texels of other tiles that its own see across seams. ghosts: (M, 2) int32 x, y in the whole
    domain; ghost_normal: (M, 3), ghost_tangent: (M, 4), as in GeometryBake.
    """

    island: np.ndarray
    chart: np.ndarray
    place: np.ndarray
    of: np.ndarray
    target: np.ndarray
    at: np.ndarray
    reach: int
    edges: SeamEdges
    ghosts: np.ndarray
    ghost_normal: np.ndarray
    ghost_tangent: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        height, width = self.island.shape
        return height, width


def seam_map(edges: SeamEdges, island: np.ndarray, reach: int = SEAM_REACH) -> SeamMap:
    """Return the neighbours past the borders of islands.

    island: (H, W) int32 the island that each texel lies on, −1 where none.
    """
    island = np.ascontiguousarray(island, np.int32)
    here = edges.some(np.isin(edges.island, island))
    pieces = pieces_of(island, reach)
    chart = charts_of(island, pieces)
    place, edge = places_beyond(here, here.island, _covered(island), island.shape, reach)
    of = here.island[edge].astype(np.int64)
    more = beyond_pieces(here, island, pieces, reach)
    place, edge, of = (np.concatenate(both) for both in zip((place, edge, of), more, strict=True))
    at = np.einsum("nij,nj->ni", here.across[edge, :, :2], place + 0.5) + here.across[edge, :, 2]
    target = texel_at(at, here.other[edge], island)
    found = target >= 0
    direct, seen_from = known_directly(chart, island, pieces)
    place, of = np.concatenate([place[found], direct]), np.concatenate([of[found], seen_from])
    at = np.concatenate([at[found], direct + 0.5])
    target = np.concatenate([target[found], direct[:, 1] * island.shape[1] + direct[:, 0]])
    order = np.lexsort((of, place[:, 0], place[:, 1]))
    return SeamMap(
        island, chart, place[order].astype(np.int32), of[order].astype(np.int32), target[order],
        at[order].astype(np.float32), reach, edges,
        np.zeros((0, 2), np.int32), np.zeros((0, 3), np.float32), np.zeros((0, 4), np.float32),
    )  # fmt: skip


def seams_of(mesh: MeshData, triangle: np.ndarray, reach: int = SEAM_REACH) -> SeamMap:
    """Return the neighbours across the seams of a mesh whose UV square was baked to (H, W) triangle numbers."""
    height, width = triangle.shape
    edges, islands = seam_edges(mesh, width, height)
    return seam_map(edges, np.where(triangle >= 0, islands[np.maximum(triangle, 0)], -1), reach)


def _covered(island: np.ndarray) -> Covered:
    """Return what tells whether places lie on the islands that look."""

    def covered(looking: np.ndarray, place: np.ndarray) -> np.ndarray:
        x, y = np.clip(place, 0, (island.shape[1] - 1, island.shape[0] - 1)).T
        return (place == np.stack([x, y], axis=-1)).all(axis=1) & (island[y, x] == looking)

    return covered


def window_seams(seams: SeamMap, window: tuple[int, int, int, int]) -> SeamMap:
    """Return the seams of texels [x0, x0 + width) × [y0, y0 + height) that are all there is: without an ghosts."""
    x0, y0, width, height = window
    y, x = np.divmod(seams.target, seams.shape[1])
    inside = (x >= x0) & (x < x0 + width) & (y >= y0) & (y < y0 + height)
    low, high = np.array([x0, y0]) - seams.reach, np.array([x0 + width, y0 + height]) + seams.reach
    kept = inside & ((seams.place >= low) & (seams.place < high)).all(axis=1)
    return replace(
        seams, island=seams.island[y0 : y0 + height, x0 : x0 + width], of=seams.of[kept], at=seams.at[kept],
        chart=seams.chart[y0 : y0 + height, x0 : x0 + width],
        place=seams.place[kept] - np.array([x0, y0], np.int32),
        target=(y[kept] - y0) * width + x[kept] - x0,
    )  # fmt: skip
