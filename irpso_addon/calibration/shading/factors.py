"""Robust factorisation of radiance into lights and scaled normals, up to a 3×3 matrix (Hayakawa 1994)."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

_USUAL = 75.0  # percentile of a pixel's samples by which it is divided, to remove albedo
_BRIGHT = 90.0  # percentile of a pixel's samples that is the reference of the next limits
_SHADOW, _HIGHLIGHT = 0.12, 1.3  # of ``_BRIGHT``: samples in between are usable
_LIT = 0.35  # least usable fraction of a pixel's samples
_PIXELS = 2500  # most pixels in the fit of the lights
_ROUNDS = 40  # of alternating least squares; most captures converge in twenty
_FEW_ROUNDS = 8  # of reweighting a pixel under fixed lights
_WIDTH = 2.0  # deviations at which a sample's weight is a half (Cauchy)
_MIN_WIDTH = 1e-4
_EVERY = 50  # stride of residuals for their median


def usable_samples(values: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return scaled samples (K, P), and bool (K, P): neither in shadow nor in a highlight. values, weight: (K, P)."""
    valid = weight > 0
    level, bright = np.zeros((2, values.shape[1]))
    seen = valid.any(axis=0)
    known = np.where(valid, values, np.nan)[:, seen]
    if seen.any():
        level[seen], bright[seen] = np.nanpercentile(known, (_USUAL, _BRIGHT), axis=0)
    level += 1e-9
    bright /= level
    scaled = np.where(valid, values, 0) / level
    return scaled, valid & (scaled > _SHADOW * bright) & (scaled < _HIGHLIGHT * bright)


def factored(
    scaled: np.ndarray, usable: np.ndarray, pixels: np.ndarray, rng: np.random.Generator
) -> Generator[None, None, np.ndarray]:
    """Yield often; return lights (K, 3), up to a 3×3 matrix; their columns are orthonormal times √K.

    Alternating weighted least squares of rank three (Wiberg 1976; Shum, Ikeuchi & Reddy 1995); Cauchy's weights
    suppress remaining highlights and shadows. pixels: indices of those to use.
    """
    lit = pixels[usable[:, pixels].mean(axis=0) > _LIT]
    chosen = rng.permutation(lit)[:_PIXELS]
    values, initial = scaled[:, chosen], usable[:, chosen].astype(np.float64)
    left, size, right = np.linalg.svd(np.where(initial > 0, values, 0), full_matrices=False)
    lights, weight = left[:, :3] * size[:3], initial
    for _ in range(_ROUNDS):
        normals = _solved(weight, lights, values)
        lights = _solved(weight.T, normals, values.T)
        weight = initial / (1 + ((values - lights @ normals.T) / _deviation(values - lights @ normals.T, initial)) ** 2)
        yield
    left, size, right = np.linalg.svd(lights, full_matrices=False)
    return left * np.sqrt(len(lights))


def scaled_normals(scaled: np.ndarray, usable: np.ndarray, lights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return normals times albedo (P, 3) under lights (K, 3), and the mean absolute residual of each pixel (P,).

    The residual is infinity where fewer than three samples are usable.
    """
    initial = usable.astype(np.float64)
    weight = initial
    for _ in range(_FEW_ROUNDS):
        normals = _solved(weight, lights, scaled)
        residual = scaled - lights @ normals.T
        weight = initial / (1 + (residual / _deviation(residual, initial)) ** 2)
    total = weight.sum(axis=0)
    misfit = (weight * np.abs(residual)).sum(axis=0) / np.maximum(total, 1e-9)
    return normals, np.where(usable.sum(axis=0) >= 3, misfit, np.inf)


def _solved(weight: np.ndarray, factors: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the weighted least-squares solutions (P, 3) of values (K, P) by factors (K, 3). weight: (K, P)."""
    products = np.einsum("ki,kj->kij", factors, factors).reshape(-1, 9)
    matrix = (weight.T @ products).reshape(-1, 3, 3)
    matrix += 1e-6 * np.trace(factors.T @ factors) / len(factors) * np.eye(3)
    solution: np.ndarray = np.linalg.solve(matrix, ((weight * values).T @ factors)[..., None])[..., 0]
    return solution


def _deviation(residual: np.ndarray, initial: np.ndarray) -> float:
    """Return the width of Cauchy's weights, from a subset of the usable residuals."""
    magnitudes = np.abs(residual.ravel()[::_EVERY][initial.ravel()[::_EVERY] > 0])
    return max(_WIDTH * 1.4826 * float(np.median(magnitudes)) if len(magnitudes) else 0.0, _MIN_WIDTH)
