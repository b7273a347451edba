"""Relief of a card as a surface that rays meet: as fine as its texels, or of cells where these are too many."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...capture.camera import Camera
from ...core.graph import connected
from ..domain import GeometryBake
from ..relief.height import integrate_steps, relief_from_log
from ..relief.relief import card_height_steps, slopes_seen
from ..surface.bake import SurfaceBake
from ..surface.mesh import MeshData

# Most vertices: along an element; along the longer side, by its elements within limits. Whole strides may halve them.
_AN_ELEMENT, _LEAST, _MOST = 4, 640, 1024
_TRIANGLES = 2  # of four vertices
_CHUNK = 1 << 16  # texels at a time
_HALF = 0.5  # part of a cell that is covered: with less it is no vertex
_CORNERS = np.array([[(0, 0), (0, 1), (1, 1)], [(0, 0), (1, 1), (1, 0)]])  # rows and columns of the triangles' corners


def relief_stride(shape: tuple[int, ...], resolution: int) -> int:
    """Return the texels between vertices of the relief of an (H, W) card. resolution: of the elements."""
    most = min(max(_AN_ELEMENT * resolution, _LEAST), _MOST)
    return -(-max(shape) // most)


def relief_triangles(shape: tuple[int, ...], resolution: int) -> int:
    """Return the number of triangles, at most, of the relief of an (H, W) card. resolution: of the elements."""
    stride = relief_stride(shape, resolution)
    return _TRIANGLES * (-(-shape[0] // stride)) * (-(-shape[1] // stride))


def card_surface_steps(
    camera: Camera, flat: GeometryBake, covered: np.ndarray, normals: np.ndarray, stride: int
) -> Generator[None, None, tuple[MeshData, SurfaceBake]]:
    """Yield often; return the relief of a card's normals (H, W, 3) as a mesh, and as a bake of its texels.

    flat: the card. covered: (H, W) bool, the texels that have a relief. The mesh has a vertex at each texel, or one
    for each cell of ``stride`` × ``stride``; then the texels lie on its triangles. The frames of the bake have the
    normals as z.
    """
    up = np.where(covered[..., None], normals, (0.0, 0.0, 1.0)).astype(np.float64)
    if stride == 1:
        height = (yield from card_height_steps(camera, up, covered)).values.astype(np.float64)
    else:
        cells = yield from _cells_steps(camera, up, covered, stride)
        yield
        height = cells.at_texels(covered.shape)
    yield
    bake = yield from _bake_steps(camera, flat, covered, up, height)
    if stride == 1:
        quads = covered[:-1, :-1] & covered[1:, :-1] & covered[:-1, 1:] & covered[1:, 1:]
        return _mesh(quads, bake.position, bake.normal, bake.tangent, bake.uv), bake
    position, uv = (_centres(values, stride) for values in (flat.position, flat.uv))
    yield
    normal, along = (_means(values, covered, stride) for values in (bake.normal, bake.tangent))
    yield
    return _mesh(cells.quads, _raised(camera, position, cells.height), normal, along, uv), bake


def _bake_steps(
    camera: Camera, flat: GeometryBake, covered: np.ndarray, up: np.ndarray, height: np.ndarray
) -> Generator[None, None, SurfaceBake]:
    """Yield often; return the bake of heights (H, W) in texels, with the unit normals ``up``, some rows at a time."""
    position, normal, facing = (np.empty((*covered.shape, 3), np.float32) for _ in range(3))
    tangent, surrounded = np.empty((*covered.shape, 4), np.float32), _surrounded(covered)
    rows = max(1, _CHUNK // covered.shape[1])
    for start in range(0, len(covered), rows):
        yield
        own = slice(start, start + rows)
        around = slice(max(start - 1, 0), start + rows + 1)  # for differences of neighbours
        places = _raised(camera, flat.position[around], height[around])
        facing[own] = _facing(places, up[around], surrounded[around])[start - around.start :][:rows]
        position[own], normal[own] = places[start - around.start :][:rows], up[own]
        along = np.stack([up[own, :, 2], np.zeros(normal[own].shape[:2]), -up[own, :, 0]], axis=-1)
        tangent[own, :, :3] = along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
    tangent[..., 3] = 1
    return SurfaceBake(position, normal, tangent, covered, flat.uv, facing, np.zeros(covered.shape, np.int32))


def _raised(camera: Camera, flat: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Return places (…, 3) of a flat card, raised by heights (…) in texels."""
    height = height[..., None] / camera.scale[0]
    return flat * (1 - height) if camera.perspective else flat + height * (0, 0, 1)


