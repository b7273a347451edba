"""Colour profiles of image files, from code values to linear Rec. 709: ICC profiles, codes of ITU-T H.273, gamma.

LittleCMS (Pillow's ImageCms) opens a profile, but transforms pixels of 8 bits only, which are too few for dark linear
values. So this module applies a profile's curves and matrix in the precision of the values.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ...core.encode import linear_from_srgb
from .primaries import ADOBE_RGB, P3_D65, REC_709, REC_2020, to_rec_709

Curve = Callable[[np.ndarray], np.ndarray]
# Linear Rec. 709 to XYZ relative to D50, white to white: the colorants of sRGB profiles (ICC, sRGB.icc; Bradford).
_REC709_TO_XYZ = np.array([[0.43607, 0.38515, 0.14307], [0.22249, 0.71687, 0.06061], [0.01392, 0.09708, 0.71410]])
_GREY = np.linspace(0, 1, 256)
_SAME_CURVE, _SAME_MATRIX = 0.003, 0.005  # largest difference of a profile that counts as linear or as sRGB
_PRIMARIES = {1: REC_709, 9: REC_2020, 12: P3_D65}  # codes of ITU-T H.273
_PRIMARY_NAMES = {1: "Rec. 709", 9: "Rec. 2020", 12: "Display P3"}
_UNSPECIFIED, _PQ, _HLG = 2, 16, 18


class ProfileError(ValueError):
    """An unusable colour profile. The message gives the reason, not the file."""


@dataclass(frozen=True, eq=False)
class ColourProfile:
    """curves: of red, green, blue: code / largest code → linear. matrix: (3, 3), linear values → linear Rec. 709."""

    name: str
    curves: tuple[Curve, Curve, Curve]
    matrix: np.ndarray

    @property
    def linear(self) -> bool:
        """Whether code values are proportional to light."""
        return self._near(_GREY)

    @property
    def srgb(self) -> bool:
        """Whether curves and primaries are those of sRGB."""
        return self._near(linear_from_srgb(_GREY)) and not self.mixes

    @property
    def mixes(self) -> bool:
        """Whether the primaries differ from those of Rec. 709."""
        return bool(np.abs(self.matrix - np.eye(3)).max() > _SAME_MATRIX)

    def linearised(self, values: np.ndarray) -> np.ndarray:
        """Return linear values (…, 3) of code values, in the profile's own primaries."""
        channels = [curve(values[..., c]) for c, curve in enumerate(self.curves)]
        return np.stack(channels, axis=-1).astype(values.dtype, copy=False)

    def in_rec709(self, linear: np.ndarray) -> np.ndarray:
        """Return values (…, 3) in Rec. 709 primaries; negative channels, outside its gamut, become 0."""
        return np.maximum(linear @ self.matrix.T.astype(linear.dtype), 0) if self.mixes else linear

    def _near(self, expected: np.ndarray) -> bool:
        return all(float(np.abs(curve(_GREY) - expected).max()) < _SAME_CURVE for curve in self.curves)


@lru_cache(maxsize=64)
def profile_of_icc(icc: bytes) -> ColourProfile:
    """Return the profile of an ICC profile of curves and a matrix (RGB) or of one curve (grey). Raises ProfileError."""
    from PIL import ImageCms

    try:
        profile = ImageCms.ImageCmsProfile(io.BytesIO(icc)).profile
        tags = _tags(icc)
        name = (profile.profile_description or "").strip() or "without a name"
        if b"cicp" in tags:
            _curve_of_h273(tags[b"cicp"][9])
        if profile.xcolor_space.strip() == "GRAY" and b"kTRC" in tags:
            return ColourProfile(name, (_curve(tags[b"kTRC"]),) * 3, np.eye(3))
        if profile.xcolor_space.strip() != "RGB" or not profile.is_matrix_shaper:
            raise ProfileError(f"its colour profile ({name}) is no matrix with curves")
        red, green, blue = (_curve(tags[tag]) for tag in (b"rTRC", b"gTRC", b"bTRC"))
        colorants = profile.red_colorant, profile.green_colorant, profile.blue_colorant
        matrix = np.linalg.solve(_REC709_TO_XYZ, np.array([c[0] for c in colorants if c]).T)
        return ColourProfile(name, (red, green, blue), matrix)
    except ProfileError:
        raise
    except (OSError, TypeError, LookupError, ValueError, struct.error, np.linalg.LinAlgError) as error:
        raise ProfileError("its colour profile is damaged") from error


