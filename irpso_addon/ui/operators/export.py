"""Exports a result as maps or in other programs' formats. The file browser shows the options."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty

from ...blender.materials.surface_check import uv_warnings
from ...blender.occlusion import mesh_open_sky
from ...core.errors import InputError, IrpsoError
from ...exports.formats import export
from ...exports.names import FORMATS, ONE_FILE, WEB
from ...exports.place import file_stem
from ...exports.result import Result
from ...exports.textures import CONVENTIONS
from ...exports.tile import tiled
from ...exports.web.photographs import PHOTOGRAPHS, Photographs, photographs_of, spread
from ...geometry.domain import subset
from ...geometry.surface.mesh import alone
from ...pipeline.result import subject_of
from ...results.derived_map import NORMAL_SPACES
from ...results.derived_maps import DerivedMaps
from ...results.report import mode_warnings
from ...results.write import write_maps
from ..common.failures import report_and_cancel
from ..common.file_paths import absolute
from ..common.words import iface, rpt
from ..session import session
from ..session.keep import NOTHING, current_maps, has_maps, pictures_of, report_of

MAPS = "maps"
_FORMATS = {MAPS: ("Maps", "16-bit PNG, 32-bit EXR, a report and a preview, in a folder"), **FORMATS}
_ITEMS = [(name, title, text) for name, (title, text) in _FORMATS.items()]
_CONVENTIONS = [(name, name.title(), f"Names and normals that {name.title()} expects") for name in CONVENTIONS]
# format → optional maps besides the model's own
_OPTIONAL = {
    MAPS: (*(f"normal_{space}" for space in NORMAL_SPACES), "height"),
    "textures": ("height", "occlusion"),
    "gltf": ("occlusion",),
}


class IRPSO_OT_export(bpy.types.Operator):
    """Write the recovered material to files: its maps, or a format of another program"""

    bl_idname = "irpso.export"
    bl_label = "Export Material"

    filepath: StringProperty(name="File or Folder", description="The file or folder to write", subtype="FILE_PATH")
    check_existing: BoolProperty(default=True, options={"HIDDEN"})
    format: EnumProperty(name="Format", description="Format of the files", items=_ITEMS, default=MAPS)
    convention: EnumProperty(
        name="Names", description="Program whose file names and normal direction are used", items=_CONVENTIONS
    )
    normal_object: BoolProperty(
        name="Normal (Object Space)", description="Also write the normals in the object's own axes"
    )
    normal_world: BoolProperty(name="Normal (World Space)", description="Also write the normals in the world's axes")
    normal_directx: BoolProperty(
        name="Normal (DirectX)", description="Also write the normal map with its green channel inverted"
    )
    height: BoolProperty(name="Height", description="Also write the relief, integrated from the normals")
    occlusion: BoolProperty(
        name="Occlusion",
        description="Also write ambient occlusion: of a card by its relief, of a mesh by Cycles, which takes time",
    )
    photographs: IntProperty(
        name="Photographs",
        description="How many photographs the page shows beside the render",
        default=PHOTOGRAPHS, min=0, soft_max=32,
    )  # fmt: skip
    seamless: BoolProperty(
        name="Seamless", description="Cut a flat card's maps so that they repeat, in a square of a power of two"
    )

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there is a result to export."""
        return has_maps(cls)

    def invoke(self, context, event):
        """Open the file browser with a proposed path."""
        running = session.current()
        self.filepath = f"{proposed_folder(running)}{os.sep}{_proposed_name(running, self.format)}"
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def check(self, context) -> bool:
        """Adapt a proposed name to the chosen format; return whether the name has changed."""
        running = session.current()
        folder, name = os.path.split(self.filepath)
        if running is None or name not in {_proposed_name(running, kind) for kind in _FORMATS}:
            return False
        former, self.filepath = self.filepath, os.path.join(folder, _proposed_name(running, self.format))
        return self.filepath != former

    def draw(self, context) -> None:
        """Draw the format and its options."""
        column = self.layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(self, "format")
        if self.format == "textures":
            column.prop(self, "convention")
        if self.format == WEB:
            column.prop(self, "photographs")
        column = self.layout.column()  # not split, because half of the narrow panel is too short for the names
        if options := _OPTIONAL.get(self.format):
            column.label(text="Also Write:")
            for name in options:
                column.prop(self, name)
        if self.format == MAPS and _is_card(session.current()):
            column.prop(self, "seamless")

    def execute(self, context):
        """Write all files or none. A running recovery pauses."""
        running = session.current()
        if running is None or running.recovery is None:  # the recovery may have ended while the file browser was open
            self.report({"ERROR"}, NOTHING)
            return {"CANCELLED"}
        if not self.filepath:
            self.report({"ERROR"}, "No path: choose a file or folder")
            return {"CANCELLED"}
        running.pause()
        try:
            path = absolute(self.filepath, "Export")
            text, warnings = (self._write_maps if self.format == MAPS else self._write_format)(running, path)
        except IrpsoError as error:
            return report_and_cancel(self, error)
        for warning in warnings:
            self.report({"WARNING"}, warning)
        self.report({"INFO"}, text)
        return {"FINISHED"}

    def _write_maps(self, running: session.Session, folder: Path) -> tuple[str, list[str]]:
        if self.seamless and _is_card(running):
            return self._write_seamless(running, folder)
        spaces = tuple(space for space in NORMAL_SPACES if getattr(self, f"normal_{space}"))
        found = current_maps(running, True, DerivedMaps(spaces, self.height))
        report, pictures = report_of(running, found), pictures_of(running, found)
        files = write_maps(found.in_blender_frames, folder, report, pictures, found.derived)
        priors = running.job.schedule.fitness.priors
        text = rpt("{count} files written to {folder}", count=len(files), folder=folder)
        return text, mode_warnings(found.in_solver_frames, priors)

    def _write_seamless(self, running: session.Session, folder: Path) -> tuple[str, list[str]]:
        found = current_maps(running, False)
        tile = tiled(found.in_blender_frames, self.height)
        report = tile.report(report_of(running, found))
        files = write_maps(tile.maps, folder, report, {"repeated": tile.picture()}, tile.derived)
        return rpt("{count} files of maps that repeat written to {folder}", count=len(files), folder=folder), []

    def _write_format(self, running: session.Session, path: Path) -> tuple[str, list[str]]:
        optional = {name for name in _OPTIONAL.get(self.format, ()) if getattr(self, name)}
        card, occluded = _is_card(running), "occlusion" in optional
        found = current_maps(
            running, self.format == WEB, DerivedMaps(height="height" in optional or (card and occluded))
        )
        job = running.job
        result = Result(
            file_stem(job.name), found.in_blender_frames, found.height, card=card, mesh=job.mesh, occluded=occluded
        )
        if occluded and not card:
            result = replace(result, baked_sky=mesh_open_sky(alone(job.mesh), result.maps))
        subject, photographs = partial(_subject, running), partial(_photographs, running, self.photographs)
        report = export(result, self.format, path, self.convention, subject, photographs)
        text = rpt("{what} written to {name}", what=iface(FORMATS[self.format][0]), name=report["output"])
        moved = uv_warnings(running.subject(), job.mesh) if self.format == "gltf" and job.mesh is not None else []
        return text, [*report.get("warnings", []), *moved]


