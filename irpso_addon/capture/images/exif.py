"""The tags of photographs (EXIF 2.3), which Pillow reads: exposure and orientation; and turning pixels upright."""

from __future__ import annotations

import io
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...core.png import SIGNATURE, png_chunks

if TYPE_CHECKING:
    from PIL.JpegImagePlugin import JpegImageFile

JPEG_START = b"\xff\xd8"
_DAMAGE = (SyntaxError, OSError, EOFError, ValueError, LookupError, TypeError, struct.error)  # what Pillow raises of it
_EXIF_DIRECTORY, _ORIENTATION, _EXPOSURE_TIME, _F_NUMBER, _ISO = 34665, 274, 33434, 33437, 34855


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


def tiff_tags(block: bytes) -> dict[int, Any]:
    """Return the tags of a TIFF structure (a TIFF file, or an EXIF block) and of its EXIF directory.

    What is damaged is left out: {} where nothing can be read.
    """
    from PIL import Image

    exif = Image.Exif()
    tags: dict[int, Any] = {}
    with _damage_is_no_news():
        exif.load(block)
        tags |= dict(exif)
        tags |= exif.get_ifd(_EXIF_DIRECTORY)
    return tags


def open_jpeg(data: bytes) -> JpegImageFile | None:
    """Return a JPEG file with ``size`` and ``info``, its pixels not decoded; None where it is damaged."""
    from PIL.JpegImagePlugin import JpegImageFile

    with _damage_is_no_news():
        return JpegImageFile(io.BytesIO(data))
    return None


@contextmanager
def _damage_is_no_news() -> Iterator[None]:
    """Pass over what Pillow raises, and warns of, where files are damaged."""
    with warnings.catch_warnings(), suppress(*_DAMAGE):
        warnings.simplefilter("ignore")
        yield


def orientation_of(tags: dict[int, Any]) -> int:
    """Return the orientation, 1 to 8; 1 where the tags hold none."""
    value = tags.get(_ORIENTATION)
    return value if isinstance(value, int) and 1 <= value <= 8 else 1


def exposure_of(data: bytes) -> Exposure | None:
    """Return the exposure that a JPEG, PNG or TIFF file tells (a DNG and many raw files are TIFF); None without one."""
    tags = tiff_tags(_exif_block(data))
    seconds, f_number, iso = (_positive(tags.get(tag)) for tag in (_EXPOSURE_TIME, _F_NUMBER, _ISO))
    return Exposure(seconds, f_number, iso) if seconds else None


def _exif_block(data: bytes) -> bytes:
    if data.startswith(SIGNATURE):
        return png_chunks(data).get(b"eXIf", b"")
    if data.startswith(JPEG_START):
        return image.info.get("exif", b"") if (image := open_jpeg(data)) else b""
    return data


def _positive(value: Any) -> float | None:
    """Return a tag's number, the first where there are several; None where it is not above 0."""
    value = value[0] if isinstance(value, tuple) else value
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if 0 < number < float("inf") else None


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
