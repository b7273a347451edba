"""EXIF 2.3 tags of photographs, read by Pillow: exposure, time, lens and orientation; and rotation of pixels."""

from __future__ import annotations

import io
import math
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from ...core.png import SIGNATURE, png_chunks
from .heif import heif_exif, is_heif

if TYPE_CHECKING:
    from PIL.JpegImagePlugin import JpegImageFile

JPEG_START = b"\xff\xd8"
_DAMAGE = (SyntaxError, OSError, EOFError, ValueError, LookupError, TypeError, struct.error)  # Pillow's exceptions
_FOCAL_LENGTH_35MM, _PIXELS_ACROSS, _PIXELS_DOWN = 41989, 40962, 40963
_DIAGONAL_35MM = math.hypot(36.0, 24.0)  # millimetres
_SAME_SHAPE = 0.01  # relative tolerance of proportions: beyond it a picture counts as cropped
_TIME, _SUBSECOND = 36867, 37521  # when the photograph was taken
_MAKE, _MODEL, _LENS, _FOCAL_LENGTH = 271, 272, 42036, 37386
SAME_STOPS = 1 / 6  # stops: exposures that differ by less than half of a third-stop are the same setting
_INTEROPERABILITY, _INDEX = 40965, 1
_COLOUR_SPACE, _UNCALIBRATED = 40961, 65535
_EXIF_DIRECTORY, _ORIENTATION, _EXPOSURE_TIME, _F_NUMBER, _ISO = 34665, 274, 33434, 33437, 34855


@dataclass(frozen=True)
class Exposure:
    """A photograph's exposure. seconds: above 0. f_number, iso: above 0, or None if the file has none."""

    seconds: float
    f_number: float | None = None
    iso: float | None = None

    @property
    def amount(self) -> float:
        """Factor from radiance to file values, up to one factor per camera: seconds · ISO / 100 / N²."""
        return self.seconds * (self.iso or 100.0) / 100 / (self.f_number or 1.0) ** 2


def tiff_tags(block: bytes) -> dict[int, Any]:
    """Return the tags of a TIFF file or EXIF block, of its EXIF directory and its interoperability (1 and 2).

    Damaged tags are left out.
    """
    from PIL import Image

    exif = Image.Exif()
    tags: dict[int, Any] = {}
    with _ignored_damage():
        exif.load(block)
        tags |= dict(exif)
        tags |= exif.get_ifd(_EXIF_DIRECTORY)
        tags |= exif.get_ifd(_INTEROPERABILITY)
    return tags


def open_jpeg(data: bytes) -> JpegImageFile | None:
    """Return a JPEG file with ``size`` and ``info``, pixels not decoded; None if it is damaged."""
    from PIL.JpegImagePlugin import JpegImageFile

    with _ignored_damage():
        return JpegImageFile(io.BytesIO(data))
    return None


@contextmanager
def _ignored_damage() -> Iterator[None]:
    """Suppress Pillow's exceptions and warnings about damaged files."""
    with warnings.catch_warnings(), suppress(*_DAMAGE):
        warnings.simplefilter("ignore")
        yield


def orientation_of(tags: dict[int, Any]) -> int:
    """Return the orientation, 1 to 8; 1 without a tag."""
    value = tags.get(_ORIENTATION)
    return value if isinstance(value, int) and 1 <= value <= 8 else 1


def tags_of(data: bytes) -> dict[int, Any]:
    """Return the EXIF tags of a JPEG, PNG, HEIC or TIFF file (DNG and many raw files are TIFF)."""
    return tiff_tags(_exif_block(data))


def is_adobe_rgb(tags: dict[int, Any]) -> bool:
    """Return whether a camera marked a file as Adobe RGB in DCF's way (DCF 2.0, JEITA CP-3461B): index R03."""
    index = tags.get(_INDEX, "")
    index = index.decode("ascii", "ignore") if isinstance(index, bytes) else str(index)
    return tags.get(_COLOUR_SPACE) == _UNCALIBRATED and index.startswith("R03")


def exposure_of(data: bytes) -> Exposure | None:
    """Return the exposure of a JPEG, PNG, HEIC or TIFF file (DNG and many raw files are TIFF); None without one."""
    return exposure_in(tags_of(data))


