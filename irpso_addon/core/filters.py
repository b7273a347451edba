"""Filters of images (H, W): Gaussian blur, block means, bilinear samples; and a weighted median."""

from __future__ import annotations

import numpy as np


def blurred(image: np.ndarray, sigma: float) -> np.ndarray:
    """Return an image convolved with a Gaussian of deviation ``sigma``, in pixels; border pixels repeat outside."""
    reach = int(np.ceil(3 * sigma))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    kernel = (kernel / kernel.sum()).astype(image.dtype)
    for axis in (0, 1):
        width = [(0, 0), (0, 0)]
        width[axis] = (reach, reach)
        padded = np.pad(image, width, mode="edge")
        size = image.shape[axis]
        image = sum(
            weight * (padded[i : i + size] if axis == 0 else padded[:, i : i + size]) for i, weight in enumerate(kernel)
        )
    return image


def block_means(image: np.ndarray, block: int) -> np.ndarray:
    """Return the means (h, w, …) of block × block pixels; pixels of a last incomplete block are left out."""
    if block == 1:
        return image
    height, width = (side // block for side in image.shape[:2])
    cut = image[: height * block, : width * block]
    return cut.reshape(height, block, width, block, *image.shape[2:]).mean(axis=(1, 3), dtype=image.dtype)


def sampled(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return bilinear samples (…) of an image at pixel coordinates (…, 2), whose first pixel has centre (0.5, 0.5).

    Places outside take the nearest pixel.
    """
    height, width = image.shape
    x = np.clip(places[..., 0] - 0.5, 0, max(width - 1.001, 0))
    y = np.clip(places[..., 1] - 0.5, 0, max(height - 1.001, 0))
    column, row = x.astype(int), y.astype(int)
    x, y = x - column, y - row
    flat, index = image.ravel(), row * width + column
    beside, next_row = min(width - 1, 1), width * min(height - 1, 1)  # steps; 0 along a side of one pixel
    low = flat[index] * (1 - x) + flat[index + beside] * x
    return low * (1 - y) + (flat[index + next_row] * (1 - x) + flat[index + next_row + beside] * x) * y


def weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    """Return the least of values (N,), N ≥ 1, up to which the weights (N,) sum to half of their total or more."""
    order = np.argsort(values)
    return float(values[order[np.searchsorted(np.cumsum(weights[order]), weights.sum() / 2)]])
