"""Distance of the lamps from the fall-off of their light over the table: a shadow's width alone does not tell it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..ball import Ball, pixel_rays, tukey
from ..table import Table
from .shadow import on_table, shadowed

_PIXELS = 3000  # compared, at most
_BESIDE = 1.1  # radii from the ball's centre: nearer pixels show the ball
_LEAST_LIT, _SHADOWED = 0.01, 0.35  # of white; of a pixel's median: a darker value is in shadow
_FEWEST, _FEWEST_SHADOWED = 100, 30  # pixels
_ITERATIONS, _CENTRING = 8, 6
_LEAST_SCALE = 0.005  # of the light
_NEAREST = 0.2  # radii over distance
_LOBE = 0.35  # width of a glossy table's lobe: tangent of the half vector's angle
_GLOSSY = 0.2  # least height of the lobe's logarithm; matte tables show up to 0.08


def inverse_distance(
    stack: np.ndarray, clipped: np.ndarray, ball: Ball, lights: np.ndarray, table: Table
) -> tuple[float, float]:
    """Return the ball's radius over the lamps' distance from it, 0 for distant ones, and its standard error.

    stack: (K, H, W) grey values over white. clipped: (K, H, W) bool. lights: (K, 3) unit, NaN where unknown. A table
    under a lamp at a distance r from it receives light in proportion to 1 / r³, as the lamp's height above it is the
    same everywhere. The logarithm of the values, less the ambient light that the ball's shadow shows, is fitted
    robustly (Tukey 1960) by a sum of one value for each pixel (its albedo), one for each photograph (its lamp), this
    law, and on a glossy table a lobe about the mirror direction, which looks like a near lamp. The error follows from
    the photographs' differences.
    """
    known = np.isfinite(lights).all(axis=-1)
    rows, columns = _places(stack.shape[1:], ball)
    values = stack[known][:, rows, columns]
    typical = np.median(values, axis=0)
    usable = ~clipped[known][:, rows, columns] & (values > np.maximum(_SHADOWED * typical, _LEAST_LIT))
    point = on_table(ball, table, rows, columns)
    values = values - _ambient(point, values, typical, lights[known])
    kept = np.isfinite(point).all(axis=-1) & (usable.sum(axis=0) > known.sum() / 2)
    if known.sum() < 3 or kept.sum() < _FEWEST:
        return 0.0, np.inf
    point, usable, value = point[kept], usable[:, kept], np.log(np.where(usable, np.maximum(values, 1e-6), 1))[:, kept]
    ray = pixel_rays(ball.camera, np.stack([columns, rows], axis=-1)[kept] + 0.5)[1]
    found = _fitted(
        value, usable, point, lights[known], lambda inverse: _lobe(point, ray, lights[known], table, inverse)
    )
    if found[2] < _GLOSSY:
        found = _fitted(value, usable, point, lights[known], None)
    return found[:2]


def _fitted(
    value: np.ndarray,
    usable: np.ndarray,
    point: np.ndarray,
    lights: np.ndarray,
    lobe: Callable[[float], np.ndarray] | None,
) -> tuple[float, float, float]:
    """Return radius over distance, its standard error and the lobe's height, from logarithms (K, N)."""
    weights, inverse, height = usable.astype(np.float64), 0.0, 0.0
    for _ in range(_ITERATIONS):
        law, slope = _law(point, lights, inverse)
        gloss = np.zeros_like(slope) if lobe is None else lobe(inverse)
        rest = _centred(value - law - height * gloss, weights)
        scale = max(1.4826 * float(np.median(np.abs(rest[usable]))), _LEAST_SCALE)
        weights = usable * tukey(rest, scale)
        rest, slope, gloss = (_centred(part, weights) for part in (value - law - height * gloss, slope, gloss))
        common = (weights * slope * gloss).sum() / max((weights * gloss**2).sum(), 1e-12)
        alone = slope - common * gloss  # of the law, what a lobe does not explain
        power, gain = (weights * alone**2).sum(axis=1), (weights * alone * rest).sum(axis=1)
        step = gain.sum() / max(power.sum(), 1e-12)
        inverse = float(np.clip(inverse + step, 0, _NEAREST))
        height += (weights * gloss * (rest - step * slope)).sum() / max((weights * gloss**2).sum(), 1e-12)
        height = max(float(height), 0.0)
    own = gain / np.maximum(power, 1e-12)  # what each photograph would add
    part = power / max(power.sum(), 1e-12)
    return inverse, float(np.sqrt((part**2 * (own - part @ own) ** 2).sum())), height


def _lobe(point: np.ndarray, ray: np.ndarray, lights: np.ndarray, table: Table, inverse: float) -> np.ndarray:
    """Return the microfacet distribution (K, N) of a glossy table at points (N, 3) seen along rays, 1 at its peak.

    D ∝ cos⁻⁴ θ (1 + tan² θ / α²)⁻² of the half vector's angle θ to the normal (Trowbridge and Reitz 1975), without the
    first factor.
    """
    toward = lights[:, None] - inverse * point
    half = toward / np.linalg.norm(toward, axis=-1, keepdims=True) - ray
    square = np.maximum(half @ table.up, 1e-3) ** 2 / (half**2).sum(axis=-1)
    return (1 + (1 / square - 1) / _LOBE**2) ** -2


def _places(shape: tuple[int, ...], ball: Ball) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns (N,) of pixels all over the picture, beside the ball."""
    step = max(1, round((shape[0] * shape[1] / _PIXELS) ** 0.5))
    rows, columns = (part.ravel() for part in np.mgrid[step // 2 : shape[0] : step, step // 2 : shape[1] : step])
    middle = ball.outline[:-1].mean(axis=0)
    beside = np.hypot(columns + 0.5 - middle[0], rows + 0.5 - middle[1]) > _BESIDE * ball.radius_px
    return rows[beside], columns[beside]


def _ambient(point: np.ndarray, values: np.ndarray, typical: np.ndarray, lights: np.ndarray) -> np.ndarray:
    """Return the part (N,) of values (K, N) that does not come from the lamp: what the ball's shadow leaves."""
    within = (shadowed(point, lights) > 0) & (typical > _LEAST_LIT)
    left = (values / np.maximum(typical, _LEAST_LIT))[within]
    return min(float(np.median(left)), _SHADOWED) * typical if len(left) >= _FEWEST_SHADOWED else 0 * typical


def _law(point: np.ndarray, lights: np.ndarray, inverse: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the logarithm (K, N) of 1 / r³ and its derivative by ``inverse``."""
    along, square = lights @ point.T, (point**2).sum(axis=-1)
    away = 1 - 2 * inverse * along + inverse**2 * square
    return -1.5 * np.log(away), -1.5 * (2 * inverse * square - 2 * along) / away


def _centred(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return (K, N) values less a sum of one value for each row and one for each column, by weighted least squares."""
    for _ in range(_CENTRING):
        for axis in (0, 1):
            total = np.maximum(weights.sum(axis=axis, keepdims=True), 1e-12)
            values = values - (weights * values).sum(axis=axis, keepdims=True) / total
    return values
