"""Texture sets with the file names that other programs expect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..core.png import encode_png
from ..core.udim import tile_part, tile_stem
from ..results.derived_map import height_map
from ..results.map_tables import encoded_values, map_tables, map_values
from ..results.maps import Maps, split_maps
from ..results.report import plain, quantiles
from . import pixels
from .lobes import fit_ggx
from .place import file_stem, filled_folder
from .result import Result, open_sky_of
from .surface import F0_HALF, Surface, surface_of

_SPECULAR_OF_F0 = 0.5 / F0_HALF  # Principled's, Unreal's and Substance's: 0.5 reflects 4 %


@dataclass(frozen=True)
class _Set:
    """The maps of one tile for a single lobe."""

    maps: Maps
    surface: Surface
    roughness: np.ndarray
    specular: np.ndarray
    height: np.ndarray | None
    open_sky: np.ndarray | float


@dataclass(frozen=True)
class _Texture:
    """One file of a set: suffix of its name, its pixels in 0…1 (None for no file), and its bits."""

    suffix: str
    pixels: Callable[[_Set], np.ndarray | None]
    bits: int = 8


_BASE = _Texture("_BaseColor", lambda s: pixels.colour(s.surface.base_color, s.maps))
_ROUGHNESS = _Texture("_Roughness", lambda s: pixels.packed(s.maps, s.roughness))
_METALLIC = _Texture("_Metallic", lambda s: pixels.packed(s.maps, s.surface.metallic))
_SPECULAR = _Texture("_Specular", lambda s: pixels.packed(s.maps, s.specular))
_NORMAL = _Texture("_Normal", lambda s: pixels.normal(s.surface.normal, s.maps), 16)
_HEIGHT = _Texture("_Height", lambda s: s.height, 16)
# Metallic, occlusion, detail mask and smoothness, as for Unity's HDRP.
_MASK = _Texture("_MaskMap", lambda s: pixels.packed(s.maps, s.surface.metallic, s.open_sky, 1.0, 1 - s.roughness))


def _orm(s: _Set) -> np.ndarray:
    """Return occlusion (1 where it is unknown), roughness and metallic."""
    return pixels.packed(s.maps, s.open_sky, s.roughness, s.surface.metallic)


def _occlusion(s: _Set) -> np.ndarray | None:
    return None if isinstance(s.open_sky, float) else pixels.packed(s.maps, s.open_sky)


def _directx(s: _Set) -> np.ndarray:
    return pixels.normal(s.surface.normal, s.maps, directx=True)


# Program → prefix of the names, files.
CONVENTIONS: dict[str, tuple[str, tuple[_Texture, ...]]] = {
    "blender": (
        "",
        (
            _BASE, _NORMAL, _ROUGHNESS, _METALLIC, _SPECULAR, _Texture("_ORM", _orm), _Texture("_AO", _occlusion),
            _HEIGHT,
        ),
    ),
    "unreal": (
        "T_",
        (
            _Texture("_BC", _BASE.pixels), _Texture("_N", _directx, 16), _Texture("_ORM", _orm),
            _Texture("_S", _SPECULAR.pixels), _Texture("_H", _HEIGHT.pixels, 16),
        ),
    ),
    "unity": ("", (_Texture("_BaseMap", _BASE.pixels), _NORMAL, _MASK, _HEIGHT)),
    "substance": (
        "",
        (
            _BASE, _Texture("_Normal_OpenGL", _NORMAL.pixels, 16), _Texture("_Normal_DirectX", _directx, 16),
            _ROUGHNESS, _METALLIC, _Texture("_SpecularLevel", _SPECULAR.pixels),
            _Texture("_AmbientOcclusion", _occlusion), _HEIGHT,
        ),
    ),
}  # fmt: skip


def write_textures(
    result: Result, folder: str | Path, convention: str = "blender", replace: bool = True
) -> dict[str, Any]:
    """Write a set of PNG, UDIM tiles as NAME_BaseColor.1001.png; return their names and the fit's error.

    convention: "blender", "unreal", "unity" or "substance". Two lobes are replaced by the nearest single GGX lobe. For
    an unknown shader each map is written unchanged. replace: files of the same names. Raises InputError.
    """
    if convention not in CONVENTIONS:
        raise InputError(f"'{convention}': no texture set has this name; choose one of {', '.join(CONVENTIONS)}")
    prefix, textures = CONVENTIONS[convention]
    stem = prefix + file_stem(result.name)
    report: dict[str, Any] = {}
    names = []
    with filled_folder(folder, replace) as place:
        for index, (number, maps) in enumerate(split_maps(result.maps)):
            try:
                pictures, error = _pictures(result, maps, index, textures)
            except InputError:
                pictures, error = _unchanged(maps, open_sky_of(result, index)), None
            for suffix, (image, bits) in pictures.items():
                names.append(f"{tile_stem(stem + suffix, number, result.maps.tiles)}.png")
                encode_png(place / names[-1], image, bits=bits)
            if error is not None:
                report[tile_stem("one_lobe_error", number, result.maps.tiles)] = plain(quantiles(error))
    return {"output": str(folder), "files": names, **report}


def _pictures(
    result: Result, maps: Maps, index: int, textures: tuple[_Texture, ...]
) -> tuple[dict[str, tuple[np.ndarray, int]], np.ndarray | None]:
    surface = surface_of(maps)
    fit = fit_ggx(surface)
    height = None
    if result.height is not None:
        height = tile_part(height_map(result.height).encoded, index, len(result.maps.tiles))
    specular = surface.f0 * fit.scale * _SPECULAR_OF_F0
    single = _Set(maps, surface, np.sqrt(fit.alpha), specular, height, open_sky_of(result, index))
    drawn = {texture.suffix: (texture.pixels(single), texture.bits) for texture in textures}
    pictures = {suffix: picture for suffix, picture in drawn.items() if picture[0] is not None}
    return pictures, fit.error[maps.covered] if len(surface.lobes) > 1 else None


def _unchanged(maps: Maps, open_sky: np.ndarray | float) -> dict[str, tuple[np.ndarray, int]]:
    """Return the model's own maps under their names in CamelCase, and the occlusion where it is known."""
    pictures = {
        "_" + table.name.title().replace("_", ""): (encoded_values(table, map_values(table, maps)), 16)
        for table in map_tables(maps.model)
    }
    return pictures if isinstance(open_sky, float) else pictures | {"_AO": (pixels.packed(maps, open_sky), 8)}
