"""Pixels of Blender's tiled images, tile by tile: Blender's Python interface reads only the first tile."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from ..core.errors import InputError
from ..core.udim import ONE_SQUARE, PATTERN, tile_place


@contextmanager
def tile_images(image, tiles: Sequence[int]) -> Iterator[list]:
    """Yield one temporary image for each UDIM tile; for an image that is not tiled, the image itself.

    Raises InputError where the image is not tiled though the maps are, or is tiled and unsaved or lacks a tile's file.
    """
    import bpy

    if image.source != "TILED":
        if tuple(tiles) != ONE_SQUARE:
            names = ", ".join(map(str, tiles))
            raise InputError(
                f"image '{image.name}' is one picture, the UV map has the UDIM tiles {names}; choose a tiled image"
            )
        yield [image]
        return
    if image.is_dirty:  # only its files can be read
        raise InputError(f"image '{image.name}' has unsaved changes; save it in the Image Editor (Image › Save) first")
    made = []
    try:
        with tempfile.TemporaryDirectory(prefix="irpso-") as folder:
            for number in tiles:
                made.append(_loaded(image, number, Path(folder)))
                made[-1].size[:]  # read while the file is there
            yield made
    finally:
        for one in made:
            bpy.data.images.remove(one)


def _loaded(image, number: int, folder: Path):
    import bpy

    packed = next((file for file in image.packed_files if file.tile_number == number), None)
    if packed is not None:
        path = folder / f"{number}{Path(image.filepath).suffix}"
        path.write_bytes(packed.packed_file.data)
    else:
        column, row = tile_place(number)
        name = image.filepath.replace(PATTERN, str(number)).replace("<UVTILE>", f"u{column + 1}_v{row + 1}")
        path = Path(bpy.path.abspath(name, library=image.library))
    if number not in {tile.number for tile in image.tiles} or not path.is_file():
        raise InputError(f"image '{image.name}' has no file for UDIM tile {number}; add the tile, and save the image")
    one = bpy.data.images.load(str(path), check_existing=False)
    one.colorspace_settings.name, one.alpha_mode = image.colorspace_settings.name, image.alpha_mode
    return one
