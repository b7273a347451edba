"""PNG, JPEG, TIFF and HDR images read by Blender's loader, and PNG written: the only place that touches either.

Measured on bpy 5.0.1: 8-bit images come out of ``pixels`` as their code values whatever their colour space; 16-bit ones
are converted from the colour space that is set, sRGB by default; "Non-Color" leaves them alone. "STRAIGHT" alpha
multiplies 16-bit colours by alpha; "CHANNEL_PACKED" does not. No format is turned by its EXIF orientation.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from ..capture.exif import upright
from ..capture.headers import read_header
from ..capture.picture import Picture
from ..capture.raw import decode_raw, is_raw
from ..errors import InputError
from ..files import replacing_file

_PNG_COLOUR_TYPES = {1: 0, 2: 4, 3: 2, 4: 6}


def decode(path: Path | str) -> Picture:
    """Return a PNG, JPEG, TIFF or HDR file's own values, (H, W, 4), upright: a ``capture.picture.Decoder``.

    No colour curve is undone. Raw files go to rawpy, which Blender does not bring.
    Raises InputError where the file is missing, damaged or of another format.
    """
    path = Path(path)
    if is_raw(path):
        return decode_raw(path)
    import bpy

    header = read_header(path)
    try:
        image = bpy.data.images.load(str(path.resolve()), check_existing=False)
    except RuntimeError as error:
        raise InputError(f"{path}: Blender cannot open it ({error}); check its permissions") from error
    try:
        image.colorspace_settings.name = "Non-Color"
        image.alpha_mode = "CHANNEL_PACKED"
        width, height = image.size
        stored = (header.height, header.width) if header.orientation >= 5 else (header.width, header.height)
        if (width, height) != stored:
            raise InputError(f"{path}: Blender cannot decode it; it is damaged or of a rare kind: save it again as PNG")
        values = np.empty(width * height * image.channels, np.float32)
        image.pixels.foreach_get(values)
    finally:
        bpy.data.images.remove(image)
    return Picture(upright(values.reshape(height, width, -1), header.orientation), header.bits)


def encode_png(path: Path | str, array: np.ndarray, bits: int = 16) -> None:
    """Write (H, W, C) values in 0…1, already encoded, row 0 at the bottom, as a PNG of 8 or 16 bits; C of 1 to 4.

    Code values are round(value · (2^bits − 1)), exactly. Written here with zlib because Blender's saver takes pixels
    through its scene's colour management and gives no say over rounding. Raises InputError where it cannot be written.
    """
    array = np.asarray(array, np.float64)
    array = array[..., None] if array.ndim == 2 else array
    height, width, channels = array.shape
    largest = 2**bits - 1
    codes = np.rint(np.clip(np.nan_to_num(array[::-1]), 0, 1) * largest).astype(">u2" if bits == 16 else np.uint8)
    bytes_per_pixel = channels * codes.itemsize
    rows = codes.reshape(height, -1).view(np.uint8)
    filtered = np.empty((height, 1 + rows.shape[1]), np.uint8)
    filtered[:, 0] = 1  # filter "Sub": each byte less that of the pixel to the left, which photographs deflate well by
    filtered[:, 1:] = rows
    filtered[:, 1 + bytes_per_pixel :] -= rows[:, :-bytes_per_pixel]
    header = struct.pack(">IIBBBBB", width, height, bits, _PNG_COLOUR_TYPES[channels], 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(filtered.tobytes(), 6)), (b"IEND", b""))
    with replacing_file(Path(path)) as partial:
        partial.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, data) for kind, data in chunks))


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
