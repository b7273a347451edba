"""Modal operators that work in time slices, so that the window stays responsive."""

from __future__ import annotations

import math
import time
from collections.abc import Generator, Mapping
from types import MappingProxyType
from typing import Any

import bpy

from ...core.errors import InputError
from ...core.optional import present
from . import failures
from .words import iface, rpt

_SLICE_SECONDS, _TIMER_SECONDS = 0.2, 0.02  # duration of a slice of work; interval of the timer events that start one


class SlicedOperator:
    """Base of a ``bpy.types.Operator`` whose ``execute`` calls ``begin``.

    doing: name of the work, for the status bar and messages. names: option in messages → its name in the dialog. A
    subclass defines ``finished``.
    """

    doing = ""
    names: Mapping[str, str] = MappingProxyType({})
    of_capture = True  # whether ``finished`` changes the capture for which the work began
    _steps: Generator[float, None, Any] | None = None
    _timer: Any = None
    _for: tuple[int, str] = (0, "")  # the scene and its capture when the work began

    def begin(self, context, steps: Generator[float, None, Any]) -> set[str]:
        """Run all steps, which yield the finished fraction (0…1) and return the argument of ``finished``.

        In a window they run in time slices, with the progress in the status bar; Esc cancels.
        """
        self._steps, self._for = steps, _capture_in(context)
        failures.clear()
        context.window_manager.progress_begin(0, 1)
        if not bpy.app.background and context.window is not None:
            self._timer = context.window_manager.event_timer_add(_TIMER_SECONDS, window=context.window)
            context.window_manager.modal_handler_add(self)
            return {"RUNNING_MODAL"}
        return self._slice(context, math.inf) or {"CANCELLED"}

    def finished(self, context, result: Any) -> set[str]:
        """Use the steps' return value; return the operator's result, as ``execute`` does."""
        raise NotImplementedError

    def unused(self, result: Any) -> str:
        """Return the message in place of ``finished`` if the capture has changed. result: begins with the new path."""
        return rpt("{path} is written, but not imported: another capture was chosen meanwhile", path=result[0])

    def modal(self, context, event):
        """Work for one slice at each timer event."""
        if event.type == "ESC" and event.value == "PRESS":
            return self._leave(context, {"CANCELLED"})
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        with failures.reported(self.doing):
            return self._slice(context, _SLICE_SECONDS) or {"RUNNING_MODAL"}
        return self._leave(context, {"CANCELLED"})

    def cancel(self, context):
        """Stop because the window or the file is closed."""
        self._leave(context, {"CANCELLED"})

    def _slice(self, context, seconds: float) -> set[str] | None:
        """Run steps for about ``seconds``; return the operator's result, None while steps are left."""
        started = time.perf_counter()
        try:
            while True:
                fraction = next(present(self._steps))
                context.window_manager.progress_update(fraction)
                if time.perf_counter() - started >= seconds:
                    break
        except StopIteration as end:
            self._leave(context, set())
            if not self.of_capture or _capture_in(context) == self._for:
                return self.finished(context, end.value)
            self.report({"WARNING"}, self.unused(end.value))
            return {"FINISHED"}
        except InputError as error:
            if self._timer is not None:  # the report's popup closes when the mouse moves
                failures.report(self.doing, error, self.names)
            self._leave(context, set())
            return failures.report_and_cancel(self, error, self.names)
        if self._timer is not None:
            context.workspace.status_text_set(
                iface("{doing}: {part:.0%}. Esc cancels", doing=iface(self.doing), part=fraction)
            )
        return None

    def _leave(self, context, result: set[str]) -> set[str]:
        """Close the steps, timer and progress; return ``result``."""
        if self._steps is not None:
            self._steps.close()
            self._steps = None
            context.window_manager.progress_end()
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
            if context.workspace is not None:
                context.workspace.status_text_set(None)
        return result


def _capture_in(context) -> tuple[int, str]:
    return context.scene.session_uid, bpy.path.abspath(context.scene.irpso.capture_path)
