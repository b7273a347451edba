"""Writes a result in an export format, chosen by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..core.errors import InputError
from .gltf import write_gltf
from .names import FORMATS, ONE_FILE, WEB
from .openlime import write_openlime
from .place import file_place, file_stem
from .ptm import write_ptm
from .result import Result
from .surface import unused_parameters
from .textures import write_textures
from .web.page import write_page
from .web.photographs import Photographs


def export(
    result: Result,
    kind: str,
    out: str | Path,
    convention: str,
    subject: Callable[[], Any],
    photographs: Callable[[], Photographs | None] = lambda: None,
    replace: bool = True,
) -> dict[str, Any]:
    """Write a result in a format; return the entries of its report. Raises InputError; then nothing is written.

    out: a folder; for gltf and ptm also a file. convention: of texture sets. subject: called only for gltf, returns the
    object in the open file to export. photographs: called only for a page, returns the capture's photographs.
    replace: existing files.
    """
    if kind not in FORMATS:
        raise InputError(f"--format {kind}: choose one of {', '.join(FORMATS)}")
    if kind == "openlime":
        return _with_warning(result, write_openlime(result, out, replace))
    if kind == WEB:
        return write_page(result, out, photographs() if result.card else None, replace)
    if kind == "textures":
        return write_textures(result, out, convention, replace)
    # A PTM's names have the numbers of UDIM tiles.
    path = file_place(out, file_stem(result.name), [ONE_FILE[kind]], replace or kind == "ptm")
    if kind == "ptm":
        return write_ptm(result, path, replace)
    return _with_warning(result, write_gltf(result, path, subject()))


def _with_warning(result: Result, report: dict[str, Any]) -> dict[str, Any]:
    """Return the report of a format of one lobe, with a warning of the parameters that it cannot hold."""
    if lost := unused_parameters(result.maps.model):
        text = f"{', '.join(lost)}: this format has no place for them; textures, or the maps themselves, have"
        report["warnings"] = [*report.get("warnings", []), text]
    return report
