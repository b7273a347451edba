"""A copy of the open file as a result's .blend file."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from ...core.errors import InputError
from ...core.files import replacing_file
from ...results.write import BLEND, FORMER_BLEND
from ..operators import quiet_operator
from .textures import TAG


def save_result_blend(folder: Path) -> None:
    """Save a copy of the open file as a result's, in place of a former result's that ``write_maps`` set aside."""
    save_blend(folder / BLEND)
    (folder / FORMER_BLEND).unlink(missing_ok=True)


def save_blend(path: str | Path) -> Path:
    """Save a copy of the open file to ``path``, complete or not at all; image files get relative paths.

    The session keeps its file name. Raises InputError where ``path`` cannot be written.
    """
    import bpy

    path = Path(path).resolve()
    if path.is_dir() or not path.parent.is_dir():
        what = "is a folder" if path.is_dir() else "its folder does not exist"
        raise InputError(f"{path}: {what}; give the name of a .blend file")
    images = [image for image in bpy.data.images if TAG in image and image.library is None]
    before = [image.filepath_raw for image in images]
    try:
        with replacing_file(path, durable=True) as partial:
            # Blender remaps relative paths from the open file's folder to the copy's, but those of no unsaved file.
            start = None if bpy.data.filepath else str(path.parent)
            for image in images:
                own = image.filepath_raw  # of a packed one: where unpacking writes it, beside each file
                file = path.parent / own.removeprefix("//") if image.packed_files else bpy.path.abspath(own)
                with suppress(ValueError):  # on Windows: another drive
                    image.filepath_raw = bpy.path.relpath(str(file), start=start)
            with quiet_operator():
                bpy.ops.wm.save_as_mainfile(filepath=str(partial), copy=True, check_existing=False, relative_remap=True)
    except RuntimeError as error:
        raise InputError(f"{path}: cannot be saved ({str(error).strip()}); choose another place") from error
    finally:
        for image, old in zip(images, before, strict=True):
            image.filepath_raw = old
    return path
