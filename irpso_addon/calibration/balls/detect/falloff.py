"""Distance of the lamps by the fall-off of their light over the table; a shadow's width is not sufficient."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..ball import Ball, pixel_rays, tukey
from ..table import Table
from .shadow import on_table, shadowed

_PIXELS = 3000  # about as many are used
_BESIDE = 1.1  # radii from the outline's centre: nearer pixels show the ball
_MIN_LIT, _SHADOWED = 0.01, 0.35  # of white; of a pixel's median: a darker value is in shadow
_MIN_PIXELS, _MIN_SHADOWED = 100, 30  # pixels
_ITERATIONS, _CENTRING = 8, 6
_MIN_SCALE = 0.005  # of the light
_NEAREST = 0.2  # radii over distance
_LOBE = 0.35  # width of a glossy table's lobe: tangent of the half vector's angle
_GLOSSY = 0.2  # least height of the lobe's logarithm; matte tables show up to 0.08


def inverse_distance(
    stack: np.ndarray, clipped: np.ndarray, ball: Ball, lights: np.ndarray, table: Table
) -> tuple[float, float]:
    """Return the ball's radius over the lamps' distance from it, 0 for distant ones, and its standard error.

    stack: (K, H, W) grey values over white. clipped: (K, H, W) bool. lights: (K, 3) unit, NaN where unknown. The
    irradiance of a point of the table at distance r from the lamp is proportional to 1 / r³, as the lamp's height above
    the table is constant. The ball's shadow gives the ambient light, which is subtracted. A robust fit (Tukey 1960)
    models the logarithm of the values as a sum of one term per pixel (albedo), one per photograph (lamp), this law, and
    on a glossy table a lobe about the mirror direction, which looks like a near lamp. The scatter between photographs
    gives the standard error.
    """
    known = np.isfinite(lights).all(axis=-1)
    rows, columns = _sample_pixels(stack.shape[1:], ball)
    values = stack[known][:, rows, columns]
    median = np.median(values, axis=0)
    usable = ~clipped[known][:, rows, columns] & (values > np.maximum(_SHADOWED * median, _MIN_LIT))
    point = on_table(ball, table, rows, columns)
    values = values - _ambient(point, values, median, lights[known])
    use = np.isfinite(point).all(axis=-1) & (usable.sum(axis=0) > known.sum() / 2)
    if known.sum() < 3 or use.sum() < _MIN_PIXELS:
        return 0.0, np.inf
    point, usable, value = point[use], usable[:, use], np.log(np.where(usable, np.maximum(values, 1e-6), 1))[:, use]
    ray = pixel_rays(ball.camera, np.stack([columns, rows], axis=-1)[use] + 0.5)[1]
    fit = _fitted(value, usable, point, lights[known], lambda inverse: _lobe(point, ray, lights[known], table, inverse))
    if fit[2] < _GLOSSY:
        fit = _fitted(value, usable, point, lights[known], None)
    return fit[:2]


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
        law, slope = _fall_off(point, lights, inverse)
        gloss = np.zeros_like(slope) if lobe is None else lobe(inverse)
        residual = _centred(value - law - height * gloss, weights)
        scale = max(1.4826 * float(np.median(np.abs(residual[usable]))), _MIN_SCALE)
        weights = usable * tukey(residual, scale)
        residual, slope, gloss = (_centred(array, weights) for array in (value - law - height * gloss, slope, gloss))
        ratio = (weights * slope * gloss).sum() / max((weights * gloss**2).sum(), 1e-12)
        projected = slope - ratio * gloss  # derivative of the law, orthogonal to the lobe
        power, gain = (weights * projected**2).sum(axis=1), (weights * projected * residual).sum(axis=1)
        step = gain.sum() / max(power.sum(), 1e-12)
        inverse = float(np.clip(inverse + step, 0, _NEAREST))
        height += (weights * gloss * (residual - step * slope)).sum() / max((weights * gloss**2).sum(), 1e-12)
        height = max(float(height), 0.0)
    per_photograph = gain / np.maximum(power, 1e-12)  # each photograph's own step
    share = power / max(power.sum(), 1e-12)
    return inverse, float(np.sqrt((share**2 * (per_photograph - share @ per_photograph) ** 2).sum())), height


def _lobe(point: np.ndarray, ray: np.ndarray, lights: np.ndarray, table: Table, inverse: float) -> np.ndarray:
    """Return a glossy table's lobe (K, N) at points (N, 3) seen along rays, 1 at its peak.

    This is D ∝ cos⁻⁴ θ (1 + tan² θ / α²)⁻², with θ from the normal to the half vector (Trowbridge and Reitz 1975),
    without the first factor.
    """
    toward = lights[:, None] - inverse * point
    half = toward / np.linalg.norm(toward, axis=-1, keepdims=True) - ray
    square = np.maximum(half @ table.up, 1e-3) ** 2 / (half**2).sum(axis=-1)
    return (1 + (1 / square - 1) / _LOBE**2) ** -2


def _sample_pixels(shape: tuple[int, ...], ball: Ball) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns (N,) of a grid of pixels over the whole image, without the ball."""
    step = max(1, round((shape[0] * shape[1] / _PIXELS) ** 0.5))
    rows, columns = (part.ravel() for part in np.mgrid[step // 2 : shape[0] : step, step // 2 : shape[1] : step])
    centre = ball.outline[:-1].mean(axis=0)
    outside = np.hypot(columns + 0.5 - centre[0], rows + 0.5 - centre[1]) > _BESIDE * ball.radius_px
    return rows[outside], columns[outside]


def _ambient(point: np.ndarray, values: np.ndarray, median: np.ndarray, lights: np.ndarray) -> np.ndarray:
    """Return the ambient part (N,) of values (K, N): the radiance in the ball's shadow."""
    shaded = (shadowed(point, lights) > 0) & (median > _MIN_LIT)
    remaining = (values / np.maximum(median, _MIN_LIT))[shaded]
    return min(float(np.median(remaining)), _SHADOWED) * median if len(remaining) >= _MIN_SHADOWED else 0 * median


def _fall_off(point: np.ndarray, lights: np.ndarray, inverse: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the logarithm (K, N) of 1 / r³ and its derivative by ``inverse``."""
    along, square = lights @ point.T, (point**2).sum(axis=-1)
    relative = 1 - 2 * inverse * along + inverse**2 * square
    return -1.5 * np.log(relative), -1.5 * (2 * inverse * square - 2 * along) / relative


def _centred(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Subtract the weighted least-squares fit of one term per row plus one per column from values (K, N)."""
    for _ in range(_CENTRING):
        for axis in (0, 1):
            total = np.maximum(weights.sum(axis=axis, keepdims=True), 1e-12)
            values = values - (weights * values).sum(axis=axis, keepdims=True) / total
    return values
