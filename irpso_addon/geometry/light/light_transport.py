"""Light transport on a mesh: elements of its surface, rays between them, and the lights that each element sees.

Elements are texels: one for each cell of a grid over the UV square, and more where parts of the surface that are apart
in space share a cell. The rays of each are distributed as the cosine to its normal (Malley's method: a uniform disk,
projected to the hemisphere), by the R2 sequence (Roberts 2018) shifted for each element (Cranley & Patterson 1976).
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from ...core.steps import map_steps
from ..surface.bake import SurfaceBake
from ..surface.mesh import MeshData
from .shadows import corner_weights

Cast = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]  # blender/ray_caster.py
_PLASTIC = 1.32471795724474602596  # the real root of x³ = x + 1, of the R2 sequence
_LIFT = 1e-4  # height of ray origins above the surface, as a fraction of the subject's size
# Likeness of a texel and an element: exp(−d²/4) cos⁴, with the distance d in widths of a cell and the angle between the
# normals. It is 0.05 at 3.5 widths, or at 62°.
_ALIKE = 0.05  # a texel less like all elements of its cell gets an element of its own
_FOREIGN = 1e-3  # an element less like a texel gives it no light
_NEAR_FACE = 0.985  # cosine of 10° between shading normal and face
_FAR = 4.0  # widths of a cell between a ray's hit and an element that stands for it
_CHUNK = 1 << 16  # texels at a time
MAX_ELEMENTS = 1 << 13  # or the cells, if these are more


@dataclass(frozen=True)
class LightTransport:
    """E elements of a mesh. texels: (E,) index of each among the H·W texels. directions: (R, E, 3) float32 unit, world.
    cosines: (R, E) float32, to the axes around which these are spread.

    hits: (R, E) int32, the element that a ray hits, −1 for none, the back of a face or an occluder. lit: (K, E) bool,
    whether neither mesh nor occluders block the way to each light. near: (T, 4) int32 and share: (T, 4)
    float32, the elements around each covered texel and their weights, by which ``at_texels`` interpolates; all 0 for a
    texel without an element on its part of the surface.
    """

    texels: np.ndarray
    directions: np.ndarray
    cosines: np.ndarray
    hits: np.ndarray
    lit: np.ndarray
    near: np.ndarray
    share: np.ndarray

    def at_texels(self, values: np.ndarray) -> np.ndarray:
        """Return (T, n) values of elements (E, n), interpolated at the covered texels, row by row."""
        return sum(self.share[:, i, None] * values[self.near[:, i]] for i in range(4))


def light_transport_steps(
    mesh: MeshData, bake: SurfaceBake, lights: np.ndarray, cast: Cast, resolution: int, rays: int
) -> Generator[float, None, LightTransport]:
    """Yield the fraction of the work that is done; return the LightTransport.

    lights: (K, 4) as in Domain. resolution: cells along the longer side of a UDIM tile, at most. rays: of an element.
    """
    elements = _Elements(bake, resolution, len(mesh.tiles))
    yield from map_steps(elements.choose_steps(), lambda step: 0.0)
    points, face = _ray_origins(mesh, bake, elements.texels)
    normals = bake.normal.reshape(-1, 3)[elements.texels].astype(np.float64)
    # The horizon of a shading normal far from the face, as of a smooth-shaded box, hides what the face sees.
    axes = np.where(np.einsum("ei,ei->e", normals, face)[:, None] < _NEAR_FACE, face, normals)
    directions = cosine_directions(axes, rays)
    hits = np.full(directions.shape[:2], -1, np.int32)
    total = rays + len(lights)
    for number, direction in enumerate(directions):
        up = np.flatnonzero(np.einsum("ei,ei->e", direction, face) > 0)
        triangle, place = cast(points[up], direction[up])
        hit = (triangle >= 0) & (triangle < len(mesh.positions))
        hits[number, up[hit]] = elements.nearest(mesh, triangle[hit], place[hit], direction[up[hit]])
        yield (number + 1) / total
    steps = lit_steps(mesh, bake, elements.texels, lights, cast)
    lit = yield from map_steps(steps, lambda part: (rays + part * len(lights)) / total)
    around = yield from map_steps(elements.around_steps(), lambda step: 1.0)
    cosines = np.einsum("rei,ei->re", directions, axes).astype(np.float32)
    return LightTransport(elements.texels, directions.astype(np.float32), cosines, hits, lit, *around)


def lit_steps(
    mesh: MeshData, bake: SurfaceBake, texels: np.ndarray, lights: np.ndarray, cast: Cast
) -> Generator[float, None, np.ndarray]:
    """Yield the fraction of the work that is done; return ``LightTransport.lit`` (K, E) under lights (K, 4)."""
    points, face = _ray_origins(mesh, bake, texels)
    lit = np.zeros((len(lights), len(points)), bool)
    for number, light in enumerate(lights.astype(np.float64)):
        toward = light[:3] - light[3] * points
        distance = np.linalg.norm(toward, axis=-1)
        toward /= distance[:, None]
        up = np.flatnonzero(np.einsum("ei,ei->e", toward, face) > 0)
        triangle, place = cast(points[up], toward[up])
        beyond = light[3] * np.linalg.norm(place - points[up], axis=-1) > distance[up]
        lit[number, up] = (triangle < 0) | beyond
        yield (number + 1) / len(lights)
    return lit


def _ray_origins(mesh: MeshData, bake: SurfaceBake, texels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (E, 3) ray origins of texels, just above their faces, and (E, 3) face normals."""
    face = bake.face_normal.reshape(-1, 3)[texels].astype(np.float64)
    points = bake.position.reshape(-1, 3)[texels].astype(np.float64)
    return points + _LIFT * np.ptp(mesh.positions.reshape(-1, 3), axis=0).max() * face, face


