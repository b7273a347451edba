"""Reads the capture table, capture.toml: a whole capture in one file (docs/capture_format.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..errors import CaptureError
from ..framing import AUTO, Framing
from ..spec import CaptureKind, CaptureSpec, ObservationSpec
from ..types import triple
from .cameras import Views
from .toml_file import image_ref, is_number, known_keys, load_toml, number, rows, text, vector

TABLE = "capture.toml"
FORMAT = 1
CARD_DISTANCE = "card_distance"
_TOP = {
    "format", "name", "colour_space", "image", "cameras", "cameras_matrix", CARD_DISTANCE, "camera", "observation",
    "crop", "corners", "scale", "card_width",
}  # fmt: skip
_EMISSION = ("light_axis", "light_cone_degrees", "light_cosine")
_OBSERVATION = {
    "name", "image", "part", "layer", "colour_space", "light_direction", "light_position", "light_intensity", "camera",
    *_EMISSION,
}  # fmt: skip


def spec_of_table(path: Path, colour_space: str = "auto") -> CaptureSpec:
    """Return the spec of a capture.toml. A ``colour_space`` other than "auto" overrides the file's.

    Raises CaptureError if a key is unknown, missing or wrong, or the cameras file is unusable.
    """
    return spec_of_keys(load_toml(path), path, colour_space)


def spec_of_keys(table: dict[str, Any], path: Path, colour_space: str = "auto") -> CaptureSpec:
    """Return the spec of the table of a capture.toml at ``path``. Raises CaptureError as ``spec_of_table`` does."""
    known_keys(table, _TOP, str(path))
    if table.get("format", FORMAT) != FORMAT:
        raise CaptureError(f"{path}: format is {table['format']!r}; this program reads format = {FORMAT}", "format")
    name = text(table, "name", str(path)) if "name" in table else path.resolve().parent.name
    distance = number(table, CARD_DISTANCE, str(path)) if CARD_DISTANCE in table else None
    views = Views(table, path)
    defaults: dict[str, Any] = {key: table[key] for key in ("image", "colour_space") if key in table}
    override: dict[str, Any] = {} if colour_space == "auto" else {"colour_space": colour_space}
    observations = tuple(
        _shot({**defaults, **row, **override}, path, n, views)
        for n, row in enumerate(rows(table, "observation", path), 1)
    )
    framing = _framing(table, str(path))
    return CaptureSpec(name, CaptureKind.TABLE, path, observations, tuple(views.specs), distance, framing=framing)


def _framing(table: dict[str, Any], where: str) -> Framing:
    fields: dict[str, Any] = {key: number(table, key, where) for key in ("scale", "card_width") if key in table}
    if "crop" in table:
        fields["crop"] = vector(table, "crop", 4, where)
    if table.get("corners") == AUTO:
        fields["corners"] = AUTO
    elif "corners" in table:
        points = table["corners"]
        if not isinstance(points, list) or not all(map(_is_point, points)):
            raise CaptureError(f'{where}: corners must be "auto", or a list of four points [x, y]', "value")
        fields["corners"] = tuple(tuple(map(float, point)) for point in points)
    if "card_width" in fields and CARD_DISTANCE in table:
        raise CaptureError(f"{where}: give one of card_width and {CARD_DISTANCE}", "value")
    try:
        return Framing(**fields)
    except CaptureError as error:
        raise CaptureError(f"{where}: {error.message}", error.code) from error


def _is_point(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(map(is_number, value))


def _shot(row: dict[str, Any], path: Path, count: int, views: Views) -> ObservationSpec:
    where = f"{path}: observation {row.get('name', count)}"
    known_keys(row, _OBSERVATION, where)
    if "image" not in row:
        raise CaptureError(f'{where}: names no image; add image = "file.exr"', "value")
    image = image_ref(row, "image", path, where)
    light_keys = [key for key in ("light_direction", "light_position") if key in row]
    if len(light_keys) != 1:
        raise CaptureError(f"{where}: needs one of light_direction and light_position", "light_missing")
    distant = light_keys[0] == "light_direction"
    light = vector(row, light_keys[0], 3, where)
    intensity = (1.0, 1.0, 1.0)
    if isinstance(row.get("light_intensity"), list):
        intensity = triple(vector(row, "light_intensity", 3, where))
    elif "light_intensity" in row:
        intensity = (number(row, "light_intensity", where, positive=False),) * 3
    camera = views.index(row, image, where)
    name = text(row, "name", where) if "name" in row else image.path.name if image.part is None else str(image.part)
    return ObservationSpec(name, image, light, where, intensity, distant, camera, *_emission(row, distant, where))


def _emission(row: dict[str, Any], distant: bool, where: str) -> tuple[tuple[float, ...] | None, float | None, float]:
    """Return a light's axis, the half-angle of its cone in degrees, and the exponent of its cosine."""
    keys = [key for key in _EMISSION if key in row]
    if keys and distant:
        raise CaptureError(f"{where}: {keys[0]} is for a light_position; a distant light has none", "value")
    if keys and "light_axis" not in row:
        raise CaptureError(f"{where}: {keys[0]} needs light_axis = [x, y, z], the light's direction", "value")
    axis = vector(row, "light_axis", 3, where) if "light_axis" in row else None
    cone = number(row, "light_cone_degrees", where) if "light_cone_degrees" in row else None
    if cone is not None and cone > 180:
        raise CaptureError(f"{where}: light_cone_degrees is the angle from the axis, 180 at most", "value")
    cosine = row.get("light_cosine", False)
    if not isinstance(cosine, bool) and not (is_number(cosine) and cosine >= 0):
        raise CaptureError(f"{where}: light_cosine must be true, false or a power of 0 or more", "value")
    return axis, cone, float(cosine)
