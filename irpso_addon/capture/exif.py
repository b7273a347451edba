"""The orientation tag of photographs (EXIF 2.3, tag 274), and turning pixels upright by it."""

from __future__ import annotations

import struct

import numpy as np

_ORIENTATION, _BITS, _WIDTH, _HEIGHT, _SAMPLE_FORMAT = 274, 258, 256, 257, 339
_SIZES = {1: 1, 3: 2, 4: 4}  # BYTE, SHORT, LONG
_CODES = {1: "B", 3: "H", 4: "I"}


def tiff_tags(data: bytes) -> dict[int, tuple[int, ...]]:
    """Return the whole-number tags of the first directory of a TIFF structure; {} where it is none or is damaged."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(data[:4])
    if order is None or len(data) < 8:
        return {}
    (start,) = struct.unpack_from(order + "I", data, 4)
    if start + 2 > len(data):
        return {}
    (count,) = struct.unpack_from(order + "H", data, start)
    tags = {}
    for entry in range(start + 2, min(start + 2 + 12 * count, len(data) - 11), 12):
        tag, kind, number = struct.unpack_from(order + "HHI", data, entry)
        size = _SIZES.get(kind, 0) * number
        if not 0 < size <= 64:
            continue
        at = entry + 8 if size <= 4 else struct.unpack_from(order + "I", data, entry + 8)[0]
        if at + size <= len(data):
            tags[tag] = struct.unpack_from(f"{order}{number}{_CODES[kind]}", data, at)
    return tags


def tiff_layout(data: bytes) -> tuple[int, int, int, bool] | None:
    """Return (width, height, bits, is float) of a TIFF file, or None where its directory lacks them."""
    tags = tiff_tags(data)
    if _WIDTH not in tags or _HEIGHT not in tags:
        return None
    is_float = tags.get(_SAMPLE_FORMAT, (1,))[0] == 3
    return tags[_WIDTH][0], tags[_HEIGHT][0], tags.get(_BITS, (1,))[0], is_float


def tiff_orientation(data: bytes) -> int:
    """Return the orientation, 1 to 8, of a TIFF structure (a TIFF file, or an EXIF block without its marker)."""
    value = tiff_tags(data).get(_ORIENTATION, (1,))[0]
    return value if 1 <= value <= 8 else 1


def jpeg_orientation(data: bytes) -> int:
    """Return the orientation, 1 to 8, of a JPEG file's EXIF block; 1 where there is none."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] not in (0xDA, 0xD9):
        (length,) = struct.unpack_from(">H", data, at + 2)
        if data[at + 1] == 0xE1 and data[at + 4 : at + 10] == b"Exif\0\0":
            return tiff_orientation(data[at + 10 : at + 2 + length])
        at += 2 + length
    return 1


def upright(image: np.ndarray, orientation: int) -> np.ndarray:
    """Return an image (H, W, …), row 0 at the BOTTOM, turned as its orientation tag says (5 to 8 swap W and H)."""
    top_first = image[::-1]
    if orientation >= 5:
        top_first = top_first.swapaxes(0, 1)
    # After the swap for 5…8, the stored picture needs these mirrorings (rows, columns).
    rows, columns = {
        1: (1, 1), 2: (1, -1), 3: (-1, -1), 4: (-1, 1), 5: (1, 1), 6: (1, -1), 7: (-1, -1), 8: (-1, 1),
    }[orientation]  # fmt: skip
    return np.ascontiguousarray(top_first[::rows, ::columns][::-1])
