"""A finished result, from a folder or a session: the input of every export."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..blender.materials.gltf import recovered_slots
from ..capture.images.exr import read_exr
from ..core.encode import fill_margin
from ..core.errors import InputError
from ..core.udim import ONE_SQUARE, PATTERN, tile_part, tile_stem
from ..geometry.relief.height import TEXELS, Height
from ..geometry.relief.occlusion import open_sky
from ..geometry.surface.mesh import MeshData
from ..geometry.surface.slots import slot_names, slots_of_text
from ..reflectance.model import ReflectanceModel, digest_of_own_model, load_model
from ..results.maps import Maps
from ..results.read import read_maps
from ..results.write import BLEND, MODEL_DIGEST, REPORT, listed_files

_TILE = re.compile(r"\.[12]\d\d\d\.")


@dataclass(frozen=True)
class Result:
    """Name and maps of a result, normals in Blender's tangent space.

    height: the relief, None if not requested. folder: of the result, None if it is only in memory. report: its own, {}
    in memory. card: whether the maps are a flat card's, not a mesh's. baked_sky: (H, W) ``mesh_open_sky`` of a mesh,
    None if not requested. mesh: the one of a session's maps, None for a card or a folder's result. occluded: whether a
    card's relief occludes.
    """

    name: str
    maps: Maps
    height: Height | None = None
    folder: Path | None = None
    report: Mapping[str, Any] = field(default_factory=dict)
    card: bool = True
    baked_sky: np.ndarray | None = None
    mesh: MeshData | None = None
    occluded: bool = True

    @cached_property
    def open_sky(self) -> np.ndarray | float:
        """(H, W) visible share of an even sky: of a card's relief, or ``baked_sky`` of a mesh; 1 if unknown.

        The relief of a mesh gives none: it is only the mesh's fine detail. Margins around a card are filled."""
        if self.baked_sky is not None:
            return self.baked_sky
        if not self.occluded or self.height is None or self.height.unit != TEXELS:
            return 1.0
        sky = open_sky(self.height, wraps="tile" in self.report)
        return fill_margin(sky[..., None], self.height.covered)[..., 0]

    @property
    def blend(self) -> Path | None:
        """The .blend with the material, None if there is none."""
        return self.folder / BLEND if self.folder is not None and (self.folder / BLEND).is_file() else None


def read_result(folder: str | Path, model: str | None = None) -> Result:
    """Return the result that ``recover`` or the panel's export wrote into a folder.

    model: as for ``recover``; None for the report's. Raises InputError if the folder holds no finished result, or the
    model's file is missing or has changed.
    """
    folder = Path(folder)
    report = _report(folder)
    settings, table = _settings(report), load_model(model) if model else _stored_model(report)
    files = [str(name).split(".") for name in report.get("files", ())]
    numbers = sorted(int(parts[1]) for parts in files if len(parts) == 3 and parts[0] == "maps" and parts[2] == "exr")
    tiles = tuple(numbers) or ONE_SQUARE
    values = read_maps(folder, table, tiles)
    covered = np.concatenate([_coverage(folder / f"{tile_stem('maps', tile, tiles)}.exr") for tile in tiles], axis=1)
    card = not (settings.get("blend") or settings.get("object"))
    # The file's margins are already filled, at seams with the texels from across the seam.
    maps = Maps(table, values, covered, tiles=tiles, margin=~covered, wrapped=not card or "tile" in report)
    return Result(folder.resolve().name, maps, _height(folder, report, maps), folder, report, card)


def model_of_result(path: str | Path) -> ReflectanceModel | None:
    """Return the model that recovered a result; None where no result lies there.

    path: its folder, or a file that its report lists, also with <UDIM> for a tile's number. Raises InputError.
    """
    path = Path(path)
    if not path.is_dir():
        listed = {_TILE.sub(f".{PATTERN}.", name) for name in listed_files(path.parent)}
        if _TILE.sub(f".{PATTERN}.", path.name) not in listed:
            return None
        path = path.parent
    return _stored_model(_report(path)) if (path / REPORT).is_file() else None


def _settings(report: Mapping[str, Any]) -> dict[str, Any]:
    settings = report.get("settings")
    return settings if isinstance(settings, dict) else {}


