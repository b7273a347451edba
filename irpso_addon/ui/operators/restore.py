"""Restores recoveries that were not kept when their file was closed; makes Blender ask before closing with one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
from bpy.app.handlers import persistent
from bpy.props import StringProperty

from ...blender.materials.textures import mark_saved
from ...core.errors import InputError, IrpsoError
from ...solver.state.checkpoint import glance
from ..common import drawing, failures
from ..common.polls import usable
from ..common.words import iface, n_
from ..properties.recipe import apply_recipe, unchanged_on_error
from ..session import session, stored_recoveries
from ..session.card_place import show_card
from ..session.scene_job import SceneJob, make_job

_AFTER_SAVING = 0.1  # seconds until Blender has marked a file as saved


def draw_stored(layout, context) -> None:
    """Draw the recoveries that were not kept, each with buttons to restore and to delete it."""
    for stored in stored_recoveries.listed():
        box = layout.box()
        text = iface("A recovery of '{name}' was not kept ({part:.0%})", name=stored.name, part=stored.fraction)
        drawing.wrapped(box, context, text, "RECOVER_LAST")
        row = box.row(align=True)
        row.operator("irpso.restore", icon="LOOP_BACK").path = str(stored.path)
        row.operator("irpso.forget", icon="X").path = str(stored.path)


def restored_job(context, stored: stored_recoveries.StoredRecovery) -> SceneJob:
    """Return the job that continues a stored recovery. Sets the scene's settings to its own.

    Raises InputError; the settings then stay.
    """
    identity = glance(stored.path, {})
    try:
        with unchanged_on_error(context.scene.irpso):
            apply_recipe(context.scene.irpso, stored.recipe)
            return replace(make_job(context), entry=identity["entry"], resumed=stored.path)
    except InputError as error:
        where = f" (it was in {stored.file})" if stored.file and stored.file != bpy.data.filepath else ""
        raise InputError(f"{error}{where}") from error


class _OfStored:
    path: StringProperty(options={"SKIP_SAVE", "HIDDEN"})

    def _stored(self) -> stored_recoveries.StoredRecovery:
        stored = next((one for one in stored_recoveries.listed() if one.path == Path(self.path)), None)
        if stored is None:
            raise InputError("this recovery is no longer stored")
        return stored


class IRPSO_OT_restore(_OfStored, bpy.types.Operator):
    """Read the photographs again and continue this recovery. Its settings replace those of the scene"""

    bl_idname = "irpso.restore"
    bl_label = "Restore"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there is no other recovery."""
        return usable(cls, session.current() is None, "Another recovery is open: keep or discard it first")

    def execute(self, context):
        """Start the recovery, which pauses as soon as its stored state is loaded."""
        try:
            started = session.begin(restored_job(context, self._stored()))
        except IrpsoError as error:
            return failures.report_and_cancel(self, error)
        if not bpy.app.background:
            run_in_window(context, started)
        return {"FINISHED"}


class IRPSO_OT_forget(_OfStored, bpy.types.Operator):
    """Delete this stored recovery"""

    bl_idname = "irpso.forget"
    bl_label = "Delete"

    def execute(self, context):
        """Delete its checkpoint."""
        try:
            stored_recoveries.delete(self._stored().path)
        except IrpsoError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


def run_in_window(context, begun: session.Session) -> None:
    """Show a session's card, mark the file as changed, and run the session by the window's timer."""
    if begun.mesh is None:
        height, width = begun.job.capture.masks[0].shape
        show_card(context, begun.subject(), begun.job.place, height / width)
    mark_changed()
    bpy.ops.irpso.run("INVOKE_DEFAULT")


@failures.reported(n_("Marking the file as changed"))
def mark_changed() -> None:
    """Make Blender ask before it closes the file while a recovery is not kept.

    Scripts cannot mark a file as changed, but an undo step does.
    """
    running = session.current()
    if bpy.app.background or running is None or running.kept or bpy.data.is_dirty:
        return
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
        bpy.ops.ed.undo_push(message="Recover")


CLASSES = (IRPSO_OT_restore, IRPSO_OT_forget)


@persistent
def _on_save(*_: object) -> None:
    stored_recoveries.delete_saved()
    mark_saved()
    if not bpy.app.timers.is_registered(mark_changed):
        bpy.app.timers.register(mark_changed, first_interval=_AFTER_SAVING)


def register() -> None:
    """After each save, delete what is stored of kept recoveries, and mark the file as changed for one that is not."""
    bpy.app.handlers.save_post.append(_on_save)


def unregister() -> None:
    """Remove the handler and the timer."""
    bpy.app.handlers.save_post.remove(_on_save)
    if bpy.app.timers.is_registered(mark_changed):
        bpy.app.timers.unregister(mark_changed)
