"""glTF 2.0: the mesh as triangles, and the maps as the format's textures.

Roughness and metallic go into green and blue of one picture, with the occlusion in red, 1 where it is unknown. The
specular level is KHR_materials_specular's colour, which scales F0 alone; below 0.3 also its factor, which scales F0 and
F90; where it is above 0.5, KHR_materials_ior's index as well.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..blender.materials.gltf import Surface, write_glb
from ..core.udim import tile_stem
from ..results.maps import Maps, split_maps
from ..results.report import plain, quantiles
from . import pixels
from .lobes import fit_ggx
from .place import file_stem
from .result import Result, open_sky_of, slots_of_result
from .surface import F0_HALF, surface_of

_METAL = 0.9  # metallic from which the dielectric part is not visible


def write_gltf(result: Result, path: str | Path, obj: Any) -> dict[str, Any]:
    """Write an object of the open file with a result's maps as .glb; return the entries of the report.

    A model of two lobes is given the one GGX lobe nearest to them. Raises InputError as ``write_glb`` does.
    """
    path, surfaces = Path(path), {}
    report: dict[str, Any] = {"output": str(path), "object": obj.name}
    for index, (number, maps) in enumerate(split_maps(result.maps)):
        stem = tile_stem(file_stem(result.name), number, result.maps.tiles)
        surfaces[number], error = _surface(maps, stem, open_sky_of(result, index))
        if error is not None:
            report[tile_stem("one_lobe_error", number, result.maps.tiles)] = plain(quantiles(error))
    uv_map = None if result.mesh is None else result.mesh.uv_map
    slots = slots_of_result(result, obj)
    if warnings := write_glb(path.with_suffix(".glb"), obj, result.name, surfaces, slots, uv_map, result.maps.wrapped):
        report["warnings"] = warnings
    return report


def _surface(maps: Maps, name: str, open_sky: np.ndarray | float) -> tuple[Surface, np.ndarray | None]:
    """Return the pictures of maps, and the error of fitting two lobes by one. open_sky: (H, W) occlusion, or 1."""
    surface = surface_of(maps)
    fit = fit_ggx(surface)
    factor = np.clip(surface.f90 * fit.strength, 0, 1)
    # Blender would also tint a metal's edge by the colour, which glTF reads for the dielectric part alone.
    color = np.where(surface.metallic > _METAL, 0, surface.f0 * fit.strength / np.maximum(factor, 1e-9))
    # Above 4 % the index of refraction has to rise: the colour is at most 1.
    highest = max(F0_HALF, float(color[maps.solved].max(initial=0)))
    color = np.where(surface.metallic > _METAL, 1, color / highest)
    pictures = Surface(
        name=name,
        base_color=pixels.colour(surface.base_below(fit.strength), maps),
        orm=pixels.packed(maps, open_sky, np.sqrt(fit.alpha), surface.metallic),
        normal=pixels.normal(surface.normal, maps),
        specular=_specular(maps, color, factor),
        ior=(1 + highest**0.5) / (1 - highest**0.5),
        occluded=not isinstance(open_sky, float),
    )
    return pictures, fit.error[maps.solved] if len(surface.lobes) > 1 else None


def _specular(maps: Maps, color: np.ndarray, factor: np.ndarray) -> np.ndarray | tuple[float, float]:
    """Return the specular colour and factor: two numbers where they are the same everywhere, else RGBA pixels."""
    inside = np.stack([color, factor])[:, maps.solved]
    if not inside.size or np.ptp(inside, axis=1).max() < 1e-6:
        return (float(inside[0].mean()), float(inside[1].mean())) if inside.size else (1.0, 1.0)
    grey = pixels.colour(np.repeat(color[..., None], 3, axis=-1), maps)
    return np.concatenate([grey, pixels.packed(maps, factor)], axis=-1)
