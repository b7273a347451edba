"""Keeps relative paths of scenes' settings on their files when the .blend file is saved in another folder.

Blender itself does so only for images.
"""

from __future__ import annotations

import os

import bpy
from bpy.app.handlers import persistent

from ...blender.scenes.scene_capture import system_properties
from ..common import failures
from ..common.file_paths import relative_to
from ..common.words import n_

_PATHS = ("capture_path", "checked_path", "chart_photograph", "model_path")  # of a scene's settings
_PRESET = "preset"  # of its schedule: a shipped one's name, or a path
_BASE = "paths_base"  # the setting with the folder that relative paths start from: an undo sets all of them back
_DOING = n_("Keeping the paths of captures")


def _move(folder: str) -> None:
    """Make relative paths start from a folder; they lead to the same files as before."""
    for scene in bpy.data.scenes:
        if scene.library is not None:
            continue
        stored = system_properties(scene.irpso)  # a set attribute would reset the settings of the capture
        former = stored.get(_BASE) or _open_folder()
        if former and former != folder:
            schedule = system_properties(scene.irpso.schedule)
            for owner, name in (*((stored, name) for name in _PATHS), (schedule, _PRESET)):
                if (path := owner.get(name, "")).startswith("//"):
                    owner[name] = relative_to(bpy.path.abspath(path, start=former), folder)
        stored[_BASE] = folder


def _open_folder() -> str:
    return os.path.dirname(bpy.data.filepath)


@persistent
@failures.reported(_DOING)
def _before_saving(path: str = "", *_: object) -> None:
    if path:  # empty for the startup file
        _move(os.path.dirname(path))


@persistent
@failures.reported(_DOING)
def _to_open_file(*_: object) -> None:
    """After a saved copy, a failed save or an undo: relative paths start from the open file's folder again."""
    if bpy.data.filepath:
        _move(_open_folder())


@persistent
@failures.reported(_DOING)
def _start_from_open_file(*_: object) -> None:
    """After loading: files that were moved together with the .blend file, without Blender, stay beside it."""
    for scene in bpy.data.scenes:
        if scene.library is None:
            system_properties(scene.irpso)[_BASE] = _open_folder()


_HANDLERS = {
    "save_pre": _before_saving,
    "save_post": _to_open_file,
    "save_post_fail": _to_open_file,
    "undo_post": _to_open_file,
    "redo_post": _to_open_file,
    "load_post": _start_from_open_file,
}


def register() -> None:
    """Add the handlers. The open file may have been saved, and moved, without the add-on."""
    for name, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, name).append(handler)
    if hasattr(bpy.data, "scenes"):  # absent while Blender enables add-ons at its start, before it loads a file
        _start_from_open_file()


def unregister() -> None:
    """Remove the handlers."""
    for name, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, name).remove(handler)
