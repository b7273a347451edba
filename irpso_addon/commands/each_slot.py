"""``recover --slots each``: the material slots of a mesh one after another, each with maps and material of its own."""

from __future__ import annotations

import re
from argparse import Namespace
from collections.abc import Callable
from typing import Any

import numpy as np

from ..blender.materials import material
from ..blender.mesh import extract_mesh
from ..blender.scenes.scene import mesh_object, open_blend
from ..core.errors import InputError
from ..core.files import write_json
from ..geometry.surface.slots import slot_names
from ..results.report import plain
from ..results.write import REPORT, check_output_folder
from .progress import unseen_reports

EACH = "each"
_UNFIT = re.compile(r"[^\w\- ]+")  # in the name of a folder


def recover_each(options: Namespace, blend: str | None, recover: Callable[[Namespace], dict], name: str) -> dict:
    """Recover every slot that has faces into a folder of its own, and return the reports by the slots' names.

    blend: the file with the mesh, which is opened here, once. recover: of one slot, in the file that is open, whose
    material it changes. name: of the file that holds all materials in the end, beside a report. Slots of one material
    are recovered together. Raises InputError before anything slow where a slot has no usable UV map.
    """
    folder = check_output_folder(options.output)
    if not blend:
        raise InputError("--slots are of a mesh, but no --blend FILE is given to find it in")
    if options.resume:
        raise InputError(f"--resume: of {EACH} slot; resume the one that was interrupted: --slots NAME -o OUT/NAME")
    with unseen_reports():
        open_blend(blend)
    subject = mesh_object(options.object)
    chosen = _slots_with_faces(subject)
    for slots in chosen.values():
        extract_mesh(subject, slots)
    reports: dict[str, Any] = {}
    for label, slots in chosen.items():
        one = {"slots": ",".join(map(str, slots)), "output": str(folder / label)}
        try:
            reports[label] = recover(Namespace(**{**vars(options), **one}))
        except InputError as error:
            raise InputError(f"slot '{label}': {error}") from error
    if options.dry_run:
        return {"slots": reports}
    result = {"texels": sum(report["texels"] for report in reports.values()), "slots": reports}
    with unseen_reports():
        material.save_blend(folder / name)
    write_json(folder / REPORT, plain(result))
    return {"output": str(folder), **result}


def _slots_with_faces(subject: Any) -> dict[str, tuple[int, ...]]:
    """Return name of a folder → the slots of one material. Raises InputError where there are no slots."""
    names = slot_names(subject)
    if not names:
        raise InputError(f"--slots {EACH}: object '{subject.name}' has no material slots; leave it away")
    used = np.zeros(len(subject.data.polygons), np.int32)
    subject.data.polygons.foreach_get("material_index", used)
    chosen: dict[str, list[int]] = {}
    folders: dict[str, str] = {}
    for slot in sorted(set(np.minimum(used, len(names) - 1).tolist())):
        if names[slot] not in folders:
            label = _UNFIT.sub("_", names[slot]).strip() or f"slot {slot}"
            # Two names may differ by case alone, or by what no folder can be called.
            taken = {other.lower() for other in folders.values()}
            folders[names[slot]] = label if label.lower() not in taken else f"{label} {slot}"
        chosen.setdefault(folders[names[slot]], []).append(slot)
    return {label: tuple(slots) for label, slots in chosen.items()}
