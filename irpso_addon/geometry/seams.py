"""UV seams: which texels are neighbours on the surface though the UV map has cut them apart.

A mesh's UV map falls into islands: triangles that share edges in it. Where an edge of the surface is cut, so that two
islands (or two sides of one) have it at different places, what lies beyond the edge on the one side is what lies within
it on the other: the triangle there, unfolded into the plane of this one. A place past a border has as neighbour the
texel that lies there on the surface; past a border of the surface itself there is none.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .domain import Domain
    from .mesh import MeshData

# Texels past a border for which neighbours are known: as far as a prior of the shipped presets looks (2^4).
SEAM_REACH = 16
# Texture coordinates of one corner that differ by less than this part of a texel are one place: rounding, not a cut.
_SAME_PLACE = 0.01
# An unfolded triangle that stretches lengths by more than this against those along the edge is a sliver, of which
# nothing can be told so far away: lengths then count alike in all directions.
_SLIVER = 8.0
# A place may lie so many texels inside its own border: rounding of the raster that drew the island.
_INSIDE = 0.75
# Of two edges equally near, at their common corner, the one that a place lies more in front of.
_BESIDE = 1e-4
# A place within a border has a covered texel's centre less than a texel away; what has not lies past the border too.
_WITHIN = 0.99
# Up to this halo a tile looks which places its texels reach; past it nearly all that are known are.
LOOKED_FOR = 4
_AROUND = np.array([(x, y) for y in (-1, 0, 1) for x in (-1, 0, 1)])


@dataclass(frozen=True)
class SeamEdges:
    """The E border edges of a UV map's islands, in texels: a texel's centre lies at (x + ½, y + ½).

    start, end: (E, 2) float64. outward: (E, 2) unit, away from the island. island: (E,) int32 its number. other: (E,)
    int32 the island on the other side of the seam, −1 at a border of the surface. across: (E, 2, 3) the affine map
    from places past the edge to where they lie on the other side.
    """

    start: np.ndarray
    end: np.ndarray
    outward: np.ndarray
    island: np.ndarray
    other: np.ndarray
    across: np.ndarray

    def some(self, chosen: np.ndarray) -> SeamEdges:
        """Return some of the edges, by (E,) bool."""
        return SeamEdges(**{item.name: getattr(self, item.name)[chosen] for item in fields(SeamEdges)})

    def halved(self) -> SeamEdges:
        """Return the edges in texels twice as large."""
        across = self.across.copy()
        across[..., 2] /= 2
        return replace(self, start=self.start / 2, end=self.end / 2, across=across)


@dataclass(frozen=True)
class SeamMap:
    """Neighbours past borders, of W×H texels.

    island: (H, W) int32 number of the island a covered texel lies on, −1 where none. place: (N, 2) int32 x, y of
    places past a border of the island ``of`` (N,), some outside the domain. target: (N,) int64 the texel that lies
    there on the surface: y·W + x, or W·H + its number in the annex. at: (N, 2) float32 exactly where, in texels of the
    whole domain. reach: how many texels past a border places are known. edges: what it was made from.

    A tile has an annex: M texels of other tiles that its own see across seams. annex: (M, 2) int32 x, y in the whole
    domain; annex_normal: (M, 3), annex_tangent: (M, 4), as in GeometryBake.
    """

    island: np.ndarray
    place: np.ndarray
    of: np.ndarray
    target: np.ndarray
    at: np.ndarray
    reach: int
    edges: SeamEdges
    annex: np.ndarray
    annex_normal: np.ndarray
    annex_tangent: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.island.shape


def seam_map(edges: SeamEdges, island: np.ndarray, reach: int = SEAM_REACH) -> SeamMap:
    """Return the neighbours past the borders of islands.

    island: (H, W) int32 the island that each texel lies on, −1 where none.
    """
    island = np.ascontiguousarray(island, np.int32)
    here = edges.some(np.isin(edges.island, island))
    place, edge = _places_beyond(here, island, reach)
    at = np.einsum("nij,nj->ni", here.across[edge, :, :2], place + 0.5) + here.across[edge, :, 2]
    target = _texel_at(at, here.other[edge], island)
    found = target >= 0
    place, edge, at, target = place[found], edge[found], at[found], target[found]
    order = np.lexsort((here.island[edge], place[:, 0], place[:, 1]))
    return SeamMap(
        island, place[order].astype(np.int32), here.island[edge][order], target[order], at[order].astype(np.float32),
        reach, edges, np.zeros((0, 2), np.int32), np.zeros((0, 3), np.float32), np.zeros((0, 4), np.float32),
    )  # fmt: skip


def seams_of(mesh: MeshData, triangle: np.ndarray, reach: int = SEAM_REACH) -> SeamMap:
    """Return the neighbours across the seams of a mesh whose UV square was baked to (H, W) triangle numbers."""
    height, width = triangle.shape
    edges, islands = seam_edges(mesh, width, height)
    return seam_map(edges, np.where(triangle >= 0, islands[np.maximum(triangle, 0)], -1), reach)


def seam_edges(mesh: MeshData, width: int, height: int) -> tuple[SeamEdges, np.ndarray]:
    """Return the borders of a mesh's islands on width × height texels, and each triangle's island, (T,) int32.

    Triangles are of one island where they share an edge at one place of the surface and of the UV map, to a hundredth
    of a texel. An edge of more than two triangles is a border of the surface.
    """
    uv = mesh.uvs.astype(np.float64) * (width, height)
    corners = _welded(mesh.positions.reshape(-1, 3)).reshape(-1, 3)
    first, second = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    turned = first > second  # so that all sides of an edge name its ends in one order
    a, b = uv.reshape(-1, 2), np.roll(uv, -1, axis=1).reshape(-1, 2)
    a, b = np.where(turned[:, None], b, a), np.where(turned[:, None], a, b)
    edge = _numbered(np.minimum(first, second), np.maximum(first, second))
    place = _welded(np.pad(mesh.uvs.reshape(-1, 2), ((0, 0), (0, 1)))).reshape(-1, 3)
    place, other = place.ravel(), np.roll(place, -1, axis=1).ravel()
    place = _numbered(np.where(turned, other, place), np.where(turned, place, other))
    shared, left = _paired(_numbered(edge, place), first != second)
    pairs, alone = _paired(edge, np.isin(np.arange(len(edge)), left))
    apart = np.ptp(np.concatenate([a, b], axis=-1)[pairs], axis=1).max(axis=-1, initial=0)
    same = apart < _SAME_PLACE
    islands = _components(len(corners), np.concatenate([shared, pairs[same]]) // 3)
    one, two = pairs[~same].T
    here, there = np.concatenate([one, two, alone]), np.concatenate([two, one, np.full(len(alone), -1)])
    return _described(mesh, uv, a, b, here, there, islands), islands


def _numbered(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return (N,) numbers of pairs of whole numbers, equal where both are."""
    return np.unique(first.astype(np.int64) * (int(second.max()) + 1) + second, return_inverse=True)[1]


