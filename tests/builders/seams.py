"""Meshes with a UV cut and known neighbours of texels across it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from irpso_addon.geometry.domain import Domain, GeometryBake, domain_of
from irpso_addon.geometry.seams.seams import SEAM_RADIUS, seams_of
from irpso_addon.geometry.surface.mesh import MeshData
from tests.oracles import geometry as geometry_oracle
from tests.oracles.geometry import joined, mesh_from_corners

LEFT, RIGHT, HIGH = 12, 9, 14  # size in texels: left and right of the cut, and along it
START = (3, 5)  # the left part's corner
TURNS = {
    "as it is": ((1, 0), (0, 1), (26, 8)),
    "turned by 90°": ((0, 1), (-1, 0), (44, 9)),
    "turned by 180°": ((-1, 0), (0, -1), (50, 30)),
    "mirrored": ((1, 0), (0, -1), (30, 26)),
    "mirrored and turned": ((0, 1), (1, 0), (27, 11)),
    "three times as large": ((3, 0), (0, 3), (17, 1)),
    "mirrored, turned, three times as large": ((0, 3), (3, 0), (17, 4)),
    "past the square's edge": ((1, 0), (0, 1), (0, 30)),
}
SHAPE = (50, 62)  # rows, columns


@dataclass(frozen=True)
class Sheet:
    """A bent sheet cut along s = 0 into a left part, whose texels are the unit of length, and a right part.

    turn: (2, 2) from (s, t) to texels of the right part; origin: (2,) its texel at s = t = 0.
    """

    mesh: MeshData
    bake: GeometryBake
    turn: np.ndarray
    origin: np.ndarray

    def part_at(self, texel: tuple[int, int]) -> int | None:
        """Return 0 for a texel (x, y) of the left part, 1 of the right one, None outside both."""
        middle = np.array(texel) + 0.5
        for part in (0, 1):
            if self._holds(part, self._sheet(part, middle)):
                return part
        return None

    def neighbour(self, texel: tuple[int, int], by: tuple[int, int]) -> tuple[int, int] | None:
        """Return the texel (x, y) at the offset ``by`` on the sheet, None past its borders."""
        part = self.part_at(texel)
        place = self._sheet(part, np.array(texel) + 0.5 + by)
        other = int(place[0] > 0)
        if not self._holds(other, place):
            return None
        position = self._texels(other, place)
        return tuple(int(c) for c in np.floor(position + 1e-6))

    def outside(self, texel: tuple[int, int], by: tuple[int, int]) -> float:
        """Return how many texels the offset ``by`` leads past the sheet's borders, the larger of both directions."""
        s, t = self._sheet(self.part_at(texel), np.array(texel) + 0.5 + by)
        return max(-LEFT - s, s - RIGHT, -t, t - HIGH)

    def domain(self, radius: int = SEAM_RADIUS, **options) -> Domain:
        """Return a domain of one dark observation, with its seams."""
        stack = np.ones((1, *self.bake.coverage.shape, 4), np.float32)
        rows = (np.float32([[0, 0, 1, 0]]), np.float32([[1, 1, 1]]), np.float32([[0, 0, 1, 0]]))
        seams = seams_of(self.mesh, self.bake.triangle, radius)
        return domain_of(self.bake, stack, *rows, card=False, seams=seams)

    def _sheet(self, part: int, place: np.ndarray) -> np.ndarray:
        return np.linalg.solve(self.turn, place - self.origin) if part else place - START - (LEFT, 0)

    def _texels(self, part: int, place: np.ndarray) -> np.ndarray:
        return self.turn @ place + self.origin if part else place + START + (LEFT, 0)

    @staticmethod
    def _holds(part: int, place: np.ndarray) -> bool:
        s, t = place
        return 0 < t < HIGH and (0 < s < RIGHT if part else -LEFT < s < 0)


@cache
def sheet(turn: str, frames_seed: int = 1) -> Sheet:
    """Return the sheet with its right part turned; every triangle has its own tangent frame."""
    across, along, origin = (np.array(v, float) for v in TURNS[turn])
    linear = np.stack([across, along], axis=-1)
    outside = "edge" in turn  # the left part touches the right border of the domain; neighbours past it lie outside
    shift = (SHAPE[1] - START[0] - LEFT if outside else 0, 0)
    parts = [
        part(np.arange(-LEFT, 1), lambda st: st + START + (LEFT, 0) + shift),
        part(np.arange(RIGHT + 1), lambda st: st @ linear.T + origin),
    ]
    mesh = joined(*parts)
    rng = np.random.default_rng(frames_seed)
    normals = mesh.normals.astype(np.float64)
    tangents = np.cross(normals, rng.normal(size=(len(normals), 1, 3)))
    tangents /= np.linalg.norm(tangents, axis=-1, keepdims=True)
    signs = np.broadcast_to(rng.choice([-1.0, 1.0], (len(normals), 1, 1)), (*normals.shape[:2], 1))
    mesh = mesh_from_corners(mesh.positions, normals, np.concatenate([tangents, signs], -1), mesh.uvs)
    bake = geometry_oracle.bake_uv(mesh, SHAPE[1], SHAPE[0])[0]
    single = {k: v.astype(np.float32) for k, v in vars(bake).items() if k not in ("coverage", "triangle")}
    return (Shifted if outside else Sheet)(mesh, replace(bake, **single), linear, origin)


class Shifted(Sheet):
    """The sheet with its left part at the right border of the domain."""

    def _sheet(self, part: int, place: np.ndarray) -> np.ndarray:
        return super()._sheet(part, place) if part else place - (SHAPE[1], START[1])

    def _texels(self, part: int, place: np.ndarray) -> np.ndarray:
        return super()._texels(part, place) if part else place + (SHAPE[1], START[1])


def part(columns: np.ndarray, to_texels, high: int = HIGH, shape: tuple[int, int] = SHAPE) -> MeshData:
    """Return columns s and rows t = 0 … high of the sheet. to_texels: from (…, 2) s, t to positions in texels."""
    s, t = np.meshgrid(columns.astype(float), np.arange(high + 1.0))
    grid = np.stack([s, t], axis=-1)
    angle = s / 40
    points = np.stack([40 * np.sin(angle), t, 40 * np.cos(angle)], axis=-1)
    normal = np.stack([np.sin(angle), np.zeros_like(s), np.cos(angle)], axis=-1)
    uv = to_texels(grid) / shape[::-1]

    def triangles(values: np.ndarray) -> np.ndarray:
        a, b, c, d = values[:-1, :-1], values[:-1, 1:], values[1:, 1:], values[1:, :-1]
        both = np.stack([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)], axis=2)
        return both.reshape(-1, 3, values.shape[-1])

    tangents = np.broadcast_to((1.0, 0, 0, 1), (*s.shape, 4))
    return mesh_from_corners(*(triangles(v) for v in (points, normal, tangents, uv)))
