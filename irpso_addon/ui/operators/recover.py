"""Recover: the modal operator that steps the session, and what pauses, resumes, stops and cancels it."""

import time

import bpy

from ...core.errors import IrpsoError
from ...gpu import context as gpu_context
from ...gpu import probe
from ...solver.planning.machine import SOFTWARE_VULKAN
from ..common import failures
from ..properties import preferences
from ..properties.recipe import schedule_asked
from ..properties.schedule_settings import schedule_of
from ..session import session, unkept
from ..session.job import make_job, missing
from .restore import follow

_TIMER_SECONDS = 1 / 60
_SLICE_SECONDS = 0.04  # of work between two looks at the user's events: 25 a second, and half of the stall that is felt
_LONGEST_SLICE_SECONDS = 0.1  # what nobody calls a stall yet


class IRPSO_OT_recover(bpy.types.Operator):
    """Recover the maps of the subject from the capture, and watch them converge. Esc pauses"""

    bl_idname = "irpso.recover"
    bl_label = "Recover"

    @classmethod
    def poll(cls, context):
        """Whether there is a capture, a subject, and nothing under way."""
        running = session.current()
        if running is not None and running.state != "done":
            cls.poll_message_set("A recovery is under way: stop or cancel it first")
            return False
        if text := missing(context):
            cls.poll_message_set(text)
            return False
        return True

    def execute(self, context):
        """Recover to the end and keep the result: what background mode and scripts want."""
        try:
            if bpy.app.background:  # in a window Blender has a context, and a probe would take seconds
                probe.probe()
            session.begin(make_job(context)).run()
        except (IrpsoError, MemoryError) as error:
            session.end()
            self.report({"ERROR"}, failures.words(error))
            return {"CANCELLED"}
        return _keep(self)

    def invoke(self, context, event):
        """Begin, and leave the window to its user meanwhile."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        try:
            begun = session.begin(make_job(context))
        except IrpsoError as error:
            self.report({"ERROR"}, failures.words(error))
            return {"CANCELLED"}
        if gpu_context.on_software_vulkan():
            self.report({"WARNING"}, SOFTWARE_VULKAN)
        follow(context, begun)
        return {"FINISHED"}


class IRPSO_OT_run(bpy.types.Operator):
    """Step the recovery that is under way, slice by slice, until it rests or ends"""

    bl_idname = "irpso.run"
    bl_label = "Run Recovery"
    bl_options = {"INTERNAL"}

    _timer = None
    _session = None
    _number = 0  # of the session's runs: one that was resumed by another in between leaves
    _draw_at = 0.0  # when the next picture is due
    _returned = 0.0  # when the last slice ended
    _drew = False  # whether a picture was asked for then

    def invoke(self, context, event):
        """Go on from timer to timer."""
        self._session = session.current()
        if self._session is None or not self._session.active:
            return {"CANCELLED"}
        self._session.runs += 1
        self._number = self._session.runs
        manager = context.window_manager
        self._timer = manager.event_timer_add(_TIMER_SECONDS, window=context.window)
        manager.modal_handler_add(self)
        _redraw(context)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Work for one slice at a time; everything but Esc goes on to Blender."""
        with failures.told("The recovery's timer"):
            return self._heed(context, event)
        self._session.pause()
        return self._leave(context)

    def _heed(self, context, event):
        running = self._session
        if not self._is_on() or not running.active:
            return self._leave(context)
        if event.type == "ESC" and event.value == "PRESS":
            running.pause()
            self.report({"INFO"}, "Paused: resume, stop or cancel in the IRPSO panel")
            return self._leave(context)
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        now = time.perf_counter()
        if self._drew:  # what came in between was the drawing: it may take a third of the time, and no more
            self._draw_at = max(self._draw_at, now + 2 * (now - self._returned))
        # Blender draws all it shows whenever an image is loaded, asked or not: then work as long as that takes.
        drawing = now - self._returned if running.state == "loading" else 0.0
        running.tick(min(max(_SLICE_SECONDS, drawing), _LONGEST_SLICE_SECONDS))
        self._returned = time.perf_counter()
        # A first guess is found the sooner the less else is done.
        self._drew = self._returned >= self._draw_at and running.state != "preparing"
        if self._drew:
            self._draw_at = self._returned + preferences.picture_seconds(context)
            _redraw(context)
        return {"PASS_THROUGH"} if running.active else self._leave(context)

    def cancel(self, context):
        """Rest when the window that it ran in is closed: nothing is lost, another one can resume."""
        if self._is_on():
            self._session.pause()

    def _is_on(self) -> bool:
        return session.current() is self._session and self._session.runs == self._number

    def _leave(self, context):
        context.window_manager.event_timer_remove(self._timer)
        _redraw(context)
        if self._session.failure:
            self.report({"ERROR"}, self._session.failure)
            return {"CANCELLED"}
        return {"FINISHED"}


