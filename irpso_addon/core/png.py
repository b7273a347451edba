"""PNG files: written with 8 and 16 bits; their chunks."""

from __future__ import annotations

import struct
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from .files import replacing_file
from .steps import available_cores

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COLOUR_TYPES = {1: 0, 2: 4, 3: 2, 4: 6}
_SOFTWARE = b"tEXtSoftware\0"
_BLOCK = 1 << 20  # bytes that one thread compresses at a time
_WINDOW = 1 << 15  # bytes before a block that it may refer to


def encode_png(
    path: Path | str, array: np.ndarray, bits: int = 16, cicp: tuple[int, int] | None = None, software: str = ""
) -> None:
    """Write ``png_bytes`` to a file. Raises InputError where it cannot be written."""
    data = png_bytes(array, bits, cicp, software)
    with replacing_file(Path(path)) as partial:
        partial.write_bytes(data)


def png_bytes(array: np.ndarray, bits: int = 16, cicp: tuple[int, int] | None = None, software: str = "") -> bytes:
    """Return (H, W, C) values in 0…1, already encoded, row 0 at the bottom, as a PNG of 8 or 16 bits; C of 1 to 4.

    cicp: colour primaries and transfer function by ITU-T H.273, to state in the file. software: Latin-1 text to state
    as the program that made it, "" for none.
    Code values are round(value · (2^bits − 1)), exactly. Written here with zlib because Pillow has no RGB of 16 bits,
    and Blender's saver applies the scene's colour management and its own rounding.
    """
    array = np.asarray(array)
    array = array[..., None] if array.ndim == 2 else array
    height, width, channels = array.shape
    rows = max(1, 8 * _BLOCK // (bits * width * channels))
    with ThreadPoolExecutor(len(available_cores())) as pool:  # NumPy and zlib work without the interpreter's lock
        parts = [array[::-1][start : start + rows] for start in range(0, height, rows)]
        filtered = list(pool.map(_filtered, parts, [bits] * len(parts)))
        befores = [b"", *(block[-_WINDOW:] for block in filtered)]
        last = [False] * (len(parts) - 1) + [True]
        deflated = b"".join(pool.map(_deflated, filtered, befores, last))
    check = 1
    for block in filtered:
        check = zlib.adler32(block, check)
    header = struct.pack(">IIBBBBB", width, height, bits, _COLOUR_TYPES[channels], 0, 0, 0)
    colours = () if cicp is None else (b"cICP" + bytes((*cicp, 0, 1)),)  # RGB, full range
    texts = (_SOFTWARE + software.encode("latin-1"),) if software else ()
    pixels = b"IDAT\x78\x9c" + deflated + struct.pack(">I", check)  # a zlib stream (RFC 1950)
    chunks = (b"IHDR" + header, *colours, *texts, pixels, b"IEND")
    framed = [struct.pack(">I", len(one) - 4) + one + struct.pack(">I", zlib.crc32(one)) for one in chunks]
    return SIGNATURE + b"".join(framed)


def _filtered(values: np.ndarray, bits: int) -> bytes:
    """Return the filtered bytes of rows (H, W, C): filter "Sub", less the byte of the pixel to the left."""
    largest = 2**bits - 1
    values = np.nan_to_num(np.asarray(values, np.float64))
    codes = np.rint(np.clip(values, 0, 1) * largest).astype(">u2" if bits == 16 else np.uint8)
    bytes_per_pixel = codes.shape[2] * codes.itemsize
    rows = codes.reshape(len(codes), -1).view(np.uint8)
    filtered = np.empty((len(rows), 1 + rows.shape[1]), np.uint8)
    filtered[:, 0] = 1  # the filter's number; photographs deflate well with it
    filtered[:, 1:] = rows
    filtered[:, 1 + bytes_per_pixel :] -= rows[:, :-bytes_per_pixel]
    return filtered.tobytes()


def _deflated(block: bytes, before: bytes, last: bool) -> bytes:
    """Return a block of a deflate stream (RFC 1951). before: the end of the block before it."""
    compressor = zlib.compressobj(6, zlib.DEFLATED, -zlib.MAX_WBITS, zdict=before)
    return compressor.compress(block) + compressor.flush(zlib.Z_FINISH if last else zlib.Z_SYNC_FLUSH)


def png_software(path: Path) -> str:
    """Return the program that a PNG file states as its first text; "" for none, or a file that cannot be read."""
    try:
        data = path.read_bytes()
    except OSError:
        return ""
    text = png_chunks(data).get(_SOFTWARE[:4], b"") if data.startswith(SIGNATURE) else b""
    keyword = _SOFTWARE[4:]
    return text[len(keyword) :].decode("latin-1") if text.startswith(keyword) else ""


def png_chunks(data: bytes) -> dict[bytes, bytes]:
    """Return kind → data, the first of each kind, of a PNG file's complete chunks.

    Pillow finds EXIF behind the pixels only by decoding them, and drops cICP.
    """
    chunks: dict[bytes, bytes] = {}
    offset = len(SIGNATURE)
    while offset + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, offset)
        if (end := offset + 12 + length) <= len(data):
            chunks.setdefault(kind, data[offset + 8 : end - 4])
        offset = end
    return chunks
