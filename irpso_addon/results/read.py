"""Reads maps from EXR files, our own or others, as parameters of a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..capture.images.exr import matrix_to_rec_709, read_exr
from ..capture.images.exr_header import read_exr_header
from ..core.errors import InputError
from ..core.udim import ONE_SQUARE, PATTERN, tile_files
from ..reflectance.model import ReflectanceModel
from .map_tables import OTHER_FILES, OTHER_SPACES, MapTable, map_tables, table_of

COVERAGE = "coverage"  # part of maps.exr: 1 at solved texels
_COLOUR_NAMES = ("R", "G", "B", "A")
_VECTOR_NAMES = ("X", "Y", "Z")


def read_maps(path: str | Path, model: ReflectanceModel, tiles: Sequence[int] = ONE_SQUARE) -> dict[str, np.ndarray]:
    """Return parameter name → (H, W, components) of all maps of a model in an EXR, or in a result's folder.

    A file of several parts has one map per part, by name (our maps.exr); a file of one part has the map that
    names its part, else the map of the longest name with which the file's name begins, such as ``normal_gt.exr``.
    tiles: UDIM tiles, side by side from the left; each has its own file, with its number in the name, or <UDIM> in
    ``path``. Colours of a file that states other primaries become linear Rec. 709. Raises InputError if a file has none
    of the model's maps, is missing, in an unknown colour space, or differs from the others in size or maps.
    """
    path = Path(path)
    maps = [_maps_of_file(file, model) for file in _files(path, tiles)]
    if any(set(values) != set(maps[0]) for values in maps):
        raise InputError(f"{path}: the files of its UDIM tiles hold different maps; write all of them again")
    return {name: _side_by_side(path, [values[name] for values in maps]) for name in maps[0]}


def unknown_maps(path: str | Path, model: ReflectanceModel, tiles: Sequence[int] = ONE_SQUARE) -> list[str]:
    """Return the names of the maps, in a file of several parts, that the model does not have; they are not read.

    path, tiles: as in ``read_maps``, which reports files that cannot be read.
    """
    parts = read_exr_header(_files(Path(path), tiles)[0])
    known = {COVERAGE, "residual", *(table.name for table in map_tables(model))}
    names = [part.name for part in parts if part.name not in known and not part.name.startswith("confidence_")]
    return names if len(parts) > 1 else []


def read_coverage(path: str | Path, tiles: Sequence[int] = ONE_SQUARE) -> np.ndarray | None:
    """Return (H, W) bool: the texels with a recovered value, by the part ``coverage``; None for files without one.

    path, tiles: as in ``read_maps``.
    """
    files = _files(Path(path), tiles)
    if not all(any(part.name == COVERAGE for part in read_exr_header(file)) for file in files):
        return None
    return _side_by_side(Path(path), [next(iter(read_exr(file)[COVERAGE].values())) > 0 for file in files])


def _files(path: Path, tiles: Sequence[int]) -> list[Path]:
    """Return the file of each tile of a result's folder, or of a path as in ``tile_files``. Raises InputError."""
    if path.is_dir():
        one = tuple(tiles) == ONE_SQUARE and (path / "maps.exr").is_file()
        path = path / ("maps.exr" if one or not any(path.glob("maps.[12]???.exr")) else f"maps.{PATTERN}.exr")
    return tile_files(path, tiles)


def _maps_of_file(path: Path, model: ReflectanceModel) -> dict[str, np.ndarray]:
    parts = _parts(path)
    tables = {table.name: table for table in map_tables(model)}
    if len(parts) == 1 and not parts.keys() & tables.keys():
        # normal_world is no normal: names of other files of a result count as well.
        named = max((name for name in (*tables, *OTHER_FILES) if path.stem.startswith(name)), key=len, default="")
        parts = {named: next(iter(parts.values()))}
    values: dict[str, np.ndarray] = {}
    for name, table in tables.items():
        if name in parts:
            values |= _split(table, _in_rec_709(table, _stacked(table, parts[name], path), path, name))
    if not values:
        names = ", ".join(tables)
        raise InputError(
            f"{path}: holds no map of model {model.name}; name the file or its parts after one of: {names}"
        )
    return values


