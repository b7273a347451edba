"""Reads the headers of an OpenEXR file, without its pixels (OpenEXR file layout, openexr.com).

OpenEXR's own reader prints to the terminal if a file is damaged, so this module checks files first.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import NamedTuple

from ..errors import CaptureError
from .headers import read_bytes, truncated

_MAGIC = 20000630
_TILED, _DEEP, _MULTI_PART = 0x200, 0x800, 0x1000
_PIXEL_TYPES = {0: "uint", 1: "half", 2: "float"}
# Compression byte of the header → scan lines in a chunk.
_LINES = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256}
TURN_NAMES = "irpsoOrientation", "irpsoTurnedBy"  # attributes of an EXR for the fields of Turn


class Turn(NamedTuple):
    """How a picture was turned upright. tag: EXIF orientation in the file of the camera, 1 to 8.

    turned_by: the orientation by which our own reading turned the stored picture, 1 where a decoder did, as of HEIC.
    """

    tag: int
    turned_by: int


@dataclass(frozen=True)
class ExrPart:
    """One part. name: "" if unnamed. channels: name → "uint", "half" or "float". width, height: display window.

    subsampled: whether a channel has fewer samples than pixels. chromaticities: x and y of red, green, blue and white;
    None where the file does not state them. colour_space: its colorInteropID, which Blender 5 writes instead; or "".
    turn: of the photograph that it was developed from; None where the file does not state it.
    """

    name: str
    channels: dict[str, str]
    width: int
    height: int
    subsampled: bool
    chromaticities: tuple[float, ...] | None = None
    colour_space: str = ""
    turn: Turn | None = None


def is_exr(path: Path) -> bool:
    """Return whether a file starts with OpenEXR's magic number; False for a missing file."""
    try:
        with path.open("rb") as file:
            return file.read(4) == struct.pack("<I", _MAGIC)
    except OSError:
        return False


def read_exr_header(path: Path) -> tuple[ExrPart, ...]:
    """Return the parts of an EXR file. Raises CaptureError where it is missing, damaged, cut short or deep.

    Of a file that can be mapped into memory only the pages with headers are read.
    """
    try:
        with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as data:
            return _parts(path, data)
    except (OSError, ValueError):  # a folder, an empty file, or on a drive without maps
        return _parts(path, read_bytes(path))


def _parts(path: Path, data: bytes | mmap) -> tuple[ExrPart, ...]:
    if data[:4] != struct.pack("<I", _MAGIC):
        raise CaptureError(f"{path}: is no OpenEXR file; replace it by one", "image_unknown")
    try:
        (flags,) = struct.unpack_from("<I", data, 4)
        if flags & _DEEP:
            raise CaptureError(f"{path}: holds deep data; save it as a flat EXR", "image_unknown")
        headers, at = _headers(data, bool(flags & _MULTI_PART))
        _check_chunks(data, at, headers, flags)
        return tuple(_part(path, header) for header in headers)
    except (struct.error, ValueError, KeyError, IndexError, OverflowError) as error:
        raise truncated(path) from error


def _headers(data: bytes | mmap, several: bool) -> tuple[list[dict[str, bytes]], int]:
    headers, at = [], 8
    while True:
        header: dict[str, bytes] = {}
        while data[at]:
            name, at = _text(data, at)
            _, at = _text(data, at)
            (size,) = struct.unpack_from("<I", data, at)
            if at + 4 + size > len(data):
                raise ValueError(name)
            header[name] = data[at + 4 : at + 4 + size]
            at += 4 + size
        headers.append(header)
        at += 1
        if not several or not data[at]:
            return headers, at + bool(several)


def _text(data: bytes | mmap, at: int) -> tuple[str, int]:
    if (end := data.find(b"\0", at, at + 257)) < 0:
        raise ValueError("text")
    return data[at:end].decode(), end + 1


def _check_chunks(data: bytes | mmap, at: int, headers: list[dict[str, bytes]], flags: int) -> None:
    """Raise ValueError if a chunk of pixels lies beyond the end of the file."""
    several = bool(flags & _MULTI_PART)
    counts = []
    for header in headers:
        if "chunkCount" in header:
            counts.append(struct.unpack("<I", header["chunkCount"])[0])
        elif flags & _TILED or header["compression"][0] not in _LINES:
            return  # OpenEXR itself reports a cut tiled file, and knows newer compressions
        else:
            _, low, _, high = struct.unpack("<4i", header["dataWindow"])
            counts.append(-(-(high - low + 1) // _LINES[header["compression"][0]]))
    for header, count in zip(headers, counts, strict=True):
        tiled = bool(flags & _TILED) or header.get("type", b"").startswith(b"tiled")
        lead = 4 * several + (16 if tiled else 4)
        for offset in struct.unpack_from(f"<{count}Q", data, at):
            (size,) = struct.unpack_from("<I", data, offset + lead)
            if offset == 0 or offset + lead + 4 + size > len(data):
                raise ValueError("chunk")
        at += 8 * count


def _part(path: Path, header: dict[str, bytes]) -> ExrPart:
    channels, subsampled, at, listing = {}, False, 0, header["channels"]
    while listing[at]:
        name, at = _text(listing, at)
        kind, _, x, y = struct.unpack_from("<iIii", listing, at)
        channels[name] = _PIXEL_TYPES[kind]
        subsampled |= x != 1 or y != 1
        at += 16
    x0, y0, x1, y1 = struct.unpack("<4i", header["displayWindow"])
    if x1 < x0 or y1 < y0:
        raise CaptureError(f"{path}: says it has no pixels; export it again", "image_unknown")
    primaries = struct.unpack("<8f", header["chromaticities"]) if "chromaticities" in header else None
    space = header.get("colorInteropID", b"").rstrip(b"\0").decode()
    name, size = header.get("name", b"").decode(), (x1 - x0 + 1, y1 - y0 + 1)
    return ExrPart(name, channels, *size, subsampled, primaries, space, _turn(header))


def _turn(header: dict[str, bytes]) -> Turn | None:
    if not all(name in header for name in TURN_NAMES):
        return None
    turn = Turn(*(struct.unpack("<i", header[name])[0] for name in TURN_NAMES))
    return turn if all(1 <= orientation <= 8 for orientation in turn) else None
