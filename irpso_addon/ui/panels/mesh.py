"""Rows of the mesh settings, for the panel Subject and for dialogs."""

from __future__ import annotations

from ..common.words import iface
from ..session.scene_job import subject_object


def draw_mesh(column, context) -> None:
    """Draw the settings of object, material slots and occluders. column: a layout that splits properties."""
    settings = context.scene.irpso
    column.prop(settings, "object")
    if settings.object is None and (active := subject_object(context)) is not None:
        column.label(text=iface("Active: {name}", name=active.name), icon="OBJECT_DATA", translate=False)
    chosen = subject_object(context)
    if chosen is not None and len(chosen.material_slots) > 1:
        column.prop(settings, "slots")
        if settings.slots == "ACTIVE" and (material := chosen.active_material) is not None:
            column.label(text=iface("Active: {name}", name=material.name), icon="MATERIAL", translate=False)
        if settings.slots == "NAMED":
            column.prop(settings, "slot_list", text="Names")
    column.prop(settings, "occluders")
