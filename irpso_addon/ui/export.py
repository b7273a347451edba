"""What is written besides the maps, and the formats of other programs, in a panel of their own."""

from __future__ import annotations

import os

import bpy
from bpy.props import StringProperty

from ..errors import InputError, IrpsoError
from ..exports.formats import FORMATS, ONE_FILE, export
from ..exports.place import file_stem
from ..exports.result import Result
from . import session
from .file_paths import absolute
from .keep import NOTHING, beside, extras_of, found_maps, has_found
from .panels import Sidebar


class IRPSO_OT_export_as(bpy.types.Operator):
    """Write what was found in the chosen format"""

    bl_idname = "irpso.export_as"
    bl_label = "Export As"

    filepath: StringProperty(name="File or Folder", description="Where it is written", subtype="FILE_PATH")

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there is something to export."""
        return has_found(cls)

    def invoke(self, context, event):
        """Ask where to, and propose a name."""
        running, kind = session.current(), context.scene.irpso.export.format
        name = f"{running.job.name} {FORMATS[kind][0]}" if kind not in ONE_FILE else running.job.name
        self.filepath = f"{beside(running)}{os.sep}{name}{ONE_FILE.get(kind, '')}"
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context):
        """Write everything, or nothing; what runs rests meanwhile."""
        running = session.current()
        if running is None or running.recovery is None:  # it may have ended while the place was chosen
            self.report({"ERROR"}, NOTHING)
            return {"CANCELLED"}
        if not self.filepath:
            self.report({"ERROR"}, "No place: choose where it is to be written")
            return {"CANCELLED"}
        running.pause()
        settings = context.scene.irpso.export
        try:
            found, written = found_maps(running, confidence=False)
            _, height = extras_of(running, settings, found, written)
            result = Result(file_stem(running.job.name), written, height)
            path = absolute(self.filepath, "Export")
            said = export(result, settings.format, path, settings.convention, lambda: _subject(running))
        except IrpsoError as error:
            self.report({"ERROR"}, " ".join(str(error).splitlines()))
            return {"CANCELLED"}
        for text in said.get("warnings", ()):
            self.report({"WARNING"}, text)
        self.report({"INFO"}, f"{FORMATS[settings.format][0]} written to {said['output']}")
        return {"FINISHED"}


def _subject(running: session.Session):
    subject = running.subject()
    if subject is None:
        raise InputError(f"'{running.job.name}' has no object to export yet: press Keep first")
    return subject


class IRPSO_PT_export(Sidebar, bpy.types.Panel):
    """What is written besides the maps, and for other programs."""

    bl_label = "Export"
    bl_parent_id = "IRPSO_PT_recover"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context) -> bool:
        """Whether something has been found."""
        running = session.current()
        return running is not None and running.recovery is not None and running.state in ("paused", "done")

    def draw(self, context) -> None:
        """Draw what Export Maps and Keep add, then the formats."""
        settings = context.scene.irpso.export
        column = self.layout.column(heading="Also Write")
        column.use_property_split, column.use_property_decorate = True, False
        for name in ("normal_object", "normal_world", "normal_directx", "height", "displacement"):
            column.prop(settings, name)
        column.separator()
        column.prop(settings, "format")
        if settings.format == "textures":
            column.prop(settings, "convention")
        title = FORMATS[settings.format][0]
        self.layout.operator("irpso.export_as", text=f"Export {title}…", icon="EXPORT")


CLASSES = (IRPSO_OT_export_as, IRPSO_PT_export)
