"""Outline of a matte ball from the light that its rim sends: an edge's place does not tell where shading ends."""

from __future__ import annotations

import numpy as np

from ....core.errors import InputError
from ....core.filters import sampled, weighted_median
from ..ball import Ball, fit_ball, tukey
from .pictures import Pictures

_ANGLES = 72
_GAP, _GAP_RADII = 2.0, 0.04  # from the rim to what it does not blur: pixels, and at least so many radii
_INSIDE, _INSIDE_PIXELS = 0.3, 3.0  # reach of the shading that is continued to the rim
_OUTSIDE, _OUTSIDE_PIXELS = 0.06, 2.0  # and of what lies beside the ball
_STEP = 0.5  # pixels
_LEAST_CONTRAST = 0.02  # of white
_MODEL, _BEND = 0.02, 0.05  # error of the shading, over the contrast and over its slope
_ROUNDS, _ITERATIONS = 4, 12
_LEAST_SCALE = 0.1  # pixels


def on_rim(pictures: Pictures, ball: Ball) -> tuple[Ball, np.ndarray] | None:
    """Return a matte ball with its outline's points (72, 2), better than edges give them; None: too little is seen.

    Where the ball darkens toward its rim, or outshines what lies behind it, an edge seems to lie up to 2 % of the
    radius inside or outside. The sum of the light across the rim does not depend on the blur: it tells how far the
    ball's own light reaches, which its shading beside the rim, α + β n·v (Lambert), and the values beside the ball
    predict. The circle follows from all directions and photographs, robustly (Tukey 1960).
    """
    angle = 2 * np.pi * np.arange(_ANGLES) / _ANGLES
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    design = np.concatenate([direction, np.ones((_ANGLES, 1))], axis=1)
    points = np.zeros((0, 2))
    for _ in range(_ROUNDS):
        middle, radius = _polar(ball, angle)
        shifts, weights = _shifts(pictures, middle, radius, direction)
        step = _agreed(design, shifts, weights)
        if step is None or np.abs(step).max() > _GAP_RADII * 3 * radius.mean() + _GAP:
            return None
        points = middle + (radius + design @ step)[:, None] * direction
        try:
            ball = fit_ball(points, pictures.camera)
        except InputError:
            return None
    return ball, points


def _polar(ball: Ball, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the middle (2,) of a ball's outline and its distance (A,) in each direction."""
    outline = ball.outline[:-1]
    middle = outline.mean(axis=0)
    away = outline - middle
    turn = np.arctan2(away[:, 1], away[:, 0])
    order = np.argsort(turn)
    return middle, np.interp(angle, turn[order], np.linalg.norm(away, axis=1)[order], period=2 * np.pi)


def _shifts(
    pictures: Pictures, middle: np.ndarray, radius: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return how far (K, A), in pixels, the rim lies outside ``radius`` (A,), and the inverse of the variance.

    The weight is 0 where a value is clipped, or the ball is as bright as what lies beside it.
    """
    size = float(radius.mean())
    gap = max(_GAP, _GAP_RADII * size)
    reach, beyond = max(_INSIDE * size, gap + _INSIDE_PIXELS), gap + max(_OUTSIDE_PIXELS, _OUTSIDE * size)
    away = np.arange(-reach, beyond, _STEP)
    inside, outside = away <= -gap, away >= gap
    places = middle + (radius[:, None] + away)[..., None] * direction[:, None]
    facing = np.sqrt(1 - np.clip((radius[:, None] + away) / radius[:, None], 0, 1) ** 2)
    slope = facing[:, inside] - facing[:, inside].mean(axis=1, keepdims=True)
    within = np.clip(0.5 - away / _STEP, 0, 1)  # the part of a sample that the ball covers
    at_rim = np.sqrt(1 - (1 - 0.5 / radius) ** 2)  # half a pixel inside
    shifts, weights = [], []
    for picture, clipped in zip(pictures.values, pictures.clipped, strict=True):
        values = sampled(np.ascontiguousarray(picture), places)
        shading = values[:, inside]
        beta = (slope * shading).sum(axis=1) / (slope**2).sum(axis=1)
        alpha = shading.mean(axis=1) - beta * facing[:, inside].mean(axis=1)
        rough = ((shading - alpha[:, None] - beta[:, None] * facing[:, inside]) ** 2).mean(axis=1)
        beside = np.median(values[:, outside], axis=1)
        uneven = ((values[:, outside] - beside[:, None]) ** 2).mean(axis=1)
        own = np.maximum(alpha[:, None] + beta[:, None] * facing, 0)
        expected = own * within + beside[:, None] * (1 - within)
        contrast = alpha + beta * at_rim - beside
        more = (values - expected)[:, ~inside & ~outside].sum(axis=1) * _STEP
        clear = (np.abs(contrast) > _LEAST_CONTRAST) & ~(sampled(clipped.astype(np.float32), places) > 0).any(axis=1)
        shift = more / np.where(clear, contrast, 1.0)
        variance = pictures.noise**2 + uneven + 4 * rough + (_MODEL * contrast) ** 2 + (_BEND * beta) ** 2
        shifts.append(shift)
        weights.append(np.where(clear & (np.abs(shift) < gap), contrast**2 / np.where(clear, variance, 1.0), 0))
    return np.array(shifts), np.array(weights)


def _agreed(design: np.ndarray, shifts: np.ndarray, weights: np.ndarray) -> np.ndarray | None:
    """Return the move (2,) and growth (3,) that shifts (K, A) agree upon, or None."""
    _, column = used = np.nonzero(weights)
    design, shift, weight = design[column], shifts[used], weights[used]
    sure, step = np.ones(len(shift)), np.zeros(3)
    for _ in range(_ITERATIONS):
        weighted = design * (weight * sure)[:, None]
        square = weighted.T @ design
        if np.linalg.matrix_rank(square) < 3:
            return None
        step = np.linalg.solve(square, weighted.T @ shift)
        rest = np.abs(shift - design @ step)
        sure = tukey(rest, max(1.4826 * weighted_median(rest, weight), _LEAST_SCALE))
    return step
