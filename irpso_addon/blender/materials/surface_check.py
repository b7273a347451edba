"""Check that an object still has the material slots and the UV map of its recovery."""

from __future__ import annotations

from typing import Any

from ...core.errors import InputError
from ...geometry.surface.mesh import MeshData
from ...geometry.surface.slots import listed, slot_names
from .material import TAG


def check_surface(obj: Any, mesh: MeshData, subject: str) -> None:
    """Raise InputError where an object has other slots than when its mesh was read, or lacks the maps' UV map.

    Materials tell whether slots have moved: one that lies elsewhere now, unless the material of ``subject``, the maps'
    own, is in its place. A last slot that no face had may be gone.
    """
    import bpy

    before, slots, now = mesh.slots, obj.material_slots, slot_names(obj)
    own = [slot.material is not None and slot.material.get(TAG) == subject for slot in slots]
    kept = {slot for slot, names in enumerate(zip(before, now, strict=False)) if names[0] == names[1]}
    gone, new = ({name for slot, name in enumerate(names) if slot not in kept} for names in (before, now))
    changed = [slot for slot in mesh.solved_slots if slot < min(len(before), len(now)) and slot not in kept]
    moved = any(not own[slot] and (before[slot] in new or now[slot] in gone) for slot in changed)
    lost = len(now) < len(before) and mesh.materials.max(initial=0) >= len(now)
    if moved or lost:
        raise InputError(
            f"the material slots of '{obj.name}' were {listed(before)} when its recovery began, and are"
            f" {listed(now) or 'none'} now; restore their order, or recover again"
        )
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    layers = {layer.name for data in (obj.data, evaluated.data) for layer in data.uv_layers}
    if mesh.uv_map not in layers:
        raise InputError(
            f"'{obj.name}' has no UV map '{mesh.uv_map}' any more, in which its maps were recovered; give it"
            " this name again, or recover again"
        )
