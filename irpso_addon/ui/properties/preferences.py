"""The add-on's preferences: memory, passes, display rate, output folder; and a report on the GPU."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import bpy
from bpy.props import EnumProperty, IntProperty, StringProperty

from ...core.errors import GpuUnavailableError, InputError
from ...core.paths import BASE_PACKAGE
from ...gpu import context as gpu_context
from ...gpu import probe
from ...gpu.versions import versions
from ...solver.planning.machine import fact_lines, machine_facts
from ...solver.planning.memory import parse_memory
from ..common.features import RELATIVE_PATH
from ..common.file_paths import absolute
from ..common.polls import usable
from ..common.words import rpt

DISPLAY_RATE = 10  # pictures per second
_SOFTWARE_SECONDS = 10.0  # between pictures under software Vulkan, whose number of draws is limited (gpu/context.py)
_ENTRIES = (
    ("auto", "Automatic", "Compute shaders if a test finds them at least 1.5 times as fast, else fragment passes"),
    ("fragment", "Fragment", "Always draw, like the paper: fastest on most desktop and laptop GPUs"),
    ("compute", "Compute", "Always use compute shaders: fastest on most data center GPUs"),
)

_report: dict[str, str] = {}  # facts of the last report on this machine; not saved


@dataclass(frozen=True)
class PreferenceValues:
    """Values of the preferences. memory: as for --memory, None for the machine's free memory.

    entry: "auto", "fragment" or "compute". display_rate: pictures per second, 1…60. output_folder: for the maps' image
    files, "" to pack them into the .blend file.
    """

    memory: str | None = None
    entry: str = "auto"
    display_rate: int = DISPLAY_RATE
    output_folder: str = ""

    def folder(self) -> Path | None:
        """Return the output folder, None for packing. Raises InputError for a // path while the file is not saved."""
        return absolute(self.output_folder, "Output Folder") if self.output_folder else None


def current(context) -> PreferenceValues:
    """Return the preferences; the defaults if the add-on is registered but not enabled."""
    addon = context.preferences.addons.get(BASE_PACKAGE)
    if addon is None or addon.preferences is None:
        return PreferenceValues()
    chosen = addon.preferences
    return PreferenceValues(chosen.memory.strip() or None, chosen.entry, chosen.display_rate, chosen.output_folder)


def picture_seconds(context) -> float:
    """Return the seconds between two pictures of a running recovery."""
    return max(1 / current(context).display_rate, _SOFTWARE_SECONDS if gpu_context.on_software_vulkan() else 0.0)


def memory_fault(text: str) -> str:
    """Return what is wrong with a memory budget's text, "" if it is valid."""
    try:
        if text.strip():
            parse_memory(text)
    except InputError as error:
        return str(error).partition(": ")[2]
    return ""


def report() -> str:
    """Return the last report on this machine as lines of text, "" if there is none."""
    return "\n".join(fact_lines(_report)) if _report else ""


class Preferences(bpy.types.AddonPreferences):
    """Settings for all files of this user."""

    bl_idname = BASE_PACKAGE

    memory: StringProperty(
        name="Memory Budget",
        description="Most memory that a recovery may use, as in 4G, or device=4G,host=8G. Larger recoveries are solved"
        " in tiles. Empty: the machine's free memory",
    )
    entry: EnumProperty(name="Passes", description="How the GPU does the work", items=_ENTRIES, default="auto")
    display_rate: IntProperty(
        name="Display Rate", description="Most redraws per second of the converging maps", min=1, max=60,
        default=DISPLAY_RATE,
    )  # fmt: skip
    output_folder: StringProperty(
        name="Output Folder",
        description="Folder for the image files of the recovered maps. Empty: they are packed into the .blend file",
        subtype="DIR_PATH",
        **RELATIVE_PATH,
    )

    def draw(self, context) -> None:
        """Draw the settings and the report."""
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "memory", **_PLACEHOLDER)
        if fault := memory_fault(self.memory):
            row = layout.row()
            row.alert = True
            row.label(text=fault[:1].upper() + fault[1:], icon="ERROR")
        layout.prop(self, "entry")
        layout.prop(self, "display_rate")
        layout.prop(self, "output_folder")
        row = layout.row()
        row.operator(Doctor.bl_idname, icon="INFO")
        row.operator(CopyReport.bl_idname, icon="COPYDOWN")
        if _report:
            box = layout.box().column(align=True)
            for name, value in _report.items():
                row = box.split(factor=0.25)
                row.label(text=name[:1].upper() + name[1:])
                row.label(text=value)


# Since Blender 4.3 an empty field can show a placeholder.
_HAS_PLACEHOLDER = "placeholder" in bpy.types.UILayout.bl_rna.functions["prop"].parameters
_PLACEHOLDER = {"placeholder": "Automatic"} if _HAS_PLACEHOLDER else {}


class Doctor(bpy.types.Operator):
    """Test the GPU with a real kernel, and report its name, its limits and the passes that will be used"""

    bl_idname = "irpso.doctor"
    bl_label = "Examine This Machine"

    def execute(self, context):
        """Examine the machine; the report stays until the next one."""
        _report.clear()
        try:
            _report.update(machine_facts(_probe_result()))
        except GpuUnavailableError as error:
            _report.update({f"version of {name}": value for name, value in versions().items()})
            _report["GPU"] = f"none usable: {error}"
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, rpt("The report is in the add-on's preferences"))
        return {"FINISHED"}


class CopyReport(bpy.types.Operator):
    """Copy the report on this machine, to paste it into a request for help"""

    bl_idname = "irpso.copy_report"
    bl_label = "Copy Report"

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there is a report."""
        return usable(cls, _report, "There is no report yet: press Examine This Machine first")

    def execute(self, context):
        """Copy the report to the clipboard."""
        context.window_manager.clipboard = report()
        self.report({"INFO"}, rpt("The report is in the clipboard"))
        return {"FINISHED"}


CLASSES = (Preferences, Doctor, CopyReport)


def unregister() -> None:
    """Delete the report."""
    _report.clear()


def _probe_result() -> dict:
    """Return the result of a GPU probe, in the window's own context if there is a window.

    In background a child process runs it: without a usable EGL the driver kills the process that creates a context.
    """
    if bpy.app.background:
        return probe.probe()
    return {**gpu_context.describe(), **probe.check()}
