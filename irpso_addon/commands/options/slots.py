"""``--slots each``: the material slots of a mesh, grouped by material."""

from __future__ import annotations

import re
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np

from ...blender.mesh import extract_mesh
from ...blender.scenes.scene import mesh_object, open_blend
from ...core.errors import InputError
from ...geometry.surface.slots import slot_names
from ...pipeline.drive import CHECKPOINT
from ...results.write import check_output_folder, check_replaces_no_maps
from ...solver.state.checkpoint import check_replaceable

EACH = "each"
_UNFIT = re.compile(r"[^\w\- ]+")  # not in a folder's name


def open_slots(options: Namespace, blend: str | None) -> tuple[Path, dict[str, tuple[int, ...]]]:
    """Open the file with the mesh; return the output folder, and subfolder name → the slots of one material.

    Raises InputError if a slot has no usable UV map, there are no slots, or a file of others would be replaced.
    """
    folder = check_output_folder(options.output)
    check_replaces_no_maps(folder)
    if not blend:
        raise InputError("--slots is for meshes: give --blend FILE")
    if options.resume:
        raise InputError("--resume: resume only the interrupted slot: --slots NAME -o OUT/NAME")
    open_blend(blend)
    subject = mesh_object(options.object)
    chosen = _slots_with_faces(subject)
    for label, slots in chosen.items():
        extract_mesh(subject, slots)
        check_replaceable(folder / label / CHECKPOINT)
    return folder, chosen


def _slots_with_faces(subject: Any) -> dict[str, tuple[int, ...]]:
    """Return folder name → the slots of one material. Raises InputError if there are no slots."""
    names = slot_names(subject)
    if not names:
        raise InputError(f"--slots {EACH}: object '{subject.name}' has no material slots; omit it")
    used = np.zeros(len(subject.data.polygons), np.int32)
    subject.data.polygons.foreach_get("material_index", used)
    chosen: dict[str, list[int]] = {}
    folders: dict[str, str] = {}
    for slot in sorted(set(np.minimum(used, len(names) - 1).tolist())):
        if names[slot] not in folders:
            label = _UNFIT.sub("_", names[slot]).strip() or f"slot {slot}"
            # Names may differ only by case, or by characters that folders cannot have.
            taken = {other.lower() for other in folders.values()}
            folders[names[slot]] = label if label.lower() not in taken else f"{label} {slot}"
        chosen.setdefault(folders[names[slot]], []).append(slot)
    return {label: tuple(slots) for label, slots in chosen.items()}
