"""Checks that an object still has the material slots, the UV map and its coordinates of its recovery."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from ...core.errors import InputError
from ...geometry.surface.mesh import MeshData
from ...geometry.surface.slots import listed, slot_names
from ...geometry.surface.udim import lay_out
from ..mesh import new_evaluated_mesh, read_attribute
from .material import TAG

_MOVED = 1e-6  # of a UDIM tile


def check_surface(obj: Any, mesh: MeshData, subject: str) -> None:
    """Raise InputError where an object has other slots than when its mesh was read, or lacks the maps' UV map.

    Materials tell whether slots have moved: one that lies elsewhere now, unless the material of ``subject``, the maps'
    own, is in its place. Slots without materials, or of one material, have moved where no face of a recovered one is in
    a recovered slot any more, or all faces of another one are. A last slot that no face had may be gone.
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
    if (left := _left_slot(obj, mesh)) is not None:
        raise InputError(
            f"all faces of material slot {left} '{mesh.slots[left]}' of '{obj.name}' have another slot since its"
            " recovery began; restore the slots' order, or recover again"
        )
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    layers = {layer.name for data in (obj.data, evaluated.data) for layer in data.uv_layers}
    if mesh.uv_map not in layers:
        raise InputError(
            f"'{obj.name}' has no UV map '{mesh.uv_map}' any more, in which its maps were recovered; give it"
            " this name again, or recover again"
        )


def uv_warnings(obj: Any, mesh: MeshData) -> list[str]:
    """Return a warning where the UV map of an object has moved since its mesh was read: the maps no longer fit.

    Nothing is known of a mesh with more or fewer triangles, or without that UV map, as a new modifier makes them.
    """
    uvs = _uvs(obj, mesh.uv_map)
    if uvs is None or uvs.shape != mesh.uvs.shape:
        return []
    chosen = slice(None) if mesh.solved is None else mesh.solved
    try:
        tiles, placed = lay_out(obj.name, uvs[chosen])
    except InputError:
        tiles = ()
    if tiles == mesh.tiles and np.abs(placed - mesh.uvs[chosen]).max(initial=0) <= _MOVED:
        return []
    return [
        f"the UV map '{mesh.uv_map}' of '{obj.name}' has changed since its maps were recovered, which no longer fit it;"
        " undo that and keep again, or recover again"
    ]


def _left_slot(obj: Any, mesh: MeshData) -> int | None:
    """Return a slot, from 0, whose triangles have all left the recovered slots, or come into them; None without.

    None also of a mesh that had no slots, and of one with more or fewer triangles, as a new modifier makes them.
    """
    with _triangulated(obj) as data:
        count = len(data.loop_triangles)
        if count != len(mesh.materials):
            return None
        now = read_attribute(data.loop_triangles, "material_index", count, np.int32)
    now = np.minimum(now, max(len(obj.material_slots) - 1, 0))  # as extract_mesh
    solved = np.isin(now, mesh.solved_slots)
    others = sorted(set(mesh.materials.tolist()) - set(mesh.solved_slots))
    moved = (
        *(slot for slot in mesh.solved_slots if not solved[mesh.materials == slot].any()),
        *(slot for slot in others if solved[mesh.materials == slot].all()),
    )
    return moved[0] if mesh.slots and moved else None


def _uvs(obj: Any, uv_map: str) -> np.ndarray | None:
    """Return (T, 3, 2) texture coordinates of an object's triangles, as ``extract_mesh`` reads them; None without."""
    with _triangulated(obj) as mesh:
        layer = mesh.uv_layers.get(uv_map)
        if layer is None:
            return None
        loops = read_attribute(mesh.loop_triangles, "loops", 3 * len(mesh.loop_triangles), np.int32)
        return read_attribute(layer.uv, "vector", 2 * len(mesh.loops)).reshape(-1, 2)[loops].reshape(-1, 3, 2)


@contextmanager
def _triangulated(obj: Any) -> Iterator[Any]:
    """Yield the evaluated mesh of an object, with its triangles, and remove it."""
    import bpy

    mesh = new_evaluated_mesh(obj)
    try:
        mesh.calc_loop_triangles()
        yield mesh
    finally:
        bpy.data.meshes.remove(mesh)
