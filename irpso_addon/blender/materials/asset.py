"""Recovered materials as assets of a Blender library: one file each, with a preview and metadata."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import InputError
from ...core.files import replacing_file
from ..operators import quiet_operator
from .material import TAG
from .nodes import images_of
from .pictures import icon
from .textures import check_saved

_SIDE = 256  # pixels of a preview, as Blender's own have


@dataclass(frozen=True)
class About:
    """Metadata of an asset in Blender's asset browser. tags: words that the browser's search finds."""

    author: str = ""
    license: str = ""
    description: str = ""
    tags: tuple[str, ...] = ()


def recovered_slot(obj: Any, slots: Sequence[int] = ()) -> Any:
    """Return the recovered material of one of some slots, else of the object's active slot, else its first.

    Raises InputError where the object has none.
    """
    of_slots = [slot.material for slot in obj.material_slots]
    materials = (*(of_slots[index] for index in slots if index < len(of_slots)), obj.active_material, *of_slots)
    recovered = next((material for material in materials if material is not None and TAG in material), None)
    if recovered is None:
        raise InputError(f"object '{obj.name}' has no recovered material")
    return recovered


def write_asset(path: Path, obj: Any, material: Any, name: str, about: About, catalog: str) -> None:
    """Write a material of an object into a .blend, as an asset with its maps packed; whole or not at all.

    The open file stays as it is. catalog: UUID, "" for none. Raises FileExistsError where ``path`` exists; InputError
    where it cannot be written, or an image has unsaved changes or no file.
    """
    import bpy

    images = sorted(images_of(material.node_tree), key=lambda image: image.name)
    if linked := next((block for block in (material, *images) if block.library is not None), None):
        raise InputError(
            f"{linked.id_type.lower()} '{linked.name}' is linked from {linked.library.filepath}, so the asset would"
            " lack maps; make the material local first (Object › Relations › Make Local › All)"
        )
    check_saved(images)
    picture = icon(obj, _SIDE)
    with _copy_named(material, name) as copy, _packed(images):
        copy.asset_mark()
        known = copy.asset_data
        known.author, known.license, known.description = about.author, about.license, about.description
        for tag in about.tags:
            known.tags.new(tag, skip_if_exists=True)
        if catalog:
            known.catalog_id = catalog
        shown = copy.preview_ensure()
        shown.image_size = (_SIDE, _SIDE)
        shown.image_pixels_float.foreach_set(picture.astype(np.float32).ravel())
        try:
            with replacing_file(path, durable=True, new=True) as partial, quiet_operator():
                bpy.data.libraries.write(str(partial), {copy}, fake_user=True, compress=True)
        except RuntimeError as error:
            raise InputError(f"{path}: cannot be saved ({str(error).strip()}); choose another library") from error


@contextlib.contextmanager
def _copy_named(material: Any, name: str) -> Iterator[Any]:
    """Yield a copy of a material with exactly this name; a material that has it already is renamed meanwhile."""
    import bpy

    taken = next((one for one in bpy.data.materials if one.library is None and one.name == name), None)
    if taken is not None:
        taken.name = f"{name[:20]} "  # never the asset's: no asset's name ends with a space
    copy = material.copy()
    copy.name = name
    try:
        yield copy
    finally:
        bpy.data.materials.remove(copy)
        if taken is not None:
            taken.name = name


@contextlib.contextmanager
def _packed(images: Iterable[Any]) -> Iterator[None]:
    """Pack images that are files; unpack them again afterwards. Raises InputError where a file is missing."""
    files = [image for image in images if image.packed_file is None and image.source in ("FILE", "TILED")]
    try:
        for image in files:
            try:
                image.pack()
            except RuntimeError as error:
                raise InputError(
                    f"image '{image.name}': {image.filepath} cannot be packed; find it by File › External Data › Find"
                    " Missing Files"
                ) from error
        yield
    finally:
        for image in files:
            if image.packed_file is not None or image.packed_files:
                image.unpack(method="REMOVE")
