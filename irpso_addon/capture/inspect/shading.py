"""A robust fit of matt shading to single pixels, which the checks of lights compare."""

from __future__ import annotations

import numpy as np

PIXELS, _MIN_PIXELS = 400, 100  # most and fewest pixels in a check
_BRIGHT = 90.0  # percentile of a pixel's samples: its bright sample
_SUBJECT = 0.1  # of the brightest pixels' bright sample: darker pixels are background
_DARKEST = 0.02  # of the bright sample: darker samples are shadow
_MIN_SAMPLES = 6  # least lit samples of a pixel
WIDTH = 0.03  # of the Cauchy weight, of the bright sample
_ROUNDS = 5  # of reweighting
_SCALINGS = 2  # times that the factors of photographs are fitted

Samples = tuple[np.ndarray, np.ndarray, np.ndarray]


def bright_samples(values: np.ndarray, usable: np.ndarray, lamps: np.ndarray) -> Samples | None:
    """Return the samples of the subject's pixels, None for fewer than 100 pixels.

    values: (K, T) radiance of T pixels in K photographs. usable: (K, T) bool. lamps: (K, T, 3) or (K, 1, 3) directions
    to the lamps times their irradiance. The result, for P pixels: (K, P) radiance over that of the pixel's bright
    sample, (K, P) bool of samples outside shadows, (K, P, 3) lamps.
    """
    if values.shape[1] < _MIN_PIXELS:
        return None
    values = np.where(usable, values, 0).astype(np.float64)
    bright = np.percentile(values, _BRIGHT, axis=0)
    used = usable & (values > _DARKEST * bright)
    chosen = (used.sum(axis=0) >= _MIN_SAMPLES) & (bright > _SUBJECT * np.percentile(bright, 95))
    if chosen.sum() < _MIN_PIXELS:
        return None
    lamps = np.broadcast_to(lamps, (*values.shape, 3))[:, chosen]
    return values[:, chosen] / bright[chosen], used[:, chosen], lamps


def shading_errors(values: np.ndarray, used: np.ndarray, lamps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (K, P) errors of the fit b·l to values (K, P), with one b for every pixel, and the samples' weights.

    Both are 0 where a sample is not used. Iteratively reweighted least squares with Cauchy's weights.
    """
    target, weight = np.where(used, values, 0), used.astype(np.float64)
    error = np.zeros_like(target)
    for _ in range(_ROUNDS):
        gram = np.einsum("kt,kti,ktj->tij", weight, lamps, lamps, optimize=True)
        gram += (1e-6 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-12) * np.eye(3)
        scaled = np.linalg.solve(gram, np.einsum("kt,kti->ti", weight * target, lamps)[..., None])[..., 0]
        shading = np.einsum("kti,ti->kt", lamps, scaled)
        error = np.where(used, np.maximum(shading, 0) - target, 0)
        weight = used * (shading > 0) / (1 + (error / WIDTH) ** 2)
    return error, weight


def with_factors(values: np.ndarray, used: np.ndarray, lamps: np.ndarray) -> np.ndarray:
    """Return values (K, P) with a factor for each photograph, ½ to 2 and of mean 1 in the logarithm, that fit best."""
    for _ in range(_SCALINGS):
        errors, weights = shading_errors(values, used, lamps)
        products, squares = ((weights * one * values).sum(axis=1) for one in (values + errors, values))
        factors = np.clip(products / np.maximum(squares, 1e-12), 0.5, 2)
        values = values * (factors / np.exp(np.log(factors).mean()))[:, None]
    return values
