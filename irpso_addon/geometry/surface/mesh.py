"""A mesh as arrays: triangles with their normals, tangents and texture coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ...core.errors import InputError
from ...core.udim import ONE_SQUARE
from .udim import MIN_AREA, layout_size, uv_areas

# Largest share of the surface without area in a valid UV map.
_DEGENERATE_LIMIT = 0.005


@dataclass(frozen=True)
class MeshData:
    """T triangles, by corner, in world units and world axes; all float32.

    positions: (T, 3, 3). normals: (T, 3, 3) unit, Cycles' shading normals (custom and sharp ones included). tangents:
    (T, 3, 4) unit MikkTSpace tangent and the bitangent's sign. uvs: (T, 3, 2) in 0…1, the place in the domain.
    materials: (T,) int32 slot. uv_map: name of the UV map of texture coordinates and tangents. matrix: (4, 4) float64
    object to world. tiles: the domain's UDIM tiles, side by side from the left: ``uvs`` span all of them, tangents are
    of the UV map itself. slots: names of the object's material slots. solved: (T,) bool, triangles of the requested
    slots, None for all; the others occlude and cast shadows, but have no texels. copied_by: names of modifiers that may
    repeat faces with their UVs. occluders: (M, 3, 3) positions of the triangles of other objects, which hide and shade
    these.
    """

    name: str
    positions: np.ndarray
    normals: np.ndarray
    tangents: np.ndarray
    uvs: np.ndarray
    materials: np.ndarray
    uv_map: str
    matrix: np.ndarray
    tiles: tuple[int, ...] = ONE_SQUARE
    slots: tuple[str, ...] = ()
    solved: np.ndarray | None = None
    copied_by: tuple[str, ...] = ()
    occluders: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 3), np.float32))

    @property
    def opaque(self) -> np.ndarray:
        """(T + M, 3, 3) positions of all opaque triangles: the mesh's, then the occluders'."""
        return np.concatenate([self.positions, self.occluders]) if len(self.occluders) else self.positions

    @property
    def texel_uvs(self) -> np.ndarray:
        """(T, 3, 2) places in the domain, all 0 for triangles that are not solved: they draw no pixel."""
        return self.uvs if self.solved is None else np.where(self.solved[:, None, None], self.uvs, np.float32(0))

    @property
    def solved_slots(self) -> tuple[int, ...]:
        """The slots of the solved triangles, ascending."""
        return tuple(np.unique(self.materials if self.solved is None else self.materials[self.solved]).tolist())

    def domain_size(self, width: int, height: int) -> tuple[int, int]:
        """Return (width, height) of the domain, from those of a UDIM tile. Raises InputError."""
        return layout_size(self.tiles, width, height)


def alone(mesh: MeshData) -> MeshData:
    """Return a mesh without the objects around it."""
    return replace(mesh, occluders=mesh.occluders[:0])


def check_uvs(name: str, uv_map: str, positions: np.ndarray, uvs: np.ndarray) -> None:
    """Raise InputError where texture coordinates (T, 3, 2) are not numbers or give the surface no area."""
    where = f"UV map '{uv_map}' of '{name}'"
    if not np.isfinite(uvs).all():
        raise InputError(f"{where} holds values that are not numbers; unwrap the mesh again")
    edges = (positions[:, 1:] - positions[:, :1]).astype(np.float64)
    surface = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=-1)
    if not surface.sum() > 0:
        raise InputError(f"the faces of '{name}' have no area; choose a mesh that has a surface")
    lost = surface[uv_areas(uvs) < MIN_AREA].sum() / surface.sum()
    if lost > _DEGENERATE_LIMIT:
        raise InputError(
            f"{where} gives no area to {100 * lost:.3g} % of the surface (collapsed faces); unwrap the mesh again"
        )
