"""A result as a web page: a folder that opens in any browser, without a server and without a network.

A page opened as a file may load scripts, but neither read other files nor hand pictures from them to WebGL. So the
tiles are scripts that contain their pictures as text, and the page's scripts are no modules.
"""

from __future__ import annotations

import base64
import io
import json
import re
import shutil
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np

from ...core.encode import srgb_from_linear
from ...core.errors import InputError
from ...core.files import JSON_ERRORS
from ...core.paths import PAGE
from ...gpu.library import read_source
from ...reflectance.model import Parameter, ReflectanceModel
from ...results.false_color import COLORS
from ...results.maps import UNKNOWN, Maps
from ...results.preview import default_maximum
from ...results.report import plain
from ..place import filled_folder
from ..result import Result, measured_maps
from .photographs import Photographs
from .planes import components_of, layout, material_planes, share_planes
from .pyramid import INSIDE, TILE, level_shapes, levels, tile_of, tile_places

ENTRY = "index.html"
_TILES = "tiles"
_RESULT = "result.js"
_BEGINNING = "relight.result = "  # of result.js
_TILE_NAME = re.compile(r"\d+-\d+-\d+-\w+\.js$")
_QUALITY = 90  # of a photograph's JPEG
_FROM_ABOVE = np.array([0.0, 0.0, 1.0, 0.0])

Level = tuple[np.ndarray, np.ndarray]  # values (H, W, C) and coverage (H, W), rows from the top
PlanesOf = Callable[[np.ndarray, np.ndarray], np.ndarray]
Encode = Callable[[np.ndarray], str]


def write_page(
    result: Result, folder: str | Path, photographs: Photographs | None = None, replace: bool = True
) -> dict[str, Any]:
    """Write index.html, its files and the tiles into a folder; return the entries of the report.

    photographs: of the same texels, None for a page without them. replace: overwrite files of the same names; a former
    page always is. Raises InputError if the result is a mesh's.
    """
    if not result.card:
        raise InputError(
            f"{result.name}: its maps are those of a mesh, which the page does not show; choose gltf (--format gltf)"
        )
    former_page = _holds_page(Path(folder))
    if (Path(folder) / ENTRY).exists() and not former_page:
        raise InputError(
            f"{Path(folder) / ENTRY}: would be replaced, but this program did not write it; name another folder"
        )
    maps, bytes_of = measured_maps(result), {"maps": 0, "uncertainty": 0, "photographs": 0}
    with filled_folder(folder, replace or former_page) as place:
        for file in sorted(PAGE.iterdir()):
            shutil.copyfile(file, place / file.name)
        (place / _TILES).mkdir()
        writer = _TileWriter(place / _TILES)
        bytes_of["maps"] = writer.write("maps", _material_levels(maps), partial(material_planes, maps.model), _webp)
        shares, entries = _uncertainties(maps)
        if shares is not None:
            pyramid = levels(shares[::-1], maps.solved[::-1])
            bytes_of["uncertainty"] = writer.write("sigma", pyramid, share_planes, _webp)
        for k in range(len(photographs.names) if photographs else 0):
            pyramid = _photograph_levels(photographs, k)
            bytes_of["photographs"] += writer.write(f"p{k}", pyramid, _photograph_planes, _jpeg)
        described = _description(result, maps, photographs, entries)
        text = json.dumps(plain(described), indent=1, ensure_ascii=False, allow_nan=False)
        (place / _RESULT).write_text(f"{_BEGINNING}{text};\n", encoding="utf-8", errors=JSON_ERRORS)
    for former in (Path(folder) / _TILES).iterdir() if former_page else ():
        if _TILE_NAME.match(former.name) and former.name not in writer.names:
            former.unlink()
    warnings = list(photographs.warnings) if photographs else []
    return {"output": str(Path(folder) / ENTRY), "bytes": bytes_of, "warnings": warnings}


def _holds_page(folder: Path) -> bool:
    """Return whether this program wrote a page into the folder."""
    file = folder / _RESULT
    return file.is_file() and file.read_bytes().startswith(_BEGINNING.encode("ascii"))


class _TileWriter:
    """Writes pyramids as scripts, one for each tile. names: of all written files."""

    def __init__(self, folder: Path):
        self._folder = folder
        self.names: set[str] = set()

    def write(self, kind: str, pyramid: Iterable[Level], planes_of: PlanesOf, encode: Encode) -> int:
        """Write the levels of a pyramid, the finest first; return the bytes. planes_of: tile → (P, h, w, 3) uint8."""

        def script(name: str, level: Level, place: tuple[int, int]) -> int:
            planes = planes_of(*(tile_of(values, *place) for values in level))
            text = f'relight.tile("{name}", {json.dumps([encode(plane) for plane in planes])});\n'
            return (self._folder / f"{name}.js").write_text(text, encoding="ascii")

        total = 0
        with ThreadPoolExecutor() as pool:  # Pillow encodes without the interpreter's lock
            for number, level in enumerate(pyramid):
                places = tile_places(*level[1].shape)
                names = [f"{number}-{column}-{row}-{kind}" for column, row in places]
                total += sum(pool.map(script, names, repeat(level), places))
                self.names.update(f"{name}.js" for name in names)
        return total


