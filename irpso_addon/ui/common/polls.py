"""Poll helpers of operators: the tooltip of a disabled button says what is missing."""

from __future__ import annotations

import bpy

from .words import n_, tip

NO_CAPTURE = n_("No capture: find the lights of a folder of photographs, or import photographs with known lights")


def usable(operator: type[bpy.types.Operator], there: object, otherwise: str) -> bool:
    """Return whether ``there`` is true; if not, add ``otherwise`` to the tooltip of the operator's disabled button."""
    if not there:
        operator.poll_message_set(tip(otherwise))
    return bool(there)


def has_files(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Return whether the scene has a capture in files. The poll of operators that read its photographs."""
    settings = context.scene.irpso
    return usable(operator, settings.source == "FILES" and settings.capture_path, NO_CAPTURE)
