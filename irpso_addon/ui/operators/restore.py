"""Going on from a recovery that was not kept when its file was closed; and having Blender ask before it closes one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
from bpy.app.handlers import persistent
from bpy.props import StringProperty

from ...core.errors import InputError, IrpsoError
from ...solver.state.checkpoint import glance
from ..common import drawing, failures
from ..properties.recipe import ask_again
from ..session import session, unkept
from ..session.card_place import show_card
from ..session.job import SceneJob, make_job

_AFTER_SAVING = 0.1  # seconds until Blender has marked a file as saved


def draw_unkept(layout, context) -> None:
    """Draw what was not kept, with the two things that can be done with it."""
    for found in unkept.listed():
        box = layout.box()
        drawing.wrapped(
            box, context, f"A recovery of '{found.name}' was not kept ({found.fraction:.0%})", "RECOVER_LAST"
        )
        row = box.row(align=True)
        row.operator("irpso.restore", icon="LOOP_BACK").path = str(found.path)
        row.operator("irpso.forget", icon="X").path = str(found.path)


def restored_job(context, found: unkept.Unkept) -> SceneJob:
    """Return the job that goes on from a stored recovery, the scene's settings set to its own. Raises InputError."""
    identity = glance(found.path, {})
    try:
        ask_again(context.scene.irpso, found.asked)
        return replace(make_job(context), entry=identity["entry"], resumed=found.path)
    except InputError as error:
        where = f" (it was in {found.file})" if found.file and found.file != bpy.data.filepath else ""
        raise InputError(f"{error}{where}") from error


class _OfOne:
    path: StringProperty(options={"SKIP_SAVE", "HIDDEN"})

    def _found(self) -> unkept.Unkept:
        found = next((one for one in unkept.listed() if one.path == Path(self.path)), None)
        if found is None:
            raise InputError("this recovery is stored no longer")
        return found


class IRPSO_OT_restore(_OfOne, bpy.types.Operator):
    """Read the photographs again and go on from where the recovery was; its settings replace the scene's"""

    bl_idname = "irpso.restore"
    bl_label = "Restore"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there is no other recovery."""
        if session.current() is not None:
            cls.poll_message_set("There is another recovery: keep or discard it first")
            return False
        return True

    def execute(self, context):
        """Begin; the panel shows how far it is, and when it rests where it was."""
        try:
            begun = session.begin(restored_job(context, self._found()))
        except IrpsoError as error:
            self.report({"ERROR"}, failures.words(error))
            return {"CANCELLED"}
        if not bpy.app.background:
            follow(context, begun)
        return {"FINISHED"}


class IRPSO_OT_forget(_OfOne, bpy.types.Operator):
    """Delete what is stored of this recovery"""

    bl_idname = "irpso.forget"
    bl_label = "Forget"

    def execute(self, context):
        """Delete it."""
        try:
            unkept.forget(self._found().path)
        except IrpsoError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


def follow(context, begun: session.Session) -> None:
    """Have a session stepped by the window's timer, seen, and asked for before the file is closed."""
    if begun.mesh is None:
        height, width = begun.job.capture.masks[0].shape
        show_card(context, begun.subject(), begun.job.place, height / width)
    mark_changed()
    bpy.ops.irpso.run("INVOKE_DEFAULT")


@failures.told("Marking the file as changed")
def mark_changed() -> None:
    """Have Blender ask before it closes the file, as long as there is a recovery that is not kept.

    Scripts cannot mark a file as changed; a step to undo does.
    """
    running = session.current()
    if bpy.app.background or running is None or running.kept or bpy.data.is_dirty:
        return
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
        bpy.ops.ed.undo_push(message="Recover")


CLASSES = (IRPSO_OT_restore, IRPSO_OT_forget)


@persistent
def _on_save(*_: object) -> None:
    if not bpy.app.timers.is_registered(mark_changed):
        bpy.app.timers.register(mark_changed, first_interval=_AFTER_SAVING)


def register() -> None:
    """Watch for the file being saved: the recovery is not saved with it."""
    bpy.app.handlers.save_post.append(_on_save)


def unregister() -> None:
    """Stop watching."""
    bpy.app.handlers.save_post.remove(_on_save)
    if bpy.app.timers.is_registered(mark_changed):
        bpy.app.timers.unregister(mark_changed)