def _material_levels(maps: Maps) -> Iterable[Level]:
    """Return the levels of all components of the model; normals stay unit vectors."""
    model = maps.model
    values = components_of(model, maps.values, maps.solved.shape)
    at = model.offset(model.normal)

    def normalise(means: np.ndarray) -> np.ndarray:
        length = np.linalg.norm(means[..., at : at + 3], axis=-1, keepdims=True)
        means[..., at : at + 3] /= np.maximum(length, 1e-9)
        return means

    return levels(values[::-1], maps.solved[::-1], normalise)


def _photograph_levels(photographs: Photographs, k: int) -> Iterable[Level]:
    radiance = np.nan_to_num(photographs.pictures[k])[::-1] / np.float32(photographs.whites[k])
    return levels(radiance, np.ones(radiance.shape[:2], bool))


def _photograph_planes(radiance: np.ndarray, covered: np.ndarray) -> np.ndarray:
    return np.rint(255 * np.clip(srgb_from_linear(radiance), 0, 1)).astype(np.uint8)[None]


def _uncertainties(maps: Maps) -> tuple[np.ndarray | None, dict[str, tuple[int, str]]]:
    """Return (H, W, C) deviations as fractions of the colour scale's end, and name → (channel, that end as text)."""
    channels, entries = [], {}
    for p in maps.model.parameters:
        if maps.confidence is not None and p.name in maps.confidence:
            most = UNKNOWN * p.width
            entries[p.name] = len(channels), f"{np.degrees(most):.3g}°" if p.is_normal else f"{most:.2g}"
            channels.append(maps.confidence[p.name].max(axis=-1) / most)
    if maps.residual is not None:
        most = default_maximum([100 * maps.residual], maps.solved)
        entries["residual"] = len(channels), f"{most:g} %"
        channels.append(100 * maps.residual / most)
    return (np.stack(channels, axis=-1) if channels else None), entries


def _description(
    result: Result, maps: Maps, photographs: Photographs | None, entries: dict[str, tuple[int, str]]
) -> dict[str, Any]:
    model, (height, width) = maps.model, maps.solved.shape
    shown = [_view(model, p, entries.get(p.name)) for p in model.parameters]
    if "residual" in entries:
        shown.append({"name": "residual", "title": "Residual", "uncertainty": entries["residual"]})
    # A flat card in units of its width: without photographs its real plane is unknown.
    flat = [[-0.5, 0.5 * height / width, 0.0], [1 / width, 0.0, 0.0], [0.0, -1 / width, 0.0]]
    return {
        "name": result.name,
        "model": model.title,
        "size": [width, height],
        "tile": [TILE, INSIDE],
        "levels": [[w, h] for h, w in level_shapes(height, width)],
        "planes": 1 + -(-(model.components - 3) // 3),
        "uncertaintyPlanes": -(-len(entries) // 3),
        "parameters": shown,
        "ramp": np.round(COLORS, 4),
        "view": photographs.view if photographs else _FROM_ABOVE,
        "place": photographs.place if photographs else flat,
        "photographs": _light_list(photographs),
        "shader": {"vertex": _source("web/page_vertex.glsl"), "fragment": _fragment(model)},
    }


def _view(model: ReflectanceModel, p: Parameter, uncertainty: tuple[int, str] | None) -> dict[str, Any]:
    title = p.name.replace("_", " ").capitalize()
    place = [model.offset(p.name), p.components]
    return {"name": p.name, "title": title, "place": place, "uncertainty": uncertainty}


def _light_list(photographs: Photographs | None) -> Sequence[dict[str, Any]]:
    if photographs is None:
        return []
    return [
        {
            "name": name, "unseen": bool(photographs.unseen[k]), "light": photographs.lights[k],
            "intensity": photographs.intensities[k], "white": photographs.whites[k],
        }
        for k, name in enumerate(photographs.names)
    ]  # fmt: skip


def _fragment(model: ReflectanceModel) -> str:
    includes = {"model.glsl": model.shader, "web/layout.glsl": layout(model, len(COLORS))}
    return _source("web/page.glsl", includes)


def _source(path: str, includes: dict[str, Any] | None = None) -> str:
    """Return a shader's text. WebGL's #line takes numbers of files only, so names become comments."""
    return re.sub(r'^#line 1 "(.*)"$', r"// \1", read_source(path, includes or {}), flags=re.M)


def _webp(picture: np.ndarray) -> str:
    return _data_uri(picture, "webp", lossless=True, quality=60, method=3)


def _jpeg(picture: np.ndarray) -> str:
    return _data_uri(picture, "jpeg", quality=_QUALITY, subsampling=0)


def _data_uri(picture: np.ndarray, kind: str, **settings: Any) -> str:
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(picture)).save(out, kind, **settings)
    return f"data:image/{kind};base64,{base64.b64encode(out.getvalue()).decode('ascii')}"
