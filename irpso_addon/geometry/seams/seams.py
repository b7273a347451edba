"""UV seams: texels that are neighbours on the surface but not in the UV map.

An island is a set of triangles that share edges in the UV map. At a seam two islands (or two sides of one) have the
same surface edge at different UV places. The surface past the edge is then the other side's triangle, unfolded into the
plane of this one: a place past a border has as neighbour the texel there. Past a border of the surface there is none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from .edges import SeamEdges, seam_edges
from .gaps import charts_of, pieces_of, places_beyond_pieces, visible_across_gaps
from .places import Covered, places_beyond, texel_at

if TYPE_CHECKING:
    from ..surface.mesh import MeshData

# Texels past a border with known neighbours: the stencil radius of the prior in the shipped presets (2^4).
SEAM_RADIUS = 16
# Up to this halo a tile selects the places that its texels radius; with a wider halo nearly all are reached.
MAX_SEARCHED_HALO = 4


@dataclass(frozen=True)
class SeamMap:
    """Neighbours past borders, of W×H texels.

    island: (H, W) int32 island number of a covered texel, −1 elsewhere. chart: (H, W) int32 the texel's island, or
    beside a gap in it a number from −2 downward. Texels of one chart see each other directly, and a chart from −2
    downward also sees the texels whose chart is its island. All other neighbours are listed:
    place: (N, 2) int32 x, y, also outside the domain, as seen from the chart ``of`` (N,). target: (N,) int64 the texel
    there on the surface: y·W + x, or W·H + its ghost number. at: (N, 2) float32 the exact position in texels of the
    whole domain. Sorted by y, x and chart. radius: texels past a border with listed places. edges: the source.

    A tile has M ghosts: texels of other tiles that its own see across seams. ghosts: (M, 2) int32 x, y in the whole
    domain; ghost_normal: (M, 3), ghost_tangent: (M, 4), as in GeometryBake.
    """

    island: np.ndarray
    chart: np.ndarray
    place: np.ndarray
    of: np.ndarray
    target: np.ndarray
    at: np.ndarray
    radius: int
    edges: SeamEdges
    ghosts: np.ndarray
    ghost_normal: np.ndarray
    ghost_tangent: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        height, width = self.island.shape
        return height, width


def seam_map(edges: SeamEdges, island: np.ndarray, radius: int = SEAM_RADIUS) -> SeamMap:
    """Return the neighbours past the borders of islands.

    island: (H, W) int32 island number of each texel, −1 for none.
    """
    island = np.ascontiguousarray(island, np.int32)
    here = edges.some(np.isin(edges.island, island))
    pieces = pieces_of(island, radius)
    chart = charts_of(island, pieces)
    place, edge = places_beyond(here, here.island, _covered(island), island.shape, radius)
    of = here.island[edge].astype(np.int64)
    more = places_beyond_pieces(here, island, pieces, radius)
    place, edge, of = (np.concatenate(both) for both in zip((place, edge, of), more, strict=True))
    at = np.einsum("nij,nj->ni", here.across[edge, :, :2], place + 0.5) + here.across[edge, :, 2]
    target = texel_at(at, here.other[edge], island)
    hit = target >= 0
    direct, seen_from = visible_across_gaps(chart, island, pieces)
    place, of = np.concatenate([place[hit], direct]), np.concatenate([of[hit], seen_from])
    at = np.concatenate([at[hit], direct + 0.5])
    target = np.concatenate([target[hit], direct[:, 1] * island.shape[1] + direct[:, 0]])
    order = np.lexsort((of, place[:, 0], place[:, 1]))
    return SeamMap(
        island, chart, place[order].astype(np.int32), of[order].astype(np.int32), target[order],
        at[order].astype(np.float32), radius, edges,
        np.zeros((0, 2), np.int32), np.zeros((0, 3), np.float32), np.zeros((0, 4), np.float32),
    )  # fmt: skip


def seams_of(mesh: MeshData, triangle: np.ndarray, radius: int = SEAM_RADIUS) -> SeamMap:
    """Return the neighbours across the seams of a mesh whose UV square was baked to (H, W) triangle numbers."""
    height, width = triangle.shape
    edges, islands = seam_edges(mesh, width, height)
    return seam_map(edges, np.where(triangle >= 0, islands[np.maximum(triangle, 0)], -1), radius)


def _covered(island: np.ndarray) -> Covered:
    """Return a function that tests whether places lie on the islands that see them."""

    def covered(viewer: np.ndarray, place: np.ndarray) -> np.ndarray:
        x, y = np.clip(place, 0, (island.shape[1] - 1, island.shape[0] - 1)).T
        return (place == np.stack([x, y], axis=-1)).all(axis=1) & (island[y, x] == viewer)

    return covered


def window_seams(seams: SeamMap, window: tuple[int, int, int, int]) -> SeamMap:
    """Return the seams of texels [x0, x0 + width) × [y0, y0 + height) as a whole domain, without ghosts."""
    x0, y0, width, height = window
    y, x = np.divmod(seams.target, seams.shape[1])
    inside = (x >= x0) & (x < x0 + width) & (y >= y0) & (y < y0 + height)
    low, high = np.array([x0, y0]) - seams.radius, np.array([x0 + width, y0 + height]) + seams.radius
    chosen = inside & ((seams.place >= low) & (seams.place < high)).all(axis=1)
    return replace(
        seams, island=seams.island[y0 : y0 + height, x0 : x0 + width], of=seams.of[chosen], at=seams.at[chosen],
        chart=seams.chart[y0 : y0 + height, x0 : x0 + width],
        place=seams.place[chosen] - np.array([x0, y0], np.int32),
        target=(y[chosen] - y0) * width + x[chosen] - x0,
    )  # fmt: skip
