"""Fits a frame by three basis images of the others, which span a matt surface under all distant lights.

Shashua 1997; highlights and shadow rims, which the sum does not explain, get low weights as in Hager and Belhumeur
1998. The fit separates a moved frame from a moved light.
"""

from __future__ import annotations

import numpy as np

IMAGES = 3
_BLUR = 0.7  # pixels: suppresses noise, and widens edges for their derivatives
_SHADOW = 0.08  # of a frame's 90th percentile: darker pixels are shadow, which the sum does not explain
_OUTLIER = 1.5  # median residuals: the Cauchy scale of the weights
_ROUNDS = 5  # of reweighting


def scale_of(frame: np.ndarray) -> float:
    """Return the 90th percentile of a frame, 1 for a black one."""
    return float(np.percentile(frame, 90)) or 1.0


def low_pass(shape: tuple[int, ...]) -> np.ndarray:
    """Return the factors of a slight Gaussian blur for an ``rfft2`` of frames (H, W)."""
    blur = _BLUR**2 * 2 * np.pi**2
    return np.exp(-blur * (np.fft.fftfreq(shape[0])[:, None] ** 2 + np.fft.rfftfreq(shape[1])[None] ** 2))


def fading(shape: tuple[int, ...]) -> np.ndarray:
    """Return (H, W) float32 weights that fade out toward the image's border."""
    return np.outer(*(np.hanning(side + 2)[1:-1] for side in shape)).astype(np.float32)


def lit(image: np.ndarray) -> np.ndarray:
    """Return (H·W,) bool: pixels outside shadows of a frame divided by its ``scale_of``."""
    return (image > _SHADOW).ravel()


def basis(flat: np.ndarray, products: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the principal images (3, N) float32 of the frames ``others`` of ``flat`` (K, N), of Gram matrix (K, K)."""
    vectors = np.linalg.eigh(products[np.ix_(others, others)])[1][:, -IMAGES:]
    mixed = np.zeros((vectors.shape[1], len(flat)), np.float32)
    mixed[:, others] = vectors.T
    return mixed @ flat


def factors(rows: np.ndarray, target: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return (R,) float64 coefficients of rows (R, N) whose sum fits a target (N,), by weighted least squares."""
    weighted = rows * weight
    normal, right_side = (weighted @ rows.T).astype(np.float64), (weighted @ target).astype(np.float64)
    return np.linalg.lstsq(normal, right_side, rcond=None)[0]


def weights(error: np.ndarray, is_lit: np.ndarray) -> np.ndarray:
    """Return (N,) float32 weights of pixels for the next fit from the errors (N,) of this one."""
    scale = _OUTLIER * float(np.median(np.abs(error))) + 1e-9
    return (is_lit / (1 + (error / scale) ** 2)).astype(np.float32)


def correlation(a: np.ndarray, b: np.ndarray, fade: np.ndarray) -> float:
    """Return the correlation of two faded images (N,) without their components along the fading itself."""
    flat = fade.ravel()
    a, b = (v - flat * float(v @ flat / (flat @ flat)) for v in (a, b))
    return float(a @ b / (np.sqrt(float(a @ a) * float(b @ b)) + 1e-30))


def explained(image: np.ndarray, images: np.ndarray, fade: np.ndarray) -> tuple[float, float]:
    """Fit an image (H, W) by three faded images (3, N); return the mean absolute residual where lit, and the fit's
    correlation with the image.
    """
    is_lit, flat, faded = lit(image), (image * fade).ravel(), fade.ravel()
    weight, fit = is_lit.astype(np.float32), flat
    for _ in range(_ROUNDS):
        fit = factors(images, flat, weight).astype(np.float32) @ images
        weight = weights((flat - fit) / (faded + 1e-3), is_lit)
    residual = np.abs(flat - fit) / (faded + 1e-3)
    pixel_weight = faded**2 * is_lit
    return float((pixel_weight * residual).sum() / (pixel_weight.sum() + 1e-12)), correlation(fit, flat, fade)
