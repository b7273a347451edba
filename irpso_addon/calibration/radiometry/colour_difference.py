"""CIELAB of linear Rec. 709, and the colour difference CIEDE2000. Plain numpy."""

from __future__ import annotations

import numpy as np

# Linear Rec. 709 to XYZ under D65 (IEC 61966-2-1).
_XYZ = np.array([(0.4124, 0.3576, 0.1805), (0.2126, 0.7152, 0.0722), (0.0193, 0.1192, 0.9505)])
_WHITE = _XYZ.sum(axis=1)
_CHROMA = 25.0**7  # constant of G and R_C
_HALF_TURN = 180 + 1e-9  # degrees: tolerates rounding of arctan2 at exactly opposite hues


def lab_of_linear(rgb: np.ndarray) -> np.ndarray:
    """Return CIELAB (…, 3), white D65, of linear Rec. 709 (…, 3); the linear part is extended to negative XYZ."""
    ratio = np.asarray(rgb, np.float64) @ _XYZ.T / _WHITE
    low = (6 / 29) ** 3
    x, y, z = np.moveaxis(np.where(ratio > low, np.cbrt(ratio), ratio * (29 / 6) ** 2 / 3 + 4 / 29), -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def delta_e_2000(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return CIEDE2000 (…) of CIELAB colours (…, 3), with k_L = k_C = k_H = 1.

    Sharma, Wu & Dalal 2005, "The CIEDE2000 Color-Difference Formula: Implementation Notes, Supplementary Test Data, and
    Mathematical Observations", equations 2 to 22.
    """
    (l1, a1, b1), (l2, a2, b2) = (np.moveaxis(np.asarray(lab, np.float64), -1, 0) for lab in (first, second))
    # Equations 2–7: a' stretches neutral colours; chroma and hue of (a', b).
    mean = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2
    stretch = 1.5 - 0.5 * np.sqrt(mean**7 / (mean**7 + _CHROMA))
    c1, c2 = np.hypot(stretch * a1, b1), np.hypot(stretch * a2, b2)
    h1, h2 = (np.degrees(np.arctan2(b, stretch * a)) % 360 for a, b in ((a1, b1), (a2, b2)))
    # Equations 8–11: ΔH' = 2 √(C1' C2') sin(Δh'/2), with Δh' in −180…180.
    turn = h2 - h1
    turn = np.where(turn > _HALF_TURN, turn - 360, np.where(turn < -_HALF_TURN, turn + 360, turn))
    turn = np.where(c1 * c2 == 0, 0.0, turn)
    lightness, chroma = l2 - l1, c2 - c1
    hue = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn) / 2)
    # Equations 12–14: means; that of the hues lies on the shorter arc.
    mean_l, mean_c, total = (l1 + l2) / 2, (c1 + c2) / 2, h1 + h2
    far = np.abs(h1 - h2) > _HALF_TURN
    mean_h = np.where(far, np.where(total < 360, total + 360, total - 360), total) / 2
    mean_h = np.where(c1 * c2 == 0, total, mean_h)
    # Equations 15–22.
    waves = ((-0.17, 1, -30), (0.24, 2, 0), (0.32, 3, 6), (-0.20, 4, -63))
    t = 1 + sum(size * np.cos(np.radians(times * mean_h + phase)) for size, times, phase in waves)
    angle = 30 * np.exp(-(((mean_h - 275) / 25) ** 2))
    s_l = 1 + 0.015 * (mean_l - 50) ** 2 / np.sqrt(20 + (mean_l - 50) ** 2)
    s_c, s_h = 1 + 0.045 * mean_c, 1 + 0.015 * mean_c * t
    rotation = -np.sin(np.radians(2 * angle)) * 2 * np.sqrt(mean_c**7 / (mean_c**7 + _CHROMA))
    parts = lightness / s_l, chroma / s_c, hue / s_h
    square = parts[0] ** 2 + parts[1] ** 2 + parts[2] ** 2 + rotation * parts[1] * parts[2]
    return np.sqrt(np.maximum(square, 0))
