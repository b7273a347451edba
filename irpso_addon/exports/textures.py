"""Texture sets with the file names that other programs expect."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
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
from .surface import F0_HALF, Surface, surface_of, unused_parameters

_SPECULAR_OF_F0 = 0.5 / F0_HALF  # Principled's, Unreal's and Substance's: 0.5 reflects 4 %
_LEAST = 0.5 / 255  # what a specular level exceeds 1 by, to be too dark in 8 bits


@dataclass(frozen=True)
class _Shape:
    """Maps of one tile that all models have. normal: (H, W, 3) unit, OpenGL. open_sky: (H, W), or 1 if unknown."""

    maps: Maps
    normal: np.ndarray
    height: np.ndarray | None
    open_sky: np.ndarray | float


@dataclass(frozen=True)
class _Set(_Shape):
    """The maps of one tile for a single lobe. error: (H, W) of the lobe, as in a Fit.

    base: (H, W, 3) base colour for a shader that takes the lobe's reflectance off it.
    """

    surface: Surface
    base: np.ndarray
    roughness: np.ndarray
    specular: np.ndarray
    error: np.ndarray


@dataclass(frozen=True)
class _Texture:
    """One file of a set: suffix of its name, its pixels in 0…1 (None for no file), and its bits."""

    suffix: str
    pixels: Callable[[Any], np.ndarray | None]
    bits: int = 8


def _opengl(s: _Shape) -> np.ndarray:
    return pixels.normal(s.normal, s.maps)


def _directx(s: _Shape) -> np.ndarray:
    return pixels.normal(s.normal, s.maps, directx=True)


def _height(s: _Shape) -> np.ndarray | None:
    return s.height


def _occlusion(s: _Shape) -> np.ndarray | None:
    return None if isinstance(s.open_sky, float) else pixels.packed(s.maps, s.open_sky)


_BASE = _Texture("_BaseColor", lambda s: pixels.colour(s.base, s.maps))
_ADDED_BASE = _Texture("_BaseColor", lambda s: pixels.colour(s.surface.base_color, s.maps))  # the lobe adds to it
_ROUGHNESS = _Texture("_Roughness", lambda s: pixels.packed(s.maps, s.roughness))
_METALLIC = _Texture("_Metallic", lambda s: pixels.packed(s.maps, s.surface.metallic))
_SPECULAR = _Texture("_Specular", lambda s: pixels.packed(s.maps, s.specular))
_NORMAL = _Texture("_Normal", _opengl, 16)
_HEIGHT = _Texture("_Height", _height, 16)
_OF_SHAPE = _opengl, _directx, _height, _occlusion
# Metallic, occlusion, detail mask and smoothness, as for Unity's HDRP.
_MASK = _Texture("_MaskMap", lambda s: pixels.packed(s.maps, s.surface.metallic, s.open_sky, 1.0, 1 - s.roughness))


def _orm(s: _Set) -> np.ndarray:
    """Return occlusion (1 where it is unknown), roughness and metallic."""
    return pixels.packed(s.maps, s.open_sky, s.roughness, s.surface.metallic)


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
            _Texture("_BC", _ADDED_BASE.pixels), _Texture("_N", _directx, 16), _Texture("_ORM", _orm),
            _Texture("_S", _SPECULAR.pixels), _Texture("_H", _HEIGHT.pixels, 16),
        ),
    ),
    "unity": ("", (_Texture("_BaseMap", _BASE.pixels), _NORMAL, _MASK, _SPECULAR, _HEIGHT)),
    "substance": (
        "",
        (
            _ADDED_BASE, _Texture("_Normal_OpenGL", _NORMAL.pixels, 16), _Texture("_Normal_DirectX", _directx, 16),
            _ROUGHNESS, _METALLIC, _Texture("_SpecularLevel", _SPECULAR.pixels),
            _Texture("_AmbientOcclusion", _occlusion), _HEIGHT,
        ),
    ),
}  # fmt: skip


def write_textures(
    result: Result, folder: str | Path, convention: str = "blender", replace: bool = True
) -> dict[str, Any]:
    """Write a set of PNG, UDIM tiles as NAME_BaseColor.1001.png; return their names, the fit's error and warnings.

    convention: "blender", "unreal", "unity" or "substance". Two lobes are replaced by the nearest single GGX lobe. Maps
    that no texture of the set holds, such as a clear coat's, and for an unknown shader all but the normal, are written
    unchanged. replace: files of the same names. Raises InputError.
    """
    if convention not in CONVENTIONS:
        raise InputError(f"'{convention}': no texture set has this name; choose one of {', '.join(CONVENTIONS)}")
    prefix, textures = CONVENTIONS[convention]
    stem = prefix + file_stem(result.name)
    report: dict[str, Any] = {}
    names = []
    with filled_folder(folder, replace) as place:
        for index, (number, maps) in enumerate(split_maps(result.maps)):
            pictures, made = _pictures(result, maps, index, textures)
            for suffix, (image, bits) in pictures.items():
                names.append(f"{tile_stem(stem + suffix, number, result.maps.tiles)}.png")
                encode_png(place / names[-1], image, bits=bits)
            if made is None:
                continue
            if len(made.surface.lobes) > 1:
                error = plain(quantiles(made.error[maps.solved]))
                report[tile_stem("one_lobe_error", number, result.maps.tiles)] = error
            if text := _too_dark(made, textures):
                text = f"{tile_stem(stem, number, result.maps.tiles)}: {text}"
                report.setdefault("warnings", []).append(text)
    return {"output": str(folder), "files": names, **report}


def _too_dark(made: _Set, textures: Iterable[_Texture]) -> str:
    """Return a warning of the texels whose dielectric reflects more than a set holds, "" for none."""
    clipped = made.specular[made.maps.solved] > 1 + _LEAST
    suffix = next((texture.suffix for texture in textures if texture.pixels is _SPECULAR.pixels), "")
    if not (suffix and clipped.any()):
        return ""
    text = f"{suffix} holds a reflectance of at most {1 / _SPECULAR_OF_F0:.0%}"
    return f"{text}: the highlight of {clipped.mean():.2%} of the texels is too dark"


def _pictures(
    result: Result, maps: Maps, index: int, textures: tuple[_Texture, ...]
) -> tuple[dict[str, tuple[np.ndarray, int]], _Set | None]:
    """Return suffix → pixels and bits of a tile, and the maps of its single lobe, None for an unknown shader."""
    height = None
    if result.height is not None:
        height = tile_part(height_map(result.height).encoded, index, len(result.maps.tiles))
    (normal,) = (p.name for p in maps.model.parameters if p.is_normal)
    shape = _Shape(maps, np.float32(maps.values[normal]), height, open_sky_of(result, index))
    try:
        surface = surface_of(maps)
    except InputError:  # the meaning of the other maps is unknown
        known = [texture for texture in textures if texture.pixels in _OF_SHAPE]
        if all(texture.pixels is not _occlusion for texture in known):
            known.append(_Texture("_AO", _occlusion))
        drawn = _drawn(known, shape)
        return drawn | _unchanged(maps, {p.name for p in maps.model.parameters} - {normal}), None
    fit = fit_ggx(surface)
    specular = surface.f0 * fit.strength * _SPECULAR_OF_F0
    made = _Set(
        **vars(shape), surface=surface, base=surface.base_below(fit.strength), roughness=np.sqrt(fit.alpha),
        specular=specular, error=fit.error,
    )  # fmt: skip
    return _drawn(textures, made) | _unchanged(maps, unused_parameters(maps.model)), made


def _drawn(textures: Iterable[_Texture], made: _Shape) -> dict[str, tuple[np.ndarray, int]]:
    """Return suffix → pixels and bits, without absent ones."""
    all_pixels = ((texture, texture.pixels(made)) for texture in textures)
    return {texture.suffix: (image, texture.bits) for texture, image in all_pixels if image is not None}


def _unchanged(maps: Maps, names: Collection[str]) -> dict[str, tuple[np.ndarray, int]]:
    """Return the model's own maps of some parameters, under their names in CamelCase."""
    return {
        "_" + table.name.title().replace("_", ""): (encoded_values(table, map_values(table, maps)), 16)
        for table in map_tables(maps.model)
        if {p.name for p in table.parameters} & set(names)
    }
