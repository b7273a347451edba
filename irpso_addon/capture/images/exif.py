"""The tags of photographs (EXIF 2.3): orientation and exposure; and turning pixels upright."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

_ICC_PROFILE, _COLOUR_SPACE, _SRGB = 34675, 40961, 1
_ORIENTATION, _BITS, _WIDTH, _HEIGHT, _SAMPLE_FORMAT = 274, 258, 256, 257, 339
_EXIF_DIRECTORY, _EXPOSURE_TIME, _F_NUMBER, _ISO = 34665, 33434, 33437, 34855
_SIZES = {1: 1, 3: 2, 4: 4, 5: 8}  # BYTE, SHORT, LONG, RATIONAL
_CODES = {1: "B", 3: "H", 4: "I", 5: "II"}
_RATIONAL = 5


@dataclass(frozen=True)
class Exposure:
    """How a photograph was exposed. seconds: above 0. f_number, iso: above 0, or None where the file does not tell."""

    seconds: float
    f_number: float | None = None
    iso: float | None = None

    @property
    def amount(self) -> float:
        """What a given radiance is multiplied by in the file, up to one factor a camera: seconds · ISO / 100 / N²."""
        return self.seconds * (self.iso or 100.0) / 100 / (self.f_number or 1.0) ** 2


def tiff_tags(data: bytes, directory: int | None = None) -> dict[int, tuple[float, ...]]:
    """Return the numeric tags of a TIFF structure's directory at an offset, or of its first; {} where it is damaged.

    Whole numbers are int, rationals float; a rational over 0 is left out.
    """
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(data[:4])
    tags = {}
    for tag, kind, number, entry in _entries(data, directory):
        size = _SIZES.get(kind, 0) * number
        if not 0 < size <= 64:
            continue
        at = entry + 8 if size <= 4 else struct.unpack_from(order + "I", data, entry + 8)[0]
        if at + size > len(data):
            continue
        values = struct.unpack_from(order + _CODES[kind] * number, data, at)
        if kind != _RATIONAL:
            tags[tag] = values
        elif all(values[1::2]):
            tags[tag] = tuple(a / b for a, b in zip(values[::2], values[1::2], strict=True))
    return tags


def _entries(data: bytes, directory: int | None = None) -> Iterator[tuple[int, int, int, int]]:
    """Yield (tag, type, count, offset of the entry) of a TIFF structure's directory, nothing where it is damaged."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(data[:4])
    if order is None or len(data) < 8:
        return
    start = struct.unpack_from(order + "I", data, 4)[0] if directory is None else directory
    if start + 2 > len(data):
        return
    (count,) = struct.unpack_from(order + "H", data, start)
    for entry in range(start + 2, min(start + 2 + 12 * count, len(data) - 11), 12):
        yield (*struct.unpack_from(order + "HHI", data, entry), entry)


def tiff_has_profile(data: bytes) -> bool:
    """Return whether a TIFF file brings a colour profile (ICC)."""
    return any(tag == _ICC_PROFILE for tag, *_ in _entries(data))


def jpeg_is_srgb(data: bytes) -> bool:
    """Return whether a JPEG file states its colour space: by a profile (ICC), or sRGB in its EXIF block."""
    block = _jpeg_block(data)
    directory = tiff_tags(block).get(_EXIF_DIRECTORY)
    stated = directory is not None and tiff_tags(block, directory[0]).get(_COLOUR_SPACE) == (_SRGB,)
    return stated or bool(_jpeg_block(data, 0xE2, b"ICC_PROFILE\0"))


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
    return tiff_orientation(_jpeg_block(data))


def exposure_of(data: bytes) -> Exposure | None:
    """Return the exposure that a JPEG, PNG or TIFF file tells (a DNG and many raw files are TIFF); None without one."""
    if data[:2] == b"\xff\xd8":
        block = _jpeg_block(data)
    elif data[:8] == b"\x89PNG\r\n\x1a\n":
        block = _png_block(data)
    else:
        block = data
    tags = tiff_tags(block)
    if _EXIF_DIRECTORY in tags:
        tags |= tiff_tags(block, tags[_EXIF_DIRECTORY][0])
    seconds, f_number, iso = (tags.get(tag, (0,))[0] for tag in (_EXPOSURE_TIME, _F_NUMBER, _ISO))
    return Exposure(float(seconds), float(f_number) or None, float(iso) or None) if seconds > 0 else None


def _jpeg_block(data: bytes, marker: int = 0xE1, name: bytes = b"Exif\0\0") -> bytes:
    """Return what follows the name in the first block of a kind, by default the EXIF block; b"" where there is none."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] not in (0xDA, 0xD9):
        (length,) = struct.unpack_from(">H", data, at + 2)
        if data[at + 1] == marker and data.startswith(name, at + 4):
            return data[at + 4 + len(name) : at + 2 + length]
        at += 2 + length
    return b""


def _png_block(data: bytes) -> bytes:
    at = 8
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        if data[at + 4 : at + 8] == b"eXIf":
            return data[at + 8 : at + 8 + length]
        at += 12 + length
    return b""


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
