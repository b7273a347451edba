"""Conversion of linear RGB of other primaries (ACES, Rec. 2020, P3) to linear Rec. 709."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

# x and y of red, green, blue and white. ITU-R BT.709; also OpenEXR's default for a file that states none.
REC_709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
_D65, _ACES_WHITE = REC_709[6:], (0.32168, 0.33767)
REC_2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *_D65)  # ITU-R BT.2020
ADOBE_RGB = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, *_D65)  # Adobe RGB (1998) Color Image Encoding
P3_D65 = (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *_D65)  # SMPTE EG 432-1
# colorInteropID → chromaticities of linear spaces: Blender 5 and OpenColorIO 2.5 write only this name (Color
# Interop Forum 2024); those of ACES: SMPTE ST 2065-1 and Academy S-2014-004.
BY_NAME = {
    "lin_rec709_scene": REC_709, "lin_rec2020_scene": REC_2020, "lin_p3d65_scene": P3_D65,
    "lin_ap1_scene": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, *_ACES_WHITE),
    "lin_ap0_scene": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, *_ACES_WHITE),
}  # fmt: skip
UNKNOWN_SPACES = ("", "data", "unknown")  # names that identify no colour space
_SAME = 2e-3  # tolerance of equal chromaticities: programs write few digits
# Cone responses of XYZ after Bradford (Lam 1985), as in ICC.1:2010, Annex E.
_BRADFORD = np.array([(0.8951, 0.2664, -0.1614), (-0.7502, 1.7135, 0.0367), (0.0389, -0.0685, 1.0296)])


def to_rec_709(chromaticities: Sequence[float]) -> np.ndarray | None:
    """Return the matrix (3, 3) from linear RGB of eight chromaticities to linear Rec. 709; None for those of Rec. 709.

    White stays white (Bradford). Raises ValueError if the chromaticities define no colour space.
    """
    source_xy = np.asarray(chromaticities, np.float64)
    if np.allclose(source_xy, REC_709, rtol=0, atol=_SAME):
        return None
    (source, source_white), (target, target_white) = _xyz_of(source_xy), _xyz_of(np.array(REC_709))
    adapted = np.linalg.inv(_BRADFORD) @ np.diag(_BRADFORD @ target_white / (_BRADFORD @ source_white)) @ _BRADFORD
    return np.linalg.inv(target) @ adapted @ source


def _xyz_of(chromaticities: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrix (3, 3) from RGB to XYZ, and the XYZ of white (SMPTE RP 177)."""
    x, y = chromaticities.reshape(4, 2).T
    with np.errstate(divide="ignore", invalid="ignore"):
        xyz = np.stack([x / y, np.ones(4), (1 - x - y) / y])
    if not np.isfinite(xyz).all() or abs(np.linalg.det(xyz[:, :3])) < 1e-6:
        raise ValueError("chromaticities of no colour space")
    scale = np.linalg.solve(xyz[:, :3], xyz[:, 3])
    return xyz[:, :3] * scale, xyz[:, 3]
