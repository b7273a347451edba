"""Cuts of a UV map: islands, their border edges, and the map from past an edge to the other side."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from ...core.graph import connected

if TYPE_CHECKING:
    from ..surface.mesh import MeshData

# Texture coordinates of one corner that differ by less than this fraction of a texel are equal: rounding, not a cut.
_SAME_PLACE = 0.01
# An unfolded triangle that stretches lengths by more than this, relative to those along the edge, is a sliver: its map
# is meaningless away from it, so lengths count alike in all directions.
_SLIVER = 8.0


@dataclass(frozen=True)
class SeamEdges:
    """The E border edges of a UV map's islands, in texels: a texel's centre lies at (x + ½, y + ½).

    start, end: (E, 2) float64. outward: (E, 2) unit, away from the island. island: (E,) int32 number. other: (E,) int32
    the island on the other side of the seam, −1 at a border of the surface. across: (E, 2, 3) the affine map from
    places past the edge to the other side.
    """

    start: np.ndarray
    end: np.ndarray
    outward: np.ndarray
    island: np.ndarray
    other: np.ndarray
    across: np.ndarray

    def some(self, chosen: np.ndarray) -> SeamEdges:
        """Return the edges selected by (E,) bool."""
        return SeamEdges(**{item.name: getattr(self, item.name)[chosen] for item in fields(SeamEdges)})

    def halved(self) -> SeamEdges:
        """Return the edges in units of texels twice as large."""
        across = self.across.copy()
        across[..., 2] /= 2
        return replace(self, start=self.start / 2, end=self.end / 2, across=across)


def seam_edges(mesh: MeshData, width: int, height: int) -> tuple[SeamEdges, np.ndarray]:
    """Return the borders of a mesh's islands on width × height texels, and each triangle's island, (T,) int32.

    Triangles of one island share an edge on the surface and, within a hundredth of a texel, in the UV map. An edge of
    more than two triangles is a border of the surface.
    """
    uv = mesh.uvs.astype(np.float64) * (width, height)
    corners = _welded(mesh.positions.reshape(-1, 3)).reshape(-1, 3)
    first, second = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    turned = first > second  # all sides of an edge list its ends in one order
    a, b = uv.reshape(-1, 2), np.roll(uv, -1, axis=1).reshape(-1, 2)
    a, b = np.where(turned[:, None], b, a), np.where(turned[:, None], a, b)
    edge = _pair_numbers(np.minimum(first, second), np.maximum(first, second))
    places = _welded(np.pad(mesh.uvs.reshape(-1, 2), ((0, 0), (0, 1)))).reshape(-1, 3)
    one, other = places.ravel(), np.roll(places, -1, axis=1).ravel()
    place = _pair_numbers(np.where(turned, other, one), np.where(turned, one, other))
    shared, left = _paired(_pair_numbers(edge, place), first != second)
    pairs, alone = _paired(edge, np.isin(np.arange(len(edge)), left))
    apart = np.ptp(np.concatenate([a, b], axis=-1)[pairs], axis=1).max(axis=-1, initial=0)
    same = apart < _SAME_PLACE
    islands = connected(len(corners), *np.concatenate([shared, pairs[same]]).T // 3).astype(np.int32)
    one, two = pairs[~same].T
    here, there = np.concatenate([one, two, alone]), np.concatenate([two, one, np.full(len(alone), -1)])
    return _border_edges(mesh, uv, a, b, here, there, islands), islands


def _pair_numbers(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return (N,) numbers of pairs of integers, equal where both are equal."""
    return np.unique(first.astype(np.int64) * (int(second.max()) + 1) + second, return_inverse=True)[1]


def _welded(points: np.ndarray) -> np.ndarray:
    """Return (N,) numbers, equal where points (N, 3) float32 are bitwise equal."""
    bits = (np.ascontiguousarray(points, np.float32) + np.float32(0)).view(np.uint32).astype(np.uint64)  # no −0
    # One number per point sorts ten times faster than three; collisions are checked below.
    mixed = bits @ np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)
    _, first, number = np.unique(mixed, return_index=True, return_inverse=True)
    if (bits[first][number] != bits).any():
        number = np.unique(bits, axis=0, return_inverse=True)[1].ravel()
    return number


