"""Rigs on disk: a folder with rig.toml (lamps, cameras) and the corrections by ``develop`` (docs/rigs.md)."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ...capture.errors import CaptureError
from ...capture.formats.table import spec_of_keys
from ...capture.formats.toml_file import load_toml, rows
from ...capture.framing import framed
from ...capture.images.exr_header import is_exr
from ...capture.images.linearise import Decoder
from ...capture.spec import CaptureSpec, build_capture
from ...capture.write import table_text
from ...core.errors import InputError
from ...core.files import check_unused, new_folder
from ..developing.corrections_file import FOLDER, Photograph, photograph_at, photograph_of_keys, read_corrections
from ..developing.measure import Measured

TABLE = "rig.toml"
FORMAT = 1
_HEAD = """\
# Lamps and cameras, calibrated once: irpso rig apply RIG PHOTOGRAPHS -o CAPTURE
# An observation is a lamp; its image is the photograph that it was calibrated with, which is not needed any more.
"""


@dataclass(frozen=True)
class Rig:
    """spec: cameras, and lamps as observations whose images need not exist. photographs: one of each lamp, in order.

    measured: the corrections, or None.
    """

    path: Path
    spec: CaptureSpec
    photographs: tuple[Photograph, ...]
    measured: Measured | None


def save_rig(spec: CaptureSpec, out: Path, decoder: Decoder | None = None) -> Rig:
    """Write the lamps and cameras of a capture as a rig into a new folder, atomically, and return it.

    If ``develop`` wrote the capture's images, the rig includes its corrections. Raises InputError if the capture is not
    usable or the folder is not empty.
    """
    check_unused(out)
    if spec.framing.corners is not None and spec.framing.card_width is not None:
        raise InputError(
            f"{spec.source}: has corners and card_width, which are of its own card; give card_distance instead"
        )
    capture = build_capture(spec, decoder)
    if spec.framing.card_width is not None:
        capture = replace(capture, card_distance=framed(capture, spec.framing).card_distance)
    corrections = _corrections_of(spec)
    images = [observation.image.path for observation in spec.observations]
    if corrections is None:
        photographs = [photograph_at(path.name, path) for path in images]
    else:
        by_image = {photograph.image: photograph for photograph in read_corrections(corrections)[1]}
        photographs = [by_image[path.name] for path in images]
    top: dict[str, Any] = {"rig": FORMAT}
    colour_spaces = {observation.image.colour_space for observation in spec.observations}
    if corrections is None and len(colour_spaces) == 1:  # of the photographs
        space = colour_spaces.pop()
        top["colour_space"] = "auto" if is_exr(images[0]) and space == "linear" else space
    pictures = [{"image": photograph.file, "photograph": _keys(photograph)} for photograph in photographs]
    with new_folder(out) as partial:
        (partial / TABLE).write_text(_HEAD + table_text(capture, pictures, {}, top), encoding="utf-8")
        if corrections is not None:
            shutil.copytree(corrections, partial / FOLDER)
    return read_rig(out)


def read_rig(path: Path) -> Rig:
    """Return the rig in a folder. Raises InputError if it is not a rig, damaged or of another version."""
    file = path / TABLE if path.is_dir() else path
    if not file.is_file():
        raise InputError(f"{path}: is no rig, a folder with {TABLE}; write one with irpso rig save CAPTURE -o RIG")
    table = load_toml(file)
    if table.pop("rig", None) != FORMAT:
        raise CaptureError(f"{file}: is no rig of version {FORMAT}; write it again with irpso rig save", "format")
    photographs = []
    for number, row in enumerate(rows(table, "observation", file), 1):
        where = f"{file}: observation {row.get('name', number)}"
        keys = row.pop("photograph", {})
        if not isinstance(keys, dict):
            raise CaptureError(f"{where}: photograph must be a table", "value")
        photographs.append(photograph_of_keys({"image": row.get("image"), "file": row.get("image"), **keys}, where))
    corrections = file.parent / FOLDER
    measured = read_corrections(corrections)[0] if corrections.is_dir() else None
    return Rig(file.parent, spec_of_keys(table, file), tuple(photographs), measured)


def _keys(photograph: Photograph) -> dict[str, Any]:
    return {key: value for key, value in photograph.keys().items() if key not in ("image", "file")}


def _corrections_of(spec: CaptureSpec) -> Path | None:
    """Return the folder of the corrections with which all images of a capture were developed, or None."""
    folders = {observation.image.path.resolve().parent for observation in spec.observations}
    folder = folders.pop() / FOLDER
    if folders or not folder.is_dir():
        return None
    images = {photograph.image for photograph in read_corrections(folder)[1]}
    return folder if {observation.image.path.name for observation in spec.observations} <= images else None
