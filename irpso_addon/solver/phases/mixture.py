"""Shared materials as a mixture of Gaussians over a subset of the domain's texels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...core.files import defined
from ...reflectance.model import Parameter, ReflectanceModel

_SHADER = defined("materials/shared.glsl")
_SEARCHED_BANDWIDTH, _LINEAR_BANDWIDTH = _SHADER["SEARCHED_BANDWIDTH"], _SHADER["LINEAR_BANDWIDTH"]
_ROWS = 7  # of the table: 12 means, 12 inverse variances, the share of the material
_NUMBERS = 12
_ROUNDS = 20  # of expectation and maximisation
_MIN_VARIANCE = 0.25  # of a material; features that are 1 apart differ
_MIN_TEXELS = 4.0  # of a material in the subset


def features_of(model: ReflectanceModel, parameters: Sequence[Parameter], values: np.ndarray) -> np.ndarray:
    """Return (n, d) float64, a column for each unknown number as kernels/free_parameters.py counts them; 0 for normals.

    Searched numbers are fractions of their range in units of SEARCHED_BANDWIDTH, linear ones the roots of such
    fractions in units of LINEAR_BANDWIDTH: colours differ by ratios rather than by differences. values: (n, C) of the
    model's components, then any others.
    """
    features = []
    for p in parameters:
        if p.is_normal:
            features += [np.zeros(len(values))] * 2
            continue
        at = model.offset(p.name)
        x = np.clip((values[:, at : at + p.components] - p.range[0]) / p.width, 0.0, 1.0)
        linear = p.kind == "linear" and p.name in model.bases
        features += list((np.sqrt(x) / _LINEAR_BANDWIDTH if linear else x / _SEARCHED_BANDWIDTH).T)
    return np.column_stack(features)


def material_table(features: np.ndarray, weights: np.ndarray, count: int) -> np.ndarray:
    """Return (7, K, 4) float32: at most ``count`` materials of a subset, for shaders/materials/shared.glsl.

    features: (n, d), d ≤ 12; rows that differ by less than 1 are equal; rows that are not finite are ignored. weights:
    (n,) above 0.
    Expectation maximisation (Dempster, Laird and Rubin 1977) of Gaussians with diagonal covariances, from the first
    means of k-means++ (Arthur and Vassilvitskii 2007).
    """
    finite = np.isfinite(features).all(axis=1)
    if not finite.any():
        features, weights, finite = np.zeros((1, features.shape[1])), np.ones(1), np.ones(1, bool)
    share, mean, variance = mixture(features[finite], weights[finite], count)
    inverse = 1.0 / (1.0 + variance)
    table = np.zeros((_ROWS, len(share), 4), np.float32)
    for row, values in ((0, mean), (3, inverse)):
        padded = np.pad(values, ((0, 0), (0, _NUMBERS - values.shape[1])))
        table[row : row + 3] = padded.reshape(len(share), 3, 4).transpose(1, 0, 2)
    table[-1, :, 0] = share * np.sqrt(inverse).prod(axis=1)
    return table


def mixture(x: np.ndarray, weights: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (K,) shares, (K, d) means and (K, d) variances of at most ``count`` Gaussians over (n, d) numbers.

    weights: (n,) of the rows of x.
    """
    mean = _first_means(x, weights, count)
    variance = np.ones_like(mean)
    share = np.full(len(mean), 1.0 / len(mean))
    for _ in range(_ROUNDS):
        weight = memberships(x, share, mean, variance)
        texels = weight.sum(axis=0)
        weight = weights[:, None] * weight[:, texels >= min(_MIN_TEXELS, texels.max())]
        texels = weight.sum(axis=0)
        mean = (weight.T @ x) / texels[:, None]
        variance = np.maximum((weight.T @ (x * x)) / texels[:, None] - mean * mean, _MIN_VARIANCE)
        share = texels / texels.sum()
    return share, mean, variance


def memberships(x: np.ndarray, share: np.ndarray, mean: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return (n, K): the probability that each row of x (n, d) belongs to each Gaussian of ``mixture``."""
    inverse = 1.0 / variance
    squared = (x * x) @ inverse.T - 2.0 * x @ (mean * inverse).T + (mean * mean * inverse).sum(axis=1)
    log = np.log(share) - 0.5 * (squared + np.log(variance).sum(axis=1))
    weight = np.exp(log - log.max(axis=1, keepdims=True))
    return weight / weight.sum(axis=1, keepdims=True)


def _first_means(x: np.ndarray, weights: np.ndarray, count: int) -> np.ndarray:
    """Return rows of x: the one nearest the median, then each drawn with a probability of weight × squared distance.

    The distance is that to the nearest earlier row.
    """
    draw = np.random.default_rng(0)
    chosen = [int(np.argmin(((x - np.median(x, axis=0)) ** 2).sum(axis=1)))]
    squared = ((x - x[chosen[0]]) ** 2).sum(axis=1)
    while len(chosen) < count and squared.max() > 1.0:
        chances = weights * squared
        chosen.append(int(np.searchsorted(np.cumsum(chances), draw.random() * chances.sum())))
        squared = np.minimum(squared, ((x - x[chosen[-1]]) ** 2).sum(axis=1))
    return x[chosen]
