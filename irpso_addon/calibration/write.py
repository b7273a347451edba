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
from ..core.png import png_bytes
from .ball_calibration import Calibrated, written_table
from .ball_report import report_of
from .balls.contact_sheet import calibration_picture
from .photographs import calibrated_table

_REPORT, _PICTURE, _POSITIONS = "report.json", "balls.png", "light_positions.txt"
_FILES = (TABLE, _REPORT, _PICTURE)  # of every output; a folder has lists, too
_LISTS = (FILENAMES, DIRECTIONS, _POSITIONS, INTENSITIES)
_LISTED = "calibration_files"  # in the report; the "files" of a report are those of a recovery, which replaces them
_FOREIGN = "would be replaced, but its report lists no such file of a calibration; choose another -o, or move it"


def checked_output(out: Path, replace: bool = False) -> Path:
    """Return the output path. replace: the files of a former calibration there, which its report lists.

    Raises InputError if another file is in the way: it is never overwritten.
    """
    former = _former(out) if replace else set()
    if not (_is_table(out) or former):
        remedy = "its report.json lists no files of a calibration (version 0.1.0 listed none); choose a new folder"
        check_unused(out, remedy if replace else "choose a new folder, or --replace a former calibration there")
        return out
    if taken := next((path for path in places(out) if path.exists() and path not in former), None):
        remedy = "exists; choose another name for -o, or --replace a former calibration"
        raise InputError(f"{taken}: {_FOREIGN if replace else remedy}")
    check_writable(table_path(out).parent)
    return out


def table_path(out: Path) -> Path:
    """Return the path of an output's table."""
    return _place(out, TABLE)


def _is_table(out: Path) -> bool:
    return out.suffix.lower() == ".toml"


def _place(out: Path, name: str) -> Path:
    """Return the path of one of an output's files. name: in a folder."""
    if not _is_table(out):
        return out / name
    return out if name == TABLE else out.with_name(f"{out.stem}_{name}")


def places(out: Path) -> list[Path]:
    """Return the paths of all files that a calibration may write."""
    return [_place(out, name) for name in (_FILES if _is_table(out) else (*_FILES, *_LISTS))]


def _former(out: Path) -> set[Path]:
    """Return the files that a former calibration wrote, by its report; none if there is no such report."""
    try:
        listed = json.loads(_place(out, _REPORT).read_text(encoding="utf-8"))[_LISTED]
        files = {path for path in places(out) if path.name in listed}
    except (OSError, ValueError, KeyError, TypeError):
        return set()
    return files


def frames_folder(out: Path) -> Path:
    """Return the folder beside an output for the frames of videos."""
    whole = out.absolute()  # "." has no name
    return whole.with_name(f"{out.stem if _is_table(out) else whole.name}_photographs")


def write_calibration(calibrated: Calibrated, out: Path, keys: Mapping[str, Any], replace: bool = False) -> None:
    """Write table, report and picture: into a folder with the lists of a DiLiGenT capture, or as OUT.toml.

    keys: of the camera. replace: see ``checked_output``. Raises InputError if writing fails, as ``_write``.
    """
    _write(
        out, lambda folder: written_table(calibrated, folder, keys), report_of(calibrated), replace,
        _lists(calibrated), calibration_picture(calibrated),
    )  # fmt: skip


def write_lights(
    spec: CaptureSpec,
    keys: Mapping[str, Any],
    lights: Sequence[Light],
    report: dict[str, Any],
    out: Path,
    card: Mapping[str, Any] = MappingProxyType({}),
    replace: bool = False,
) -> None:
    """Write a table and a report of lights from other sources than balls: into a folder, or as OUT.toml.

    keys: of the cameras. lights: one per photograph. card: keys that replace the source's, lengths in the lights' unit.
    replace: see ``checked_output``. Raises InputError if writing fails, as ``_write``.
    """
    cameras = dict.fromkeys(range(len(spec.views)), keys) if keys else {}
    by_number = dict(enumerate(lights))
    _write(out, lambda folder: calibrated_table(spec, cameras, by_number, folder, card), report, replace)


def _write(
    out: Path,
    table_in: Callable[[Path], str],
    report: Mapping[str, Any],
    replace: bool,
    lists: Mapping[str, Sequence[str]] = MappingProxyType({}),
    picture: np.ndarray | None = None,
) -> None:
    """Write a picture, lists, a table and a report, in this order: into a folder, or, without lists, as OUT.toml.

    A new output is atomic. Of a former one the files before one that cannot be replaced are replaced; the report, which
    lists them all, is the last. table_in: folder → the table's text. lists: file name → lines. Raises InputError if
    writing fails.
    """
    former = _former(out) if replace else set()
    files = {} if picture is None else {_PICTURE: png_bytes(picture, 8)}
    if not _is_table(out):
        files |= {name: "".join(f"{line}\n" for line in lines).encode() for name, lines in lists.items()}
    files[TABLE] = table_in(table_path(out).parent).encode()
    listed = [_place(out, name).name for name in (*files, _REPORT)]
    files[_REPORT] = (json.dumps({**report, _LISTED: listed}, indent=1) + "\n").encode()
    if _is_table(out) or former:
        _write_beside(out, {_place(out, name): data for name, data in files.items()}, former)
        return
    with new_folder(out) as partial:
        for name, data in files.items():
            (partial / name).write_bytes(data)


def _write_beside(out: Path, files: Mapping[Path, bytes], former: set[Path]) -> None:
    """Write files under temporary names, then replace the former ones in their order; remove those without a successor.

    If writing fails, no new file is left; if replacing fails, former ones before it are replaced.
    """
    partials = {path: path.with_name(f".{path.stem}.partial-{os.getpid()}{path.suffix}") for path in files}
    placed: list[Path] = []  # files that were not there before
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        for path, data in files.items():
            partials[path].write_bytes(data)
        for path, partial in partials.items():
            existed = path.exists()
            os.replace(partial, path)
            placed += [] if existed else [path]
    except OSError as error:
        _remove(placed)
        raise InputError(f"{out}: cannot be written ({error.strerror or error}); choose another place") from error
    finally:
        _remove(partials.values())
    _remove(former - set(files))


def _remove(paths: Iterable[Path]) -> None:
    """Delete those of these files that can be deleted."""
    for path in paths:
        with suppress(OSError):
            path.unlink()


def _lists(calibrated: Calibrated) -> dict[str, list[str]]:
    """Return file name → lines of the DiLiGenT lists: the photographs' files, directions or positions, intensities."""
    result = calibrated.result
    files = [calibrated.spec.observations[index].image.path.name for index in calibrated.indices]
    located = [(name, light.light) for name, light in zip(files, result.lights, strict=True) if light.light]
    vectors = [" ".join(f"{v:.8f}" for v in light.vector) for _, light in located]
    lists = {FILENAMES: [name for name, _ in located]}
    lists[_POSITIONS if result.near else DIRECTIONS] = vectors
    if result.kind == "matte":
        lists[INTENSITIES] = [" ".join(f"{v:.8f}" for v in light.intensity) for _, light in located]
    return lists
