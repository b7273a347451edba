"""Paths as people write them in Blender's settings, where // stands for the folder of the open file."""

from __future__ import annotations

from pathlib import Path

import bpy

from ...core.errors import InputError


def absolute(path: str, setting: str) -> Path:
    """Return the file or folder that a setting names. Raises InputError for a // path while the file has no folder.

    Blender itself then takes // for the folder that it was started in, often the root of the disk. setting: its name,
    for the message.
    """
    if path.startswith("//") and not bpy.data.filepath:
        raise InputError(
            f"{setting}: {path} lies beside the .blend file, which is not saved yet; save it first, or choose a"
            " folder by its full path"
        )
    return Path(bpy.path.abspath(path))
