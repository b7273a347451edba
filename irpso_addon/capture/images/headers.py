"""What an image file says of itself in its first bytes: kind, size, depth, orientation; and whether it is whole."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass, replace
from pathlib import Path

from ..errors import CaptureError
from .exif import jpeg_is_srgb, jpeg_orientation, tiff_has_profile, tiff_layout, tiff_orientation

_HDR_SIZE = re.compile(rb"\n([-+][XY]) (\d+) ([-+][XY]) (\d+)\n")
_NO_SIZE_MARKERS = (0xC4, 0xC8, 0xCC)  # among the JPEG markers C0…CF, those that start no frame
_JPEG_TAIL = 1 << 16  # cameras append a few kilobytes after the end mark
_LINEAR_GAMMA = 100_000  # of a gAMA chunk: 100 000 over the exponent
_PROFILES = (b"sRGB", b"iCCP", b"cICP")  # PNG chunks that name a colour space


@dataclass(frozen=True)
class ImageHeader:
    """kind: "EXR", "PNG", "JPEG", "TIFF" or "HDR". width, height: pixels, once upright. bits: 8, 16, or 32 for floats.

    orientation: the EXIF tag, 1 to 8. states: the encoding that the file states, "srgb" or "linear", "" for none; a
    colour profile counts as "srgb", which nearly all are near to.
    """

    kind: str
    width: int
    height: int
    bits: int
    orientation: int = 1
    states: str = ""


def read_header(path: Path) -> ImageHeader:
    """Return the header of an image that is no EXR. Raises CaptureError where it is missing, unknown or cut short."""
    data = read_bytes(path)
    if data[:8] == b"\x89PNG\r\n\x1a\n":
        header = _png(path, data)
    elif data[:2] == b"\xff\xd8":
        header = _jpeg(path, data)
    elif data[:4] in (b"II*\0", b"MM\0*"):
        header = _tiff(path, data)
    elif data[:2] == b"#?":
        header = _hdr(path, data)
    else:
        what = "is no PNG, JPEG, TIFF, HDR or EXR image; replace it by one" if data else "is empty; copy it again"
        raise CaptureError(f"{path}: {what}", "image_unknown")
    if header.orientation >= 5:
        header = replace(header, width=header.height, height=header.width)
    if header.width < 1 or header.height < 1:
        raise CaptureError(f"{path}: says it has no pixels; export it again", "image_unknown")
    return header


def read_bytes(path: Path) -> bytes:
    """Return a file's bytes; CaptureError where it is missing or may not be read."""
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        raise CaptureError(f"{path}: this image is not there; put it there or take its line out", "missing") from error
    except OSError as error:
        raise CaptureError(f"{path}: cannot be read ({error.strerror}); check what it is", "missing") from error


def truncated(path: Path) -> CaptureError:
    """Return the error for a file that ends too early."""
    return CaptureError(f"{path}: is cut short or damaged; copy or export it again", "image_truncated")


def _png(path: Path, data: bytes) -> ImageHeader:
    at, orientation, states = 8, 1, ""
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        kind, end = data[at + 4 : at + 8], at + 12 + length
        if kind == b"eXIf":
            orientation = tiff_orientation(data[at + 8 : at + 8 + length])
        if kind in _PROFILES:  # which count before gAMA
            states = "srgb"
        if kind == b"gAMA" and length == 4 and not states:
            states = "linear" if struct.unpack_from(">I", data, at + 8)[0] == _LINEAR_GAMMA else "srgb"
        if kind == b"IEND":
            width, height, bits = struct.unpack_from(">IIB", data, 16)
            return ImageHeader("PNG", width, height, 16 if bits == 16 else 8, orientation, states)
        at = end
    raise truncated(path)


def _jpeg(path: Path, data: bytes) -> ImageHeader:
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # a fill byte
            at += 1
            continue
        if 0xC0 <= marker <= 0xCF and marker not in _NO_SIZE_MARKERS:
            if b"\xff\xd9" not in data[max(at, len(data) - _JPEG_TAIL) :]:
                break
            height, width = struct.unpack_from(">HH", data, at + 5)
            return ImageHeader("JPEG", width, height, 8, jpeg_orientation(data), "srgb" if jpeg_is_srgb(data) else "")
        at += 2 + struct.unpack_from(">H", data, at + 2)[0]
    raise truncated(path)


def _tiff(path: Path, data: bytes) -> ImageHeader:
    layout = tiff_layout(data)
    if layout is None:
        raise truncated(path)
    width, height, bits, is_float = layout
    if not is_float and bits > 16:
        raise CaptureError(f"{path}: holds {bits}-bit whole numbers; save it with 8 or 16 bits", "image_unknown")
    states = "linear" if is_float else "srgb" if tiff_has_profile(data) else ""
    return ImageHeader("TIFF", width, height, 32 if is_float else 16 if bits > 8 else 8, tiff_orientation(data), states)


def _hdr(path: Path, data: bytes) -> ImageHeader:
    match = _HDR_SIZE.search(data[:8192])
    if match is None:
        raise truncated(path)
    sizes = {match[1][1:]: int(match[2]), match[3][1:]: int(match[4])}
    if set(sizes) != {b"X", b"Y"}:
        raise truncated(path)
    return ImageHeader("HDR", sizes[b"X"], sizes[b"Y"], 32, states="linear")
