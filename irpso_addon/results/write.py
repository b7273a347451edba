"""Writes a result to a folder: all files into a temporary folder first, then each under its name."""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..capture.images.exr import write_exr
from ..core.errors import InputError
from ..core.files import JSON_ERRORS, check_writable, synced
from ..core.png import encode_png
from ..core.steps import available_cores
from ..core.udim import tile_part, tile_stem
from ..reflectance.model import ReflectanceModel
from .derived_map import DerivedMap
from .map_tables import OTHER_FILES, MapTable, encoded_values, encoding_text, exr_channels, map_tables, map_values
from .maps import Maps, split_maps
from .report import plain

REPORT = "report.json"
MODEL_DIGEST = "model_files_sha256"  # key of a report's settings: of a user's own model
BLEND = "material.blend"
FORMER_BLEND = "material.former.blend"  # of the result before, until the new material is saved
_OWN_FILE = re.compile(r"[A-Za-z0-9_-]+(\.[12]\d\d\d)?\.(png|exr)$")
_PARTIAL = ".irpso-result-"  # prefix of the temporary folder


def check_output_folder(folder: str | Path) -> Path:
    """Return the folder as a Path. Raises InputError if a result cannot be written there."""
    if not str(folder):
        raise InputError("the output folder has an empty name; give a name")
    check_writable(Path(folder))
    return Path(folder)


def check_replaces_nothing(folder: Path, model: ReflectanceModel) -> None:
    """Raise InputError if a result of ``model`` in ``folder`` would replace a file that no former result wrote."""
    stems = {table.name for table in map_tables(model)} | set(OTHER_FILES)
    names = [path.name for path in sorted(folder.iterdir())] if folder.is_dir() else []
    ours = [n for n in names if n in (REPORT, BLEND) or (_OWN_FILE.match(n) and n.partition(".")[0] in stems)]
    _refuse_foreign(folder, ours, listed_files(folder))


def check_replaces_no_maps(folder: Path) -> None:
    """Raise InputError if the report and the file of several slots would replace others, or the report of maps."""
    former = listed_files(folder)
    _refuse_foreign(folder, (REPORT, BLEND), former)
    if maps := sorted(former - {REPORT, BLEND}):
        raise InputError(
            f"{folder / maps[0]}: is of a recovery whose report would be replaced; choose another folder, or move it"
        )


def _refuse_foreign(folder: Path, names: Sequence[str], former: set[str]) -> None:
    if foreign := _first_foreign(folder, names, former):
        raise InputError(
            f"{folder / foreign}: would be replaced, but no recovery wrote it; choose another folder, or move it"
        )


def _first_foreign(folder: Path, names: Sequence[str], former: set[str]) -> str | None:
    """Return the first of ``names`` that exists in ``folder`` and is not in ``former``, None for none."""
    return next((name for name in names if name not in former and (folder / name).exists()), None)


