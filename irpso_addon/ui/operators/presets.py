"""Presets: the shipped schedules, which are read-only, and the user's own in Blender's folder of presets.

A user's preset is a Python file like Blender's own, with lines like ``schedule.particles = 24``: the name of a shipped
schedule and the settings that differ from it. The file is parsed, never executed: a mistake in it gives one error
message and changes no setting.
"""

from __future__ import annotations

import ast
import os
import re
from pathlib import Path
from typing import Any

import bpy
from bl_operators.presets import AddPresetBase
from bpy.props import StringProperty

from ...core.errors import InputError
from ...core.files import replacing_file
from ...solver.settings.renamed import current_settings
from ...solver.settings.schedule import SETTINGS, Schedule, load_schedule, shipped_presets
from ..common import failures
from ..common.file_paths import absolute
from ..common.words import iface, tip
from ..properties.schedule_settings import base_schedule, differences, fill, is_shipped, schedule_of

FOLDER = "irpso"  # in the user's folder of presets
_HEAD = "import bpy\nschedule = bpy.context.scene.irpso.schedule\n\n"
_OBJECT = "schedule"  # the object whose attributes a preset file assigns
_ASSIGNMENT = re.compile(rf"{_OBJECT}\.(\w+)\s*=(.*)")


def title_of(schedule: Schedule) -> str:
    """Return the short title of a shipped schedule, as in "Standard"."""
    return schedule.title.partition(":")[0]


def purpose_of(schedule: Schedule) -> str:
    """Return what a shipped schedule is for, as in "Few searched dimensions, the rest in closed form"."""
    return schedule.title.partition(":")[2].strip().capitalize()


def label_of(settings: Any) -> str:
    """Return the label of the preset menu: the preset's name, with a star if settings differ from it.

    A schedule given by its path has only the file's name: drawing a panel opens no file.
    """
    if not is_shipped(settings):
        return settings.own or Path(settings.preset).stem
    saved = _values_of(settings.own_text) if settings.own else {"preset": settings.preset}
    changed = {"preset": settings.preset, **differences(settings)} != saved
    return (settings.own or iface(title_of(base_schedule(settings)))) + (" *" if changed else "")


def preset_text(settings: Any) -> str:
    """Return the text of a preset file with these settings: the user's schedules by their full path, for other scenes.

    Raises InputError if their schedule does not exist.
    """
    base = settings.preset if is_shipped(settings) else str(absolute(settings.preset, "Preset"))
    lines = [("preset", base), *sorted(differences(settings).items())]
    return _HEAD + "".join(f"{_OBJECT}.{name} = {value!r}\n" for name, value in lines)


def read_preset(path: str | Path) -> tuple[str, Schedule]:
    """Return the name of a preset file's base schedule, and the resulting schedule. Raises InputError."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); remove it and save it anew") from error
    try:
        values = _values_of(text)
        name = values.pop("preset", None)
        if not isinstance(name, str):
            raise InputError(f"names no schedule; add a line {_OBJECT}.preset = 'standard'")
        if unknown := sorted(values.keys() - SETTINGS.keys()):
            raise InputError(f"there is no setting '{unknown[0]}'; remove that line")
        return name, load_schedule(absolute(name, "Preset")).replaced(**values)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _values_of(text: str) -> dict[str, Any]:
    """Return name → value of a preset file's text, under the present names. Raises InputError."""
    values: dict[str, Any] = {}
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line in _HEAD.splitlines():
            continue
        try:
            name, value = _ASSIGNMENT.fullmatch(line).groups()
            values[name] = ast.literal_eval(value)
        except (AttributeError, SyntaxError, ValueError) as error:
            raise InputError(
                f"line {number} sets no setting to a value; write lines like {_OBJECT}.particles = 24"
            ) from error
    return current_settings(values)