def read_parameter(
    path: str | Path, model: ReflectanceModel, name: str, tiles: Sequence[int] = ONE_SQUARE
) -> np.ndarray:
    """Return (H, W, components) of a model's parameter from an EXR of a single part. Raises InputError.

    The file is the parameter's own, or the map that it shares with others. tiles: as in ``read_maps``.
    """
    table = table_of(model, name)
    return _side_by_side(Path(path), [_parameter_of_file(file, table, name) for file in tile_files(Path(path), tiles)])


def _parameter_of_file(path: Path, table: MapTable, name: str) -> np.ndarray:
    parts = _parts(path)
    if len(parts) != 1:
        raise InputError(f"{path}: has {len(parts)} parts; give a file with the map of {name} alone")
    if table.is_normal and path.stem.startswith(OTHER_SPACES):
        raise InputError(f"{path}: its normals are those of another space by its name; give normal.exr")
    channels = next(iter(parts.values()))
    sole = tuple(channels) if len(channels) == 1 else ()
    known = _COLOUR_NAMES, _COLOUR_NAMES[:3], _VECTOR_NAMES, ("R", "G"), ("R",), ("Y",), sole
    names = next((names for names in known if names and set(names) <= set(channels)), ())
    if not names:
        raise InputError(f"{path}: has the channels {', '.join(channels)}; save it as R, G, B")
    values = np.stack([channels[one] for one in names], axis=-1).astype(np.float32)
    return table.channels_of(name, _in_rec_709(table, values, path), str(path))


def _side_by_side(path: Path, values: list[np.ndarray]) -> np.ndarray:
    if len({value.shape for value in values}) > 1:
        sizes = ", ".join(sorted({f"{value.shape[1]} × {value.shape[0]}" for value in values}))
        raise InputError(f"{path}: the files of its UDIM tiles differ in size ({sizes}); scale them to one size")
    return values[0] if len(values) == 1 else np.concatenate(values, axis=1)


def _parts(path: Path) -> dict[str, dict[str, np.ndarray]]:
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the path of an EXR with maps")
    return read_exr(path)


def _stacked(table: MapTable, channels: Mapping[str, np.ndarray], path: Path) -> np.ndarray:
    count = table.components
    for names in (_COLOUR_NAMES[:count], _VECTOR_NAMES[:count], ("Y",) * count if count == 1 else ()):
        if names and all(name in channels for name in names):
            return np.stack([channels[name] for name in names], axis=-1).astype(np.float32)
    if len(channels) == 1 and count == 1:
        return next(iter(channels.values()))[..., None].astype(np.float32)
    available = ", ".join(channels)
    raise InputError(f"{path}: the map {table.name} has {count} channels, the file has {available}; save it as R, G, B")


def _in_rec_709(table: MapTable, values: np.ndarray, path: Path, name: str = "") -> np.ndarray:
    """Return a map's values (H, W, C), colours as linear Rec. 709. name: of the file's part, if it has several."""
    if table.color_space != "sRGB" or table.components < 3 or values.shape[-1] < 3:
        return values
    parts = read_exr_header(path)
    part = next(part for part in parts if len(parts) == 1 or part.name == name)
    matrix = matrix_to_rec_709(part, _COLOUR_NAMES[:3], str(path))
    if matrix is None:
        return values
    return np.concatenate([values[..., :3] @ matrix.T, values[..., 3:]], axis=-1).astype(np.float32)


def _split(table: MapTable, values: np.ndarray) -> dict[str, np.ndarray]:
    result, at = {}, 0
    for parameter in table.parameters:
        result[parameter.name] = values[..., at : at + parameter.components]
        at += parameter.components
    return result
