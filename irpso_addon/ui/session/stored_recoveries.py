"""Stores recoveries that were not kept when their file was closed or another began; lists and deletes them."""

from __future__ import annotations

import hashlib
import json
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...blender.materials.material import STAMP
from ...core.errors import CheckpointError, GpuUnavailableError
from ...core.paths import BASE_PACKAGE
from ...exports.place import file_stem
from ...gpu import context_guard
from ...solver.state.checkpoint import read_extra_array

_ABOUT, HISTORY, SECONDS = "about", "history", "seconds"  # extra arrays of the checkpoint
_kept: dict[Path, str] = {}  # stored recoveries to delete when the file is saved → the kept material's stamp
_log = logging.getLogger(__name__)
_listed: list[StoredRecovery] | None = None  # contents of the folder, None before it is read


@dataclass(frozen=True)
class StoredRecovery:
    """A stored recovery. fraction: done, 0…1. file: path of its .blend, "" if unsaved. recipe: from ``recipe_of``."""

    path: Path
    name: str
    fraction: float
    file: str
    recipe: dict[str, Any]


def folder() -> Path | None:
    """Return the folder of stored recoveries; None without an installed extension or a window."""
    if bpy.app.background:
        return None
    try:
        return Path(bpy.utils.extension_path_user(BASE_PACKAGE, path="unkept"))
    except ValueError:  # not installed as an extension
        return None


def store(running: Any) -> bool:
    """Store a session whose maps are not kept; return whether nothing is lost.

    Of one capture, subject, model and file at most two are stored: the one that got farthest, and the last. Errors are
    only logged, because Blender may be closing its file.
    """
    if running.recovery is None or running.kept or (directory := folder()) is None:
        return True
    job, file = running.job, bpy.data.filepath
    about = {"name": job.name, "fraction": running.fraction, "file": file, "recipe": job.recipe}
    what = (job.origin, job.capture.source, job.name, job.model.name, file)
    digest = hashlib.sha256("\n".join(map(str, what)).encode(errors="surrogatepass")).hexdigest()[:8]
    try:
        if context_guard.active() is None:
            raise GpuUnavailableError("no graphics context is current")
        extra_arrays = {
            _ABOUT: np.frombuffer(json.dumps(about).encode(), np.uint8),
            HISTORY: np.array(running.history).reshape(-1, 2),
            SECONDS: np.array(running.seconds),
        }
        path = job.resumed or _place(directory, job.name, digest, running.fraction)
        running.recovery.save(path, extra_arrays, running=True)
        _kept.pop(path, None)
    except Exception:  # noqa: BLE001  the file must close in spite of a full disk or a lost device
        _log.exception("the recovery of %s could not be stored", job.name)
        return False
    refresh()
    return True


def _place(directory: Path, name: str, digest: str, fraction: float) -> Path:
    stem = f"{file_stem(name)}-{digest}"
    path = directory / f"{stem}.npz"
    former = _read(path) if path.exists() else None
    return path if former is None or former.fraction < fraction else directory / f"{stem}-last.npz"


def listed() -> list[StoredRecovery]:
    """Return the stored recoveries, the newest first."""
    if _listed is None:
        refresh()
    return _listed or []


def refresh() -> None:
    """Read the folder again; skips unreadable files and other files."""
    global _listed
    directory = folder()
    try:
        paths = [] if directory is None or not directory.is_dir() else directory.glob("*.npz")
        newest = sorted(paths, key=lambda path: path.stat().st_mtime, reverse=True)
    except OSError:
        newest = []
    _listed = [stored for path in newest if (stored := _read(path)) is not None]


def delete_when_saved(path: Path | None, stamp: str) -> None:
    """Delete a stored recovery once a file is saved whose material has ``stamp``: until then a crash would lose it."""
    if path is not None:
        _kept[path] = stamp


def kept_stamps() -> set[str]:
    """Return the stamps of the materials that a saved file holds. Blender saves none without users."""
    bare = [mesh for mesh in bpy.data.meshes if not mesh.users]  # of deleted objects

    def users(material: Any) -> int:
        return material.users - sum(list(mesh.materials).count(material) for mesh in bare)

    return {material[STAMP] for material in bpy.data.materials if STAMP in material and users(material) > 0}


def delete_saved() -> None:
    """After the file was saved: delete the stored recoveries whose maps it holds."""
    stamps = kept_stamps()
    for path in [path for path, stamp in _kept.items() if stamp in stamps]:
        del _kept[path]
        delete(path)


def delete(path: Path | None) -> None:
    """Delete a stored recovery; do nothing for None."""
    if path is None:
        return
    try:
        path.unlink(missing_ok=True)
    except OSError:
        _log.exception("%s could not be deleted", path)
    refresh()


def _read(path: Path) -> StoredRecovery | None:
    try:
        return StoredRecovery(path, **json.loads(bytes(read_extra_array(path, _ABOUT))))
    except (CheckpointError, ValueError, TypeError):
        return None
