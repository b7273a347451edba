"""Converts a scene's settings to plain data, which outlives the .blend file, and back."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import bpy

from ...core.errors import InputError
from ...solver.settings.renamed import current_settings
from ...solver.settings.schedule import SETTINGS
from ..common.file_paths import absolute
from .model_items import CUSTOM

_TYPES = {"BOOLEAN", "INT", "FLOAT", "STRING", "ENUM"}  # types of properties that are numbers, texts or choices
_LEFT_OUT = {"name", "checked_path", "paths_base", "summary", "slots", "slot_list"}
_SCHEDULE = ("preset", "own", "own_text", *SETTINGS)  # the preset first: it overwrites the others
_PARAMETER = ("recover", "value")


def recipe_of(settings: Any, obj: Any, slots: Sequence[int] | None) -> dict[str, Any]:
    """Return the settings of a scene. obj: the mesh object, None for a card. slots: the material slots to recover.

    Objects, collections and images are stored by name, paths as absolute ones. Raises InputError as ``absolute`` does.
    """
    recipe = _recipe_as_is(settings, obj, slots)
    recipe["settings"] |= {
        "capture_path": str(absolute(settings.capture_path, "Capture")) if settings.source == "FILES" else "",
        "model_path": str(absolute(settings.model_path, "Model File")) if settings.model == CUSTOM else "",
        "chart_photograph": bpy.path.abspath(settings.chart_photograph),
    }
    recipe["schedule"]["preset"] = str(absolute(settings.schedule.preset, "Preset"))
    return recipe


@contextmanager
def unchanged_on_error(settings: Any) -> Iterator[None]:
    """Set a scene's settings back if the block raises an InputError."""
    former, slots = _recipe_as_is(settings, settings.object, None), (settings.slots, settings.slot_list)
    try:
        yield
    except InputError:
        apply_recipe(settings, former)
        settings.slots, settings.slot_list = slots
        raise


def _recipe_as_is(settings: Any, obj: Any, slots: Sequence[int] | None) -> dict[str, Any]:
    """Return ``recipe_of`` with paths as they are set."""
    return {
        "settings": {name: _plain_value(getattr(settings, name)) for name in _plain_names(settings)},
        "object": None if obj is None else obj.name,
        "occluders": None if settings.occluders is None else settings.occluders.name,
        "slots": None if slots is None else ", ".join(map(str, slots)),
        "parameters": {
            item.name: {name: getattr(item, name) for name in _PARAMETER}
            | {"color": _plain_value(item.color), "image": item.image.name if item.image is not None else None}
            for item in settings.parameters
        },
        "schedule": schedule_recipe(settings.schedule),
    }  # fmt: skip


def _plain_names(settings: Any) -> list[str]:
    """Return the names of the settings of type number, text or choice."""
    rna = settings.bl_rna.properties
    return [p.identifier for p in rna if p.type in _TYPES and not p.is_readonly and p.identifier not in _LEFT_OUT]


def _plain_value(value: Any) -> Any:
    """Return a setting's value for JSON: a list for a vector."""
    return value if isinstance(value, (bool, int, float, str)) else list(value)


def schedule_recipe(schedule: Any) -> dict[str, Any]:
    """Return the settings of the search as plain data."""
    return {name: getattr(schedule, name) for name in _SCHEDULE}


def apply_recipe(settings: Any, recipe: dict[str, Any]) -> None:
    """Set a scene's settings from a recipe.

    Raises InputError if an object, collection or image of it is missing, or this version has no such setting or value.
    """
    try:
        _apply(settings, recipe)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"its settings are of another version of the program ({error}); finish it there, or delete it"
        ) from error


def _apply(settings: Any, recipe: dict[str, Any]) -> None:
    objects, images = bpy.data.objects, bpy.data.images
    if (name := recipe["object"]) is not None and name not in objects:
        raise InputError(f"this file has no object '{name}', which was recovered; open the file that has it")
    occluders = recipe.get("occluders")  # absent in recipes of earlier versions
    if occluders is not None and occluders not in bpy.data.collections:
        raise InputError(f"this file has no collection '{occluders}' of occluders; open the file that has it")
    parameters = recipe["parameters"]
    for name, values in parameters.items():
        if values["image"] is not None and values["image"] not in images:
            raise InputError(f"this file has no image '{values['image']}', given for {name}; open the file that has it")
    for name in _plain_names(settings):
        if name in recipe["settings"] and recipe["settings"][name] != _plain_value(getattr(settings, name)):
            setattr(settings, name, recipe["settings"][name])
    settings.object = None if recipe["object"] is None else objects[recipe["object"]]
    settings.occluders = None if occluders is None else bpy.data.collections[occluders]
    settings.slots, settings.slot_list = ("ALL", "") if recipe["slots"] is None else ("NAMED", recipe["slots"])
    for item in settings.parameters:
        for name, value in parameters.get(item.name, {}).items():
            setattr(item, name, value if name != "image" or value is None else images[value])
    for name, value in current_settings(recipe["schedule"]).items():
        setattr(settings.schedule, name, value)