def write_maps(
    maps: Maps,
    folder: str | Path,
    report: Mapping[str, Any],
    pictures: Mapping[str, np.ndarray] | None = None,
    derived: Sequence[DerivedMap] = (),
) -> list[Path]:
    """Write maps, residual, confidence, report and pictures into ``folder``; return the written paths.

    Each map is a 16-bit PNG and a 32-bit EXR; normal.exr has the unit vector; maps.exr has every map as a part. Each
    UDIM tile has its own files: normal.1001.exr, normal.1002.exr, and so on.
    pictures: file stem → (H, W, 3) display values in 0…1, row 0 at the bottom, written as 8-bit PNG. derived: maps that
    are not the model's, each in its own files. report: plain data; "maps" and "files" are added. Files of a former
    result, listed in its report, are removed where this one lacks them; its material becomes FORMER_BLEND until
    the new one is saved. Raises InputError where the folder or the model's table of maps is unusable.
    """
    tables = map_tables(maps.model)
    folder = check_output_folder(folder)
    created = [p for p in (folder, *folder.parents) if not p.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        former = listed_files(folder)
        for left in folder.glob(f"{_PARTIAL}*"):  # left by a killed process
            shutil.rmtree(left, ignore_errors=True)
        with tempfile.TemporaryDirectory(prefix=_PARTIAL, dir=folder) as temporary:
            names = _write_all(maps, tables, Path(temporary), dict(pictures or {}))
            names += _write_derived(derived, maps.tiles, Path(temporary))
            _write_report(Path(temporary), report, tables, derived, names)
            if foreign := _first_foreign(folder, [*names, REPORT], former):
                raise InputError(f"{foreign} was not written by a recovery")
            # The report is last: every file that a report lists exists.
            for name in (*names, REPORT):
                synced(Path(temporary) / name)
            if BLEND in former:  # exports would take it for that of the new maps; the user may have edited it
                with suppress(FileNotFoundError):
                    os.replace(folder / BLEND, folder / FORMER_BLEND)
            for name in (*names, REPORT):
                os.replace(Path(temporary) / name, folder / name)
            synced(folder)
    except (OSError, InputError) as error:
        _remove_empty(created)
        why = error.strerror or error if isinstance(error, OSError) else error
        raise InputError(f"{folder}: the result cannot be written ({why}); choose another folder") from error
    for name in former - {*names, REPORT, BLEND}:
        (folder / name).unlink(missing_ok=True)
    return [folder / name for name in (*names, REPORT)]


def remove_result(folder: Path) -> None:
    """Remove the files of the result in this folder, and the folder if nothing else is in it."""
    for name in listed_files(folder):
        (folder / name).unlink(missing_ok=True)
    _remove_empty([folder])


def _write_all(maps: Maps, tables: list[MapTable], folder: Path, pictures: dict[str, np.ndarray]) -> list[str]:
    """Write every file except the report; return the names."""
    names = []
    for number, part in split_maps(maps):
        names += _write_tile(part, tables, folder, partial(tile_stem, number=number, tiles=maps.tiles))
    for stem, image in pictures.items():
        encode_png(folder / f"{stem}.png", image, bits=8)
        names.append(f"{stem}.png")
    return names


def _write_tile(maps: Maps, tables: list[MapTable], folder: Path, stem_of: Callable[[str], str]) -> list[str]:
    """Write maps, residual, confidence and maps.exr; return the names."""
    everything: dict[str, dict[str, np.ndarray]] = {}
    files: dict[str, dict[str, dict[str, np.ndarray]]] = {}  # name of an EXR file → its parts
    names = []
    for table in tables:
        values = map_values(table, maps)
        everything[table.name] = exr_channels(values)
        stem = stem_of(table.name)
        encode_png(folder / f"{stem}.png", encoded_values(table, values), bits=16)
        files[f"{stem}.exr"] = {table.name: everything[table.name]}
        names.append(f"{stem}.png")
    outside = ~maps.solved
    if maps.residual is not None:
        residual = np.where(outside, 0, np.asarray(maps.residual, np.float32).reshape(outside.shape))
        everything["residual"] = exr_channels(residual[..., None])
        files[f"{stem_of('residual')}.exr"] = {"residual": everything["residual"]}
    if maps.confidence is not None:
        parts = {}
        for name, deviation in maps.confidence.items():
            deviation = np.asarray(deviation, np.float32).reshape(*outside.shape, -1)
            parts[f"confidence_{name}"] = exr_channels(np.where(outside[..., None], 0, deviation))
        files[f"{stem_of('confidence')}.exr"] = parts
        everything |= parts
    everything["coverage"] = exr_channels(maps.solved[..., None].astype(np.float32))
    files[f"{stem_of('maps')}.exr"] = everything
    with ThreadPoolExecutor(len(available_cores())) as pool:  # OpenEXR compresses without the interpreter's lock
        list(pool.map(lambda name: write_exr(folder / name, files[name]), reversed(files)))  # the largest first
    return [*names, *files]


def _write_derived(derived: Sequence[DerivedMap], tiles: Sequence[int], folder: Path) -> list[str]:
    names = []
    for extra in derived:
        for index, number in enumerate(tiles):
            stem = tile_stem(extra.name, number, tiles)
            names.append(f"{stem}.png")
            encode_png(folder / names[-1], tile_part(extra.encoded, index, len(tiles)), bits=16)
            if extra.exr:
                names.append(f"{stem}.exr")
                write_exr(folder / names[-1], {extra.name: exr_channels(tile_part(extra.values, index, len(tiles)))})
    return names


def _write_report(
    folder: Path, report: Mapping[str, Any], tables: list[MapTable], derived: Sequence[DerivedMap], names: list[str]
) -> None:
    described = {
        table.name: {
            "channels": [
                p.name if p.components == 1 else f"{p.name}[{i}]" for p in table.parameters for i in range(p.components)
            ],
            "color_space": table.color_space,
            "png": encoding_text(table),
        }
        for table in tables
    }
    for extra in derived:
        described[extra.name] = {"channels": [extra.name], "color_space": "Non-Color", "png": extra.text}
    data = {**plain(report), "maps": described, "files": [*names, REPORT]}
    text = json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False)
    (folder / REPORT).write_text(text + "\n", encoding="utf-8", errors=JSON_ERRORS)


def listed_files(folder: Path) -> set[str]:
    """Return the names of the files of the result in a folder, and of one whose process was killed while moving them.

    The empty set where no result lies there.
    """
    names = set()
    for report in (folder / REPORT, *folder.glob(f"{_PARTIAL}*/{REPORT}")):
        try:
            known = json.loads(report.read_text(encoding="utf-8"))
            listed = known.get("files", [] if "slots" in known else None)  # a report of slots lists their folders
        except (OSError, ValueError, AttributeError):
            continue
        if isinstance(listed, list):
            names |= {REPORT, BLEND, *(name for name in listed if isinstance(name, str) and _OWN_FILE.match(name))}
    return names


def _remove_empty(folders: list[Path]) -> None:
    """Remove the empty ones of ``folders``, deepest first, up to the first that is not empty."""
    for folder in folders:
        if not folder.is_dir() or any(folder.iterdir()):
            return
        folder.rmdir()
