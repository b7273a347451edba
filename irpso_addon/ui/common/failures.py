"""Messages in the panel about exceptions in timers, threads, draw handlers and modal operators."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType

import bpy
from bpy.app.handlers import persistent

from ...core.errors import IrpsoError
from . import drawing
from .words import iface

# Options in error messages → what the user sets or does in Blender.
_SETTINGS = {
    "--refine-directions (Refine Lights)": "Refine Lights",
    "--fixed: ": "Maps: ",
    "--distance": "Card Distance",
    "--memory": "Memory Budget",
    "--card-width (Card Width)": "Card Width",
    "--card-width": "Card Width",
    "--intensities estimate": "Light Strengths: Estimate",
    "irpso develop --dark": "Develop, with Dark Frames",
    "irpso develop --register": "the command line (irpso develop --register)",  # Develop cannot
    "--intensities given (Light Strengths)": "Light Strengths: As Given",
    "--colour-space srgb (Color Space)": "Color Space: sRGB",
    "--colour-space linear (Color Space)": "Color Space: Linear",
    "--entry fragment (Passes, in the preferences)": "Passes: Fragment, in the preferences",
    "--entry compute (Passes, in the preferences)": "Passes: Compute, in the preferences",
    "--resolution": "Resolution",
    "--slots": "Slots",
    "start without --resume": "delete it, and recover anew",
    "run without --resume": "delete it, and recover anew",
    "leave out --resume": "delete it",
    "--resume": "Restore",
    "--object and the cameras": "the chosen Object and the cameras",
    "fix some (--fixed)": "fix some, under Maps",
    "give them: --corners X1,Y1,…,X4,Y4, or mark them in the window": "use Mark in Photograph",
    "--skip-damaged": "Leave Out Damaged Images",
    "recover with --set interreflection_rounds=0": "switch Interreflection off",
    "a smaller --scale": "a smaller Scale",
    "choose gltf (--format gltf)": "choose the format glTF",
}

_log = logging.getLogger(__name__)
_messages: list[str] = []  # the panel's messages, until the user dismisses them or starts a recovery


def message_of(error: Exception, names: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return the error's message in one line, with Blender's names for options. names: a dialog's, which come first."""
    text = " ".join(str(error).splitlines()) or "memory is full; choose a smaller resolution"
    for option, setting in (*names.items(), *_SETTINGS.items()):
        text = text.replace(option, setting)
    return text


def report_and_cancel(
    operator: bpy.types.Operator, error: Exception, names: Mapping[str, str] = MappingProxyType({})
) -> set[str]:
    """Report an IrpsoError or a MemoryError of an operator; return {"CANCELLED"}. names: see ``message_of``."""
    operator.report({"ERROR"}, message_of(error, names))
    return {"CANCELLED"}


@contextmanager
def reported(doing: str) -> Iterator[None]:
    """Context manager and decorator: catch an exception and show it in the panel.

    doing: the name of the work, as in "The check". After an exception a decorated function returns None, which ends a
    timer.
    """
    try:
        yield
    except Exception as error:  # noqa: BLE001  Blender would print it at every event or redraw, and call again
        report(doing, error)


def report(doing: str, error: Exception, names: Mapping[str, str] = MappingProxyType({})) -> str:
    """Show an exception in the panel, once even if it repeats, and return its text. names: see ``message_of``."""
    if isinstance(error, IrpsoError | MemoryError):
        text, expected = message_of(error, names), True
    else:
        message = " ".join(str(error).split()) or type(error).__name__
        text, expected = iface("{doing} has ended: {what}", doing=iface(doing), what=message), False
    if text not in _messages:
        _messages.append(text)
        if not expected:
            _log.error(text, exc_info=error)
        drawing.redraw_sidebars()
    return text


def messages() -> tuple[str, ...]:
    """Return the messages in the panel."""
    return tuple(_messages)


def clear() -> None:
    """Remove all messages."""
    _messages.clear()


def draw(layout, context) -> None:
    """Draw the messages and the button that dismisses them."""
    for text in _messages:
        row = layout.row()
        row.alert = True
        drawing.wrapped(row, context, text[:1].upper() + text[1:], "CANCEL")
    layout.operator(DismissFailures.bl_idname, icon="X")


class DismissFailures(bpy.types.Operator):
    """Remove the message. Blender's system console keeps the details"""

    bl_idname = "irpso.dismiss_failures"
    bl_label = "Dismiss"
    bl_options = {"INTERNAL"}

    def execute(self, context):
        """Remove all messages."""
        clear()
        return {"FINISHED"}


CLASSES = (DismissFailures,)


@persistent
def _on_load(*_: object) -> None:
    clear()


def register() -> None:
    """Clear the messages when another file is loaded."""
    bpy.app.handlers.load_pre.append(_on_load)


def unregister() -> None:
    """Remove the handler and the messages."""
    bpy.app.handlers.load_pre.remove(_on_load)
    clear()
