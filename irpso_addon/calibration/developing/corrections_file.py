"""The corrections of a developed capture as a folder: corrections.toml, the response curve, dark and flat frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...capture.errors import CaptureError
from ...capture.formats.toml_file import known_keys, load_toml, number, rows, text, vector
from ...capture.images.exif import Exposure, exposure_of, lens_of, orientation_of, tags_of
from ...capture.images.exr import read_exr, write_exr
from ...capture.images.exr_header import is_exr
from ...capture.images.headers import read_bytes
from ...capture.images.raw import is_raw, raw_header
from ...core.errors import InputError
from ...core.files import new_folder
from ...core.toml_text import toml_value
from ..radiometry.curve_file import read_response, write_response
from ..radiometry.develop import Corrections, ExposureGroup
from ..radiometry.frames import Dark, Flat
from ..radiometry.source import Exposing
from .measure import Measured

FOLDER = "corrections"
_TABLE, _CURVE, _FLAT = "corrections.toml", "response.toml", "flat.exr"
FORMAT = 1
LENS_KEYS = ("make", "model", "lens", "focal_length", "focal_length_35mm")
_KEYS = {"format", "colour_space", "saturated", "reference", "gains", "matrix", "exposure", "response", "flat", "dark",
         "scale_dark", "photograph"}  # fmt: skip


@dataclass(frozen=True)
class Photograph:
    """Source of an image. image: its file in the capture. file: name of the camera's file, or of the bracket.

    lens: camera, lens and focal length, as far as EXIF states them. exposure, orientation: by EXIF, or None.
    """

    image: str
    file: str
    lens: dict[str, str | float] = field(default_factory=dict)
    exposure: Exposure | None = None
    orientation: int | None = None

    def keys(self) -> dict[str, Any]:
        """Return its keys in corrections.toml, without those that are None."""
        exposure = self.exposure
        table: dict[str, Any] = {"image": self.image, "file": self.file, **self.lens}
        if exposure is not None:
            table |= {"seconds": exposure.seconds, "f_number": exposure.f_number, "iso": exposure.iso}
        table["orientation"] = self.orientation
        return {key: value for key, value in table.items() if value is not None}


def photograph_of(image: str, group: ExposureGroup) -> Photograph:
    """Return the source of a group; an EXR has no EXIF. Raises InputError if its file cannot be read."""
    photograph = photograph_at(image, group.images[0].path)
    return photograph if len(group.images) == 1 else replace(photograph, file=group.name + group.images[0].path.suffix)


def photograph_at(image: str, path: Path) -> Photograph:
    """Return the source of an image from a file; an EXR has no EXIF."""
    if is_exr(path):
        return Photograph(image, path.name)
    data = read_bytes(path)
    orientation = raw_header(path).tag if is_raw(path) else orientation_of(tags_of(data))
    return Photograph(image, path.name, lens_of(data), exposure_of(data), orientation)


def photograph_of_keys(row: dict[str, Any], where: str) -> Photograph:
    """Return a Photograph from its table. Raises CaptureError at unknown keys."""
    known_keys(row, {"image", "file", *LENS_KEYS, "seconds", "f_number", "iso", "orientation"}, where)
    seconds, f_number, iso, orientation = (
        number(row, key, where) if key in row else None for key in ("seconds", "f_number", "iso", "orientation")
    )
    lens = {key: row[key] for key in LENS_KEYS if key in row}
    exposure = None if seconds is None else Exposure(seconds, f_number, iso)
    tag = None if orientation is None else int(orientation)
    return Photograph(text(row, "image", where), text(row, "file", where), lens, exposure, tag)


def write_corrections(folder: Path, measured: Measured, photographs: Sequence[Photograph]) -> None:
    """Write corrections into a new folder, atomically. Raises InputError if writing fails."""
    corrections = measured.corrections
    with new_folder(folder) as partial:
        if corrections.response is not None:
            write_response(partial / _CURVE, corrections.response)
        dark, flat = corrections.darks[0], corrections.flats[0]
        for n, (_, level) in enumerate(dark.levels if dark else ()):
            write_exr(partial / f"dark_{n}.exr", {"": _channels(level)})
        if flat is not None:
            channels = _channels(flat.field) | {"A": flat.usable.astype(np.float32)}
            write_exr(partial / _FLAT, {"": channels})
        lines = "\n".join(_lines(measured, photographs)) + "\n"
        (partial / _TABLE).write_text(lines, encoding="utf-8")


def _lines(measured: Measured, photographs: Sequence[Photograph]) -> Iterator[str]:
    corrections, exposing = measured.corrections, measured.exposing
    yield "# What irpso develop measured: linear images of other photographs by the same camera under the same lamps."
    top = {"format": FORMAT, "colour_space": measured.colour_space, "saturated": corrections.saturated,
           "reference": corrections.reference, "gains": list(corrections.gains)}  # fmt: skip
    if corrections.matrix is not None:
        top["matrix"] = corrections.matrix
    if exposing is not None:
        top["exposure"] = {"by": exposing.by, "merged": exposing.merged, "given": list(exposing.exposures)}
    if corrections.response is not None:
        top["response"] = _CURVE
    if corrections.flats[0] is not None:
        top["flat"] = _FLAT
    dark = corrections.darks[0]
    if dark is not None:
        top["scale_dark"] = dark.scaled
    yield from (f"{key} = {toml_value(value)}" for key, value in top.items())
    for n, (amount, _) in enumerate(dark.levels if dark else ()):
        yield from ("", "[[dark]]", f'image = "dark_{n}.exr"')
        if amount is not None:
            yield f"exposure = {toml_value(float(amount))}"
    for photograph in photographs:
        yield from ("", "[[photograph]]", *(f"{k} = {toml_value(v)}" for k, v in photograph.keys().items()))


def read_corrections(folder: Path) -> tuple[Measured, tuple[Photograph, ...]]:
    """Return the corrections in a folder, for one camera, and the photographs for which they were measured.

    Raises InputError if a file is missing or damaged.
    """
    path = folder / _TABLE
    table, where = load_toml(path), str(path)
    known_keys(table, _KEYS, where)
    if table.get("format") != FORMAT:
        raise CaptureError(f"{path}: format is {table.get('format')!r}; this program reads format = {FORMAT}", "format")
    try:
        dark = _dark(folder, table, path)
        flat = _flat(folder / _FLAT) if "flat" in table else None
        exposing = table.get("exposure")
        measured = Measured(
            Corrections(
                response=read_response(folder / _CURVE) if "response" in table else None,
                darks=(dark,),
                flats=(flat,),
                reference=number(table, "reference", where),
                gains=vector(table, "gains", 3, where),  # type: ignore[arg-type]
                matrix=np.array(table["matrix"], np.float64).reshape(3, 3) if "matrix" in table else None,
                saturated=number(table, "saturated", where),
            ),
            exposing=None if exposing is None else Exposing(
                exposing["by"], bool(exposing["merged"]), tuple(map(float, exposing["given"]))
            ),
            colour_space=text(table, "colour_space", where),
        )  # fmt: skip
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: is damaged ({error}); develop the photographs again") from error
    photographs = rows(table, "photograph", path, needed=False)
    return measured, tuple(photograph_of_keys(row, f"{path}: photograph {n}") for n, row in enumerate(photographs, 1))


def _dark(folder: Path, table: dict[str, Any], path: Path) -> Dark | None:
    levels = [(float(row["exposure"]) if "exposure" in row else None, _frame(folder / row["image"])[0])
              for row in rows(table, "dark", path, needed=False)]  # fmt: skip
    return Dark(tuple(levels), bool(table.get("scale_dark", False))) if levels else None


def _flat(path: Path) -> Flat:
    field_of, usable = _frame(path)
    return Flat(field_of, usable > 0)


def _channels(frame: np.ndarray) -> dict[str, np.ndarray]:
    return {name: frame[..., i] for i, name in enumerate("RGB")}


def _frame(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return colours (H, W, 3) and alpha (H, W), 1 without one."""
    (channels,) = read_exr(path).values()
    frame = np.stack([channels[name] for name in "RGB"], axis=-1)
    return frame, channels.get("A", np.ones(frame.shape[:2], np.float32))
