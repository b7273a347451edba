"""Headers of image files: kind, size, depth, orientation, encoding; and detection of truncated files."""

from __future__ import annotations

import re
import struct
import zlib
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...core.png import SIGNATURE, png_chunks
from ..errors import CaptureError
from .exif import JPEG_START, Exposure, exposure_in, is_adobe_rgb, open_jpeg, orientation_of, tags_of, tiff_tags
from .heif import heif_header, is_heif

_HDR_SIZE = re.compile(rb"\n([-+][XY]) (\d+) ([-+][XY]) (\d+)\n")
_HDR_ORIENTATIONS = {b"-Y+X": 1, b"-Y-X": 2, b"+Y-X": 3, b"+Y+X": 4}  # by where the first pixel lies
_HDR_GAIN = re.compile(rb"\n(EXPOSURE|COLORCORR)=([^\n]*)")
_NO_SEGMENT = b"\xd9\xda"  # end of a JPEG file, and start of a scan
_GAMMAS, _SAME_GAMMA = {"linear": 1.0, "srgb": 1 / 2.2}, 0.01  # of gAMA chunks; their relative tolerance
_PROFILES = {b"sRGB", b"iCCP", b"cICP"}  # PNG chunks that name a colour space
_MAX_ICC = 1 << 22  # bytes
_WIDTH, _HEIGHT, _BITS, _SAMPLE_FORMAT, _ICC_PROFILE, _COLOUR_SPACE = 256, 257, 258, 339, 34675, 40961  # TIFF tags
_PHOTOMETRIC = 262
_FLOATS, _SRGB, _WHITE_IS_ZERO = 3, 1, 0  # of the sample format, of the colour space, of the photometric tag


@dataclass(frozen=True)
class ImageHeader:
    """Header of one image. kind: "EXR", "PNG", "JPEG", "TIFF", "HDR" or "HEIF". width, height: pixels, upright.

    bits: 8, 16, or 32 for floats; of HEIF also 10 and 12. orientation: EXIF orientation of the stored pixels, 1 to 8;
    of HEIF 1, because libheif applies ``applied``; of HDR by the signs of its size. states: the encoding that the file
    states, "srgb" or "linear", "" for none; a colour profile counts as "srgb": nearly all are similar. icc: the colour
    profile. cicp: the arguments of ``profile_of_h273``. exposure: by EXIF, None without. adobe_rgb: by EXIF, where no
    profile says otherwise. gamma: the power from samples to light that a PNG states, 0 without one and for about that
    of linear values or sRGB. gains: red, green, blue of an HDR file over the radiance.
    """

    kind: str
    width: int
    height: int
    bits: int
    orientation: int = 1
    states: str = ""
    icc: bytes = b""
    cicp: tuple[int, ...] | None = None
    exposure: Exposure | None = None
    applied: int = 1
    adobe_rgb: bool = False
    gamma: float = 0.0
    gains: tuple[float, ...] = (1.0, 1.0, 1.0)

    @property
    def tag(self) -> int:
        """EXIF orientation as stored, 1 to 8."""
        return self.applied if self.kind == "HEIF" else self.orientation


def read_header(path: Path) -> ImageHeader:
    """Return the header of an image that is no EXR. Raises CaptureError if it is missing, unknown or cut short."""
    data = read_bytes(path)
    if data.startswith(SIGNATURE):
        header = _png(path, data)
    elif data.startswith(JPEG_START):
        header = _jpeg(path, data)
    elif data[:4] in (b"II*\0", b"MM\0*"):
        header = _tiff(path, data)
    elif data[:2] == b"#?":
        header = _hdr(path, data)
    elif is_heif(data):
        heif = heif_header(data, str(path))
        tags = tags_of(data)
        header = ImageHeader("HEIF", heif.width, heif.height, heif.bits, 1, "srgb", heif.icc, heif.cicp,
                             exposure_in(tags), orientation_of(tags))  # fmt: skip
    else:
        what = "is no PNG, JPEG, TIFF, HDR, HEIC or EXR image; replace it by one" if data else "is empty; copy it again"
        raise CaptureError(f"{path}: {what}", "image_unknown")
    if header.orientation >= 5:
        header = replace(header, width=header.height, height=header.width)
    if header.width < 1 or header.height < 1:
        raise CaptureError(f"{path}: says it has no pixels; export it again", "image_unknown")
    return header


def read_bytes(path: Path, most: int = -1) -> bytes:
    """Return a file's bytes, or its first ``most``. Raises CaptureError if it is missing or unreadable."""
    try:
        with path.open("rb") as file:
            return file.read(most)
    except FileNotFoundError as error:
        raise missing(path) from error
    except OSError as error:
        raise CaptureError(f"{path}: cannot be read ({error.strerror}); check what it is", "missing") from error


def missing(path: Path, named_in: str = "its name") -> CaptureError:
    """Return the error for a file that does not exist. named_in: what to correct if the file is elsewhere."""
    return CaptureError(f"{path}: this image is not there; put it there, or correct {named_in}", "missing")


def truncated(path: Path) -> CaptureError:
    """Return the error for a file that ends too early."""
    return CaptureError(f"{path}: is cut short or damaged; copy or export it again", "image_truncated")


def _stated_by(tags: dict[int, Any]) -> str:
    """Return the encoding that EXIF states, "srgb" or ""; weaker than profiles and chunks."""
    return "srgb" if tags.get(_COLOUR_SPACE) == _SRGB else ""


