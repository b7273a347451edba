"""Choice and computation of the derived maps: normals in other spaces, and the relief."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..capture.camera import Camera
from ..core.errors import InputError
from ..geometry.domain import GeometryBake
from ..geometry.relief.height import Height
from ..geometry.relief.relief import card_height, mesh_height
from ..geometry.spaces import object_normals, turned, world_normals
from ..geometry.surface.bake import surface_bake
from ..geometry.surface.mesh import MeshData
from ..reflectance.model import ReflectanceModel
from .derived_map import NORMAL_SPACES, DerivedMap, height_map, normal_maps
from .maps import Maps


@dataclass(frozen=True)
class DerivedMaps:
    """Choice of derived maps. normals: some of "object", "world" and "directx". height: the relief as a map.

    displacement: the relief as a map and as displacement of the material.
    """

    normals: tuple[str, ...] = ()
    height: bool = False
    displacement: bool = False

    def check(self, model: ReflectanceModel) -> None:
        """Raise InputError if any is chosen and the model has no normal."""
        if (self.normals or self.relief) and not any(parameter.is_normal for parameter in model.parameters):
            raise InputError(f"model {model.name}: has no normal, so it has no other normal maps and no height")

    @property
    def relief(self) -> bool:
        """Whether heights are needed."""
        return self.height or self.displacement


def normals_of_text(option: str, text: str | None) -> tuple[str, ...]:
    """Return the spaces in a list like "object,world,directx", each once, in that order. Raises InputError."""
    spaces = [part.strip().lower() for part in text.split(",")] if text else []
    if unknown := [part for part in spaces if part not in NORMAL_SPACES]:
        raise InputError(f"{option}: '{unknown[0]}' is not a normal map; choose some of {', '.join(NORMAL_SPACES)}")
    return tuple(space for space in NORMAL_SPACES if space in spaces)


def derived_maps(
    extras: DerivedMaps, recovered: Maps, written: Maps, bake: GeometryBake, mesh: MeshData | None, camera: Camera
) -> tuple[list[DerivedMap], Height | None]:
    """Compute the chosen maps; return them and the relief, None if not chosen.

    recovered: maps with normals and grain in the solver's frames. written: in those of Blender's normal maps. bake: the
    domain's. mesh: None for a card; then object space is that of ``camera``, and world space the capture's.
    """
    name = next((parameter.name for parameter in recovered.model.parameters if parameter.is_normal), None)
    if name is None or not (extras.normals or extras.relief):
        return [], None
    solver, tangent = (_everywhere(maps.values[name], recovered.solved.shape) for maps in (recovered, written))
    spaces = {}
    for space in extras.normals:
        if space == "directx":
            spaces[space] = tangent
        elif mesh is None:
            spaces[space] = tangent if space == "object" else turned(camera.matrix, tangent)
        else:
            world = world_normals(bake, solver)
            spaces[space] = world if space == "world" else object_normals(mesh.matrix, world)
    maps = normal_maps(spaces, recovered.solved, written.margin)
    if not extras.relief:
        return maps, None
    if mesh is None:
        height = card_height(camera, solver, recovered.solved)
    else:
        height = mesh_height(mesh, surface_bake(bake), solver, recovered.solved)
    return [*maps, height_map(height)], height


def _everywhere(normals: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return normals (H, W, 3) from one per texel, or broadcast from one for all."""
    normals = np.asarray(normals)
    return np.broadcast_to(normals.reshape(1, 1, 3), (*shape, 3)) if normals.size == 3 else normals.reshape(*shape, 3)
