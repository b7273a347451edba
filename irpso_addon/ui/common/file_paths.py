"""Absolute paths from Blender's settings, where // stands for the folder of the open file."""

from __future__ import annotations

from pathlib import Path

import bpy

from ...core.errors import InputError


def absolute(path: str, setting: str) -> Path:
    """Return a setting's path as an absolute one. Raises InputError for a // path while the .blend file is not saved.

    Blender would resolve it to the folder of its start, often the disk's root. setting: its name, for the message.
    """
    if path.startswith("//") and not bpy.data.filepath:
        raise InputError(
            f"{setting}: {path} lies beside the .blend file, which is not saved yet; save it first, or choose a"
            " folder by its full path"
        )
    return Path(bpy.path.abspath(path))


def relative_to(path: str, folder: str) -> str:
    """Return an absolute path as one from a folder, "//…"; on Windows from another drive unchanged."""
    try:
        return bpy.path.relpath(path, start=folder)
    except ValueError:  # Windows has no relative path from one drive to another
        return path


def first_free(folder: Path, stem: str, suffix: str = "") -> Path:
    """Return the first of the paths STEM, STEM_1, STEM_2, … with ``suffix`` in a folder that does not exist yet."""
    names = (f"{stem}{suffix}", *(f"{stem}_{number}{suffix}" for number in range(1, 10_000)))
    return next(folder / name for name in names if not (folder / name).exists())
