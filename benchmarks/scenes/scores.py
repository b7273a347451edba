"""Errors of maps and pictures against the truth. numpy and scipy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

# Wang et al. 2004, Image Quality Assessment: a window of 11 × 11 with σ = 1.5, K1 = .01, K2 = .03.
_SIGMA, _RADIUS = 1.5, 5
_C1, _C2 = 0.01**2, 0.03**2


@dataclass(frozen=True)
class Errors:
    """Mean, median and 95th percentile of the errors at all texels."""

    mean: float
    median: float
    p95: float

    @staticmethod
    def of(values: np.ndarray) -> Errors:
        """Return the summary of an array of errors."""
        return Errors(float(values.mean()), float(np.median(values)), float(np.percentile(values, 95)))


def angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return (…) degrees between unit vectors (…, 3), from the chord: precise for small angles."""
    chord = np.linalg.norm(np.asarray(a, np.float64) - b, axis=-1)
    return np.degrees(2 * np.arcsin(np.minimum(chord / 2, 1)))


def psnr(a: np.ndarray, b: np.ndarray, mask: np.ndarray) -> float:
    """Return the peak signal-to-noise ratio in dB of pictures (H, W, C) in 0…1 over the mask (H, W)."""
    error = np.mean((np.asarray(a, np.float64) - b)[mask] ** 2)
    return float(-10 * np.log10(max(error, 1e-12)))  # at most 120 dB: pictures equal to six digits


def ssim(a: np.ndarray, b: np.ndarray, mask: np.ndarray) -> float:
    """Return the structural similarity (Wang et al. 2004) of pictures (H, W, C) in 0…1, mean over the mask (H, W).

    Pixels outside the mask count as black in both.
    """
    return float(np.mean([_ssim_map(a[..., c] * mask, b[..., c] * mask)[mask].mean() for c in range(a.shape[-1])]))


def _ssim_map(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)

    def mean(values: np.ndarray) -> np.ndarray:
        return gaussian_filter(values, _SIGMA, radius=_RADIUS)

    mu_a, mu_b = mean(a), mean(b)
    var_a, var_b, cov = mean(a * a) - mu_a**2, mean(b * b) - mu_b**2, mean(a * b) - mu_a * mu_b
    likeness = (2 * mu_a * mu_b + _C1) * (2 * cov + _C2)
    return likeness / ((mu_a**2 + mu_b**2 + _C1) * (var_a + var_b + _C2))
