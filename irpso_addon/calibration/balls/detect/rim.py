"""Outline of a matte ball from radiance integrated across its rim, where edges are biased by the shading."""

from __future__ import annotations

import numpy as np

from ....core.errors import InputError
from ....core.filters import sampled, weighted_median
from ..ball import Ball, fit_ball, tukey
from .pictures import Pictures

_ANGLES = 72
_GAP, _GAP_RADII = 2.0, 0.04  # distance from the rim beyond its blur: pixels, radii; the larger one
_INSIDE, _INSIDE_PIXELS = 0.3, 3.0  # radii, pixels: extent of the shading that is extrapolated to the rim
_OUTSIDE, _OUTSIDE_PIXELS = 0.06, 2.0  # radii, pixels: extent of the background
_STEP = 0.5  # pixels
_MIN_CONTRAST = 0.02  # of white
_MODEL, _BEND = 0.02, 0.05  # error of the shading model: over the contrast, and over β
_ROUNDS, _ITERATIONS = 4, 12
_MIN_SCALE = 0.1  # pixels


def on_rim(pictures: Pictures, ball: Ball) -> tuple[Ball, np.ndarray] | None:
    """Return a matte ball and its outline's points (72, 2), more accurate than edges; None if too little is visible.

    Edges are biased by up to 2 % of the radius where the ball darkens toward its rim or is brighter than the
    background. The sum of radiance across the rim does not depend on blur. Its excess over a prediction, from the
    shading inside, α + β n·v (Lambert), and the background, gives the rim's position. A robust fit (Tukey 1960) over
    all directions and photographs gives the circle.
    """
    angle = 2 * np.pi * np.arange(_ANGLES) / _ANGLES
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    design = np.concatenate([direction, np.ones((_ANGLES, 1))], axis=1)
    points = np.zeros((0, 2))
    for _ in range(_ROUNDS):
        middle, radius = _polar(ball, angle)
        shifts, weights = _shifts(pictures, middle, radius, direction)
        step = _robust_fit(design, shifts, weights)
        if step is None or np.abs(step).max() > _GAP_RADII * 3 * radius.mean() + _GAP:
            return None
        points = middle + (radius + design @ step)[:, None] * direction
        try:
            ball = fit_ball(points, pictures.camera)
        except InputError:
            return None
    return ball, points


def _polar(ball: Ball, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the centre (2,) of a ball's outline and the outline's distance from it (A,) in each direction."""
    outline = ball.outline[:-1]
    centre = outline.mean(axis=0)
    offsets = outline - centre
    azimuth = np.arctan2(offsets[:, 1], offsets[:, 0])
    order = np.argsort(azimuth)
    return centre, np.interp(angle, azimuth[order], np.linalg.norm(offsets, axis=1)[order], period=2 * np.pi)


def _shifts(
    pictures: Pictures, middle: np.ndarray, radius: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the rim's offsets (K, A) outside ``radius`` (A,), in pixels, and their inverse variances.

    The inverse variance is 0 where a value is clipped or the contrast to the background is too low.
    """
    size = float(radius.mean())
    gap = max(_GAP, _GAP_RADII * size)
    reach, beyond = max(_INSIDE * size, gap + _INSIDE_PIXELS), gap + max(_OUTSIDE_PIXELS, _OUTSIDE * size)
    offsets = np.arange(-reach, beyond, _STEP)
    inside, outside = offsets <= -gap, offsets >= gap
    places = middle + (radius[:, None] + offsets)[..., None] * direction[:, None]
    facing = np.sqrt(1 - np.clip((radius[:, None] + offsets) / radius[:, None], 0, 1) ** 2)
    slope = facing[:, inside] - facing[:, inside].mean(axis=1, keepdims=True)
    covered = np.clip(0.5 - offsets / _STEP, 0, 1)  # fraction of a sample
    at_rim = np.sqrt(1 - (1 - 0.5 / radius) ** 2)  # n·v half a pixel inside
    shifts, weights = [], []
    for picture, clipped in zip(pictures.values, pictures.clipped, strict=True):
        values = sampled(np.ascontiguousarray(picture), places)
        shading = values[:, inside]
        beta = (slope * shading).sum(axis=1) / (slope**2).sum(axis=1)
        alpha = shading.mean(axis=1) - beta * facing[:, inside].mean(axis=1)
        misfit = ((shading - alpha[:, None] - beta[:, None] * facing[:, inside]) ** 2).mean(axis=1)
        background = np.median(values[:, outside], axis=1)
        uneven = ((values[:, outside] - background[:, None]) ** 2).mean(axis=1)
        ball_values = np.maximum(alpha[:, None] + beta[:, None] * facing, 0)
        expected = ball_values * covered + background[:, None] * (1 - covered)
        contrast = alpha + beta * at_rim - background
        excess = (values - expected)[:, ~inside & ~outside].sum(axis=1) * _STEP
        clear = (np.abs(contrast) > _MIN_CONTRAST) & ~(sampled(clipped.astype(np.float32), places) > 0).any(axis=1)
        shift = excess / np.where(clear, contrast, 1.0)
        variance = pictures.noise**2 + uneven + 4 * misfit + (_MODEL * contrast) ** 2 + (_BEND * beta) ** 2
        shifts.append(shift)
        weights.append(np.where(clear & (np.abs(shift) < gap), contrast**2 / np.where(clear, variance, 1.0), 0))
    return np.array(shifts), np.array(weights)


def _robust_fit(design: np.ndarray, shifts: np.ndarray, weights: np.ndarray) -> np.ndarray | None:
    """Return the robust step (3,), x, y and radius, for shifts (K, A); None if they do not determine it."""
    _, column = used = np.nonzero(weights)
    design, shift, weight = design[column], shifts[used], weights[used]
    robust, step = np.ones(len(shift)), np.zeros(3)
    for _ in range(_ITERATIONS):
        weighted = design * (weight * robust)[:, None]
        square = weighted.T @ design
        if np.linalg.matrix_rank(square) < 3:
            return None
        step = np.linalg.solve(square, weighted.T @ shift)
        residual = np.abs(shift - design @ step)
        robust = tukey(residual, max(1.4826 * weighted_median(residual, weight), _MIN_SCALE))
    return step
