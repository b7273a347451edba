"""Filling the list of parameters of scenes that have none yet: a fresh file, a new scene, one from before."""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from ..common import failures
from .scene_settings import CUSTOM, refresh_parameters


@failures.told("Listing the maps of the model")
def fill_lists() -> None:
    """Give every scene the parameters of its model. Panels may not: while they are drawn nothing can be changed."""
    for scene in bpy.data.scenes:
        if is_wanting(scene.irpso):
            refresh_parameters(scene.irpso)


def is_wanting(settings) -> bool:
    """Return whether the list is empty that should not be; a model of the user's own may not be readable."""
    return not settings.parameters and settings.model != CUSTOM


def ask() -> None:
    """Have the lists filled as soon as Blender is done with what it is doing now."""
    if not bpy.app.timers.is_registered(fill_lists):
        bpy.app.timers.register(fill_lists, first_interval=0)


@persistent
def _on_load(*_: object) -> None:
    fill_lists()


CLASSES = ()


def register() -> None:
    """Watch for files being loaded; what is open already is filled as soon as it may be changed."""
    bpy.app.handlers.load_post.append(_on_load)
    if hasattr(bpy.data, "scenes"):  # while Blender enables add-ons at its start, data are out of reach
        fill_lists()
    else:
        ask()


def unregister() -> None:
    """Stop watching."""
    bpy.app.handlers.load_post.remove(_on_load)
    if bpy.app.timers.is_registered(fill_lists):
        bpy.app.timers.unregister(fill_lists)
