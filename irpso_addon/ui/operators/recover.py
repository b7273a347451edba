"""Operators that start, step, pause, resume, stop and cancel a recovery."""

import time

import bpy

from ...core.errors import IrpsoError
from ...gpu import context as gpu_context
from ...gpu import probe
from ...solver.planning.machine import SOFTWARE_VULKAN
from ..common import failures
from ..common.polls import usable
from ..common.words import n_, rpt, tip
from ..overlay import handlers
from ..properties import preferences
from ..properties.recipe import schedule_recipe
from ..properties.schedule_settings import schedule_of
from ..session import session, stored_recoveries
from ..session.scene_job import make_job, missing
from .restore import run_in_window

_TIMER_SECONDS = 1 / 60
_SLICE_SECONDS = 0.04  # work between events: 25 slices a second, half of the delay that users notice
_LONGEST_SLICE_SECONDS = 0.1  # longest work between events: users do not call this delay a stall


class IRPSO_OT_recover(bpy.types.Operator):
    """Recover the subject's maps from the capture, and show them while they converge. Esc pauses"""

    bl_idname = "irpso.recover"
    bl_label = "Recover"

    @classmethod
    def poll(cls, context):
        """Whether there is a capture, a subject and no unfinished recovery."""
        running = session.current()
        if running is not None and running.state != "done":
            return usable(cls, False, "Another recovery is not finished: stop or cancel it first")
        reason = missing(context)
        return usable(cls, not reason, reason)

    def execute(self, context):
        """Recover to the end and keep the result, for background mode and scripts."""
        try:
            if bpy.app.background:  # a window has a GPU context already, and a probe takes seconds
                probe.probe()
            session.begin(make_job(context)).run()
        except (IrpsoError, MemoryError) as error:
            return failures.report_and_cancel(self, error)
        return _keep(self)

    def invoke(self, context, event):
        """Start the recovery. The window stays responsive."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        try:
            started = session.begin(make_job(context))
        except IrpsoError as error:
            return failures.report_and_cancel(self, error)
        if gpu_context.on_software_vulkan():
            self.report({"WARNING"}, SOFTWARE_VULKAN)
        run_in_window(context, started)
        return {"FINISHED"}


class IRPSO_OT_run(bpy.types.Operator):
    """Run the current recovery in time slices until it pauses or ends"""

    bl_idname = "irpso.run"
    bl_label = "Run Recovery"
    bl_options = {"INTERNAL"}

    _timer = None
    _session = None
    _number = 0  # Session.runs at the start; the operator ends when a later one has started
    _draw_at = 0.0  # earliest time of the next redraw, by time.perf_counter
    _slice_end = 0.0  # when the last slice ended
    _drew = False  # whether the last slice ended with a redraw

    def invoke(self, context, event):
        """Start the timer."""
        self._session = session.current()
        if self._session is None or not self._session.active:
            return {"CANCELLED"}
        self._session.runs += 1
        self._number = self._session.runs
        manager = context.window_manager
        self._timer = manager.event_timer_add(_TIMER_SECONDS, window=context.window)
        manager.modal_handler_add(self)
        handlers.redraw()
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Work for one slice at each timer event. Esc pauses; Blender handles all other events."""
        with failures.reported(n_("The recovery's timer")):
            return self._handle(context, event)
        self._session.pause()
        return self._leave(context)

    def _handle(self, context, event):
        running = self._session
        if not self._is_current() or not running.active:
            return self._leave(context)
        if event.type == "ESC" and event.value == "PRESS":
            running.pause()
            self.report({"INFO"}, rpt("Paused: resume, stop or cancel in the IRPSO panel"))
            return self._leave(context)
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        now = time.perf_counter()
        if self._drew:  # the time since then went to drawing, which may take at most a third of all time
            self._draw_at = max(self._draw_at, now + 2 * (now - self._slice_end))
        # While images load, Blender redraws everything after each: a slice then takes as long as that drawing.
        drawing = now - self._slice_end if running.state == "loading" else 0.0
        running.tick(min(max(_SLICE_SECONDS, drawing), _LONGEST_SLICE_SECONDS))
        self._slice_end = time.perf_counter()
        # No redraws during preparation, which then ends earlier.
        self._drew = self._slice_end >= self._draw_at and running.state != "preparing"
        if self._drew:
            self._draw_at = self._slice_end + preferences.picture_seconds(context)
            handlers.redraw()
        return {"PASS_THROUGH"} if running.active else self._leave(context)

    def cancel(self, context):
        """Pause when the operator's window or file is closed. Another window can resume."""
        if self._is_current():
            self._session.pause()
        context.window_manager.event_timer_remove(self._timer)

    def _is_current(self) -> bool:
        return session.current() is self._session and self._session.runs == self._number

    def _leave(self, context):
        context.window_manager.event_timer_remove(self._timer)
        handlers.redraw()
        if self._session.failure:
            self.report({"ERROR"}, self._session.failure)
            return {"CANCELLED"}
        return {"FINISHED"}


