"""Lambertian photometric stereo with outliers, for all texels at once in float64.

With b = albedo · normal a texel's grey samples are y = L b + e. The methods differ in their model of e: noise (least
squares), outside of percentiles (trimmed), sparse with an ℓ1 norm, sparse over the whole image stack, the rest of low
rank (Wu et al. 2010), sparse under a hierarchical prior (Ikehata et al. 2012). All omit samples in shadow, below
``shadow`` times the texel's brightness, as both papers do.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from .problem import PeerResult, Problem, peak_memory_mb, percentile_of

_RIDGE = 1e-9  # of the trace: texels with fewer than three samples get their shortest solution


def least_squares(problem: Problem, shadow: float | None = None) -> PeerResult:
    """Woodham 1980. shadow: None to use every sample, as the plain method does."""
    return _run("least squares", problem, shadow, lambda y, weights, L: _solve(L, weights, y), unit=False)


def trimmed(problem: Problem, shadow: float = 0.0, low: float = 20.0, high: float = 75.0) -> PeerResult:
    """Least squares over the lit samples of a texel between two of their percentiles."""

    def fit(y: np.ndarray, weights: np.ndarray, L: np.ndarray) -> np.ndarray:
        values = np.sort(np.where(weights > 0, y, np.inf), axis=0)
        count = (weights > 0).sum(axis=0)
        bounds = [percentile_of(values, count, q) for q in (low, high)]
        inside = weights * (y >= bounds[0]) * (y <= bounds[1])
        return _solve(L, np.where(inside.sum(axis=0) >= 3, inside, weights), y)

    return _run("trimmed least squares", problem, shadow, fit, low=low, high=high)


def least_absolute(problem: Problem, shadow: float = 0.0, iterations: int = 200, floor: float = 1e-5) -> PeerResult:
    """min ‖y − L b‖₁ by iteratively reweighted least squares: Ikehata et al. 2012 Eq. 8 as its λ goes to 0.

    floor: residuals below it, over the texel's brightness, count alike; it falls to this from 0.1 over the first half.
    """

    def fit(y: np.ndarray, weights: np.ndarray, L: np.ndarray) -> np.ndarray:
        b = _solve(L, weights, y)
        for smallest in np.maximum(floor, 0.1 * (floor / 0.1) ** (np.linspace(0, 2, iterations))):
            b = _solve(L, weights / np.maximum(np.abs(y - L @ b.T), smallest), y)
        return b

    return _run("L1", problem, shadow, fit, iterations=iterations, floor=floor)


def sparse_bayesian(
    problem: Problem, shadow: float = 0.0, noise: float = 1e-6, iterations: int = 300, gamma: float = 1.0
) -> PeerResult:
    """Sparse Bayesian learning, Ikehata et al. 2012 Eq. 13–17: y = L b + e + N(0, λ), e_k ~ N(0, γ_k), b ~ N(0, ∞).

    noise: λ, over the square of the texel's brightness. gamma: where all γ begin. The paper inverts a K×K matrix a
    texel; with Woodbury's identity it is 3×3 and the numbers are the same.
    """

    def fit(y: np.ndarray, weights: np.ndarray, L: np.ndarray) -> np.ndarray:
        variance, outer = np.full_like(y, gamma), (L[:, :, None] * L[:, None, :]).reshape(-1, 9)
        for _ in range(iterations):
            weight = weights / (variance + noise)
            inverse = np.linalg.inv(_ridged(_gram(L, weight)))
            b = np.einsum("tij,tj->ti", inverse, (weight * y).T @ L)
            leverage = outer @ inverse.reshape(-1, 9).T
            share = variance / (variance + noise)
            variance = (share * (y - L @ b.T)) ** 2 + share * noise + share**2 * leverage
        return _solve(L, weights / (variance + noise), y)

    return _run("sparse Bayesian", problem, shadow, fit, noise=noise, iterations=iterations)


def low_rank(
    problem: Problem, shadow: float = 0.0, strength: float = 1.0, tolerance: float = 1e-6, iterations: int = 500
) -> PeerResult:
    """Wu et al. 2010: min ‖A‖* + λ‖E‖₁ so that A + E is the stack where it is lit, by inexact augmented Lagrangian.

    λ = strength / √max(K, T), as their Eq. 9. Entries in shadow are missing: E is free there (their Algorithm 1).
    """

    def fit(y: np.ndarray, weights: np.ndarray, L: np.ndarray) -> np.ndarray:
        seen = (weights > 0).any(axis=1)  # an image without valid samples is undetermined
        part = _low_rank_part(y[seen], weights[seen] > 0, strength, tolerance, iterations)
        return part.T @ np.linalg.pinv(L[seen]).T

    return _run("low rank + sparse", problem, shadow, fit, unit=False, strength=strength, tolerance=tolerance)


METHODS: dict[str, Callable[..., PeerResult]] = {
    "least squares": least_squares,
    "trimmed": trimmed,
    "l1": least_absolute,
    "sparse bayesian": sparse_bayesian,
    "low rank": low_rank,
}

# Candidate settings of each method, of which the truth chooses the best: the ends of a search on three captures.
SETTINGS: dict[str, tuple[dict[str, float], ...]] = {
    "least squares": ({}, {"shadow": 0.0}, {"shadow": 0.2}, {"shadow": 0.5}),
    "trimmed": ({}, {"low": 40, "high": 60}, {"low": 45, "high": 60}, {"low": 50, "high": 60}),
    "l1": ({}, {"shadow": 0.1}, {"shadow": 0.5}, {"shadow": 0.8}),
    "sparse bayesian": ({}, {"shadow": 0.1, "noise": 1e-3}, {"shadow": 0.3, "noise": 1e-4}, {"shadow": 0.8}),
    "low rank": ({}, {"shadow": 0.2, "strength": 0.5}, {"shadow": 0.3, "strength": 0.55}, {"shadow": 0.5}),
}


def _low_rank_part(y: np.ndarray, fixed: np.ndarray, strength: float, tolerance: float, iterations: int) -> np.ndarray:
    """Return A (K, T) of robust PCA with missing entries; Lin, Chen & Ma 2010, Algorithm 5."""
    data = np.where(fixed, y, 0)
    weight = strength / np.sqrt(max(y.shape))
    size = np.linalg.norm(data)
    largest = np.sqrt(np.linalg.eigvalsh(data @ data.T)[-1])
    multiplier = data / max(largest, np.abs(data).max() / weight)
    sparse, penalty = np.zeros_like(data), 1.25 / largest
    low = data
    for _ in range(iterations):
        low = _shrink_spectrum(data - sparse + multiplier / penalty, 1 / penalty)
        rest = data - low + multiplier / penalty
        sparse = np.where(fixed, np.sign(rest) * np.maximum(np.abs(rest) - weight / penalty, 0), rest)
        gap = data - low - sparse
        multiplier = multiplier + penalty * gap
        penalty *= 1.1
        if np.linalg.norm(gap) < tolerance * size:
            break
    return low


def _shrink_spectrum(matrix: np.ndarray, threshold: float) -> np.ndarray:
    """Return the (K, T) matrix with singular values reduced by the threshold, by its K×K Gram matrix (K ≪ T)."""
    squared, left = np.linalg.eigh(matrix @ matrix.T)
    values = np.sqrt(np.maximum(squared, 0))
    share = np.maximum(values - threshold, 0) / np.maximum(values, 1e-300)
    return (left * share) @ (left.T @ matrix)


def _run(
    name: str, problem: Problem, shadow: float | None, fit: Callable[..., np.ndarray], unit: bool = True, **settings
) -> PeerResult:
    """Fit b to the grey samples, divided by the texel's brightness if ``unit``; return normals and albedos."""
    start = time.perf_counter()
    y, scale = problem.grey, problem.scale() if unit or shadow is not None else np.ones(problem.count)
    weights = problem.weights if shadow is None else problem.weights * (y > shadow * scale)
    weights = np.where(weights.sum(axis=0) >= 3, weights, problem.weights)
    divisor = scale if unit else 1.0
    b = fit(y / divisor, weights, problem.lights) * np.reshape(divisor, (-1, 1) if unit else ())
    length = np.linalg.norm(b, axis=-1, keepdims=True)
    normal = np.where(length > 0, b / np.where(length > 0, length, 1), (0.0, 0.0, 1.0))
    values = {"normal": normal, "base_color": length * _tint(problem, weights)}
    seconds = time.perf_counter() - start
    count = np.zeros(problem.count)
    return PeerResult(name, values, count, seconds, peak_memory_mb(), {"shadow": shadow, **settings})


def _tint(problem: Problem, weights: np.ndarray) -> np.ndarray:
    """Return (T, 3): each channel over the grey, by the samples with weight."""
    intensities = np.where(problem.intensities > 0, problem.intensities, np.inf)
    channels = np.einsum("kt,ktc,kc->tc", weights, problem.radiance, 1 / intensities, optimize=True)
    grey = (weights * problem.grey).sum(axis=0)[:, None]
    return np.where(grey > 0, channels / np.where(grey > 0, grey, 1), 0)


def _gram(L: np.ndarray, weight: np.ndarray) -> np.ndarray:
    return (weight.T @ (L[:, :, None] * L[:, None, :]).reshape(-1, 9)).reshape(-1, 3, 3)


def _ridged(gram: np.ndarray) -> np.ndarray:
    return gram + (_RIDGE * np.trace(gram, axis1=1, axis2=2) + 1e-300)[:, None, None] * np.eye(3)


def _solve(L: np.ndarray, weight: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return (T, 3), b by weighted least squares."""
    return np.linalg.solve(_ridged(_gram(L, weight)), ((weight * y).T @ L)[..., None])[..., 0]
