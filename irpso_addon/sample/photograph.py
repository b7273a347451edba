"""Writes photographs like a phone's: 8-bit sRGB in JPEG, with EXIF."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..core.encode import srgb_from_linear
from .sensor import Sensor

MAKE, MODEL = "IRPSO", "sample rendered by Cycles, not a camera"
_SENSOR = Sensor(gain=1.0, read=0.002, shot=0.01)
_QUALITY = 95
# EXIF 2.3: tags of the image and of its EXIF directory.
_MAKE, _MODEL, _ORIENTATION, _SOFTWARE, _DIRECTORY = 271, 272, 274, 305, 34665
_EXPOSURE_TIME, _F_NUMBER, _ISO, _VERSION, _COLOUR_SPACE = 33434, 33437, 34855, 36864, 40961
_WIDTH, _HEIGHT, _FOCAL_35MM = 40962, 40963, 41989
_UPRIGHT, _SRGB = 1, 1


def developed(radiance: np.ndarray, seed: int) -> np.ndarray:
    """Return (H, W, 3) uint8 sRGB codes, row 0 at the TOP, of radiance, row 0 at the bottom; 1 is full scale."""
    finite = np.minimum(np.nan_to_num(radiance, nan=0.0), 1e4)
    codes = srgb_from_linear(_SENSOR.expose(finite, seed))
    return np.round(255 * codes[::-1]).astype(np.uint8)


def write_photograph(path: Path, codes: np.ndarray, focal_35mm: int) -> None:
    """Write (H, W, 3) uint8 sRGB codes, row 0 at the top, as JPEG. focal_35mm: equivalent focal length."""
    from PIL import Image
    from PIL.TiffImagePlugin import IFDRational

    exif = Image.Exif()
    exif[_MAKE], exif[_MODEL], exif[_SOFTWARE], exif[_ORIENTATION] = MAKE, MODEL, "irpso sample", _UPRIGHT
    height, width = codes.shape[:2]
    exif.get_ifd(_DIRECTORY).update({
        _EXPOSURE_TIME: IFDRational(1, 60), _F_NUMBER: IFDRational(28, 10), _ISO: 64, _VERSION: b"0230",
        _COLOUR_SPACE: _SRGB, _WIDTH: width, _HEIGHT: height, _FOCAL_35MM: focal_35mm,
    })  # fmt: skip
    Image.fromarray(codes).save(path, "JPEG", quality=_QUALITY, exif=exif)
