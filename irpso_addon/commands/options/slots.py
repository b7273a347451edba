"""``--slots each``: the material slots of a mesh, grouped by material."""

from __future__ import annotations

import re
from argparse import Namespace
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ...blender.materials.material import slots_subject
from ...blender.mesh import extract_mesh
from ...blender.scenes.scene import mesh_object, open_blend
from ...core.errors import InputError
from ...core.interrupt import delayed_signals
from ...exports.asset import write_to_shelf
from ...geometry.surface.slots import slot_names
from ...pipeline.drive import CHECKPOINT
from ...results.write import check_output_folder, check_replaces_no_maps
from ...solver.state.checkpoint import check_replaceable
from .values import shelf_of

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


def asset_names(options: Namespace, chosen: dict[str, tuple[int, ...]]) -> dict[str, str]:
    """Return folder name → the asset's name, of the slots of the open file; nothing without --asset.

    Raises InputError, with the slot, where the library has an asset already, or two would be one file.
    """
    if options.asset is None:
        return {}
    subject, shelf = mesh_object(options.object), shelf_of(options, options.asset)
    names: dict[str, str] = {}
    taken: dict[str, str] = {}
    for label, slots in chosen.items():
        names[label] = f"{options.asset_name} {label}" if options.asset_name else slots_subject(subject, slots)
        try:
            path = shelf.path(names[label])
        except InputError as error:
            raise InputError(f"slot '{label}': {error}") from error
        other = taken.setdefault(str(path).lower(), label)
        if other != label:
            raise InputError(f"slot '{label}': its asset would have the file of '{other}', {path}; rename its material")
    return names


def write_assets(options: Namespace, chosen: dict[str, tuple[int, ...]], names: dict[str, str]) -> dict[str, str]:
    """Write the recovered slots of the open file as assets, all or none; return folder name → .blend.

    names: from ``asset_names``. Where one cannot be written (InputError), or after a signal, those that this call has
    written are removed: the command can run again.
    """
    subject = mesh_object(options.object)
    shelf = shelf_of(options, options.asset)
    written: dict[str, Path] = {}
    try:
        with delayed_signals() as interrupted:
            for label, name in names.items():
                written[label] = write_to_shelf(shelf, subject, name, chosen[label])
                if interrupted():
                    raise KeyboardInterrupt("no asset was written")
    except BaseException as error:
        for path in written.values():
            path.unlink(missing_ok=True)
        if isinstance(error, InputError):
            raise InputError(f"slot '{label}': {error}") from error
        raise
    return {label: str(path) for label, path in written.items()}


@contextmanager
def export_named(options: Namespace, finished: Collection[str]) -> Iterator[None]:
    """Add to an InputError or KeyboardInterrupt by which command the slots that have finished become assets.

    finished: their folders' names. Nothing is added where there are none, or without --asset.
    """
    try:
        yield
    except (InputError, KeyboardInterrupt) as error:
        if options.asset is None or not finished:
            raise
        command = f"irpso export {Path(options.output) / 'SLOT'} --format asset -o {options.asset}"
        which = ", ".join(f"'{label}'" for label in finished)
        said = f"{error}; " if str(error) else ""
        kind = InputError if isinstance(error, InputError) else KeyboardInterrupt
        raise kind(f"{said}to save the finished slots ({which}) as assets: {command}") from error


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
