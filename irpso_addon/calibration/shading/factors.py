"""A photometric matrix as lights times scaled normals, up to a common 3×3 matrix (Hayakawa 1994), robustly."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

_USUAL = 75.0  # percentile of a pixel's samples by which it is divided, so that albedo does not weigh
_BRIGHT = 90.0  # percentile against which a pixel's shadows and highlights are recognised
_SHADOW, _HIGHLIGHT = 0.12, 1.3  # of that: samples between them take part
_LIT = 0.35  # least part of a pixel's samples that take part, for it to enter the lights
_PIXELS = 2500  # at most, for the lights
_ROUNDS = 40  # of alternating least squares; most captures settle in twenty
_FEW_ROUNDS = 8  # of reweighting a pixel under settled lights
_WIDTH = 2.0  # deviations at which a sample's weight is a half (Cauchy)
_LEAST_WIDTH = 1e-4
_EVERY = 50  # pixels: for the median of the residuals


def usable_samples(values: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return scaled samples (K, P), and bool (K, P): neither in shadow nor in a highlight. values, weight: (K, P)."""
    seen = weight > 0
    shown = np.where(seen, values, np.nan)
    with np.errstate(invalid="ignore"):
        usual = np.nan_to_num(np.nanpercentile(shown, _USUAL, axis=0)) + 1e-9
        bright = np.nan_to_num(np.nanpercentile(shown, _BRIGHT, axis=0)) / usual
    scaled = np.where(seen, values, 0) / usual
    return scaled, seen & (scaled > _SHADOW * bright) & (scaled < _HIGHLIGHT * bright)


def factored(
    scaled: np.ndarray, usable: np.ndarray, pixels: np.ndarray, rng: np.random.Generator
) -> Generator[None, None, np.ndarray]:
    """Return lights (K, 3) of the samples, up to a 3×3 matrix; their columns are orthonormal times √K. Yields often.

    Alternating weighted least squares of rank three (Wiberg 1976; Shum, Ikeuchi & Reddy 1995) with Cauchy's weights:
    highlights and shadows that the limits left in hardly count. pixels: indices of those to use.
    """
    lit = pixels[usable[:, pixels].mean(axis=0) > _LIT]
    chosen = rng.permutation(lit)[:_PIXELS]
    values, first = scaled[:, chosen], usable[:, chosen].astype(np.float64)
    left, size, right = np.linalg.svd(np.where(first > 0, values, 0), full_matrices=False)
    lights, weight = left[:, :3] * size[:3], first
    for _ in range(_ROUNDS):
        normals = _solved(weight, lights, values)
        lights = _solved(weight.T, normals, values.T)
        weight = first / (1 + ((values - lights @ normals.T) / _deviation(values - lights @ normals.T, first)) ** 2)
        yield
    left, size, right = np.linalg.svd(lights, full_matrices=False)
    return left * np.sqrt(len(lights))


def scaled_normals(scaled: np.ndarray, usable: np.ndarray, lights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (P, 3) normals times albedo under lights (K, 3), and (P,) how far the samples are from them on average.

    infinity where fewer than three samples are usable.
    """
    first = usable.astype(np.float64)
    weight = first
    for _ in range(_FEW_ROUNDS):
        normals = _solved(weight, lights, scaled)
        residual = scaled - lights @ normals.T
        weight = first / (1 + (residual / _deviation(residual, first)) ** 2)
    total = weight.sum(axis=0)
    misfit = (weight * np.abs(residual)).sum(axis=0) / np.maximum(total, 1e-9)
    return normals, np.where(usable.sum(axis=0) >= 3, misfit, np.inf)


def _solved(weight: np.ndarray, factors: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return (P, 3) least squares solutions of values (K, P) by factors (K, 3) with weights (K, P)."""
    products = np.einsum("ki,kj->kij", factors, factors).reshape(-1, 9)
    matrix = (weight.T @ products).reshape(-1, 3, 3)
    matrix += 1e-6 * np.trace(factors.T @ factors) / len(factors) * np.eye(3)
    solution: np.ndarray = np.linalg.solve(matrix, ((weight * values).T @ factors)[..., None])[..., 0]
    return solution


def _deviation(residual: np.ndarray, first: np.ndarray) -> float:
    """Return the width of the weights: of a sample of the residuals that take part."""
    some = np.abs(residual.ravel()[::_EVERY][first.ravel()[::_EVERY] > 0])
    return max(_WIDTH * 1.4826 * float(np.median(some)) if len(some) else 0.0, _LEAST_WIDTH)