def _paired(keys: np.ndarray, usable: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (P, 2) indices of keys that occur twice, and (A,) indices of the other usable keys."""
    order = np.flatnonzero(usable)
    order = order[np.argsort(keys[order], kind="stable")]
    start = np.flatnonzero(np.diff(keys[order], prepend=-1))
    count = np.diff(start, append=len(order))
    twice = start[count == 2]
    alone = np.repeat(count != 2, count)
    return np.stack([order[twice], order[twice + 1]], axis=-1), order[alone]


def _border_edges(
    mesh: MeshData,
    uv: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    here: np.ndarray,
    there: np.ndarray,
    islands: np.ndarray,
) -> SeamEdges:
    """Return the border edges. here: (E,) their start corners. there: (E,) the other sides' corners, −1 for none.

    a, b: (3T, 2) the ends of every edge in texels, both sides in one order.
    """
    outward, along, across = _sides(mesh, uv, a, b, here)
    inward, along_there, across_there = _sides(mesh, uv, a, b, np.maximum(there, 0))
    with np.errstate(all="ignore"):
        linear = np.stack([along_there, -across_there], axis=-1) @ _inverse(np.stack([along, across], axis=-1))
    lost = (there < 0) | ~np.isfinite(linear).all(axis=(1, 2))
    linear[lost] = 0
    shift = a[np.maximum(there, 0)] - np.einsum("nij,nj->ni", linear, a[here])
    return SeamEdges(
        a[here], b[here], outward, islands[here // 3], np.where(lost, -1, islands[there // 3]).astype(np.int32),
        np.concatenate([linear, shift[..., None]], axis=-1),
    )  # fmt: skip


def _sides(mesh: MeshData, uv: np.ndarray, a: np.ndarray, b: np.ndarray, edge: np.ndarray) -> tuple:
    """Return, per edge, the unit vector out of its triangle, and the texel vectors of a unit length on the surface:
    along the edge, and out of the triangle perpendicular to it."""
    triangle, corner = edge // 3, edge % 3
    third = (corner + 2) % 3
    points = mesh.positions.astype(np.float64)
    p, q, r = points[triangle, corner], points[triangle, (corner + 1) % 3], points[triangle, third]
    # Both sides list the edge's ends in one order.
    swapped = ((uv[triangle, corner] != a[edge]).any(axis=-1))[:, None]
    p, q = np.where(swapped, q, p), np.where(swapped, p, q)
    length = np.linalg.norm(q - p, axis=-1, keepdims=True)
    unit = (q - p) / length
    x = ((r - p) * unit).sum(axis=-1, keepdims=True)
    y = np.linalg.norm(r - p - x * unit, axis=-1, keepdims=True)
    side, apex = b[edge] - a[edge], uv[triangle, third] - a[edge]
    outward = np.stack([side[:, 1], -side[:, 0]], axis=-1)
    with np.errstate(all="ignore"):
        outward /= np.linalg.norm(outward, axis=-1, keepdims=True)
        outward *= -np.sign((outward * apex).sum(axis=-1, keepdims=True))
        along = side / length
        across = (x * along - apex) / y
        stretch = np.linalg.norm(across, axis=-1) / np.linalg.norm(along, axis=-1)
        upright = (across * outward).sum(axis=-1) / np.linalg.norm(along, axis=-1)
    sliver = ~((stretch < _SLIVER) & (upright > 1 / _SLIVER))
    across[sliver] = outward[sliver] * np.linalg.norm(along[sliver], axis=-1, keepdims=True)
    return np.nan_to_num(outward), along, across


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Return the inverses of (N, 2, 2) matrices; not finite for singular ones."""
    (a, b), (c, d) = matrix[:, 0].T, matrix[:, 1].T
    adjugate = np.stack([np.stack([d, -b], axis=-1), np.stack([-c, a], axis=-1)], axis=-2)
    return adjugate / (a * d - b * c)[:, None, None]
