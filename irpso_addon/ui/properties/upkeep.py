"""Updates scenes: fills missing parameter lists, and renames settings of older versions."""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from ..common import failures
from ..common.words import n_
from .model_items import CUSTOM
from .scene_settings import refresh_parameters
from .schedule_settings import rename_stored


@failures.reported(n_("Listing the maps of the model"))
def fill_lists() -> None:
    """Fill missing parameter lists of all scenes. Panels cannot: Blender forbids changes during drawing."""
    for scene in bpy.data.scenes:
        if lacks_parameters(scene.irpso):
            refresh_parameters(scene.irpso)


def lacks_parameters(settings) -> bool:
    """Return whether the parameter list is missing. A custom model may have none: its file may be unreadable."""
    return not settings.parameters and settings.model != CUSTOM


def ask() -> None:
    """Schedule ``fill_lists`` for the next turn of Blender's event loop."""
    if not bpy.app.timers.is_registered(fill_lists):
        bpy.app.timers.register(fill_lists, first_interval=0)


@persistent
def _on_load(*_: object) -> None:
    for scene in bpy.data.scenes:
        rename_stored(scene.irpso.schedule)
    fill_lists()


def register() -> None:
    """Fill the lists of every loaded file, and of the open one as soon as it may be changed."""
    bpy.app.handlers.load_post.append(_on_load)
    if hasattr(bpy.data, "scenes"):  # absent while Blender enables add-ons at its start
        fill_lists()
    else:
        ask()


def unregister() -> None:
    """Remove the handler and the timer."""
    bpy.app.handlers.load_post.remove(_on_load)
    if bpy.app.timers.is_registered(fill_lists):
        bpy.app.timers.unregister(fill_lists)