def exposure_in(tags: dict[int, Any]) -> Exposure | None:
    """Return the exposure in the tags of a file; None without one."""
    seconds, f_number, iso = (_positive(tags.get(tag)) for tag in (_EXPOSURE_TIME, _F_NUMBER, _ISO))
    return Exposure(seconds, f_number, iso) if seconds else None


def time_of(data: bytes) -> float | None:
    """Return the time of a photograph in seconds by the camera's clock, from 1970 on; None without the tag."""
    tags = tags_of(data)
    text = str(tags.get(_TIME) or "").strip("\0 ")
    part = str(tags.get(_SUBSECOND) or "").strip("\0 ")
    with suppress(ValueError):
        taken = datetime.strptime(text, "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC).timestamp()
        return taken + (float(f"0.{part}") if part.isdecimal() else 0.0)
    return None


def lens_of(data: bytes) -> dict[str, str | float]:
    """Return a file's make, model, lens, focal_length and focal_length_35mm (millimetres), without missing ones."""
    tags = tags_of(data)
    named = {"make": _MAKE, "model": _MODEL, "lens": _LENS}
    texts = {key: str(tags.get(tag) or "").strip("\0 ") for key, tag in named.items()}
    lengths = {"focal_length": _FOCAL_LENGTH, "focal_length_35mm": _FOCAL_LENGTH_35MM}
    numbers = {key: _positive(tags.get(tag)) for key, tag in lengths.items()}
    return {key: value for key, value in {**texts, **numbers}.items() if value}


def field_of_view(data: bytes, width: int, height: int) -> float | None:
    """Return the field of view in degrees over the width of an upright picture of this size; None without the tag.

    From FocalLengthIn35mmFilm, which compares diagonals (CIPA DCG-001). None also if the picture's proportions differ
    from those in the tags: it was cropped.
    """
    tags = tags_of(data)
    focal, across, down = (_positive(tags.get(tag)) for tag in (_FOCAL_LENGTH_35MM, _PIXELS_ACROSS, _PIXELS_DOWN))
    if focal is None:
        return None
    if across and down:
        shapes = max(across, down) / min(across, down), max(width, height) / min(width, height)
        if abs(shapes[0] / shapes[1] - 1) > _SAME_SHAPE:
            return None
    return math.degrees(2 * math.atan(width / 2 / focal_in_pixels(focal, width, height)))


def focal_in_pixels(focal_35mm: float, width: int, height: int) -> float:
    """Return the focal length in pixels of a picture of this size. focal_35mm: 35 mm equivalent in millimetres."""
    return focal_35mm * math.hypot(width, height) / _DIAGONAL_35MM


def _exif_block(data: bytes) -> bytes:
    if data.startswith(SIGNATURE):
        return png_chunks(data).get(b"eXIf", b"")
    if data.startswith(JPEG_START):
        return image.info.get("exif", b"") if (image := open_jpeg(data)) else b""
    return heif_exif(data) if is_heif(data) else data


def _positive(value: Any) -> float | None:
    """Return a tag's (first) number; None if it is not above 0."""
    value = value[0] if isinstance(value, tuple) else value
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if 0 < number < float("inf") else None


# The mirrorings (rows, columns) by which each orientation turns a stored picture upright, after a swap for 5 to 8.
_MIRRORINGS = {
    1: (1, 1), 2: (1, -1), 3: (-1, -1), 4: (-1, 1), 5: (1, 1), 6: (1, -1), 7: (-1, -1), 8: (-1, 1),
}  # fmt: skip


def upright(image: np.ndarray, orientation: int) -> np.ndarray:
    """Apply an EXIF orientation to an image (H, W, …), row 0 at the BOTTOM; 5 to 8 swap W and H."""
    top_first = image[::-1]
    if orientation >= 5:
        top_first = top_first.swapaxes(0, 1)
    rows, columns = _MIRRORINGS[orientation]
    return np.ascontiguousarray(top_first[::rows, ::columns][::-1])


def upright_axes(orientation: int) -> np.ndarray:
    """Return the matrix (3, 3) from a stored picture's axes (right, up, toward the viewer) to the upright one's."""
    rows, columns = _MIRRORINGS[orientation]
    swap = np.array([(0.0, -1.0), (-1.0, 0.0)]) if orientation >= 5 else np.eye(2)
    turn = np.eye(3)
    turn[:2, :2] = np.diag([columns, rows]) @ swap
    return turn
