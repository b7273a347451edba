"""Intersection of the rays from several balls: position of a near light or direction of a distant one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .ball import tangents

SIGNIFICANT = 3.0  # standard errors: least 1 / distance of a near light
_ITERATIONS = 40


@dataclass(frozen=True)
class Intersection:
    """A light from rays. direction: (3,) unit, from the balls' centre. error: its standard error, radians.

    inverse: 1 / distance from the centre, at most 0 where rays diverge. inverse_error: its standard error.
    misfit: root mean square angle between the rays and the light, radians.
    """

    direction: np.ndarray
    error: float
    inverse: float
    inverse_error: float
    misfit: float

    @property
    def significance(self) -> float:
        """1 / distance in standard errors."""
        return self.inverse / max(self.inverse_error, 1e-300)


def meet(
    points: np.ndarray,
    directions: np.ndarray,
    errors: Sequence[float],
    centre: np.ndarray,
    near: bool,
    inverse: float = 0.0,
) -> Intersection:
    """Return the intersection of rays from points (B, 3) along unit directions (B, 3): least squares of angles.

    Free parameters are the direction and 1 / distance from ``centre``: from a point P the light lies along
    direction − inverse (P − centre), so a distant light is no special case. errors: standard errors of the directions,
    radians. near: fit the distance; else ``inverse`` is fixed and its standard error equals its magnitude.
    """
    weights = 1 / np.maximum(np.asarray(errors, np.float64), 1e-9) ** 2
    axis = (directions * weights[:, None]).sum(axis=0)
    axis /= np.linalg.norm(axis)
    frames = [tangents(direction) for direction in directions]
    count, offsets = 3 if near else 2, points - centre
    steps = 1e-6 * np.array([1, 1, 1 / max(np.ptp(points, axis=0).max(), 1e-9)])
    for _ in range(_ITERATIONS):
        residuals = _residuals(np.zeros(3), axis, inverse, offsets, frames)
        moved = [_residuals(step, axis, inverse, offsets, frames) for step in np.diag(steps)[:count]]
        jacobian = np.stack([(m - residuals) / size for m, size in zip(moved, steps, strict=False)], axis=-1)
        square = (jacobian * np.repeat(weights, 2)[:, None]).T @ jacobian
        step = np.zeros(3)
        step[:count] = -np.linalg.solve(square, (jacobian * np.repeat(weights, 2)[:, None]).T @ residuals)
        axis = _turned(axis, step)
        axis /= np.linalg.norm(axis)
        inverse += step[2]
        if np.abs(step).max() < 1e-12:
            break
    # ``errors`` are of the whole angle: each of its two axes has half the variance.
    chi_squared = (residuals**2 * np.repeat(weights, 2)).sum() * 2 / max(2 * len(points) - count, 1)
    covariance = np.linalg.inv(square) / 2 * max(chi_squared, 1.0)
    error = np.sqrt(covariance[0, 0] + covariance[1, 1])
    inverse_error = np.sqrt(covariance[2, 2]) if near else abs(inverse)
    misfit = np.sqrt((residuals**2).sum() / len(points))
    return Intersection(axis, float(error), float(inverse), float(inverse_error), float(misfit))


def _turned(axis: np.ndarray, step: np.ndarray) -> np.ndarray:
    across, upward = tangents(axis)
    return axis + step[0] * across + step[1] * upward


def _residuals(
    step: np.ndarray, axis: np.ndarray, inverse: float, offsets: np.ndarray, frames: list[tuple[np.ndarray, np.ndarray]]
) -> np.ndarray:
    """Return the angles (2B,) between rays and light after a step, along both tangents of each ray. offsets: (B, 3)."""
    light = _turned(axis, step)
    toward = light / np.linalg.norm(light) - (inverse + step[2]) * offsets
    toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
    return np.array([[t @ a, t @ b] for t, (a, b) in zip(toward, frames, strict=True)]).ravel()


def converge(intersections: Sequence[Intersection]) -> bool:
    """Return whether lights are near: the median of 1 / distance is above 3 standard errors."""
    return bool(intersections) and float(np.median([i.significance for i in intersections])) > SIGNIFICANT
