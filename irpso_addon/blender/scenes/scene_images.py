"""Photographs that are images of the open file: on disk, packed, or painted in Blender."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np

from ...capture.errors import CaptureError
from ...capture.images.exif import upright
from ...capture.images.exr_header import is_exr
from ...capture.images.image import ImageRef, ImageStore
from ...capture.images.linearise import Picture, Samples, mask_of_picture, samples_of_picture
from ...core.errors import InputError
from ..colour_spaces import to_rec_709, use_of
from ..images import decode

# Custom properties of an image: part and layer of an EXR with several, and the colour space that a capture states for
# its file. Blender has no properties for them.
PART, LAYER, COLOUR_SPACE = "irpso_part", "irpso_layer", "irpso_colour_space"
_NOT_STILL = {"SEQUENCE": "an image sequence", "MOVIE": "a movie", "TILED": "a set of UDIM tiles"}


@dataclass(frozen=True)
class Photograph:
    """An image of the open file for a capture. size: (width, height). where: its name in errors.

    coarse: it holds 8-bit sRGB codes. turned_by: EXIF orientation by which the stored picture was turned.
    read: returns its Samples. mask: returns (H, W) bool. Both raise InputError.
    """

    size: tuple[int, int]
    where: str
    coarse: bool
    turned_by: int
    read: Callable[[], Samples]
    mask: Callable[[], np.ndarray]


def open_photograph(image: Any, owner: str, store: ImageStore, colour_space: str = "auto") -> Photograph:
    """Return a ``bpy.types.Image`` as a photograph; pixels are read on demand.

    owner: for errors, such as "light 'Sun'". IRPSO's readers read files, also packed ones, so packing changes nothing.
    An image painted or made in Blender is used as Blender holds it. colour_space: as for read_capture; "auto" follows
    a linear colour space set in Blender. Raises InputError where it is not a still image of one layer in sRGB or linear
    Rec. 709, or its file is missing.
    """
    where = f"image '{image.name}' of {owner}"
    if image.source in _NOT_STILL:
        raise InputError(f"{where} is {_NOT_STILL[image.source]}; give it one still image")
    if image.source == "VIEWER":
        raise InputError(f"{where} is a render result; save it as EXR and use that file")
    space = _colour_space(image, where, colour_space)
    if image.is_dirty or image.source == "GENERATED":
        return _in_memory(image, where, space)
    if image.packed_file is not None:
        return _packed(image, where, space)
    reference = ImageRef(file_of(image), image.get(PART), image.get(LAYER), space)
    if not reference.path.is_file():
        message = f"{where} is missing: {reference.path}; choose it again, or use File > External Data"
        raise CaptureError(message, "missing")
    with _named(where):
        size, coarse, turned_by = _facts(store, reference)
    return Photograph(size, where, coarse, turned_by, lambda: store.samples(reference), lambda: store.mask(reference))


def file_of(image: Any) -> Path:
    """Return the path of an image's file, which may be missing."""
    import bpy

    return Path(bpy.path.abspath(image.filepath, library=image.library))


def _colour_space(image, where: str, requested: str) -> str:
    if requested != "auto":
        return requested
    if COLOUR_SPACE in image:
        return image[COLOUR_SPACE]
    use = use_of(image)
    if use is None:
        name = image.colorspace_settings.name
        raise InputError(f"{where} is in color space '{name}'; set it to sRGB, Linear Rec.709 or Non-Color")
    return "auto" if use == "srgb" else "linear"


def _in_memory(image, where: str, space: str) -> Photograph:
    """Return an image without an up-to-date file. Found again by its session id: an undo invalidates all pointers."""
    uid, size, orientation = image.session_uid, tuple(image.size), stored_orientation(image)
    if 0 in size:
        raise InputError(f"{where} has no pixels; choose another")
    if orientation >= 5:
        size = size[::-1]

    def picture() -> Picture:
        current = _image_of(uid, where)
        width, height = current.size
        values = np.empty(width * height * current.channels, np.float32)
        current.pixels.foreach_get(values)
        values = values.reshape(height, width, current.channels)
        if current.is_float and not current.colorspace_settings.is_data and current.channels >= 3:
            values[..., :3] = to_rec_709(values[..., :3])
        return Picture(upright(values, orientation), 32 if current.is_float else 8)

    def read() -> Samples:
        # Blender keeps floats linear, whatever the colour space of their file; "auto" reads floats as linear.
        return samples_of_picture(picture(), space)

    coarse, turned_by = not image.is_float and space != "linear", _turned_by(image)
    return Photograph(size, where, coarse, turned_by, read, lambda: mask_of_picture(picture()))


def stored_orientation(image) -> int:
    """Return the EXIF orientation of an image's file, which Blender does not apply; 1 without an intact file."""
    return _turned_by(image, exr=False)  # an EXR is upright already


def _turned_by(image, exr: bool = True) -> int:
    """Return ``ImageStore.turned_by`` of an image's file; 1 without an intact file, and of an EXR unless ``exr``."""
    if image.source != "FILE":
        return 1
    with suppress(InputError), _path_of(image) as path:
        return ImageStore().turned_by(ImageRef(path, image.get(PART))) if exr or not is_exr(path) else 1
    return 1


@contextmanager
def _path_of(image) -> Iterator[Path]:
    """Yield the path of an image's file, or of a temporary one with its packed bytes."""
    if image.packed_file is None:
        yield file_of(image)
        return
    with _unpacked(image, image.name) as path:
        yield path


def _packed(image, where: str, space: str) -> Photograph:
    uid, part, layer = image.session_uid, image.get(PART), image.get(LAYER)

    def through_file(work: Callable):
        with _unpacked(_image_of(uid, where), where) as path, _named(where, path):
            return work(ImageStore(decode), ImageRef(path, part, layer, space))

    size, coarse, turned_by = through_file(_facts)
    read, mask = (lambda: through_file(ImageStore.samples)), (lambda: through_file(ImageStore.mask))
    return Photograph(size, where, coarse, turned_by, read, mask)


def _facts(store: ImageStore, reference: ImageRef) -> tuple[tuple[int, int], bool, int]:
    """Return size, coarse and turned_by of a Photograph."""
    return store.size(reference), store.coarse(reference), store.turned_by(reference)


@contextmanager
def _unpacked(image, where: str) -> Iterator[Path]:
    """Yield the path of a temporary file with a packed image's bytes."""
    import bpy

    if image.packed_file is None:
        raise InputError(f"{where} was unpacked meanwhile; start again")
    with tempfile.TemporaryDirectory(prefix="irpso-", dir=bpy.app.tempdir) as folder:
        # Only its suffix tells a raw file.
        path = Path(folder) / f"packed{PureWindowsPath(image.filepath).suffix}"
        path.write_bytes(image.packed_file.data)
        yield path


def _image_of(uid: int, where: str):
    import bpy

    for image in bpy.data.images:
        if image.session_uid == uid:
            return image
    raise InputError(f"{where} was deleted meanwhile; assign another image and start again")


@contextmanager
def _named(where: str, path: Path | None = None) -> Iterator[None]:
    """Put the image's name into errors about its file."""
    try:
        yield
    except CaptureError as error:
        if error.code in ("part", "layer"):
            raise InputError(
                f"{where} is an EXR of several layers; save one layer as a file, or list it in a capture.toml"
            ) from error
        raise CaptureError(f"{where}: {error.message.replace(f'{path}: ', '')}", error.code) from error
