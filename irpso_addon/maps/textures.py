"""Maps as Blender images: one image a map, found again by its tag when the same subject is recovered anew."""

from __future__ import annotations

import tempfile
from pathlib import Path

from ..capture.exr import write_exr
from ..errors import InputError
from ..reflectance.model import ReflectanceModel
from .blender_images import encode_png
from .result import Maps
from .tables import MapTable, encoded_values, map_tables, map_values

TAG = "irpso_map"


def material_images(maps: Maps, subject: str, folder: Path | None) -> dict[str, object]:
    """Return map name → bpy image, made or brought up to date.

    folder: where the picture files are kept; None packs them into the .blend. A map is a 16-bit PNG, or a 32-bit EXR
    where its range does not fit 0…1. Raises InputError where the folder cannot be written or the image is linked.
    """
    tables = map_tables(maps.model)
    images = {table.name: _own_image(subject, table.name) for table in tables}
    with tempfile.TemporaryDirectory(prefix="irpso-") as temporary:
        for table in tables:
            where = Path(temporary) if folder is None else folder
            name = bpy_name(subject, table.name)
            path = _write_picture(maps, table, where, name)
            images[table.name] = _update_image(images[table.name], name, path, table, packed=folder is None)
            images[table.name][TAG] = f"{subject}/{table.name}"
    return images


def check_images(model: ReflectanceModel, subject: str) -> None:
    """Raise InputError where an image made for this subject before is linked from a library, or a map has no place."""
    for table in map_tables(model):
        _own_image(subject, table.name)


def bpy_name(subject: str, map_name: str) -> str:
    """Return the name of a map's image, as in "IRPSO subject base_color"."""
    return f"IRPSO {subject} {map_name}"


def _own_image(subject: str, map_name: str):
    """Return the image made for this map before, or None; InputError where it is linked from a library."""
    import bpy

    found = [image for image in bpy.data.images if image.get(TAG) == f"{subject}/{map_name}"]
    local = [image for image in found if image.library is None]
    if found and not local:
        raise InputError(
            f"image '{found[0].name}' is linked from {found[0].library.filepath}; make it local or choose another name"
        )
    return local[0] if local else None


def _write_picture(maps: Maps, table: MapTable, folder: Path, name: str) -> Path:
    stem = "".join(c if c.isalnum() or c in "_- " else "_" for c in name).replace(" ", "_")
    values = map_values(table, maps)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); choose another folder") from error
    path = folder / f"{stem}{'.png' if table.fits_unit else '.exr'}"
    if table.fits_unit:
        encode_png(path, encoded_values(table, values), bits=16)
    else:
        write_exr(path, {"": {name: values[..., i] for i, name in enumerate(table.channels)}})
    return path


def _update_image(image, name: str, path: Path, table: MapTable, packed: bool):
    """Point an image at a picture file, or pack the file into it."""
    import bpy

    if image is None:
        image = bpy.data.images.new(name, 1, 1)
    if image.packed_file is not None:
        image.unpack(method="REMOVE")
    image.source = "FILE"
    image.filepath = str(path)
    # The colour space comes before any pixel is read: the loader takes 16-bit PNG for sRGB.
    image.colorspace_settings.name = table.color_space if table.fits_unit else "Non-Color"
    image.alpha_mode = "CHANNEL_PACKED" if table.components == 4 else "NONE"
    image.use_half_precision = False
    if packed:
        data = path.read_bytes()
        image.pack(data=data, data_len=len(data))
        image.filepath = f"//textures/{path.name}"
    return image
