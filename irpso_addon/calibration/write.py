"""Writing what balls have told: a capture table, lists, a report and a picture to judge them by."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..capture.formats.diligent import DIRECTIONS, FILENAMES, INTENSITIES
from ..capture.formats.table import TABLE
from ..core.errors import InputError
from ..core.files import check_unused, new_folder
from ..core.png import encode_png
from .balls.contact_sheet import calibration_picture
from .job import Calibrated, report_text, written_table

_REPORT, _PICTURE = "report.json", "balls.png"


def checked_output(out: Path) -> Path:
    """Return where to write. Raises InputError where that is there already: nothing is overwritten."""
    if out.suffix.lower() == ".toml":
        for path in (out, _beside(out, _REPORT), _beside(out, _PICTURE)):
            if path.exists():
                raise InputError(f"{path}: is there already; choose another name for -o, or delete it first")
    else:
        check_unused(out, "choose a new folder, or a .toml file for -o")
    return out


def _beside(table: Path, name: str) -> Path:
    return table.with_name(f"{table.stem}_{name}")


def write_calibration(found: Calibrated, out: Path, keys: Mapping[str, Any]) -> None:
    """Write table, report and picture, into a new folder with the lists of a DiLiGenT capture, or as OUT.toml.

    keys: of the camera, where they were given. Whole or not at all. Raises InputError where it cannot be written.
    """
    if out.suffix.lower() == ".toml":
        texts = {_beside(out, _REPORT): report_text(found), out: written_table(found, out.parent, keys)}
        _write_beside(out, texts, calibration_picture(found))
        return
    text = written_table(found, out, keys)
    with new_folder(out) as partial:
        (partial / TABLE).write_text(text, encoding="utf-8")
        (partial / _REPORT).write_text(report_text(found), encoding="utf-8")
        encode_png(partial / _PICTURE, calibration_picture(found), 8)
        for name, lines in _lists(found).items():
            (partial / name).write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def _write_beside(out: Path, texts: dict[Path, str], image: np.ndarray) -> None:
    """Write a table with its report and picture; the table comes last, and where it cannot be written none stays."""
    partials = {path: path.with_name(f".{path.name}.partial-{os.getpid()}") for path in texts}
    shown = _beside(out, _PICTURE)
    hidden = shown.with_name(f".{shown.stem}.partial-{os.getpid()}.png")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        for path, text in texts.items():
            partials[path].write_text(text, encoding="utf-8")
        encode_png(hidden, image, 8)
        os.replace(hidden, shown)
        for path in texts:
            os.replace(partials[path], path)
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error.strerror or error}); choose another place") from error
    finally:
        for path in (*partials.values(), hidden):
            path.unlink(missing_ok=True)


def _lists(found: Calibrated) -> dict[str, list[str]]:
    """Return the lines of the lists that other programs read: names, directions (or positions), intensities."""
    kept = [(name, light.light) for name, light in zip(found.names, found.result.lights, strict=True) if light.light]
    vectors = [" ".join(f"{v:.8f}" for v in light.vector) for _, light in kept]
    lists = {FILENAMES: [name for name, _ in kept]}
    lists["light_positions.txt" if found.result.near else DIRECTIONS] = vectors
    if found.result.kind == "matte":
        lists[INTENSITIES] = [" ".join(f"{v:.8f}" for v in light.intensity) for _, light in kept]
    return lists
