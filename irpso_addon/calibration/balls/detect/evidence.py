"""Evidence for a ball at a circle: highlights of a mirror ball, shading of a matte one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..ball import Ball
from ..crops import BallView, Surroundings
from ..matte import fit_lights
from ..mirror import Sight, find_highlights
from ..shading import shading_of
from ..table import Table, radiance_from_table

_MARGIN = 3  # pixels
_LIT = 0.25  # of the range of values: brighter ones are outside the attached shadow
_ITERATIONS = 10
_RIM = 0.35  # n·v: at smaller values the outline's error dominates
_PIXELS = 500
_FITTED_RADIUS = 12.0  # values along a radius
_MIN_SHADED = 0.12  # standard deviation over the mean of a ball's values


@dataclass(frozen=True)
class Evidence:
    """lights: (K, 3) unit directions in camera axes, NaN where a photograph shows none. share: fraction with a light.

    moved: spread of the directions, 0…1. fit: explained part of the values' variance, 0…1 (mirror: 1).
    pixels: (K, 2) of the highlights, NaN for a matte ball.
    """

    kind: str
    lights: np.ndarray
    share: float
    moved: float
    fit: float
    pixels: np.ndarray


def of_mirror(stack: np.ndarray, clipped: np.ndarray, ball: Ball, up: np.ndarray | None = None) -> Evidence:
    """Return the evidence that each photograph shows one highlight, which moves. stack: (K, H, W).

    up: (3,) normal of the table. Without it a glossy table's highlight may compete: the higher score is used.
    """
    view = cropped(stack, clipped, ball)
    sights = find_highlights(view, up, sure=up is not None)
    lights, pixels = np.full((len(stack), 3), np.nan), np.full((len(stack), 2), np.nan)
    for number, sight in enumerate(sights):
        if isinstance(sight, Sight):
            lights[number], pixels[number] = sight.direction, sight.pixel
    known = np.isfinite(lights).all(axis=-1)
    return Evidence("mirror", lights, float(known.mean()), _spread(lights[known]), 1.0, pixels)


def of_matte(stack: np.ndarray, clipped: np.ndarray, ball: Ball) -> Evidence:
    """Return the evidence that Lambert's law explains the shading of every photograph. stack: (K, H, W)."""
    view = cropped(stack, clipped, ball)
    _, normals, toward, inside = ball.surface(view.pixels)
    keep = inside & ((normals * toward).sum(axis=-1) > _RIM)
    step = max(1, int(keep.sum()) // _PIXELS)
    normals = normals[keep][::step]
    lights, fits = np.full((len(stack), 3), np.nan), []
    for number in range(len(stack)):
        values, usable = view.values[number, ..., 0][keep][::step], view.usable[number][keep][::step]
        if usable.sum() < 12:
            fits.append(0.0)
            continue
        light, fit = _lambert(normals[usable], values[usable].astype(np.float64))
        fits.append(fit)
        if light is not None:
            lights[number] = light
    known = np.isfinite(lights).all(axis=-1)
    # A quantile of 0.4: up to two of five photographs may have a cast shadow on the ball.
    fit = float(np.quantile(fits, 0.4))
    return Evidence("matte", lights, float(known.mean()), _spread(lights[known]), fit, np.full((len(stack), 2), np.nan))


def on_table(stack: np.ndarray, clipped: np.ndarray, ball: Ball, table: Table, inverse: float) -> Evidence:
    """Return a matte ball's evidence with lights fitted jointly with the light of its table. stack: (K, H, W).

    inverse: the ball's radius over the lamps' distance. Without the table's light (``of_matte``), directions on a
    bright table err by 4°.
    """
    view, matte = cropped(stack, clipped, ball), of_matte(stack, clipped, ball)
    step = max(1, round(ball.radius_px / _FITTED_RADIUS))
    view = BallView(
        ball, view.pixels[::step, ::step], view.values[:, ::step, ::step], view.usable[:, ::step, ::step], step
    )
    surroundings = Surroundings(np.broadcast_to(stack[..., None], (*stack.shape, 3)), np.zeros(2), 1)
    table_values = [radiance_from_table(view, surroundings, table)]
    shadings = [shading_of([view], number, table_values) for number in range(len(stack))]
    fits, _ = fit_lights(shadings, ball.centre, False, inverse / ball.radius)
    lights = [np.full(3, np.nan) if isinstance(fit, str) else fit.direction for fit in fits]
    return replace(matte, lights=np.array(lights))


def cropped(stack: np.ndarray, clipped: np.ndarray, ball: Ball) -> BallView:
    """Return a ball's crop of grey images (K, H, W)."""
    outline = ball.outline
    low = np.maximum(np.floor(outline.min(axis=0)).astype(int) - _MARGIN, 0)
    high = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + _MARGIN, stack.shape[:0:-1])
    part = np.s_[:, low[1] : high[1], low[0] : high[0]]
    grid = np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5)
    values = np.repeat(stack[part][..., None], 3, axis=-1)
    return BallView(ball, np.stack(grid, axis=-1), values, ~clipped[part], 1)


def _lambert(normals: np.ndarray, values: np.ndarray) -> tuple[np.ndarray | None, float]:
    """Fit max(n·b, 0) + a by alternating least squares; return the light (3,) and the explained share of variance."""
    centred = values - values.mean()
    if values.std() < _MIN_SHADED * values.mean():
        return None, 0.0
    lit = values > values.min() + _LIT * (values.max() - values.min())
    solution = np.zeros(4)
    for _ in range(_ITERATIONS):
        design = np.concatenate([normals * lit[:, None], np.ones((len(normals), 1))], axis=1)
        solution = np.linalg.lstsq(design, values, rcond=None)[0]
        positive = normals @ solution[:3] > 0
        if (positive == lit).all():
            break
        lit = positive
    strength = float(np.linalg.norm(solution[:3]))
    if not strength > 0:
        return None, 0.0
    residual = values - np.maximum(normals @ solution[:3], 0) - solution[3]
    return solution[:3] / strength, float(1 - (residual**2).sum() / max((centred**2).sum(), 1e-12))


def _spread(lights: np.ndarray) -> float:
    """Return the spread of unit directions (N, 3): 0 if all are equal, 1 if their mean is 0."""
    mean = float(np.linalg.norm(lights.mean(axis=0))) if len(lights) else 1.0
    return max(0.0, 1 - mean) ** 0.5  # the mean of unit vectors may round to a length above 1
