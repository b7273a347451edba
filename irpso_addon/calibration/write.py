"""Output of a calibration: capture table, lists, report and contact sheet."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ..capture.formats.diligent import DIRECTIONS, FILENAMES, INTENSITIES
from ..capture.formats.table import TABLE
from ..capture.spec import CaptureSpec
from ..capture.types import Light
from ..core.errors import InputError
from ..core.files import check_unused, check_writable, new_folder
from ..core.png import encode_png, png_bytes
from .balls.contact_sheet import calibration_picture
from .job import Calibrated, report_text, written_table
from .photographs import calibrated_table

_REPORT, _PICTURE = "report.json", "balls.png"


def checked_output(out: Path) -> Path:
    """Return the output path. Raises InputError if it exists: nothing is overwritten."""
    if out.suffix.lower() == ".toml":
        for path in (out, _beside(out, _REPORT), _beside(out, _PICTURE)):
            if path.exists():
                raise InputError(f"{path}: exists; choose another name for -o, or delete it first")
        check_writable(out)
    else:
        check_unused(out, "choose a new folder, or a .toml file for -o")
    return out


def table_path(out: Path) -> Path:
    """Return the path of the table that an output has."""
    return out if out.suffix.lower() == ".toml" else out / TABLE


def frames_folder(out: Path) -> Path:
    """Return the folder beside an output for the frames of videos."""
    return out.with_name(f"{out.stem if out.suffix.lower() == '.toml' else out.name}_photographs")


def _beside(table: Path, name: str) -> Path:
    return table.with_name(f"{table.stem}_{name}")


def write_calibration(calibrated: Calibrated, out: Path, keys: Mapping[str, Any]) -> None:
    """Write table, report and picture: into a new folder with the lists of a DiLiGenT capture, or as OUT.toml.

    keys: of the camera. The output is atomic. Raises InputError if writing fails.
    """
    _write(
        out, lambda folder: written_table(calibrated, folder, keys), report_text(calibrated), _lists(calibrated),
        calibration_picture(calibrated),
    )  # fmt: skip


def write_lights(
    spec: CaptureSpec,
    keys: Mapping[str, Any],
    lights: Sequence[Light],
    report: dict[str, Any],
    out: Path,
    card: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Write a table and a report of lights from other sources than balls: into a new folder, or as OUT.toml.

    keys: of the cameras. lights: one per photograph. card: keys that replace the source's, lengths in the lights' unit.
    The output is atomic. Raises InputError if writing fails.
    """
    cameras = dict.fromkeys(range(len(spec.views)), keys) if keys else {}
    by_number = dict(enumerate(lights))
    text = json.dumps(report, indent=1) + "\n"
    _write(out, lambda folder: calibrated_table(spec, cameras, by_number, folder, card), text)


def _write(
    out: Path,
    table_in: Callable[[Path], str],
    report: str,
    lists: Mapping[str, Sequence[str]] = MappingProxyType({}),
    picture: np.ndarray | None = None,
) -> None:
    """Write a table, a report and a picture atomically: into a new folder, with lists, or as OUT.toml.

    table_in: folder → the table's text. lists: file name → lines. Raises InputError if writing fails.
    """
    if out.suffix.lower() == ".toml":
        files = {} if picture is None else {_beside(out, _PICTURE): png_bytes(picture, 8)}
        texts = {_beside(out, _REPORT): report, out: table_in(out.parent)}
        _write_beside(out, files | {path: text.encode() for path, text in texts.items()})
        return
    table = table_in(out)
    with new_folder(out) as partial:
        (partial / TABLE).write_text(table, encoding="utf-8")
        (partial / _REPORT).write_text(report, encoding="utf-8")
        if picture is not None:
            encode_png(partial / _PICTURE, picture, 8)
        for name, lines in lists.items():
            (partial / name).write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def _write_beside(out: Path, files: dict[Path, bytes]) -> None:
    """Write files under temporary names, then replace the former ones in their order.

    If writing fails, no new file is left; if replacing fails, former ones before it are replaced.
    """
    partials = {path: path.with_name(f".{path.stem}.partial-{os.getpid()}{path.suffix}") for path in files}
    placed: list[Path] = []  # files that were not there before
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        for path, data in files.items():
            partials[path].write_bytes(data)
        for path, partial in partials.items():
            former = path.exists()
            os.replace(partial, path)
            placed += [] if former else [path]
    except OSError as error:
        _remove(placed)
        raise InputError(f"{out}: cannot be written ({error.strerror or error}); choose another place") from error
    finally:
        _remove(partials.values())


def _remove(paths: Iterable[Path]) -> None:
    """Delete those of these files that can be deleted."""
    for path in paths:
        with suppress(OSError):
            path.unlink()


def _lists(calibrated: Calibrated) -> dict[str, list[str]]:
    """Return file name → lines of the DiLiGenT lists: names, directions (or positions), intensities."""
    result = calibrated.result
    located = [(name, light.light) for name, light in zip(calibrated.names, result.lights, strict=True) if light.light]
    vectors = [" ".join(f"{v:.8f}" for v in light.vector) for _, light in located]
    lists = {FILENAMES: [name for name, _ in located]}
    lists["light_positions.txt" if result.near else DIRECTIONS] = vectors
    if result.kind == "matte":
        lists[INTENSITIES] = [" ".join(f"{v:.8f}" for v in light.intensity) for _, light in located]
    return lists
