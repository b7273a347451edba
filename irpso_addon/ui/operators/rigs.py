"""Saves the capture's lamps and cameras as a rig, and applies a rig to photographs; the menu of photographs."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty

from ...blender.images import decode
from ...calibration.developing.measure import Progress
from ...calibration.rigs.apply import Applied, apply_steps
from ...calibration.rigs.rig import read_rig, save_rig
from ...capture.read import read_spec
from ...core.errors import InputError
from ...core.steps import map_steps
from ..common import failures
from ..common.features import RELATIVE_PATH
from ..common.file_paths import absolute
from ..common.polls import has_files
from ..common.sliced import SlicedOperator
from ..common.words import n_, rpt
from ..session.scene_capture import capture_path
from .develop import free_folder, reported

_MATCH = (
    ("auto", "Automatic", "By equal names, else by order"),
    ("order", "Order", "In the order of their names; every lamp has a photograph"),
    ("names", "Names", "By the same names as the rig's photographs; some may be missing"),
    ("numbers", "Numbers", "By the last number in their names; some may be missing"),
)
_FOLDER = {"subtype": "DIR_PATH", "options": {"SKIP_SAVE", *RELATIVE_PATH.get("options", ())}}
_REMEDIES = {
    "write one with irpso rig save CAPTURE -o RIG": "choose the folder that Save Rig made",
    "write it again with irpso rig save": "save it again with Save Rig",
}
_last_rig = ""  # the rig last saved or applied, which Apply Rig offers


class IRPSO_OT_save_rig(bpy.types.Operator):
    """Keep the capture's lamps and cameras, and the corrections of Develop, for other photographs under the same lamps.
    Choose a new folder"""

    bl_idname = "irpso.save_rig"
    bl_label = "Save Rig"
    bl_options = {"REGISTER"}

    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there is a capture of files."""
        return has_files(cls, context)

    def invoke(self, context, event):
        """Open the file browser at a new name beside the capture."""
        try:
            self.filepath = str(free_folder(capture_path(context.scene.irpso), "rig"))
        except InputError as error:
            return failures.report_and_cancel(self, error)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context):
        """Write the rig. On an error nothing is written."""
        settings = context.scene.irpso
        try:
            out = absolute(self.filepath, "Rig") if self.filepath else free_folder(capture_path(settings), "rig")
            rig = save_rig(read_spec(capture_path(settings), settings.colour_space), out, decode)
        except InputError as error:
            return failures.report_and_cancel(self, error)
        _remember(out)
        count = len(rig.photographs)
        if rig.measured is not None:
            text = rpt("{name}: {count} lamps, with corrections", name=out.name, count=count)
        else:
            text = rpt("{name}: {count} lamps, without corrections", name=out.name, count=count)
        self.report({"INFO"}, text)
        return {"FINISHED"}


class IRPSO_OT_apply_rig(SlicedOperator, bpy.types.Operator):
    """Import photographs under the lamps of a rig, which need no ball and no chart. They stay as they are"""

    bl_idname = "irpso.apply_rig"
    bl_label = "Apply Rig"
    bl_options = {"UNDO"}  # without REGISTER, as Find Lights
    doing = n_("Applying the rig")
    names = {
        "--match names or --match numbers": "Match: Names or Numbers", "--match order": "Match: Order",
        "--match names": "Match: Names", "--match numbers": "Match: Numbers", ", or scale with --exposure exif": "",
        **_REMEDIES,
    }  # fmt: skip

    rig: StringProperty(name="Rig", description="Folder of the rig, with rig.toml", **_FOLDER)
    photographs: StringProperty(name="Photographs", description="Folder with one photograph for each lamp", **_FOLDER)
    match: EnumProperty(name="Match", description="Which lamp lit which photograph", items=_MATCH, default="auto")

    def invoke(self, context, event):
        """Open a file browser for the rig, if none is known, and for the photographs; then the dialog.

        A file browser that the dialog itself opens in the same window would end the dialog.
        """
        self.rig = self.rig or (_last_rig if Path(_last_rig).is_dir() else "")
        if self.rig and self.photographs:
            return context.window_manager.invoke_props_dialog(self, width=420)
        if self.rig:
            bpy.ops.irpso.choose_photographs("INVOKE_DEFAULT", rig=self.rig)
        else:
            bpy.ops.irpso.choose_rig("INVOKE_DEFAULT")
        return {"CANCELLED"}

    def draw(self, context) -> None:
        """Draw the dialog."""
        column = self.layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        for name in ("rig", "photographs", "match"):
            column.prop(self, name)

    def execute(self, context):
        """Write a capture beside the photographs, and import it. On an error nothing is written."""
        return self.begin(context, map_steps(self._apply_steps(), lambda step: step.done))

    def _apply_steps(self) -> Generator[Progress, None, tuple[Path, Applied]]:
        """Yield the progress; return the new folder and the result. Raises InputError."""
        if not self.rig or not self.photographs:
            raise InputError(f"{'Photographs' if self.rig else 'Rig'}: no folder is chosen; choose one")
        photographs = absolute(self.photographs, "Photographs")
        out = free_folder(photographs, "capture")
        applied = yield from apply_steps(
            read_rig(absolute(self.rig, "Rig")), photographs, out, self.match, decoder=decode
        )
        return out, applied

    def finished(self, context, result: tuple[Path, Applied]) -> set[str]:
        """Import the capture, and report the lamps."""
        out, applied = result
        _remember(absolute(self.rig, "Rig"))
        count = len(applied.lamps)
        developed = applied.developed
        summary = rpt("{count} lamps, linear images", count=count) if developed else rpt("{count} lamps", count=count)
        bpy.ops.irpso.import_capture(directory=str(out))
        return reported(self, out, [*applied.left_out, *applied.warnings], summary)


class IRPSO_OT_choose_rig(bpy.types.Operator):
    """Choose the folder that Save Rig made; the photographs are chosen next"""

    bl_idname = "irpso.choose_rig"
    bl_label = "Choose Rig"
    bl_options = {"INTERNAL"}

    directory: StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE"})
    filter_folder: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context, event):
        """Open the file browser."""
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context):
        """Go on with Apply Rig, if the folder is a rig."""
        try:
            rig = read_rig(absolute(self.directory, "Rig"))
        except InputError as error:
            return failures.report_and_cancel(self, error, _REMEDIES)
        bpy.ops.irpso.apply_rig("INVOKE_DEFAULT", rig=str(rig.path))
        return {"FINISHED"}


def _remember(rig: Path) -> None:
    global _last_rig
    _last_rig = str(rig)


class IRPSO_MT_photographs(bpy.types.Menu):
    """What makes a capture of photographs, or keeps it for others."""

    bl_label = "Photographs"

    def draw(self, context) -> None:
        """Draw the entries."""
        layout = self.layout
        layout.operator("irpso.photographs_of_video", text="Photographs of a Video…", icon="FILE_MOVIE")
        layout.separator()
        layout.operator("irpso.develop", text="Develop…", icon="IMAGE_DATA")
        layout.operator("irpso.mark_chart", icon="EYEDROPPER")
        layout.separator()
        layout.operator("irpso.save_rig", text="Save Rig…", icon="EXPORT")
        layout.operator("irpso.apply_rig", text="Apply Rig…", icon="IMPORT")


CLASSES = (IRPSO_OT_save_rig, IRPSO_OT_apply_rig, IRPSO_OT_choose_rig, IRPSO_MT_photographs)