class IRPSO_OT_pause(bpy.types.Operator):
    """Rest; settings can be changed meanwhile, and are heeded on resuming"""

    bl_idname = "irpso.pause"
    bl_label = "Pause"

    @classmethod
    def poll(cls, context):
        """Whether a recovery runs."""
        running = session.current()
        if running is None or not running.active:
            cls.poll_message_set("No recovery is running: press Recover")
            return False
        return True

    def execute(self, context):
        """Pause."""
        session.current().pause()
        return {"FINISHED"}


class IRPSO_OT_resume(bpy.types.Operator):
    """Go on with the recovery, heeding settings that were changed"""

    bl_idname = "irpso.resume"
    bl_label = "Resume"

    @classmethod
    def poll(cls, context):
        """Whether a recovery is paused, or was stopped early."""
        running = session.current()
        if running is None or not (running.state == "paused" or running.stopped):
            cls.poll_message_set("No recovery is paused or stopped early")
            return False
        return True

    def execute(self, context):
        """Go on, with the schedule as it is set now in the scene that it was begun in."""
        running = session.current()
        scenes = {scene.session_uid: scene for scene in bpy.data.scenes}
        scene = scenes.get(running.job.scene_uid, context.scene)
        try:
            running.resume(schedule_of(scene.irpso.schedule))
            running.job.asked["schedule"] = schedule_asked(scene.irpso.schedule)
        except IrpsoError as error:
            self.report({"ERROR"}, failures.words(error))
            return {"CANCELLED"}
        if context.window is not None:
            bpy.ops.irpso.run("INVOKE_DEFAULT")
        return {"FINISHED"}


class IRPSO_OT_stop(bpy.types.Operator):
    """Stop here and keep what has been found as the subject's material. Resume goes on from here"""

    bl_idname = "irpso.stop"
    bl_label = "Stop"

    @classmethod
    def poll(cls, context):
        """Whether something has been found."""
        running = session.current()
        if running is None or running.recovery is None:
            cls.poll_message_set("No recovery is under way: press Recover")
            return False
        return True

    def execute(self, context):
        """Keep, and end."""
        done = _keep(self)
        if done == {"FINISHED"}:
            running = session.current()
            running.finish()
            _go_on_relighting(context, running)
        return done


class IRPSO_OT_cancel(bpy.types.Operator):
    """Drop what has been found; the scene stays as it was before Recover"""

    bl_idname = "irpso.cancel"
    bl_label = "Cancel"

    @classmethod
    def description(cls, context, properties):
        """Say what is dropped, and what is not once it has been kept."""
        running = session.current()
        if running is not None and running.kept:
            return "Let go of the recovery; the material that was kept stays"
        return cls.__doc__

    @classmethod
    def poll(cls, context):
        """Whether there is anything to drop."""
        if session.current() is None:
            cls.poll_message_set("No recovery is under way")
            return False
        return True

    def execute(self, context):
        """Drop the session, and what is stored of it."""
        unkept.forget(session.current().job.resumed)
        session.end()
        _redraw(context)
        return {"FINISHED"}


def _go_on_relighting(context, running: session.Session) -> None:
    """Have the photographs held out relit, where that has begun: in a window slice by slice, else at once."""
    if not running.relighting:
        return
    if bpy.app.background or context.window is None:
        running.run()
    else:
        bpy.ops.irpso.run("INVOKE_DEFAULT")


def _keep(operator) -> set[str]:
    """Keep, and report what keeps that from being done as the operator's own error: Blender raises it here."""
    try:
        return bpy.ops.irpso.keep("INVOKE_DEFAULT", True)  # True: one step to undo, as if pressed itself
    except RuntimeError as error:
        operator.report({"ERROR"}, str(error).removeprefix("Error: ").strip())
        return {"CANCELLED"}


def _redraw(context) -> None:
    """Have the editors drawn anew that show the recovery, in every window."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in ("VIEW_3D", "IMAGE_EDITOR"):
                area.tag_redraw()


CLASSES = (IRPSO_OT_recover, IRPSO_OT_run, IRPSO_OT_pause, IRPSO_OT_resume, IRPSO_OT_stop, IRPSO_OT_cancel)