def tile_seams(seams: SeamMap, domain: Domain, box: tuple[int, int, int, int], halo: int) -> SeamMap:
    """Return the seams of a tile of a domain, with an annex of what its own texels see beyond it.

    box: x0, y0, width, height of its own texels. halo: texels around them, less where the domain ends.
    """
    height, width = seams.shape
    x0, y0, wide, high = box
    left, bottom = max(0, x0 - halo), max(0, y0 - halo)
    right, top = min(width, x0 + wide + halo), min(height, y0 + high + halo)
    solvable = domain.solvable
    own = solvable[y0 : y0 + high, x0 : x0 + wide]
    islands = np.unique(seams.island[y0 : y0 + high, x0 : x0 + wide][own])
    near = (seams.place >= (x0 - halo, y0 - halo)) & (seams.place < (x0 + wide + halo, y0 + high + halo))
    kept = np.flatnonzero(near.all(axis=1) & np.isin(seams.of, islands))
    if halo <= LOOKED_FOR:
        around = np.where(own, seams.island[y0 : y0 + high, x0 : x0 + wide], -1)
        kept = kept[_sees(around, seams.place[kept] - (x0, y0), seams.of[kept], halo)]
    target = seams.target[kept]
    passed = target >= height * width
    y, x = np.divmod(np.where(passed, 0, target), width)
    kept, target, passed, x, y = (a[passed | solvable[y, x]] for a in (kept, target, passed, x, y))
    inside = ~passed & (y >= bottom) & (y < top) & (x >= left) & (x < right)
    outside, number = np.unique(target[~inside], return_inverse=True)
    new = (y - bottom) * (right - left) + x - left
    new[~inside] = (top - bottom) * (right - left) + number
    ay, ax = np.divmod(outside[outside < height * width], width)
    old = outside[outside >= height * width] - height * width
    there = np.stack([ax + domain.origin[0], ay + domain.origin[1]], axis=-1)
    return replace(
        seams, island=seams.island[bottom:top, left:right], of=seams.of[kept], target=new, at=seams.at[kept],
        place=seams.place[kept] - np.array([left, bottom], np.int32),
        annex=np.concatenate([there, seams.annex[old]]).astype(np.int32),
        annex_normal=np.concatenate([domain.bake.normal[ay, ax], seams.annex_normal[old]]),
        annex_tangent=np.concatenate([domain.bake.tangent[ay, ax], seams.annex_tangent[old]]),
    )  # fmt: skip


