"""Maps as Blender images: one per map, identified by its tag when the subject is recovered again."""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ...capture.images.exr import write_exr
from ...core.errors import InputError
from ...core.files import shortened
from ...core.png import encode_png
from ...core.udim import ONE_SQUARE, PATTERN, tile_stem
from ...reflectance.model import Parameter, ReflectanceModel
from ...results.map_tables import MapTable, encoded_values, exr_channels, map_tables, map_values
from ...results.maps import Maps, split_maps
from ..colour_spaces import use_space
from .nodes import images_of

TAG = "irpso_map"
_unsaved: set[Path] = set()  # the maps' files written in this session that no saved .blend shows


Pictures = dict[str, tuple[MapTable, dict[int, Path]]]  # map name → its table, and UDIM tile → file


@contextmanager
def written_pictures(maps: Maps, subject: str, folder: Path | None, height: np.ndarray | None) -> Iterator[Pictures]:
    """Write the files of all maps, and of a relief's heights (H, W), for ``material_images``.

    folder: of the files; None: a temporary one, removed at the end. A map is a 16-bit PNG, or a 32-bit EXR where its
    range exceeds 0…1; UDIM tiles have one file each. Beyond UV seams heights have the nearest value of their own side,
    as at other borders. Raises InputError where the folder cannot be written; no file is left then.
    """
    parts = [(table, maps) for table in map_tables(maps.model)]
    if height is not None:
        table = MapTable("height", (Parameter("height", range=(-1.0, 1.0)),))  # a range that exceeds PNG's
        parts.append((table, replace(maps, values={"height": height[..., None]}, margin=None)))
    with tempfile.TemporaryDirectory(prefix="irpso-") as temporary:
        pictures: Pictures = {}
        try:
            for table, part in parts:
                pictures[table.name] = table, _new_paths(table, folder or Path(temporary), subject, maps.tiles)
                _write_picture(part, table, pictures[table.name][1])
        except BaseException as error:
            for path in (path for _, paths in pictures.values() for path in paths.values()):
                with suppress(OSError):
                    path.unlink()
            # An encoder's own words name the single file.
            reason = error.__cause__ if isinstance(error, InputError) else error
            if not isinstance(reason, OSError):
                raise
            place, remedy = folder, "choose another folder"
            if folder is None:
                place, remedy = tempfile.gettempdir(), "free space there, or set TMPDIR to another folder"
            raise InputError(f"{place}: cannot be written ({reason.strerror or reason}); {remedy}") from error
        yield pictures


def material_images(pictures: Pictures, subject: str, packed: bool, former: Mapping[str, Any]) -> dict[str, Any]:
    """Return map name → bpy image, created or updated. former: from ``own_images``. packed: into the .blend."""
    images = {}
    for name, (table, paths) in pictures.items():
        tag = f"{subject}/{name}"
        images[name] = _update_image(former.get(tag), f"IRPSO {subject} {name}", paths, table, packed)
        images[name][TAG] = tag
        if not packed:
            _unsaved.update(path.resolve() for path in paths.values())
    return images


def check_saved(images: Iterable[Any]) -> None:
    """Raise InputError for an image with unsaved changes: what was painted would be lost."""
    if dirty := next((image for image in images if image.is_dirty), None):
        raise InputError(f"image '{dirty.name}' has unsaved changes; save it in the Image Editor (Image › Save) first")


def check_images(model: ReflectanceModel, subject: str) -> None:
    """Raise InputError where an image of this subject is linked from a library, or two maps have one name."""
    for table in map_tables(model):
        own_blocks("image", TAG, f"{subject}/{table.name}")


def own_blocks(kind: Literal["image", "material"], tag: str, value: str) -> list[Any]:
    """Return the local images or materials whose property ``tag`` is ``value``.

    Raises InputError where all are linked.
    """
    import bpy

    found = [block for block in getattr(bpy.data, f"{kind}s") if block.get(tag) == value]
    local = [block for block in found if block.library is None]
    if found and not local:
        raise InputError(
            f"{kind} '{found[0].name}' is linked from {found[0].library.filepath};"
            " make it local or recover under another name"
        )
    return local


def own_images(subject: str, material: Any, copies: Iterable[Any]) -> dict[str, Any]:
    """Return tag → local image that a new map of a material replaces. Images that ``copies`` of it show stay."""
    copied = set().union(*(images_of(copy.node_tree) for copy in copies))
    shown = images_of(material.node_tree)
    free = [image for image in map_images(subject) if image.library is None and image not in copied]
    return {image[TAG]: image for image in sorted(free, key=lambda image: image in shown)}