class IRPSO_OT_pause(bpy.types.Operator):
    """Pause the recovery. Resume uses settings that are changed during the pause"""

    bl_idname = "irpso.pause"
    bl_label = "Pause"

    @classmethod
    def poll(cls, context):
        """Whether a recovery runs."""
        running = session.current()
        return usable(cls, running is not None and running.active, "No recovery is running: press Recover")

    def execute(self, context):
        """Pause."""
        session.current().pause()
        return {"FINISHED"}


class IRPSO_OT_resume(bpy.types.Operator):
    """Continue the recovery with the current settings"""

    bl_idname = "irpso.resume"
    bl_label = "Resume"

    @classmethod
    def poll(cls, context):
        """Whether a recovery is paused, or was stopped early."""
        running = session.current()
        there = running is not None and (running.state == "paused" or running.stopped)
        return usable(cls, there, "No recovery is paused or stopped early")

    def execute(self, context):
        """Continue with the current schedule of the scene in which the recovery was started."""
        running = session.current()
        scene = running.home_scene()
        try:
            if scene is None or running.restoring:  # a stored one opens paused; the next Resume takes changed settings
                running.resume()
            else:
                running.resume(schedule_of(scene.irpso.schedule))
                running.job.recipe["schedule"] = schedule_recipe(scene.irpso.schedule)
        except IrpsoError as error:
            return failures.report_and_cancel(self, error)
        if context.window is not None:
            bpy.ops.irpso.run("INVOKE_DEFAULT")
        return {"FINISHED"}


class IRPSO_OT_stop(bpy.types.Operator):
    """Stop, and keep the maps so far as the subject's material. Resume continues from here"""

    bl_idname = "irpso.stop"
    bl_label = "Stop"

    @classmethod
    def poll(cls, context):
        """Whether there are maps to keep."""
        running = session.current()
        return usable(cls, running is not None and running.recovery is not None, "There is no recovery: press Recover")

    def execute(self, context):
        """Keep the maps and end the recovery."""
        result = _keep(self)
        if result == {"FINISHED"}:
            running = session.current()
            running.finish()
            _continue_relighting(context, running)
        return result


class IRPSO_OT_cancel(bpy.types.Operator):
    """Discard the recovered maps. The scene stays as it was before Recover"""

    bl_idname = "irpso.cancel"
    bl_label = "Cancel"

    @classmethod
    def description(cls, context, properties):
        """Return the tooltip, which says whether a kept material stays."""
        running = session.current()
        if running is not None and running.kept:
            return tip("Close the recovery. The material that was kept stays")
        return tip(cls.bl_description)

    @classmethod
    def poll(cls, context):
        """Whether there is a recovery."""
        return usable(cls, session.current() is not None, "There is no recovery")

    def execute(self, context):
        """End the session and delete its stored checkpoint, unless it is not loaded yet or its maps are kept."""
        running = session.current()
        if not (running.kept or running.restoring):
            stored_recoveries.delete(running.job.resumed)
        session.end()
        handlers.redraw()
        return {"FINISHED"}


def _continue_relighting(context, running: session.Session) -> None:
    """Continue a relighting of held-out photographs: in time slices if there is a window, else to its end."""
    if not running.relighting:
        return
    if bpy.app.background or context.window is None:
        running.run()
    else:
        bpy.ops.irpso.run("INVOKE_DEFAULT")


def _keep(operator) -> set[str]:
    """Call the operator Keep. Its error, which Blender raises here, is reported as the caller's own."""
    try:
        return bpy.ops.irpso.keep("INVOKE_DEFAULT", True)  # True: one undo step, as if the user had pressed it
    except RuntimeError as error:
        operator.report({"ERROR"}, str(error).removeprefix("Error: ").strip())
        return {"CANCELLED"}


CLASSES = (IRPSO_OT_recover, IRPSO_OT_run, IRPSO_OT_pause, IRPSO_OT_resume, IRPSO_OT_stop, IRPSO_OT_cancel)