class IRPSO_MT_presets(bpy.types.Menu):
    """Schedules of the search"""

    bl_label = "Presets"
    preset_subdir = FOLDER
    preset_operator = "irpso.preset_load"

    def draw(self, context) -> None:
        """List the shipped schedules, then the user's own."""
        layout = self.layout
        for name in shipped_presets():
            layout.operator("irpso.preset_choose", text=title_of(load_schedule(name))).name = name
        folders = [folder for folder in bpy.utils.preset_paths(FOLDER) if any(Path(folder).glob("*.py"))]
        if folders:
            layout.separator()
            self.path_menu(
                folders, self.preset_operator, filter_ext=lambda ext: ext.lower() == ".py",
                display_name=lambda path: bpy.path.display_name(path, title_case=False),
            )  # fmt: skip


class IRPSO_OT_preset_choose(bpy.types.Operator):
    """Set all settings of the search to those of a shipped schedule"""

    bl_idname = "irpso.preset_choose"
    bl_label = "Choose Preset"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}

    name: StringProperty(name="Schedule", options={"SKIP_SAVE"})

    @classmethod
    def description(cls, context, properties) -> str:
        """Return the purpose of the schedule."""
        if properties.name not in shipped_presets():
            return tip(cls.bl_description)
        return tip(purpose_of(load_schedule(properties.name)))

    def execute(self, context):
        """Set the settings."""
        settings = context.scene.irpso.schedule
        try:
            load_schedule(self.name)
        except InputError as error:
            return failures.report_and_cancel(self, error)
        settings.preset, settings.own = self.name, ""
        return {"FINISHED"}


class IRPSO_OT_preset_load(bpy.types.Operator):
    """Set all settings of the search to those of this preset"""

    bl_idname = "irpso.preset_load"
    bl_label = "Load Preset"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}

    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})

    def execute(self, context):
        """Set the settings. If the file has a mistake, none changes."""
        settings = context.scene.irpso.schedule
        try:
            name, schedule = read_preset(self.filepath)
        except InputError as error:
            return failures.report_and_cancel(self, error)
        settings.preset = name
        fill(settings, schedule)
        _store_own(settings, self.filepath)
        return {"FINISHED"}


class IRPSO_OT_preset_add(AddPresetBase, bpy.types.Operator):
    """Save the settings of the search as your own preset"""

    bl_idname = "irpso.preset_add"
    bl_label = "Add Preset"
    preset_menu = "IRPSO_MT_presets"
    preset_subdir = FOLDER

    @classmethod
    def description(cls, context, properties) -> str:
        """Return the tooltip: for adding or for removing."""
        if properties.remove_active or properties.remove_name:
            return tip("Remove this preset of yours. The settings do not change")
        return tip(cls.bl_description)

    def draw(self, context) -> None:
        """Draw the field for the name, with the cursor in it."""
        row = self.layout.row()
        row.activate_init = True
        row.prop(self, "name")

    def execute(self, context):
        """Add or remove a user's preset. Shipped ones are never changed."""
        settings = context.scene.irpso.schedule
        if self.remove_active:  # Blender's own way is by the menu's label, which scenes share
            self.remove_active, self.remove_name, self.name = False, True, settings.own
        shipped = self.as_filename(self.name).lower() in shipped_presets()
        try:
            if shipped or (self.remove_name and not self.name):
                what = "removed" if self.remove_name else "replaced"
                raise InputError(f"Shipped presets cannot be {what}; choose another name")
            schedule_of(settings)
            return super().execute(context)
        except InputError as error:
            return failures.report_and_cancel(self, error)

    def add(self, context, filepath: str) -> None:
        """Write the file."""
        settings = context.scene.irpso.schedule
        with replacing_file(Path(filepath)) as partial:
            partial.write_text(preset_text(settings), encoding="utf-8")
        _store_own(settings, filepath)

    def post_cb(self, context, filepath: str) -> None:
        """Clear the name of a removed preset."""
        if self.remove_name:
            context.scene.irpso.schedule.own = ""


def _store_own(settings: Any, path: str) -> None:
    settings.own = bpy.path.display_name(os.path.basename(path), title_case=False)
    settings.own_text = preset_text(settings)


CLASSES = (IRPSO_MT_presets, IRPSO_OT_preset_choose, IRPSO_OT_preset_load, IRPSO_OT_preset_add)