def map_images(subject: str) -> list[Any]:
    """Return the images of a subject's maps."""
    import bpy

    return [image for image in bpy.data.images if str(image.get(TAG, "")).rpartition("/")[0] == subject]


def _new_paths(table: MapTable, folder: Path, subject: str, tiles: Sequence[int]) -> dict[int, Path]:
    """Return UDIM tile number → the file of a map, of which none exists; make their folder.

    No file is replaced: a saved .blend, another subject of a similar name or an earlier step of *Undo* may show it.
    """
    name = f"IRPSO {shortened(subject)} {table.name}"
    stem = "".join(c if c.isalnum() or c in "_-" else "_" for c in name)
    suffix = ".png" if table.fits_unit else ".exr"
    stems = (stem if number == 0 else f"{stem}_{number}" for number in itertools.count())
    sets = ({number: folder / f"{tile_stem(one, number, tiles)}{suffix}" for number in tiles} for one in stems)
    folder.mkdir(parents=True, exist_ok=True)
    return next(one for one in sets if not any(path.exists() for path in one.values()))


def _write_picture(maps: Maps, table: MapTable, paths: Mapping[int, Path]) -> None:
    """Write a map into files by UDIM tile number."""
    for number, part in split_maps(maps):
        values = map_values(table, part)
        if table.fits_unit:
            encode_png(paths[number], encoded_values(table, values), bits=16)
        else:
            write_exr(paths[number], {"": exr_channels(values)})


def image_files(subject: str | None = None) -> set[Path]:
    """Return the files that the open file's images show; of a subject's maps alone, or, with None, of all images."""
    import bpy

    return set().union(*map(_files, bpy.data.images if subject is None else map_images(subject)))


def unsaved(files: Iterable[Path]) -> set[Path]:
    """Return those of the files that were written since the .blend was loaded, and that it did not show when saved."""
    return _unsaved.intersection(files)


def mark_saved() -> None:
    """Note that the .blend has been saved: the maps' files that it shows are not removed any more."""
    _unsaved.difference_update(image_files())


def superseded() -> set[Path]:
    """Return the maps' files that neither a saved .blend nor the open file shows: only *Undo* reaches them."""
    return _unsaved - image_files()


def remove_superseded(files: Iterable[Path]) -> None:
    """Remove the files of ``superseded``, except those that the file shows which has been loaded since."""
    for path in set(files) - image_files():
        with suppress(OSError):
            path.unlink()
    _unsaved.clear()


def _files(image: Any) -> set[Path]:
    """Return the files that an image shows; none where it is packed."""
    import bpy

    if image.packed_files or not image.filepath:
        return set()
    path = Path(bpy.path.abspath(image.filepath, library=image.library)).resolve()
    return {path.with_name(path.name.replace(PATTERN, str(tile.number))) for tile in image.tiles}


def _update_image(image, name: str, paths: dict[int, Path], table: MapTable, packed: bool):
    """Point an image at files by UDIM tile, or pack the files into it."""
    import bpy

    if image is None:
        image = bpy.data.images.new(name, 1, 1)
    if image.packed_file is not None:
        image.unpack(method="REMOVE")
    path = next(iter(paths.values()))
    if tuple(paths) == ONE_SQUARE:
        image.source = "FILE"
        image.filepath = str(path)
    else:
        _point_at_tiles(image, paths)
    # Set the colour space before pixels are read: the loader reads 16-bit PNG as sRGB.
    use_space(image, "srgb" if table.fits_unit and table.color_space == "sRGB" else "data")
    image.alpha_mode = "CHANNEL_PACKED" if table.components == 4 else "NONE"
    image.use_half_precision = False
    if packed and tuple(paths) == ONE_SQUARE:
        data = path.read_bytes()
        image.pack(data=data, data_len=len(data))
        image.filepath = f"//textures/{path.name}"
    elif packed:
        _pack_tiles(image)
    return image


def _point_at_tiles(image, paths: dict[int, Path]) -> None:
    """Make an image a tiled one of exactly these files."""
    number, path = next(iter(paths.items()))
    image.filepath = str(path.with_name(path.name.replace(f".{number}.", f".{PATTERN}.")))
    image.source = "TILED"
    present = {tile.number for tile in image.tiles}
    for number in sorted(set(paths) - present):
        image.tiles.new(number)
    for number in sorted(present - set(paths)):
        image.tiles.remove(image.tiles.get(number))


def _pack_tiles(image) -> None:
    """Pack a tiled image's files. Blender packs several tiles from files only, and records their paths."""
    image.pack()
    for file in image.packed_files:
        file.filepath = f"//textures/{Path(file.filepath).name}"
    # Raw: else Blender warns that the new place has no tiles.
    image.filepath_raw = f"//textures/{Path(image.filepath).name}"