def cosine_directions(normals: np.ndarray, rays: int) -> np.ndarray:
    """Return (rays, E, 3) float64 unit directions with the density cos/π around unit normals (E, 3)."""
    steps = np.array([1 / _PLASTIC, 1 / _PLASTIC**2])
    shifts = np.random.default_rng(0).random((len(normals), 2))
    places = (steps * np.arange(rays)[:, None, None] + shifts) % 1
    radius, angle = np.sqrt(places[..., 0]), 2 * np.pi * places[..., 1]
    aside = np.eye(3)[np.abs(normals).argmin(axis=-1)]
    first = np.cross(aside, normals)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.cross(normals, first)
    local = radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - places[..., 0])
    return sum(part[..., None] * axis for part, axis in zip(local, (first, second, normals), strict=True))


class _Elements:
    """Elements of a surface: in each cell of a grid the covered texel nearest to its centre, and further ones.

    A further element is, of the texels that are unlike all elements of their cell, the nearest to the centre.
    tiles: number of UDIM tiles side by side, each with ``resolution`` cells along its longer side.
    """

    def __init__(self, bake: SurfaceBake, resolution: int, tiles: int):
        self._bake = bake
        height, width = bake.coverage.shape
        self._longer = longer = max(height, width // tiles)
        self._count = count = min(resolution, longer)
        self._stride = longer / count  # texels along a cell, not always whole
        self._cells = -(-height * count // longer), -(-width * count // longer)
        self._most = max(tiles * count**2, MAX_ELEMENTS)
        self.texels = np.zeros(0, np.int64)
        self._of_cells: list[np.ndarray] = []  # the first element of each cell, the second, …; −1 for none

    def choose_steps(self) -> Generator[None, None, None]:
        """Yield often; set the elements."""
        count, stride, longer, most = self._count, self._stride, self._longer, self._most
        width, widths = self._bake.coverage.shape[1], [1e-12]
        for axis in (0, 1):
            yield
            widths.append(_texel_width(self._bake, axis))
        yield
        self._width = stride * max(widths)
        rows, columns = np.nonzero(self._bake.coverage)
        row, column = ((2 * at + 1) * count // (2 * longer) for at in (rows, columns))
        cell, texels = row * self._cells[1] + column, rows * width + columns
        distance = np.hypot(*(at + 0.5 - stride * (own + 0.5) for at, own in ((rows, row), (columns, column))))
        del rows, columns, row, column
        yield
        left = np.lexsort((distance, cell))
        yield
        while len(left) and len(self.texels) < most:
            cells, first = (found[: most - len(self.texels)] for found in np.unique(cell[left], return_index=True))
            number = np.full(self._cells[0] * self._cells[1], -1, np.int32)
            number[cells] = len(self.texels) + np.arange(len(cells))
            self._of_cells.append(number)
            self.texels = np.append(self.texels, texels[left[first]])
            self._places, self._normals = (
                part.reshape(-1, 3)[self.texels] for part in (self._bake.position, self._bake.normal)
            )
            unlike = np.zeros(len(left), bool)
            for part in _chunks(len(left)):
                yield
                unlike[part] = self._likeness(number[cell[left[part]]], texels[left[part]]) < _ALIKE
            left = left[unlike]

    def _likeness(self, element: np.ndarray, texels: np.ndarray) -> np.ndarray:
        """Return (N,) in 0 … 1, of elements and texels (N,); 0 for element −1."""
        position, normal = (part.reshape(-1, 3)[texels] for part in (self._bake.position, self._bake.normal))
        squared = ((self._places[element] - position) ** 2).sum(axis=-1)
        facing = np.maximum(np.einsum("ti,ti->t", self._normals[element], normal), 0) ** 4
        return (element >= 0) * np.exp(-squared / (2 * self._width) ** 2) * facing

    def nearest(self, mesh: MeshData, triangle: np.ndarray, place: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Return (N,) the elements nearest to hit points (N, 3) on triangles.

        −1 on backs, on unsolved triangles, and where no element is near that faces the same way.
        """
        corners = mesh.positions[triangle].astype(np.float64)
        weights = corner_weights(corners, place)
        uv = np.einsum("nk,nki->ni", weights, mesh.uvs[triangle])
        normal = np.einsum("nk,nki->ni", weights, mesh.normals[triangle])
        height, width = self._bake.coverage.shape
        row, column = ((uv[:, i] * size / self._stride).astype(int) for i, size in ((1, height), (0, width)))
        best, least = np.full(len(place), -1, np.int32), np.full(len(place), (_FAR * self._width) ** 2)
        for down, across in product((-1, 0, 1), repeat=2):
            for element in self._at(row + down, column + across):
                squared = ((self._places[element] - place) ** 2).sum(axis=-1)
                facing = np.einsum("ni,ni->n", self._normals[element], normal) > 0
                better = (element >= 0) & facing & (squared < least)
                best[better], least[better] = element[better], squared[better]
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        face *= np.sign(np.einsum("ni,nki->n", face, mesh.normals[triangle]))[:, None]
        front = np.einsum("ni,ni->n", face, direction) < 0
        solved = True if mesh.solved is None else mesh.solved[triangle]
        return np.where(front & solved, best, -1)

    def around_steps(self) -> Generator[None, None, tuple[np.ndarray, np.ndarray]]:
        """Yield often; return the elements (T, 4) of the cells around every covered texel, and their weights (T, 4).

        In each cell the element most like the texel. Bilinear weights, lowered for elements that are unlike it.
        """
        rows, columns = np.nonzero(self._bake.coverage)
        near, share = np.empty((len(rows), 4), np.int32), np.empty((len(rows), 4), np.float32)
        for part in _chunks(len(rows)):
            yield
            near[part], share[part] = self._around(rows[part], columns[part])
        return near, share

    def _around(self, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ``around_steps`` of some texels."""
        texels = rows * self._bake.coverage.shape[1] + columns
        y, x = ((at + 0.5) / self._stride - 0.5 for at in (rows, columns))
        near, share = [], []
        for down, across in product((0, 1), repeat=2):
            row, column = np.floor(y).astype(int) + down, np.floor(x).astype(int) + across
            best, alike = np.zeros(len(texels), np.int32), np.full(len(texels), _FOREIGN)
            for element in self._at(row, column):
                likeness = self._likeness(element, texels)
                better = likeness > alike
                best[better], alike[better] = element[better], likeness[better]
            near.append(best)
            share.append(np.where(alike > _FOREIGN, (1 - np.abs(y - row)) * (1 - np.abs(x - column)) * alike, 0))
        total = np.sum(share, axis=0)
        total[total == 0] = 1
        return np.stack(near, axis=-1), np.stack(share, axis=-1) / total[:, None]

    def _at(self, row: np.ndarray, column: np.ndarray) -> Iterator[np.ndarray]:
        """Yield the first elements of cells, the second, …; −1 for none."""
        rows, columns = self._cells
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        cell = np.clip(row, 0, rows - 1) * columns + np.clip(column, 0, columns - 1)
        for number in self._of_cells:
            yield np.where(inside, number[cell], -1)


def _chunks(count: int) -> Iterator[slice]:
    """Yield slices of ``count`` texels, some at a time."""
    return (slice(start, start + _CHUNK) for start in range(0, count, _CHUNK))


def _texel_width(bake: SurfaceBake, axis: int) -> float:
    """Return the median distance, in world units, between neighbouring texels along rows (1) or columns (0)."""
    both = np.minimum(*(np.delete(bake.coverage, end, axis) for end in (0, -1)))
    gaps = np.linalg.norm(np.diff(bake.position, axis=axis)[both], axis=-1)
    return float(np.median(gaps)) if len(gaps) else 0.0
