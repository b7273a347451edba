"""The capture table, capture.toml: everything about a capture in one file. docs/capture_format.md describes it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .camera import is_rotation
from .draft import Draft, Shot, ViewDraft
from .images import ImageRef
from .picture import COLOUR_SPACES
from .problems import CaptureError
from .toml_file import CAMERA_KEYS, camera_maker, is_number, known_keys, load_toml, number, text, vector

TABLE = "capture.toml"
FORMAT = 1
_TOP = {"format", "name", "colour_space", "image", "camera", "observation"}
_CAMERA = {"name", "width", "height", "matrix", "mask", "mask_part", "mask_layer"} | CAMERA_KEYS
_OBSERVATION = {
    "name", "image", "part", "layer", "colour_space", "light_direction", "light_position", "light_intensity", "camera",
}  # fmt: skip


def draft_of_table(path: Path, colour_space: str = "auto") -> Draft:
    """Return the draft of a capture.toml. ``colour_space``, where not "auto", goes before what the file says.

    Raises CaptureError where a key is unknown, missing or wrong.
    """
    table = load_toml(path)
    known_keys(table, _TOP, str(path))
    if table.get("format", FORMAT) != FORMAT:
        raise CaptureError(f"{path}: format is {table['format']!r}; this program reads format = {FORMAT}", "format")
    name = text(table, "name", str(path)) if "name" in table else path.resolve().parent.name
    views = tuple(_view(row, path, n) for n, row in enumerate(_rows(table, "camera", path), 1))
    names = [view.name for view in views]
    if len(set(names)) != len(names):
        raise CaptureError(f"{path}: two cameras have the same name; names must differ", "camera")
    defaults = {key: table[key] for key in ("image", "colour_space") if key in table}
    if colour_space != "auto":
        defaults["colour_space"] = colour_space
    rows = _rows(table, "observation", path)
    shots = tuple(
        _shot({**defaults, **row, **({"colour_space": colour_space} if colour_space != "auto" else {})}, path, n, names)
        for n, row in enumerate(rows, 1)
    )
    return Draft(name, "capture table", path, shots, views)


def _rows(table: dict[str, Any], key: str, path: Path) -> list[dict[str, Any]]:
    rows = table.get(key)
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise CaptureError(f"{path}: has no [[{key}]]; add one such table for each {key}", key)
    return rows


def _view(row: dict[str, Any], path: Path, count: int) -> ViewDraft:
    where = f"{path}: camera {row.get('name', count)}"
    known_keys(row, _CAMERA, where)
    name = text(row, "name", where) if "name" in row else f"camera {count}"
    matrix = _matrix(row["matrix"], where) if "matrix" in row else None
    size = None
    if "width" in row or "height" in row:
        size = row.get("width"), row.get("height")
        if not all(isinstance(v, int) and not isinstance(v, bool) and v > 0 for v in size):
            raise CaptureError(f"{where}: width and height must both be whole numbers above 0", "value")
    mask = _image(row, "mask", path, where) if "mask" in row else None
    return ViewDraft(name, camera_maker(row, where, matrix), where, size, mask)


def _matrix(value: Any, where: str) -> np.ndarray:
    flat = sum(value, []) if isinstance(value, list) and all(isinstance(r, list) for r in value) else value
    if not isinstance(flat, list) or len(flat) != 16 or not all(map(is_number, flat)):
        raise CaptureError(f"{where}: matrix must be 16 numbers, row by row: camera to world", "matrix")
    matrix = np.asarray(flat, float).reshape(4, 4)
    if not np.isfinite(matrix).all() or not np.allclose(matrix[3], (0, 0, 0, 1)):
        raise CaptureError(f"{where}: matrix must end with the row 0, 0, 0, 1; write it row by row", "matrix")
    if not is_rotation(matrix[:3, :3]):
        raise CaptureError(
            f"{where}: matrix is no rotation with a place (it scales, mirrors or has no inverse);"
            " write the camera's matrix with its scale applied",
            "matrix",
        )
    return matrix


def _shot(row: dict[str, Any], path: Path, count: int, cameras: list[str]) -> Shot:
    where = f"{path}: observation {row.get('name', count)}"
    known_keys(row, _OBSERVATION, where)
    if "image" not in row:
        raise CaptureError(f'{where}: names no image; add image = "file.exr"', "value")
    image = _image(row, "image", path, where)
    given = [key for key in ("light_direction", "light_position") if key in row]
    if len(given) != 1:
        raise CaptureError(f"{where}: needs one of light_direction and light_position", "light_missing")
    light = vector(row, given[0], 3, where)
    intensity = (1.0,) * 3
    if isinstance(row.get("light_intensity"), list):
        intensity = vector(row, "light_intensity", 3, where)
    elif "light_intensity" in row:
        intensity = (number(row, "light_intensity", where, positive=False),) * 3
    camera = text(row, "camera", where) if "camera" in row else cameras[0]
    if camera not in cameras:
        raise CaptureError(
            f"{where}: there is no camera '{camera}'; its name must be one of {', '.join(cameras)}", "camera"
        )
    name = text(row, "name", where) if "name" in row else image.path.name if image.part is None else str(image.part)
    return Shot(name, image, light, where, intensity, given[0] == "light_direction", cameras.index(camera))


def _image(row: dict[str, Any], key: str, path: Path, where: str) -> ImageRef:
    """Return the image that ``image``, ``part``, ``layer`` (or ``mask``, ``mask_part``, ``mask_layer``) name."""
    prefix = "mask_" if key == "mask" else ""
    part, layer = row.get(f"{prefix}part"), row.get(f"{prefix}layer")
    if part is not None and (not isinstance(part, str | int) or isinstance(part, bool)):
        raise CaptureError(f"{where}: {prefix}part must be the name or the number of a part", "value")
    if layer is not None and not isinstance(layer, str):
        raise CaptureError(f"{where}: {prefix}layer must be a text", "value")
    space = row.get("colour_space", "auto")
    if space not in COLOUR_SPACES:
        raise CaptureError(f"{where}: colour_space must be one of {', '.join(COLOUR_SPACES)}", "value")
    return ImageRef(path.parent / text(row, key, where), part, layer, space)
