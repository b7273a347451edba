"""Strict reader of TOML tables: errors for unknown keys and wrong types name file, place and remedy."""

from __future__ import annotations

import math
import sys
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..camera import Camera
from ..distortion import MAX_COEFFICIENT, NAMES
from ..errors import CaptureError
from ..images.image import ImageRef
from ..images.linearise import COLOUR_SPACES

FOCAL_KEYS, _WIDTHS = {"fov_degrees", "focal_length_px"}, {"world_width", "world_height"}
CAMERA_KEYS = {"orthographic", "principal_point", "distortion"} | FOCAL_KEYS | _WIDTHS
_SQUARE_WORLD = 2.0  # the width of Blender's default plane


def load_toml(path: Path) -> dict[str, Any]:
    """Return the table of a TOML file. Raises CaptureError if it is missing or not TOML."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise CaptureError(
            f"{path}: cannot be read ({error.strerror}); write it or check its name", "missing"
        ) from error
    except ValueError as error:  # also of UTF-8, and of a number with thousands of digits
        raise CaptureError(f"{path}: is not valid TOML: {error}; correct it there", "not_toml") from error


def known_keys(table: dict[str, Any], known: set[str], where: str) -> None:
    """Raise CaptureError for the first unknown key of a table."""
    unknown = sorted(set(table) - known)
    if unknown:
        raise CaptureError(f"{where}: unknown key '{unknown[0]}'; known are {', '.join(sorted(known))}", "unknown_key")


def number(table: dict[str, Any], key: str, where: str, positive: bool = True) -> float:
    """Return a number of a table. Raises CaptureError for other types; if ``positive``, also unless 0 < number < ∞."""
    value = table[key]
    if not is_number(value) or (positive and not 0 < value < math.inf):
        raise CaptureError(
            f"{where}: {key} must be a number{' above 0' if positive else ''}, as in {key} = 1.5", "value"
        )
    return float(value)


def vector(table: dict[str, Any], key: str, length: int, where: str) -> tuple[float, ...]:
    """Return a list of ``length`` numbers. Raises CaptureError for anything else."""
    value = table[key]
    if not isinstance(value, list) or len(value) != length or not all(map(is_number, value)):
        raise CaptureError(f"{where}: {key} must be a list of {length} numbers", "value")
    return tuple(map(float, value))


def text(table: dict[str, Any], key: str, where: str) -> str:
    """Return a non-empty string of a table. Raises CaptureError for anything else."""
    if not isinstance(table[key], str) or not table[key]:
        raise CaptureError(f'{where}: {key} must be a text, as in {key} = "name"', "value")
    return table[key]


def is_number(value: Any) -> bool:
    """Return whether a TOML value is an integer that a float can hold or a float (NaN included), and no boolean."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return isinstance(value, float) or abs(value) <= sys.float_info.max


def rows(table: dict[str, Any], key: str, path: Path, needed: bool = True) -> list[dict[str, Any]]:
    """Return the tables [[key]]. Raises CaptureError if they are of another type or, if ``needed``, missing."""
    tables = table.get(key, [])
    if not isinstance(tables, list) or not (tables or not needed) or not all(isinstance(row, dict) for row in tables):
        raise CaptureError(f"{path}: has no [[{key}]]; add one such table for each {key}", key)
    return tables


def image_ref(row: dict[str, Any], key: str, path: Path, where: str) -> ImageRef:
    """Return the image of the keys ``image``, ``part``, ``layer`` (or ``mask``, ``mask_part``, ``mask_layer``)."""
    prefix = "mask_" if key == "mask" else ""
    part, layer = row.get(f"{prefix}part"), row.get(f"{prefix}layer")
    if part is not None and (not isinstance(part, str | int) or isinstance(part, bool)):
        raise CaptureError(f"{where}: {prefix}part must be the name or the number of a part", "value")
    if layer is not None and not isinstance(layer, str):
        raise CaptureError(f"{where}: {prefix}layer must be a text", "value")
    space = row.get("colour_space", "auto")
    if space not in COLOUR_SPACES:
        raise CaptureError(f"{where}: colour_space must be one of {', '.join(COLOUR_SPACES)}", "value")
    return ImageRef(path.parent / text(row, key, where), part, layer, space, f"'{key}' in {where}")


def has_lens(table: Mapping[str, Any]) -> bool:
    """Return whether a camera's table gives an angle, a focal length or a width."""
    return not {"fov_degrees", "focal_length_px", "world_width"}.isdisjoint(table)


def camera_maker(table: dict[str, Any], where: str, matrix: np.ndarray | None = None) -> Callable[[int, int], Camera]:
    """Return (width, height) → Camera of the keys CAMERA_KEYS; without any, an orthographic camera 2 units wide.

    Raises CaptureError if keys are wrong or contradict each other.
    """
    perspective = not FOCAL_KEYS.isdisjoint(table)
    orthographic = table.get("orthographic", "world_width" in table or not perspective)
    if not isinstance(orthographic, bool):
        raise CaptureError(f"{where}: orthographic must be true or false", "value")
    if "world_height" in table and "world_width" not in table:
        raise CaptureError(f"{where}: world_height needs world_width; give both, or neither", "camera")
    wrong = FOCAL_KEYS if orthographic else _WIDTHS
    if wrong & set(table) or set(table) >= FOCAL_KEYS:
        raise CaptureError(
            f"{where}: give one of fov_degrees, focal_length_px, or orthographic = true with world_width", "camera"
        )
    if not orthographic and not perspective:
        raise CaptureError(f"{where}: a perspective camera needs fov_degrees or focal_length_px", "camera")
    world_width = number(table, "world_width", where) if "world_width" in table else _SQUARE_WORLD
    world_height = number(table, "world_height", where) if "world_height" in table else None
    fov = number(table, "fov_degrees", where) if "fov_degrees" in table else None
    if fov is not None and fov >= 180:
        raise CaptureError(f"{where}: fov_degrees must be below 180", "value")
    focal = _focal(table, where) if "focal_length_px" in table else None
    centre = vector(table, "principal_point", 2, where) if "principal_point" in table else None
    distortion = _distortion(table["distortion"], orthographic, where) if "distortion" in table else ()

    def make(width: int, height: int) -> Camera:
        x, y = centre or (width / 2, height / 2)
        if orthographic:
            camera = Camera.orthographic(width, height, world_width, matrix)
        else:
            camera = Camera.from_fov(width, height, fov or 90.0, matrix)
        scale = focal or (camera.scale[0], height / world_height if world_height else camera.scale[1])
        return Camera(width, height, scale, (x, y), camera.matrix, camera.perspective, distortion)

    return make


def _distortion(value: Any, orthographic: bool, where: str) -> tuple[float, ...]:
    if orthographic:
        raise CaptureError(f"{where}: distortion is for perspective cameras; remove it or give fov_degrees", "camera")
    if not isinstance(value, list) or not 0 < len(value) <= len(NAMES) or not all(map(is_number, value)):
        raise CaptureError(f"{where}: distortion must be a list of up to 8 numbers: {', '.join(NAMES)}", "value")
    if not all(abs(number) <= MAX_COEFFICIENT for number in value):
        raise CaptureError(f"{where}: distortion must hold finite numbers only, as a lens has them", "value")
    return tuple(map(float, value))


def _focal(table: dict[str, Any], where: str) -> tuple[float, float]:
    if isinstance(table["focal_length_px"], list):
        x, y = vector(table, "focal_length_px", 2, where)
        if not min(x, y) > 0:
            raise CaptureError(f"{where}: focal_length_px must be above 0", "value")
        return x, y
    return (number(table, "focal_length_px", where),) * 2
