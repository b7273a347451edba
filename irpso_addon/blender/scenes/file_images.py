"""Image files of captures as images of the open file, with the colour space in which a capture reads them."""

from __future__ import annotations

from typing import Any

from ...capture.images.headers import read_header
from ...capture.images.image import ImageRef, ImageStore
from ...capture.images.raw import is_raw
from ..colour_spaces import use_of, use_space
from .scene_images import COLOUR_SPACE, LAYER, PART, file_of

_USES = {"linear": ("linear", "data"), "srgb": ("srgb",)}  # colour spaces of an image that is read in an encoding


class FileImages:
    """The open file's images by file, EXR part, layer and colour space. Missing ones are loaded, without pixels.

    with_own_spaces: also images in which the user has set another colour space, or painted. Without it they stay as
    they are, and the file is loaded again.
    """

    def __init__(self, with_own_spaces: bool = False):
        import bpy

        self._with_own_spaces = with_own_spaces
        self._images: dict[tuple, list[Any]] = {}
        for image in bpy.data.images:
            if image.source == "FILE" and image.filepath and not image.library:
                key = file_of(image).resolve(), *(image.get(name) for name in (PART, LAYER, COLOUR_SPACE))
                self._images.setdefault(key, []).append(image)

    def of(self, reference: ImageRef, mask: bool = False) -> Any:
        """Return the image of a file. Raises CaptureError and loads nothing if the header is unreadable."""
        import bpy

        path = reference.path.resolve()
        exr = path.suffix.lower() == ".exr"
        # What an EXR is read as anyway is not stored: an image that an earlier version loaded is found again.
        usual = "linear" if exr else "auto"
        space = None if mask or reference.colour_space in ("auto", usual) else reference.colour_space
        key = path, reference.part, reference.layer, space
        read_as = "" if mask or exr or space is not None else _read_as(reference)
        for image in self._images.get(key, ()):
            if self._with_own_spaces or (not image.is_dirty and (not read_as or use_of(image) in _USES[read_as])):
                return image
        image = bpy.data.images.load(str(path), check_existing=False)
        for name, value in zip((PART, LAYER, COLOUR_SPACE), key[1:], strict=True):
            if value is not None:
                image[name] = value
        if mask:
            use_space(image, "data")
        elif read_as == "linear" or space == "linear":
            use_space(image, "linear")
        self._images.setdefault(key, []).append(image)
        return image


def _read_as(reference: ImageRef) -> str:
    """Return the encoding of a file without a stated one that an image's colour space decides; "" if none does.

    Blender reads codes of 16 bits as sRGB; a capture reads them as linear unless they state otherwise. Raises
    CaptureError if its header is unreadable.
    """
    if is_raw(reference.path):
        return "linear"
    store, bits = ImageStore(), read_header(reference.path).bits
    # A profile applies only in the colour space "auto".
    deep = bits == 16 and store.profile(reference) is None and store.encoding(reference)[0] == "linear"
    return "linear" if deep else "" if bits == 32 else "srgb"