def profile_of_h273(primaries: int, transfer: int, full_range: int = 1) -> ColourProfile:
    """Return the profile of codes of ITU-T H.273 (nclx of HEIF, cICP of PNG); sRGB for unspecified ones.

    Raises ProfileError for HDR (PQ, HLG), rare codes and values that do not have the full range.
    """
    if not full_range:
        raise ProfileError("its values have the narrow range of video (cICP)")
    primaries = 1 if primaries == _UNSPECIFIED else primaries
    curve = _curve_of_h273(transfer)
    if primaries not in _PRIMARIES:
        raise ProfileError(f"its colour primaries (H.273 code {primaries}) are not known")
    matrix = to_rec_709(_PRIMARIES[primaries])
    return ColourProfile(_PRIMARY_NAMES[primaries], (curve, curve, curve), np.eye(3) if matrix is None else matrix)


@lru_cache(maxsize=1)
def adobe_rgb() -> ColourProfile:
    """Return the profile Adobe RGB (1998), whose exponent is 2 + 51/256."""
    curve = _parametric(0, [2.19921875])
    return ColourProfile("Adobe RGB", (curve, curve, curve), np.asarray(to_rec_709(ADOBE_RGB)))


def profile_of_gamma(power: float) -> ColourProfile:
    """Return the profile of values whose power is linear, in Rec. 709 primaries (PNG, third edition, 13.13)."""
    return ColourProfile(f"gamma {power:.2f}", (_parametric(0, [power]),) * 3, np.eye(3))


def linear_from_rec709(values: np.ndarray) -> np.ndarray:
    """Return scene-linear values of a video signal 0…1: the inverse of Rec. ITU-R BT.709-6, item 1.2."""
    values = np.asarray(values)
    curve = np.power((np.maximum(values, 0.081) + 0.099) / 1.099, 1 / 0.45)
    return np.where(values < 0.081, values / 4.5, curve).astype(values.dtype, copy=False)


def _curve_of_h273(transfer: int) -> Curve:
    if transfer in (_PQ, _HLG):
        raise ProfileError("it is an HDR picture (PQ or HLG), which is not read")
    curves: dict[int, Curve] = {
        1: linear_from_rec709, 6: linear_from_rec709, 14: linear_from_rec709, 15: linear_from_rec709,
        _UNSPECIFIED: linear_from_srgb, 4: lambda v: np.maximum(v, 0) ** 2.2, 5: lambda v: np.maximum(v, 0) ** 2.8,
        8: lambda v: v, 13: linear_from_srgb,
    }  # fmt: skip
    if transfer not in curves:
        raise ProfileError(f"its transfer function (H.273 code {transfer}) is not known")
    return curves[transfer]


def _tags(icc: bytes) -> dict[bytes, bytes]:
    """Return the data of a profile's tags (ICC.1:2022, 7.3)."""
    (count,) = struct.unpack_from(">I", icc, 128)
    rows = (struct.unpack_from(">4sII", icc, 132 + 12 * n) for n in range(min(count, 256)))
    return {name: icc[start : start + size] for name, start, size in rows}


def _curve(tag: bytes) -> Curve:
    """Return the curve of a curveType or parametricCurveType (ICC.1:2022, 10.6 and 10.18)."""
    kind, (first, second) = tag[:4], struct.unpack_from(">HH", tag, 8)
    if kind == b"curv":
        count = first << 16 | second
        if count == 0:
            return lambda values: values
        codes = np.frombuffer(tag, ">u2", count, 12)
        if count == 1:
            return _parametric(0, [codes[0] / 256])
        places, table = np.linspace(0, 1, count), codes / 65535
        return lambda values: np.interp(values, places, table)
    if kind != b"para":
        raise ProfileError(f"its colour profile has a curve of the kind {kind!r}")
    count = (1, 3, 4, 5, 7)[first]
    return _parametric(first, [v / 65536 for v in struct.unpack_from(f">{count}i", tag, 12)])


def _parametric(kind: int, coefficients: list[float]) -> Curve:
    """Return the curve Y = (a X + b)^g + e for X ≥ d, c X + f below, from the coefficients of one of the five kinds."""
    g, a, b, c, d, e, f = [*coefficients, *[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0][len(coefficients) - 1 :]][:7]
    if kind in (1, 2):
        d, e, f, c = -b / a, c, c, 0.0

    def curve(values: np.ndarray) -> np.ndarray:
        return np.where(values >= d, np.maximum(a * values + b, 0) ** g + e, c * values + f)

    return curve