def _png(path: Path, data: bytes) -> ImageHeader:
    chunks = png_chunks(data)
    if not chunks.keys() >= {b"IHDR", b"IEND"} or len(chunks[b"IHDR"]) < 9:
        raise truncated(path)
    width, height, bits = struct.unpack_from(">IIB", chunks[b"IHDR"])
    states, gamma = _png_gamma(chunks.get(b"gAMA", b""))
    if chunks.keys() & _PROFILES:  # they override gAMA
        states, gamma = "srgb", 0.0
    tags = tiff_tags(chunks.get(b"eXIf", b""))
    states = states or _stated_by(tags)
    # cICP overrides iCCP (Portable Network Graphics, third edition, 4.3).
    numbers = chunks.get(b"cICP", b"")
    cicp = (numbers[0], numbers[1], numbers[3]) if len(numbers) == 4 else None
    icc = b"" if cicp else _png_icc(chunks.get(b"iCCP", b""))
    bits, turn = 16 if bits == 16 else 8, orientation_of(tags)
    return ImageHeader("PNG", width, height, bits, turn, states, icc, cicp, exposure_in(tags), gamma=gamma)


def _png_gamma(chunk: bytes) -> tuple[str, float]:
    """Return ``states`` and ``gamma`` of a gAMA chunk: 100 000 over the power; 0 is to be ignored (PNG, 11.2.2)."""
    value = int.from_bytes(chunk, "big") / 100_000
    near = [encoding for encoding, usual in _GAMMAS.items() if abs(value / usual - 1) <= _SAME_GAMMA]
    if near or not value:
        return near[0] if near else "", 0.0
    return "srgb", 1 / value


def _png_icc(chunk: bytes) -> bytes:
    """Return the profile of an iCCP chunk: a name, 0, the method, and deflated data."""
    with suppress(zlib.error):
        return zlib.decompressobj().decompress(chunk.partition(b"\0")[2][1:], _MAX_ICC)
    return b""


def _jpeg(path: Path, data: bytes) -> ImageHeader:
    image = open_jpeg(data)
    if image is None or data.find(b"\xff\xd9", _jpeg_scan(data)) < 0:
        raise truncated(path)
    tags = tiff_tags(image.info.get("exif", b""))
    icc = image.info.get("icc_profile") or b""
    adobe = not icc and is_adobe_rgb(tags)
    states = "srgb" if icc or adobe else _stated_by(tags)
    return ImageHeader("JPEG", *image.size, 8, orientation_of(tags), states, icc, None, exposure_in(tags),
                       adobe_rgb=adobe)  # fmt: skip


def _jpeg_scan(data: bytes) -> int:
    """Return the offset of a JPEG file's first scan, behind the segments, which may hold a thumbnail with its own end.

    In a scan the end mark occurs only at its end (ITU-T T.81, B.1.1.2). A phone may append a video.
    """
    place = 2
    while place + 4 <= len(data) and data[place] == 0xFF and data[place + 1] not in _NO_SEGMENT:
        fill = data[place + 1] == 0xFF  # any number of these may precede a marker
        place += 1 if fill else 2 + int.from_bytes(data[place + 2 : place + 4], "big")
    return place


def _tiff(path: Path, data: bytes) -> ImageHeader:
    tags = tiff_tags(data)
    width, height, bits, sample_format = (tags.get(tag, 1) for tag in (_WIDTH, _HEIGHT, _BITS, _SAMPLE_FORMAT))
    if _WIDTH not in tags or _HEIGHT not in tags:
        raise truncated(path)
    depth, is_float = np.max(bits), np.max(sample_format) == _FLOATS
    if not is_float and depth > 16:
        raise CaptureError(f"{path}: holds {depth}-bit whole numbers; save it with 8 or 16 bits", "image_unknown")
    if depth > 8 and tags.get(_PHOTOMETRIC) == _WHITE_IS_ZERO:  # measured on bpy 5.0.1: only 8 bits are inverted
        raise CaptureError(f"{path}: stores white as 0 (WhiteIsZero); save it with black as 0", "image_unknown")
    states = "linear" if is_float else "srgb" if _ICC_PROFILE in tags else _stated_by(tags)
    bits, icc = 32 if is_float else 16 if depth > 8 else 8, tags.get(_ICC_PROFILE, b"")
    icc = icc if isinstance(icc, bytes) else b""
    return ImageHeader("TIFF", width, height, bits, orientation_of(tags), states, icc, None, exposure_in(tags))


def _hdr(path: Path, data: bytes) -> ImageHeader:
    match = _HDR_SIZE.search(data[:8192])
    if match is None:
        raise truncated(path)
    down, height, along, width = match.groups()
    if (down + along) not in _HDR_ORIENTATIONS:
        raise CaptureError(f"{path}: stores columns, not rows of pixels; save it with -Y and +X", "image_unknown")
    turn = _HDR_ORIENTATIONS[down + along]
    gains = _hdr_gains(path, data[: match.start()])
    return ImageHeader("HDR", int(width), int(height), 32, turn, "linear", gains=gains)


def _hdr_gains(path: Path, head: bytes) -> tuple[float, ...]:
    """Return ``gains``: the product of all lines EXPOSURE and COLORCORR (Radiance file formats, picture files)."""
    gains = np.ones(3)
    for key, text in _HDR_GAIN.findall(head):
        try:
            gains *= [float(number) for number in text.split()]
        except ValueError:
            gains[:] = np.nan
        if not (np.isfinite(gains) & (gains > 0)).all():
            what = f"states {key.decode()}={text.decode(errors='replace').strip()}, which is no gain above 0"
            raise CaptureError(f"{path}: {what}; correct its header, or export it again", "image_unknown")
    return tuple(gains.tolist())
