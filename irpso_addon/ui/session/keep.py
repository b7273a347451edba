"""Operator Keep, which makes the maps the subject's material in one undo step; and the results for exports."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext, suppress
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...blender.materials import material
from ...blender.materials.surface_check import uv_warnings
from ...blender.materials.textures import image_files, unsaved
from ...core.errors import IrpsoError
from ...pipeline import result
from ...pipeline.result import ResultMaps, result_maps
from ...results.derived_maps import DerivedMaps
from ...results.map_tables import map_tables
from ...results.preview import Curves, convergence, display_image
from ...results.write import MODEL_DIGEST
from ..common.failures import report_and_cancel
from ..common.polls import usable
from ..common.words import n_, rpt
from ..properties import preferences
from . import session, stored_recoveries
from .card_place import put_card

_NO_EXTRAS = DerivedMaps()
NOTHING = n_("Nothing has been recovered yet: press Recover")
_STANDARD = "Standard"
# Other settings of a view that change no colour; the white balance is absent before Blender 4.3.
_NEUTRAL = {"look": "None", "exposure": 0.0, "gamma": 1.0, "use_curve_mapping": False, "use_white_balance": False}


def current_maps(running: session.Session, confidence: bool, extras: DerivedMaps = _NO_EXTRAS) -> ResultMaps:
    """Return the current maps. extras: derived maps to add. Raises InputError if one cannot be made."""
    return result_maps(running.job_run, running.maps(confidence), extras)


def report_of(running: session.Session, recovered: ResultMaps) -> dict[str, Any]:
    """Return the report of the current maps, in the form that the command line writes."""
    job = running.job
    settings = {
        "capture": str(job.capture.source or job.capture.name),
        "model": job.model_source,
        "object": None if job.mesh is None else job.name,
        "fixed": sorted(job.fixed),
        "hold_out": "auto" if job.held_out else None,
        "done": running.progress.done,
    }
    if job.model_digest is not None:
        settings[MODEL_DIGEST] = job.model_digest
    running.relight(recovered.in_solver_frames)
    return result.report_of(running.job_run, recovered, settings, running.seconds)


def pictures_of(running: session.Session, recovered: ResultMaps) -> dict[str, np.ndarray]:
    """Return the pictures of a result: file stem → (H, W, 3) display values; convergence if there is a history."""
    running.relight(recovered.in_solver_frames)
    pictures, maps = result.pictures_of(running.job_run, recovered), recovered.in_solver_frames
    panels = [_curve("Mean error", [running.history])] if running.history else []
    watched = [probe for probe in running.probes if probe.curve]
    if watched:
        panels.append(_curve("Error of the marked texels", [probe.curve for probe in watched]))
    if panels:
        normal = maps.model.parameter(maps.model.normal)
        image = display_image([normal], [maps.values[normal.name]]) * maps.solved[..., None]
        pictures["convergence"] = convergence(image, [(p.column, p.row) for p in watched], panels)
    return pictures


def _curve(title: str, curves: list[list[tuple[int, float]]]) -> Curves:
    """Return curves of (iteration, error) with different iterations, in % of white."""
    iterations = sorted({iteration for curve in curves for iteration, _ in curve})
    errors = np.full((len(iterations), len(curves)), np.nan)
    for column, curve in enumerate(curves):
        for iteration, error in curve:
            errors[iterations.index(iteration), column] = 100 * error
    return Curves(title, np.array(iterations), errors, "%", log=True)


def has_maps(cls) -> bool:
    """Return whether there are maps to keep; if not, the button's tooltip names the remedy."""
    running = session.current()
    return usable(cls, running is not None and running.recovery is not None, NOTHING)


class IRPSO_OT_keep(bpy.types.Operator):
    """Make the maps the material of the subject. Nodes that you have added to it stay"""

    bl_idname = "irpso.keep"
    bl_label = "Keep"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there are maps to keep."""
        return has_maps(cls)

    def execute(self, context):
        """Pause the recovery, and make images, material and, for a card, its object, in the recovery's scene."""
        running = session.current()
        running.pause()
        try:
            with _home(context, running):
                text, warnings = _keep(context, running)
            stored_recoveries.delete_when_saved(running.job.resumed, running.stamp)
        except IrpsoError as error:
            return report_and_cancel(self, error)
        for warning in warnings:
            self.report({"WARNING"}, warning)
        self.report({"INFO"}, text)
        return {"FINISHED"}


