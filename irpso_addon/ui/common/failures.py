"""Exceptions where no operator can report them (timers, threads, draw handlers, modal operators): told in the panel."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

import bpy
from bpy.app.handlers import persistent

from ...core.errors import IrpsoError
from . import drawing

# As errors of the engine call them, and as they are called in Blender.
_SETTINGS = {
    "--distance": "Card Distance",
    "--memory": "Memory Budget",
    "--resolution": "Resolution",
    "--slots": "Slots",
    "start without --resume": "forget it, and recover anew",
    "run without --resume": "forget it, and recover anew",
    "--resume": "Restore",
    "--skip-damaged": "Leave Out Damaged Images",
}

_log = logging.getLogger(__name__)
_said: list[str] = []  # what the panel shows, until it is dismissed or something is begun anew


def words(error: Exception) -> str:
    """Return what an IrpsoError or a MemoryError says, in one line, with settings called as they are in Blender."""
    text = " ".join(str(error).splitlines()) or "memory is full; choose a smaller resolution"
    for option, setting in _SETTINGS.items():
        text = text.replace(option, setting)
    return text


@contextmanager
def told(doing: str) -> Iterator[None]:
    """Do some work, or as a decorator call a function; an exception goes into the panel and no further.

    doing: what the exception ends, as in "The check". A decorated function then returns None, which ends a timer.
    """
    try:
        yield
    except Exception as error:  # noqa: BLE001  Blender would print it and call again, at every event or redraw
        tell(doing, error)


def tell(doing: str, error: Exception) -> str:
    """Put an exception into the panel, once however often it is raised, and return what it says there."""
    if isinstance(error, IrpsoError | MemoryError):
        text, expected = words(error), True
    else:
        what = " ".join(str(error).split()) or type(error).__name__
        text, expected = f"{doing} has ended: {what}", False
    if text not in _said:
        _said.append(text)
        if not expected:
            _log.error(text, exc_info=error)
        drawing.redraw_sidebars()
    return text


def said() -> tuple[str, ...]:
    """Return what the panel shows."""
    return tuple(_said)


def clear() -> None:
    """Show nothing any longer: it was read, or something is begun anew."""
    _said.clear()


def draw(layout, context) -> None:
    """Draw what has failed, and the button that takes it away."""
    for text in _said:
        row = layout.row()
        row.alert = True
        drawing.wrapped(row, context, text, "CANCEL")
    layout.operator(DismissFailures.bl_idname, icon="X")


class DismissFailures(bpy.types.Operator):
    """Take the message away; Blender's system console keeps what led to it"""

    bl_idname = "irpso.dismiss_failures"
    bl_label = "Dismiss"
    bl_options = {"INTERNAL"}

    def execute(self, context):
        """Dismiss."""
        clear()
        return {"FINISHED"}


CLASSES = (DismissFailures,)


@persistent
def _on_load(*_: object) -> None:
    clear()


def register() -> None:
    """Watch for another file being loaded."""
    bpy.app.handlers.load_pre.append(_on_load)


def unregister() -> None:
    """Stop watching."""
    bpy.app.handlers.load_pre.remove(_on_load)
    clear()
