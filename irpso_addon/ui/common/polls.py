"""Buttons that are grey, and say why."""

from __future__ import annotations

import bpy


def usable(operator: type[bpy.types.Operator], there: object, otherwise: str) -> bool:
    """Return whether something is there; if not, the tooltip of the operator's grey button says what is missing."""
    if not there:
        operator.poll_message_set(otherwise)
    return bool(there)
