"""Buttons that are grey, and say why."""

from __future__ import annotations

import bpy

from .words import n_, tip

NO_CAPTURE = n_("No capture: find the lights of a folder of photographs, or import photographs with known lights")


def usable(operator: type[bpy.types.Operator], there: object, otherwise: str) -> bool:
    """Return whether something is there; if not, the tooltip of the operator's grey button says what is missing."""
    if not there:
        operator.poll_message_set(tip(otherwise))
    return bool(there)


def has_files(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Return whether the scene's capture is photographs in files; the poll of what works on these."""
    settings = context.scene.irpso
    return usable(operator, settings.source == "FILES" and settings.capture_path, NO_CAPTURE)
