"""Keeping what was found as the subject's material, in one undo step; and what exports need of it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import bpy
import numpy as np

from ...blender.materials import material
from ...blender.materials.margins import blender_maps
from ...core.errors import InputError, IrpsoError
from ...geometry.relief.height import Height
from ...gpu import context as gpu_context
from ...reflectance.model import shipped_models
from ...results.derived_map import DerivedMap
from ...results.derived_maps import DerivedMaps, derived_maps
from ...results.map_tables import map_tables
from ...results.maps import Maps
from ...results.preview import Curves, convergence, display_image
from ...results.report import build_report, limit_warnings, mode_warnings, prior_shares
from ...solver.engine.modes import with_modes
from ...solver.views.held_out import preview_names
from ...solver.views.pictures import confidence_preview, error_preview
from ..properties import preferences
from . import session, unkept
from .card_place import put_card

NOTHING = "Nothing has been recovered yet: press Recover"
_STANDARD = "Standard"


def found_maps(running: session.Session, confidence: bool) -> tuple[Maps, Maps]:
    """Return what was found, in the solver's frames, and with normals in those of Blender's normal maps."""
    maps = with_modes(running.maps(confidence))
    if running.mesh is None:
        return maps, maps
    return maps, blender_maps(maps, running.mesh, running.domain.bake, running.domain.seams)


def derived_maps_of(
    running: session.Session, wanted: DerivedMaps, found: Maps, written: Maps
) -> tuple[list[DerivedMap], Height | None]:
    """Return the maps that are wanted besides the model's, and the relief. Raises InputError."""
    wanted.check(found.model)
    return derived_maps(wanted, found, written, running.domain.bake, running.mesh, running.job.capture.cameras[0])


def report_of(running: session.Session, maps: Maps) -> dict[str, Any]:
    """Return the report on a session's maps, as the command line writes it."""
    job, progress = running.job, running.progress
    settings = {
        "capture": str(job.capture.source or job.capture.name),
        "model": maps.model.name
        if maps.model.name in shipped_models()
        else str(maps.model.shader.with_suffix(".toml")),
        "object": None if running.mesh is None else job.name,
        "preset": asdict(job.schedule),
        "fixed": sorted(job.given),
        "hold_out": "auto" if job.held_out else None,
        "entry": running.recovery.entry,
        "done": progress.done,
    }
    report = build_report(
        maps, settings=settings, seed=job.seed, gpu=gpu_context.describe()["renderer"],
        iterations=progress.iteration_in_all, evaluations=progress.evaluations, seconds={"solve": running.seconds},
        noise=running.domain.noise,
    )  # fmt: skip
    lights = running.lights
    warnings = [*limit_warnings(maps, job.given), *mode_warnings(maps, job.schedule.fitness.priors), *job.notes()]
    if lights is not None:
        warnings += lights.warnings(job.lights.intensities != "auto")
    if job.schedule.fitness.priors and (shares := prior_shares(maps, job.given)):
        report["priors_decided"] = shares
    report |= running.relit()[1] | {"warnings": warnings}
    return report | ({} if lights is None else {"lights": lights.report(job.numbers)})


def pictures_of(running: session.Session, maps: Maps) -> dict[str, np.ndarray]:
    """Return the pictures of a result: file stem → (H, W, 3) display values.

    They are a preview and how sure the numbers are; with photographs held out relit; with a history convergence.
    """
    job = running.job
    names = preview_names(job.capture, job.unseen)
    pictures = {"preview": error_preview(running.domain, maps, None, names)} | confidence_preview(maps)
    pictures |= running.relit()[0]
    panels = [_curve("Mean error", [running.history])] if running.history else []
    watched = [probe for probe in running.probes if probe.curve]
    if watched:
        panels.append(_curve("Error of the marked texels", [probe.curve for probe in watched]))
    if panels:
        normal = next(parameter for parameter in maps.model.parameters if parameter.is_normal)
        image = display_image([normal], [maps.values[normal.name]]) * maps.covered[..., None]
        pictures["convergence"] = convergence(image, [(p.column, p.row) for p in watched], panels)
    return pictures


