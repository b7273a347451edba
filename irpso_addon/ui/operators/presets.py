"""Presets: the shipped schedules, which nobody can change, and the user's own, kept where Blender keeps presets.

A user's preset is a Python file like Blender's own, of lines like ``schedule.particles = 24``: the name of a shipped
schedule, and what differs from it. It is read here line by line and never run, so that a mistake in one is told in one
sentence and leaves the settings as they were.
"""

from __future__ import annotations

import ast
import os
from pathlib import Path
from typing import Any

import bpy
from bl_operators.presets import AddPresetBase
from bpy.props import StringProperty

from ...core.errors import InputError
from ...core.files import replacing_file
from ...solver.settings.schedule import SETTINGS, Schedule, load_schedule, shipped_presets
from ..common.file_paths import absolute
from ..properties.schedule_settings import base_schedule, differences, fill, is_shipped, schedule_of

FOLDER = "irpso"  # in the user's folder of presets
_HEAD = "import bpy\nschedule = bpy.context.scene.irpso.schedule\n\n"
_OBJECT = "schedule"  # what the lines of a preset file assign to
_EXAMPLE = f"write lines like {_OBJECT}.particles = 24"


def title_of(schedule: Schedule) -> str:
    """Return the short title of a shipped schedule, as in "Standard"."""
    return schedule.title.partition(":")[0]


def label_of(settings: Any) -> str:
    """Return what the preset menu says: the preset's name, with a star where settings differ from it.

    Of a schedule by its path only the name: a panel that is drawn opens no file.
    """
    if not is_shipped(settings):
        return settings.own or Path(settings.preset).stem
    changed = preset_text(settings) != settings.own_text if settings.own else bool(differences(settings))
    return (settings.own or title_of(base_schedule(settings))) + (" *" if changed else "")


def preset_text(settings: Any) -> str:
    """Return the text of a preset file that holds the settings. Raises InputError where there is no such schedule."""
    lines = [("preset", settings.preset), *sorted(differences(settings).items())]
    return _HEAD + "".join(f"{_OBJECT}.{name} = {value!r}\n" for name, value in lines)


def read_preset(path: str | Path) -> tuple[str, Schedule]:
    """Return the name of the schedule that a preset file begins from, and its schedule. Raises InputError."""
    path = Path(path)
    try:
        tree = ast.parse(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, SyntaxError, ValueError) as error:
        raise InputError(f"{path}: is no preset ({_reason(error)}); remove it and save it anew") from error
    values = dict(found for node in tree.body if (found := _assignment(node, path)))
    name = values.pop("preset", None)
    if not isinstance(name, str):
        raise InputError(f"{path}: names no schedule; add a line {_OBJECT}.preset = 'standard'")
    if unknown := sorted(values.keys() - SETTINGS.keys()):
        raise InputError(f"{path}: there is no setting '{unknown[0]}'; remove that line")
    try:
        return name, load_schedule(absolute(name, "Preset")).replaced(**values)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _assignment(node: ast.stmt, path: Path) -> tuple[str, Any] | None:
    """Return setting and value of one line, None for the two lines that every preset begins with."""
    if isinstance(node, ast.Import):
        return None
    if isinstance(node, ast.Assign) and len(node.targets) == 1:
        target = node.targets[0]
        if isinstance(target, ast.Name) and target.id == _OBJECT:
            return None
        if isinstance(target, ast.Attribute) and isinstance(target.value, ast.Name) and target.value.id == _OBJECT:
            try:
                return target.attr, ast.literal_eval(node.value)
            except ValueError as error:
                raise InputError(f"{path}: line {node.lineno} sets no plain value; {_EXAMPLE}") from error
    raise InputError(f"{path}: line {node.lineno} does not belong into a preset; {_EXAMPLE}")


def _reason(error: Exception) -> str:
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return f"line {error.lineno} is not Python" if isinstance(error, SyntaxError) else "it is not text"


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
        """Return what the schedule is good for."""
        if properties.name not in shipped_presets():
            return cls.__doc__
        return load_schedule(properties.name).title.partition(":")[2].strip().capitalize()

    def execute(self, context):
        """Fill the settings."""
        settings = context.scene.irpso.schedule
        try:
            load_schedule(self.name)
        except InputError as error:
            return _refused(self, error)
        settings.preset, settings.own = self.name, ""
        return {"FINISHED"}


class IRPSO_OT_preset_load(bpy.types.Operator):
    """Set all settings of the search to those of this preset"""

    bl_idname = "irpso.preset_load"
    bl_label = "Load Preset"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}

    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})

    def execute(self, context):
        """Fill the settings, or leave all as they are where the file has a mistake."""
        settings = context.scene.irpso.schedule
        try:
            name, schedule = read_preset(self.filepath)
        except InputError as error:
            return _refused(self, error)
        settings.preset = name
        fill(settings, schedule)
        _note_own(settings, self.filepath)
        return {"FINISHED"}


class IRPSO_OT_preset_add(AddPresetBase, bpy.types.Operator):
    """Save the settings of the search as a preset of your own"""

    bl_idname = "irpso.preset_add"
    bl_label = "Add Preset"
    preset_menu = "IRPSO_MT_presets"
    preset_subdir = FOLDER

    @classmethod
    def description(cls, context, properties) -> str:
        """Return what the button does: add, or remove."""
        if properties.remove_active or properties.remove_name:
            return "Remove this preset of your own; the settings stay as they are"
        return cls.__doc__

    def draw(self, context) -> None:
        """Ask for the name, its field ready to be typed into."""
        row = self.layout.row()
        row.activate_init = True
        row.prop(self, "name")

    def execute(self, context):
        """Add or remove a preset of the user's own; shipped ones are never touched."""
        settings = context.scene.irpso.schedule
        if self.remove_active:  # Blender's own way takes the menu's label for the active preset, whatever the scene
            self.remove_active, self.remove_name, self.name = False, True, settings.own
        shipped = self.as_filename(self.name).lower() in shipped_presets()
        try:
            if shipped or (self.remove_name and not self.name):
                what = "removed" if self.remove_name else "replaced"
                raise InputError(f"Shipped presets cannot be {what}; choose another name")
            schedule_of(settings)
            return super().execute(context)
        except InputError as error:
            return _refused(self, error)

    def add(self, context, filepath: str) -> None:
        """Write the file."""
        settings = context.scene.irpso.schedule
        with replacing_file(Path(filepath)) as partial:
            partial.write_text(preset_text(settings), encoding="utf-8")
        _note_own(settings, filepath)

    def post_cb(self, context, filepath: str) -> None:
        """Forget the name of a preset that is gone."""
        if self.remove_name:
            context.scene.irpso.schedule.own = ""


def _note_own(settings: Any, path: str) -> None:
    settings.own = bpy.path.display_name(os.path.basename(path), title_case=False)
    settings.own_text = preset_text(settings)


def _refused(operator: bpy.types.Operator, error: InputError) -> set[str]:
    operator.report({"ERROR"}, str(error))
    return {"CANCELLED"}


CLASSES = (IRPSO_MT_presets, IRPSO_OT_preset_choose, IRPSO_OT_preset_load, IRPSO_OT_preset_add)