def _sees(island: np.ndarray, place: np.ndarray, of: np.ndarray, halo: int) -> np.ndarray:
    """Return (N,) bool: whether a texel of the island ``of`` lies within ``halo`` of a place (N, 2)."""
    padded = np.pad(island, 2 * halo, constant_values=-1)
    found = np.zeros(len(place), bool)
    for y in range(-halo, halo + 1):
        for x in range(-halo, halo + 1):
            found |= padded[place[:, 1] + y + 2 * halo, place[:, 0] + x + 2 * halo] == of
    return found


def window_seams(seams: SeamMap, window: tuple[int, int, int, int]) -> SeamMap:
    """Return the seams of texels [x0, x0 + width) × [y0, y0 + height) that are all there is: without an annex."""
    x0, y0, width, height = window
    y, x = np.divmod(seams.target, seams.shape[1])
    inside = (x >= x0) & (x < x0 + width) & (y >= y0) & (y < y0 + height)
    low, high = np.array([x0, y0]) - seams.reach, np.array([x0 + width, y0 + height]) + seams.reach
    kept = inside & ((seams.place >= low) & (seams.place < high)).all(axis=1)
    return replace(
        seams, island=seams.island[y0 : y0 + height, x0 : x0 + width], of=seams.of[kept], at=seams.at[kept],
        place=seams.place[kept] - np.array([x0, y0], np.int32),
        target=(y[kept] - y0) * width + x[kept] - x0,
    )  # fmt: skip


def _welded(points: np.ndarray) -> np.ndarray:
    """Return (N,) numbers, equal where points (N, 3) float32 are equal to the last bit."""
    bits = (np.ascontiguousarray(points, np.float32) + np.float32(0)).view(np.uint32).astype(np.uint64)  # no −0
    # One number a point sorts ten times faster than three; it is checked below.
    mixed = bits @ np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)
    _, first, number = np.unique(mixed, return_index=True, return_inverse=True)
    if (bits[first][number] != bits).any():
        number = np.unique(bits, axis=0, return_inverse=True)[1].ravel()
    return number