class IRPSO_MT_export(bpy.types.Menu):
    """Export the recovered material as maps or in formats of other programs"""

    bl_label = "Recovered Material (IRPSO)"

    def draw(self, context) -> None:
        """List the formats."""
        for name, (title, _) in _FORMATS.items():
            text = f"{iface(title)} ({ONE_FILE.get(name) or iface('folder')})"
            self.layout.operator("irpso.export", text=text, translate=False).format = name


def _is_card(running: session.Session | None) -> bool:
    return running is not None and running.job.mesh is None


def proposed_folder(running: session.Session) -> Path:
    """Return the proposed folder: that of the .blend, else the parent of the photographs' folder, else the user's home.

    It is never the photographs' own folder, because the capture would read the written files as photographs.
    """
    source = running.job.capture.source
    photographs = None if source is None else source if source.is_dir() else source.parent
    blend = Path(bpy.data.filepath).parent if bpy.data.filepath else None
    places = (blend, None if photographs is None else photographs.parent, Path.home())
    return next(place for place in places if place is not None and place != photographs)


def _proposed_name(running: session.Session, kind: str) -> str:
    name = file_stem(running.job.name)
    return f"{name}{ONE_FILE[kind]}" if kind in ONE_FILE else f"{name} {_FORMATS[kind][0].lower()}"


def _subject(running: session.Session) -> Any:
    subject = subject_of(running.job)
    if subject is None:
        raise InputError(f"'{running.job.name}' has no object to export yet: press Keep first")
    return subject


def _photographs(running: session.Session, count: int) -> Photographs | None:
    """Return some photographs of a card: those held out of the fit, then those whose lights are farthest apart."""
    job, domain = running.job, running.domain
    if not count or domain is None:
        return None
    chosen = spread(domain.lights, domain.bake, list(job.held_out_indices), count)
    names = [job.capture.observations[k].name for k in chosen]
    return photographs_of(subset(domain, chosen), names, [i for i, k in enumerate(chosen) if k in job.held_out_indices])


def _draw_menu(self, context) -> None:
    self.layout.menu("IRPSO_MT_export")


def register() -> None:
    """Add the formats to File ▸ Export."""
    bpy.types.TOPBAR_MT_file_export.append(_draw_menu)


def unregister() -> None:
    """Remove the formats."""
    bpy.types.TOPBAR_MT_file_export.remove(_draw_menu)


CLASSES = (IRPSO_OT_export, IRPSO_MT_export)
