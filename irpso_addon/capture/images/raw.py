"""Decodes raw files of cameras to linear values with rawpy (LibRaw), an optional extra."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..errors import CaptureError
from .headers import missing
from .linearise import Picture

if TYPE_CHECKING:
    from rawpy import RawPy

_SUFFIXES = (
    ".3fr .arw .cr2 .cr3 .crw .dcr .dng .erf .fff .iiq .kdc .mef .mos .mrw .nef .nrw .orf .pef .raf .rw2 .rwl .sr2 .srf"
    " .srw .x3f"
)
_SATURATION = 0.99  # of the range from black to white level: from here a photosite is saturated
_FLIPS = 5, 0, 1, 3, 2, 4, 6, 7  # LibRaw's flip of each EXIF orientation, the first of 8
_FOOTPRINT = 2  # radius in pixels to which demosaicing spreads a saturated photosite


def is_raw(path: Path) -> bool:
    """Return whether a file's suffix is that of a camera's raw format. The content does not tell: many are TIFF."""
    return path.suffix.lower() in _SUFFIXES.split()


class RawHeader(NamedTuple):
    """Size of a raw file, upright, in pixels. tag: its EXIF orientation, 1 to 8, which LibRaw applies."""

    width: int
    height: int
    tag: int


def raw_header(path: Path) -> RawHeader:
    """Return the header of a raw file. Raises CaptureError as ``decode_raw`` does."""
    with _opened(path) as raw:
        sizes = raw.sizes
        width, height = (sizes.iheight, sizes.iwidth) if sizes.flip & 4 else (sizes.iwidth, sizes.iheight)
        return RawHeader(width, height, _FLIPS.index(sizes.flip) or 8)


def decode_raw(path: Path | str, camera_white: bool = True) -> Picture:
    """Decode a raw file to a linear 16-bit Picture of four channels, Rec. 709 primaries, upright.

    The white balance is the camera's, or none without ``camera_white``; brightness is unchanged: a grey at the
    saturation of its strongest channel is 1, and colours may lie above. Alpha is 0 at saturated photosites. Raises
    CaptureError without rawpy, or if the file is missing, damaged or of an unknown camera.
    """
    path = Path(path)
    with _opened(path) as raw:
        import rawpy

        # By default LibRaw scales each frame by its brightest photosite.
        white = {"use_camera_wb": True} if camera_white else {"user_wb": [1.0, 1.0, 1.0, 1.0]}
        try:
            top = _range_of_balance(raw, path) if camera_white else 1.0
            mode = rawpy.HighlightMode.Clip if top == 1 else rawpy.HighlightMode.Ignore
            codes = raw.postprocess(
                gamma=(1, 1), no_auto_bright=True, adjust_maximum_thr=0.0, output_bps=16,
                output_color=rawpy.ColorSpace.sRGB, highlight_mode=mode, **white,
            )  # fmt: skip
        except (rawpy.LibRawError, ValueError) as error:
            raise _damaged(path, error) from error
        saturated = _saturated(raw)
    values = np.ones((*codes.shape[:2], 4), np.float32)
    values[..., :3] = codes * np.float32(top / 65535)
    if saturated.shape == codes.shape[:2]:
        values[..., 3][saturated] = 0
    return Picture(np.ascontiguousarray(values[::-1]), 16, top=top)


def _opened(path: Path) -> RawPy:
    try:
        import rawpy
    except ImportError as error:
        raise CaptureError(
            f"{path}: is a camera's raw file, which needs rawpy: run '{sys.executable} -m pip install rawpy', or"
            " develop it to a linear 16-bit TIFF",
            "no_decoder",
        ) from error
    if not path.is_file():
        raise missing(path)
    try:
        return rawpy.imread(str(path))
    except (rawpy.LibRawError, OSError) as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> CaptureError:
    what = error.args[0] if error.args else error
    what = what.decode(errors="replace") if isinstance(what, bytes) else what
    return CaptureError(f"{path}: LibRaw cannot read it ({what}); copy it again or develop it to TIFF", "image_unknown")


def _range_of_balance(raw: RawPy, path: Path) -> float:
    """Return the largest over the smallest multiplier of the camera's white balance; 1 where LibRaw should clip.

    By default LibRaw's smallest multiplier is 1, and it clips colours whose photosites are far from saturated. With
    ``HighlightMode.Ignore`` its largest one is 1. Files without a mosaic, other than DNG, may be balanced already.
    """
    if raw.raw_image_visible.ndim != 2 and path.suffix.lower() != ".dng":
        return 1.0
    balance = list(raw.camera_whitebalance)
    if min(balance[0], balance[2]) <= 0:  # LibRaw then takes daylight's
        balance = list(raw.daylight_whitebalance)
    used = [float(multiplier) for multiplier in balance if multiplier > 0] or [1.0]
    return max(used) / min(used)


def _saturated(raw: RawPy) -> np.ndarray:
    """Return (H, W) bool, top row first and upright: pixels to which a saturated photosite contributes."""
    levels = raw.camera_white_level_per_channel
    white = min(level for level in levels if level > 0) if levels and any(levels) else raw.white_level
    black = max(raw.black_level_per_channel)
    affected = raw.raw_image_visible >= black + _SATURATION * (white - black)
    affected = _spread(affected) if affected.ndim == 2 else affected[..., : raw.num_colors].any(axis=-1)
    flip = raw.sizes.flip
    affected = affected[:: -1 if flip & 2 else 1, :: -1 if flip & 1 else 1]
    return affected.T if flip & 4 else affected


def _spread(saturated: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: pixels within the footprint of demosaicing of a mosaic's saturated photosites (H, W) bool."""
    height, width = saturated.shape
    padded = np.pad(saturated, _FOOTPRINT)
    affected = np.zeros_like(saturated)
    for i in range(2 * _FOOTPRINT + 1):
        for j in range(2 * _FOOTPRINT + 1):
            affected |= padded[i : i + height, j : j + width]
    return affected