def _paired(keys: np.ndarray, usable: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (P, 2) indices of keys that occur twice, and (A,) those of all others that are usable."""
    order = np.flatnonzero(usable)
    order = order[np.argsort(keys[order], kind="stable")]
    start = np.flatnonzero(np.diff(keys[order], prepend=-1))
    count = np.diff(start, append=len(order))
    twice = start[count == 2]
    alone = np.repeat(count != 2, count)
    return np.stack([order[twice], order[twice + 1]], axis=-1), order[alone]


def _components(count: int, links: np.ndarray) -> np.ndarray:
    """Return (count,) int32 numbers of the connected components of a graph with links (L, 2)."""
    label = np.arange(count)
    while True:
        ends = label[links]
        ends = ends[ends[:, 0] != ends[:, 1]]
        if not len(ends):
            return np.unique(label, return_inverse=True)[1].astype(np.int32)
        np.minimum.at(label, ends.max(axis=1), ends.min(axis=1))
        while (label[label] != label).any():
            label = label[label]


def _described(
    mesh: MeshData, uv: np.ndarray, a: np.ndarray, b: np.ndarray, here: np.ndarray, there: np.ndarray, islands
) -> SeamEdges:
    """Return the border edges ``here``, (E,) corners at which they begin; there: their other sides, −1 for none.

    a, b: (3T, 2) texels of the ends of every edge, both sides in one order.
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
    """Return of edges: the unit vector out of their triangle; and the texels to a unit of length on the surface, along
    the edge and out of the triangle at a right angle to it."""
    triangle, corner = edge // 3, edge % 3
    third = (corner + 2) % 3
    points = mesh.positions.astype(np.float64)
    p, q, r = points[triangle, corner], points[triangle, (corner + 1) % 3], points[triangle, third]
    # Both sides name the edge's ends in one order.
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
    """Return the inverses of (N, 2, 2) matrices; not finite where there is none."""
    (a, b), (c, d) = matrix[:, 0].T, matrix[:, 1].T
    adjugate = np.stack([np.stack([d, -b], axis=-1), np.stack([-c, a], axis=-1)], axis=-2)
    return adjugate / (a * d - b * c)[:, None, None]


def _places_beyond(edges: SeamEdges, island: np.ndarray, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 2) places past borders, and (N,) the border edge that each is nearest to.

    They are found ring by ring outward, each place trying the edges of those around it.
    """
    height, width = island.shape
    grid = width + 2 * reach + 2, height + 2 * reach + 2
    before = np.zeros(0, np.int64)
    last = _nearest(*_seeds(edges), edges, island, grid, reach, before)
    found = [last]
    for _ in range(reach - 1):
        key, edge = last
        place = _place_of(key, grid, reach)[0]
        around = (place[:, None] + _AROUND).reshape(-1, 2)
        new = _nearest(around, np.repeat(edge, len(_AROUND)), edges, island, grid, reach, np.union1d(before, key))
        before, last = key, new
        found.append(new)
    keys, chosen = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return _place_of(keys, grid, reach)[0], chosen


def _seeds(edges: SeamEdges) -> tuple[np.ndarray, np.ndarray]:
    """Return places along all edges and around them, and which edge each is of."""
    length = np.linalg.norm(edges.end - edges.start, axis=-1)
    count = np.ceil(2 * length).astype(np.int64) + 1
    edge = np.repeat(np.arange(len(count)), count)
    step = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    t = (step / np.maximum(count[edge] - 1, 1))[:, None]
    place = np.floor(edges.start[edge] * (1 - t) + edges.end[edge] * t).astype(np.int64)
    return (place[:, None] + _AROUND).reshape(-1, 2), np.repeat(edge, len(_AROUND))


def _nearest(
    place: np.ndarray,
    edge: np.ndarray,
    edges: SeamEdges,
    island: np.ndarray,
    grid: tuple[int, int],
    reach: int,
    known: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return sorted keys (island and place) of what lies past a border, and the nearest edge of those tried for each.

    known: sorted keys that are left out.
    """
    height, width = island.shape
    far = ((place < -reach) | (place >= (width + reach, height + reach))).any(axis=1)
    inside = ((place >= 0) & (place < (width, height))).all(axis=1)
    covered = np.zeros(len(place), bool)
    covered[inside] = island[place[inside, 1], place[inside, 0]] == edges.island[edge[inside]]
    left = ~(far | covered)
    place, edge = place[left], edge[left]
    key = (edges.island[edge].astype(np.int64) * grid[1] + place[:, 1] + reach) * grid[0] + place[:, 0] + reach
    at = np.searchsorted(known, key)
    new = (at >= len(known)) | (known[np.minimum(at, len(known) - 1)] != key) if len(known) else np.ones(len(key), bool)
    place, edge, key = place[new], edge[new], key[new]
    start, side = edges.start[edge], edges.end[edge] - edges.start[edge]
    away = place + 0.5 - start
    t = (away * side).sum(axis=-1) / np.maximum((side**2).sum(axis=-1), 1e-30)
    past = t - np.clip(t, 0, 1)
    distance = ((away - np.clip(t, 0, 1)[:, None] * side) ** 2).sum(axis=-1)
    cost = distance + _BESIDE * past**2 * (side**2).sum(axis=-1)
    front = (away * edges.outward[edge]).sum(axis=-1) > -_INSIDE
    order = np.lexsort((edge, cost, key))
    order = order[front[order]]
    first = np.diff(key[order], prepend=-1) != 0
    return key[order][first], edge[order][first]


def _place_of(key: np.ndarray, grid: tuple[int, int], reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 2) the places of keys, and their islands."""
    rest, x = np.divmod(key, grid[0])
    number, y = np.divmod(rest, grid[1])
    return np.stack([x, y], axis=-1) - reach, number


def _texel_at(at: np.ndarray, wanted: np.ndarray, island: np.ndarray) -> np.ndarray:
    """Return (N,) flat indices of the texel of the wanted island whose centre is nearest to a place, −1 where none is.

    Looked for is in the texel that the place lies in, and in the eight around it.
    """
    height, width = island.shape
    result, least = np.full(len(at), -1, np.int64), np.full(len(at), _WITHIN**2)
    with np.errstate(invalid="ignore"):
        middle = np.clip(np.floor(np.nan_to_num(at, nan=-9)), -9, max(width, height) + 9).astype(np.int64)
    for offset in _AROUND:
        texel = middle + offset
        x, y = np.clip(texel, 0, (width - 1, height - 1)).T
        there = (texel == np.stack([x, y], axis=-1)).all(axis=1) & (wanted >= 0) & (island[y, x] == wanted)
        distance = ((texel + 0.5 - at) ** 2).sum(axis=-1)
        better = there & (distance < least)
        result[better], least[better] = (y * width + x)[better], distance[better]
    return result