def _curve(title: str, curves: list[list[tuple[int, float]]]) -> Curves:
    """Return curves of (iteration, error) that were looked at different iterations, in % of white."""
    iterations = sorted({iteration for curve in curves for iteration, _ in curve})
    errors = np.full((len(iterations), len(curves)), np.nan)
    for column, curve in enumerate(curves):
        for iteration, error in curve:
            errors[iterations.index(iteration), column] = 100 * error
    return Curves(title, np.array(iterations), errors, "%", log=True)


def has_found(cls) -> bool:
    """Whether there is something to keep; tells the operator's button what to do where not."""
    running = session.current()
    if running is None or running.recovery is None:
        cls.poll_message_set(NOTHING)
        return False
    return True


class IRPSO_OT_keep(bpy.types.Operator):
    """Make the maps the material of the subject. Nodes that you have added to it stay"""

    bl_idname = "irpso.keep"
    bl_label = "Keep"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there is something to keep."""
        return has_found(cls)

    def execute(self, context):
        """Make images, material and, on a card, its object; what runs rests meanwhile."""
        running = session.current()
        running.pause()
        try:
            text = _keep(context, running)
            unkept.forget(running.job.resumed)
        except IrpsoError as error:
            self.report({"ERROR"}, " ".join(str(error).splitlines()))
            return {"CANCELLED"}
        self.report({"INFO"}, text)
        return {"FINISHED"}


def _keep(context, running: session.Session) -> str:
    """Keep, and return a sentence that says what was done. Raises InputError."""
    name = running.job.name
    subject = running.subject()
    if subject is None and running.mesh is not None:
        raise InputError(f"'{name}' has been deleted: undo that and keep again, or export the maps")
    if subject is not None:
        material.check_object(subject)
    found, maps = found_maps(running, confidence=False)
    _, height = derived_maps_of(running, DerivedMaps(displacement=context.scene.irpso.displacement), found, maps)
    folder = preferences.current(context).folder()
    uv_map = "" if running.mesh is None else material.other_uv_map(subject, running.mesh.uv_map)
    made = material.build_material(maps, name, folder, uv_map, height)
    made[material.ORIGIN], made[material.STAMP] = running.job.origin, running.stamp
    if running.mesh is None:
        former, subject = subject, material.card_object(name, *maps.covered.shape, height is not None)
        if former is None:
            put_card(subject, running.job.place)
        _show(context, subject, new=former is None)
    material.apply_material(subject, made, () if running.mesh is None else running.mesh.solved_slots)
    count = len(map_tables(maps.model))
    where = f"in {folder}" if folder else "packed into the file"
    return f"Material '{made.name}' on '{subject.name}', with {count} maps {where}"


def _show(context, card, new: bool) -> None:
    """Bring a card into the scene and into view: it may have been hidden, or deleted, since it was made.

    A new one becomes the active object, as whatever is added in Blender does.
    """
    if card.name not in context.scene.objects:
        context.scene.collection.objects.link(card)
    card.hide_viewport = card.hide_render = False
    context.view_layer.update()  # else it does not know of an object that was linked just now
    if card.name not in context.view_layer.objects:  # its collection is left out of this view layer
        return
    card.hide_set(False)
    if new and context.mode == "OBJECT":
        for obj in context.view_layer.objects:
            obj.select_set(obj == card)
        context.view_layer.objects.active = card


class IRPSO_OT_standard_view(bpy.types.Operator):
    """Show colors as they are: the Standard view transform, without the film look that AgX and Filmic add.

    Only so a render can be compared with the photographs
    """

    bl_idname = "irpso.standard_view"
    bl_label = "Use Standard View"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context) -> bool:
        """Whether another view transform is set."""
        if is_standard_view(context.scene):
            cls.poll_message_set("The scene has the Standard view transform already")
            return False
        return True

    def execute(self, context):
        """Set view transform and look, and nothing else."""
        context.scene.view_settings.view_transform = _STANDARD
        context.scene.view_settings.look = "None"
        return {"FINISHED"}


def is_standard_view(scene) -> bool:
    """Return whether the scene is shown without a film look."""
    return scene.view_settings.view_transform == _STANDARD and scene.view_settings.look == "None"


CLASSES = (IRPSO_OT_keep, IRPSO_OT_standard_view)