def _home(context, running: session.Session) -> AbstractContextManager[Any]:
    """Return a context manager in which ``context`` has the recovery's scene, if that still exists."""
    scene = running.home_scene() or context.scene
    return (
        nullcontext() if scene == context.scene else context.temp_override(scene=scene, view_layer=scene.view_layers[0])
    )


def _keep(context, running: session.Session) -> tuple[str, list[str]]:
    """Make images, material and card object; return the operator's message and warnings. Raises InputError."""
    job = running.job
    former = result.subject_of(job)
    found = current_maps(running, False, DerivedMaps(displacement=context.scene.irpso.displacement))
    wanted = preferences.current(context)
    folder = wanted.folder()
    _remove_undone(running, folder)
    made_material, subject = result.make_material(job, former, found, found.height, wanted.output_folder or None)
    made_material[material.ORIGIN], made_material[material.STAMP] = job.origin, running.stamp
    running.files = image_files(job.name)
    if job.mesh is None:
        if former is None:
            put_card(subject, job.place)
        _show(context, subject, new=former is None)
    count = len(map_tables(job.model))
    where = rpt("in {folder}", folder=folder) if folder else rpt("packed into the file")
    text = rpt(
        "Material '{name}' on '{object}', with {count} maps {where}", name=made_material.name, object=subject.name,
        count=count, where=where,
    )  # fmt: skip
    return text, [] if job.mesh is None else uv_warnings(subject, job.mesh)


def _remove_undone(running: session.Session, folder: Path | None) -> None:
    """Remove what an undone Keep wrote into the folder; the maps would be written beside it under numbered names.

    Files that a saved .blend shows stay.
    """
    for path in unsaved(running.files - image_files()):
        if folder is not None and path.parent == folder.resolve():
            with suppress(OSError):
                path.unlink()


def _show(context, card, new: bool) -> None:
    """Link a hidden or deleted card to the scene and show it; make a new one the active object."""
    if card.name not in context.scene.objects:
        context.scene.collection.objects.link(card)
    card.hide_viewport = card.hide_render = False
    context.view_layer.update()  # else it lacks the newly linked object
    if card.name not in context.view_layer.objects:  # its collection is excluded from this view layer
        return
    card.hide_set(False)
    if new and context.mode == "OBJECT":
        for obj in context.view_layer.objects:
            obj.select_set(obj == card)
        context.view_layer.objects.active = card


class IRPSO_OT_standard_view(bpy.types.Operator):
    """Show colors as they are: the Standard view transform, without the film look that AgX and Filmic add, and without
    exposure, gamma, curves and white balance. A render can be compared with the photographs only in this view
    """

    bl_idname = "irpso.standard_view"
    bl_label = "Use Standard View"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context) -> bool:
        """Whether something else is set."""
        return usable(cls, not is_standard_view(context.scene), "The scene has the Standard view transform already")

    def execute(self, context):
        """Set the view transform, and the other settings to their defaults."""
        view = context.scene.view_settings
        try:
            view.view_transform = _STANDARD
        except TypeError:
            self.report(
                {"ERROR"},
                "The OpenColorIO configuration has no view transform Standard: choose one without a tone curve under"
                " Color Management",
            )
            return {"CANCELLED"}
        for name, value in _NEUTRAL.items():
            if hasattr(view, name):
                setattr(view, name, value)
        return {"FINISHED"}


def is_standard_view(scene) -> bool:
    """Return whether the scene shows colours by the Standard view transform, and changes them no further."""
    view = scene.view_settings
    neutral = all(getattr(view, name, value) == value for name, value in _NEUTRAL.items())
    return neutral and view.view_transform == _STANDARD


CLASSES = (IRPSO_OT_keep, IRPSO_OT_standard_view)