def _stored_model(report: Mapping[str, Any]) -> ReflectanceModel:
    """Return the model of a report. Raises InputError where its file is missing or has changed."""
    stored = _settings(report).get("model")
    _check_unchanged(stored, _settings(report).get(MODEL_DIGEST))
    try:
        return load_model(stored or report.get("model", ""))
    except InputError as error:
        raise InputError(f"{error}; give its present place by --model") from error


def _check_unchanged(model: Any, digest: Any) -> None:
    """Raise InputError if a user's model is not the file that recovered. digest: of that; None where unknown."""
    found = digest_of_own_model(model) if isinstance(model, str) else None
    if digest is not None and found is not None and found != digest:
        raise InputError(
            f"{model}: has changed since this recovery; give the former file by --model, or this one, if the maps'"
            " meaning is the same"
        )


def open_sky_of(result: Result, index: int) -> np.ndarray | float:
    """Return ``Result.open_sky`` of the tile with this index."""
    sky = result.open_sky
    return sky if isinstance(sky, float) else tile_part(sky, index, len(result.maps.tiles))


def slots_of_result(result: Result, obj: Any) -> tuple[int, ...] | None:
    """Return the slots of a mesh object that the maps belong to, None for all.

    Their numbers are those of the report: their names are now the recovered materials'. A report of an older version
    has the numbers only where the recovery chose by number; then they are all slots with a recovered material.
    """
    if result.mesh is not None:
        return result.mesh.solved_slots
    solved = result.report.get("solved_slots")
    if isinstance(solved, list):
        return tuple(slot for slot in solved if slot < max(1, len(obj.material_slots))) or None
    settings = result.report.get("settings")
    chosen = (settings.get("slots") if isinstance(settings, dict) else None) or ""
    if chosen and all(part.strip().isdecimal() for part in chosen.split(",")):
        return slots_of_text(chosen, slot_names(obj))
    return recovered_slots(obj) or None


def measured_maps(result: Result) -> Maps:
    """Return the maps of a result with confidence and residual, where its folder has them."""
    if result.folder is None or result.maps.confidence is not None:
        return result.maps
    files = [result.folder / f"{tile_stem('maps', tile, result.maps.tiles)}.exr" for tile in result.maps.tiles]
    parts: dict[str, list[np.ndarray]] = {}
    for file in files:
        for name, channels in read_exr(file).items():
            parts.setdefault(name, []).append(np.stack(list(channels.values()), axis=-1))
    whole = {name: np.concatenate(values, axis=1) for name, values in parts.items() if len(values) == len(files)}
    prefix = "confidence_"
    confidence = {name.removeprefix(prefix): value for name, value in whole.items() if name.startswith(prefix)}
    residual = whole["residual"][..., 0] if "residual" in whole else None
    return replace(result.maps, confidence=confidence or None, residual=residual)


def _report(folder: Path) -> dict[str, Any]:
    if folder.is_file():
        raise InputError(f"{folder}: is a file; give the folder that recover wrote with -o")
    try:
        report = json.loads((folder / REPORT).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{folder}: holds no {REPORT}; give the folder that recover wrote with -o") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{folder / REPORT}: cannot be read ({error}); recover again") from error
    if not isinstance(report, dict):
        raise InputError(f"{folder / REPORT}: is no report of a result; recover again")
    if "model" not in report and "slots" not in report:
        raise InputError(f"{folder}: holds no result of recover; give the folder that recover wrote with -o")
    if isinstance(report.get("slots"), dict):
        names = ", ".join(f"'{folder / name}'" for name in report["slots"])
        raise InputError(f"{folder}: holds a result for each material slot; give one of their folders: {names}")
    return report


def _coverage(path: Path) -> np.ndarray:
    channels = read_exr(path).get("coverage")
    if channels is None:
        raise InputError(f"{path}: has no part 'coverage'; recover again")
    return next(iter(channels.values())) > 0


def _height(folder: Path, report: dict[str, Any], maps: Maps) -> Height | None:
    stems = [tile_stem("height", tile, maps.tiles) for tile in maps.tiles]
    described = report.get("height")
    if not isinstance(described, dict) or not all((folder / f"{stem}.exr").is_file() for stem in stems):
        return None
    parts = [next(iter(next(iter(read_exr(folder / f"{stem}.exr").values())).values())) for stem in stems]
    values = np.concatenate(parts, axis=1)
    if values.shape != maps.solved.shape:
        raise InputError(f"{folder}: its height is of another size than its maps; recover again")
    return Height(values, maps.solved, str(described.get("unit")), int(described.get("steps", 0)))
