"""PNG, JPEG, TIFF and HDR images, read by Blender's loader.

Measured on bpy 5.0.1: ``pixels`` of 8-bit images are code values in every colour space; those of 16-bit images are
converted from the image's colour space, sRGB by default, and unchanged with "Non-Color". "STRAIGHT" alpha multiplies
16-bit colours by alpha; "CHANNEL_PACKED" does not. Blender applies neither the EXIF orientation nor the exposure of HDR
files.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..capture.images.exif import upright
from ..capture.images.headers import read_bytes, read_header
from ..capture.images.heif import decode_heif
from ..capture.images.linearise import Picture
from ..capture.images.raw import decode_raw, is_raw
from ..core.errors import InputError
from .colour_spaces import use_space


def loaded(path: Path) -> Any:
    """Return a new image of a file, a picture or a movie. Raises InputError if Blender cannot open it."""
    import bpy

    try:
        return bpy.data.images.load(str(path.resolve()), check_existing=False)
    except RuntimeError as error:
        raise InputError(f"{path}: Blender cannot open it ({error}); check its permissions") from error


def decode(path: Path | str) -> Picture:
    """Return a PNG, JPEG, TIFF or HDR file's own values, (H, W, 4), upright: a ``linearise.Decoder``.

    No colour curve is inverted. Values of HDR files are divided by their gains. rawpy reads raw files and pillow-heif
    HEIC files; Blender includes neither.
    Raises InputError where the file is missing, damaged or of another format.
    """
    path = Path(path)
    if is_raw(path):
        return decode_raw(path)
    header = read_header(path)
    if header.kind == "HEIF":
        return decode_heif(path, read_bytes(path))
    import bpy

    image = loaded(path)
    try:
        use_space(image, "data")
        image.alpha_mode = "CHANNEL_PACKED"
        width, height = image.size
        stored = (header.height, header.width) if header.orientation >= 5 else (header.width, header.height)
        if (width, height) != stored:
            raise InputError(f"{path}: Blender cannot decode it; it is damaged or of a rare format; save it as PNG")
        values = np.empty(width * height * image.channels, np.float32)
        image.pixels.foreach_get(values)
    finally:
        bpy.data.images.remove(image)
    values = values.reshape(height, width, -1)
    if header.kind == "HDR":
        values[..., :3] /= np.array(header.gains, np.float32)
    return Picture(upright(values, header.orientation), header.bits)
