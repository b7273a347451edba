"""Decodes HEIC and HEIF photographs of phones with pillow-heif (libheif), an optional library.

libheif returns upright pictures (it applies the boxes irot and imir). The EXIF orientation repeats this rotation, so
this module does not apply it.
"""

from __future__ import annotations

import io
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import CaptureError
from .linearise import Picture

if TYPE_CHECKING:
    from pillow_heif import HeifFile

SUFFIXES = (".heic", ".heif", ".hif")
_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1")
_DAMAGE = (ValueError, EOFError, SyntaxError, RuntimeError, OSError)  # of pillow-heif


@dataclass(frozen=True)
class HeifHeader:
    """Header of the primary image. width, height: pixels, upright. bits: 8, 10 or 12. icc: colour profile or b"".

    cicp: colour primaries and transfer function by the codes of ITU-T H.273, or None.
    """

    width: int
    height: int
    bits: int
    icc: bytes
    cicp: tuple[int, int] | None


def is_heif(data: bytes) -> bool:
    """Return whether a file starts with the brand of a HEIF file of HEVC images."""
    return data[4:8] == b"ftyp" and data[8:12] in _BRANDS


def heif_header(data: bytes, where: str) -> HeifHeader:
    """Return the header of the primary image. Raises CaptureError as ``decode_heif`` does."""
    file = _opened(data, where)
    nclx = file.info.get("nclx_profile")
    cicp = (nclx["color_primaries"], nclx["transfer_characteristics"]) if nclx else None
    width, height = file.size
    return HeifHeader(width, height, file.info["bit_depth"], file.info.get("icc_profile") or b"", cicp)


def heif_exif(data: bytes) -> bytes:
    """Return the EXIF block, b"" for none. Raises CaptureError as ``decode_heif`` does."""
    return _opened(data, "a HEIC photograph").info.get("exif") or b""


def decode_heif(path: Path, data: bytes) -> Picture:
    """Decode the primary image of a HEIF file's bytes, upright, with all its bits.

    A gain map, which brightens highlights on HDR displays, is not applied. Raises CaptureError naming ``path`` if
    pillow-heif is not installed or the file is damaged.
    """
    file = _opened(data, str(path))
    try:
        codes = np.asarray(file)
    except _DAMAGE as error:
        raise _damaged(str(path), error) from error
    codes = codes if codes.ndim == 3 else codes[..., None]
    bits = file.info["bit_depth"]
    return Picture(np.ascontiguousarray(codes[::-1]) / np.float32(2**bits - 1), bits)


def _opened(data: bytes, where: str) -> HeifFile:
    try:
        import pillow_heif
    except ImportError as error:
        raise CaptureError(
            f"{where}: HEIC needs pillow-heif; run '{sys.executable} -m pip install pillow-heif', or export the"
            " photographs as JPEG or TIFF",
            "no_decoder",
        ) from error
    try:
        return pillow_heif.open_heif(io.BytesIO(data), convert_hdr_to_8bit=False, hdr_to_16bit=False)
    except _DAMAGE as error:
        raise _damaged(where, error) from error


def _damaged(where: str, error: Exception) -> CaptureError:
    what = str(error).strip().split("\n")[0].rstrip(".")
    return CaptureError(f"{where}: cannot be decoded as HEIC ({what}); copy or export it again", "image_truncated")