def _facing(places: np.ndarray, up: np.ndarray, surrounded: np.ndarray) -> np.ndarray:
    """Return (h, w, 3) unit normals of the faces at places (h, w, 3); the normals ``up`` where there are none."""
    facing = np.cross(np.gradient(places, axis=1), np.gradient(places, axis=0)) if min(places.shape[:2]) > 1 else up
    # Beside an uncovered texel a difference of positions is no slope: rim texels would face along the card.
    facing = np.where((facing[..., 2:] > 0) & surrounded[..., None], facing, up)
    return facing / np.linalg.norm(facing, axis=-1, keepdims=True)


def _surrounded(covered: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: covered texels whose neighbours in row and column are covered, or beyond the image."""
    around = np.pad(covered, 1, mode="edge")
    return covered & around[:-2, 1:-1] & around[2:, 1:-1] & around[1:-1, :-2] & around[1:-1, 2:]


def _mesh(quads: np.ndarray, *values: np.ndarray) -> MeshData:
    """Return two triangles for each of some quads of vertices, (h − 1, w − 1) bool.

    values: position, normal, tangent and UV of the vertices, (h, w, …).
    """
    at = (np.argwhere(quads)[:, None, None] + _CORNERS).reshape(-1, 3, 2)
    position, normal, tangent, uv = (value[at[..., 0], at[..., 1]].astype(np.float32) for value in values)
    return MeshData("relief", position, normal, tangent, uv, np.zeros(len(at), np.int32), "", np.eye(4))


@dataclass(frozen=True, eq=False)
class _Cells:
    """Heights of cells of ``stride`` × ``stride`` texels.

    height: (h, w) of their centres, in texels. slope: (h, w, 2) along x and y. quads: (h − 1, w − 1) bool, whether four
    cells are of one island, and each at least half covered: the corners of two triangles.
    """

    stride: int
    height: np.ndarray
    slope: np.ndarray
    quads: np.ndarray

    def at_texels(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return (H, W): the heights of the texels on the triangles; elsewhere on the plane of a texel's own cell."""
        (row, y), (column, x) = (self._corner(size, axis) for axis, size in enumerate(shape))
        result = np.empty(shape)
        for number in np.unique(row):  # a row of cells at a time
            rows = row == number
            result[rows] = self._on_triangles(number, y[rows, None], column, x)
        whole = np.zeros(shape, bool)
        if self.quads.size:
            whole = self.quads[row[:, None], column]
        return np.where(whole, result, self._on_planes(shape))

    def _corner(self, size: int, axis: int) -> tuple[np.ndarray, np.ndarray]:
        """Return for each texel along an axis the cell before it, and the distance from its centre in cells."""
        place = (np.arange(size) + 0.5) / self.stride - 0.5
        cell = np.clip(np.floor(place).astype(int), 0, max(self.height.shape[axis] - 2, 0))
        return cell, place - cell

    def _on_triangles(self, row: int, y: np.ndarray, column: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the heights on the triangles of ``_CORNERS``, between a row of cells and the next."""
        above = min(row + 1, self.height.shape[0] - 1)
        beside = np.minimum(column + 1, self.height.shape[1] - 1)
        first, last = self.height[row, column], self.height[above, beside]
        right, left = self.height[row, beside], self.height[above, column]
        return first + np.where(
            x >= y, x * (right - first) + y * (last - right), y * (left - first) + x * (last - left)
        )

    def _on_planes(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return (H, W): the heights of all texels on the planes of their own cells."""
        at = [np.arange(size) for size in shape]
        rows, columns = (places // self.stride for places in at)
        y, x = (places + 0.5 - self.stride * (own + 0.5) for places, own in zip(at, (rows, columns), strict=True))
        own = rows[:, None], columns
        return self.height[own] + self.slope[..., 0][own] * x + self.slope[..., 1][own] * y[:, None]


def _cells_steps(
    camera: Camera, normals: np.ndarray, covered: np.ndarray, stride: int
) -> Generator[None, None, _Cells]:
    """Yield often; return the cells of a card's normals (H, W, 3) in camera space.

    Slopes are averaged before they are integrated: heights of the cells' centres are as those of single texels, and
    neither time nor memory of the integration grows with the card. A cell on several islands is of the largest one.
    """
    slopes, weights = slopes_seen(camera, normals)
    yield
    island, chosen = _islands(covered, stride)
    yield
    own = covered & (island == _spread(chosen, stride, covered.shape))
    slope, share = _means(slopes, own, stride), _blocks(own, stride).mean(axis=(1, 3))
    yield
    # The harmonic mean, as of springs in a row.
    weight = 1 / np.maximum(_means(1 / np.maximum(weights, 1e-30)[..., None], own, stride)[..., 0], 1e-30)
    yield
    torn = np.zeros((*chosen.shape, 2), bool)
    torn[:, :-1, 0] = chosen[:, 1:] != chosen[:, :-1]
    torn[:-1, :, 1] = chosen[1:] != chosen[:-1]
    height, _ = yield from integrate_steps(slope * stride, weight, share > 0, torn)
    if camera.perspective:
        height = relief_from_log(height, camera.scale[0])
    at = np.where(share >= _HALF, chosen, -1)
    first, *others = at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]
    quads = (first >= 0) & np.all([other == first for other in others], axis=0)
    return _Cells(stride, height, slope, quads)


def _islands(covered: np.ndarray, stride: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (H, W) int island numbers of texels, −1 for uncovered ones, and (h, w): of cells, that of most texels."""
    full = _blocks(covered, stride).all(axis=(1, 3))  # cells that are one node; of others each texel is one
    cell = _spread(np.arange(full.size).reshape(full.shape), stride, covered.shape)
    single = covered & ~_spread(full, stride, covered.shape)
    node = cell.copy()
    node[single] = full.size + np.arange(np.count_nonzero(single))
    ends = []
    for axis in (0, 1):
        here, there = (np.delete(covered, end, axis) for end in (-1, 0))
        pairs = [np.delete(node, end, axis)[here & there] for end in (-1, 0)]
        ends.append([part[pairs[0] != pairs[1]] for part in pairs])
    first, second = (np.concatenate(part) for part in zip(*ends, strict=True))
    component = connected(full.size + np.count_nonzero(single), first, second)
    island = np.where(covered, component[node], -1)
    chosen = np.where(full, component[: full.size].reshape(full.shape), -1)
    of_cells, count = np.unique(np.stack([cell[single], island[single]]), axis=1, return_counts=True)
    cells, islands = of_cells[:, np.argsort(count, kind="stable")]
    chosen.flat[cells] = islands  # the last of a cell, of most texels, stays
    return island, chosen


def _blocks(values: np.ndarray, stride: int, **padding: Any) -> np.ndarray:
    """Return (h, stride, w, stride, …) of (H, W, …): the texels of each cell. padding: as for np.pad, by default 0."""
    sizes = [-(-size // stride) for size in values.shape[:2]]
    missing = [(0, count * stride - size) for count, size in zip(sizes, values.shape, strict=False)]
    if any(end for _, end in missing):
        values = np.pad(values, [*missing, *[(0, 0)] * (values.ndim - 2)], **padding)
    return values.reshape(sizes[0], stride, sizes[1], stride, *values.shape[2:])


def _means(values: np.ndarray, counted: np.ndarray, stride: int) -> np.ndarray:
    """Return (h, w, n) means of (H, W, n) over the counted texels, (H, W) bool, of each cell; 0 without any."""
    total = _blocks(np.where(counted[..., None], values, 0), stride).sum(axis=(1, 3), dtype=np.float64)
    return total / np.maximum(_blocks(counted, stride).sum(axis=(1, 3)), 1)[..., None]


def _centres(values: np.ndarray, stride: int) -> np.ndarray:
    """Return (h, w, n) float64 values at the centres of the cells, of (H, W, n) that are linear in row and column."""
    return _blocks(values, stride, mode="reflect", reflect_type="odd").mean(axis=(1, 3), dtype=np.float64)


def _spread(values: np.ndarray, stride: int, shape: tuple[int, ...]) -> np.ndarray:
    """Return (H, W): the value (h, w) of each texel's cell."""
    return values.repeat(stride, axis=0).repeat(stride, axis=1)[: shape[0], : shape[1]]
