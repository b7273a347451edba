"""Where the rays from several balls meet: the place of a near light, or that it is distant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .ball import tangents

SIGNIFICANT = 3.0  # standard errors that 1 / distance must be off 0 by
_ITERATIONS = 40


@dataclass(frozen=True)
class HaloOverlap:
    """A light that rays lead to. direction: (3,) unit, from the rig's centre. error: of it, radians.

    inverse: 1 / distance from the centre, not above 0 where rays do not converge. inverse_error: its standard error.
    misfit: root mean square angle that rays are off the light by, in radians.
    """

    direction: np.ndarray
    error: float
    inverse: float
    inverse_error: float
    misfit: float

    @property
    def significance(self) -> float:
        """How many standard errors 1 / distance is above 0."""
        return self.inverse / max(self.inverse_error, 1e-300)


def meet(
    points: np.ndarray,
    directions: np.ndarray,
    errors: Sequence[float],
    centre: np.ndarray,
    near: bool,
    inverse: float = 0.0,
) -> HaloOverlap:
    """Return where rays from points (B, 3) along unit directions (B, 3) meet, by weighted least squares of angles.

    The light is sought as direction and 1 / distance from ``centre``, so that a distant one is no special case: seen
    from a point P it lies along direction − inverse (P − centre). errors: of each direction, radians. near: whether
    the distance is fitted; else ``inverse`` is taken for what is known, and its error is as large as itself.
    """
    weights = 1 / np.maximum(np.asarray(errors, np.float64), 1e-9) ** 2
    axis = (directions * weights[:, None]).sum(axis=0)
    axis /= np.linalg.norm(axis)
    frames = [tangents(direction) for direction in directions]
    count = 3 if near else 2
    for _ in range(_ITERATIONS):
        across, upward = tangents(axis)

        def residual(
            step: np.ndarray,
            axis: np.ndarray = axis,
            inverse: float = inverse,
            across: np.ndarray = across,
            upward: np.ndarray = upward,
        ) -> np.ndarray:
            light = axis + step[0] * across + step[1] * upward
            toward = light / np.linalg.norm(light) - (inverse + step[2]) * (points - centre)
            toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
            return np.array([[t @ a, t @ b] for t, (a, b) in zip(toward, frames, strict=True)]).ravel()

        here = residual(np.zeros(3))
        small = 1e-6 * np.array([1, 1, 1 / max(np.ptp(points, axis=0).max(), 1e-9)])
        jacobian = np.stack([(residual(d) - here) / d.sum() for d in np.diag(small)[:count]], axis=-1)
        square = (jacobian * np.repeat(weights, 2)[:, None]).T @ jacobian
        step = np.zeros(3)
        step[:count] = -np.linalg.solve(square, (jacobian * np.repeat(weights, 2)[:, None]).T @ here)
        axis = axis + step[0] * across + step[1] * upward
        axis /= np.linalg.norm(axis)
        inverse += step[2]
        if np.abs(step).max() < 1e-12:
            break
    # An error is of the whole angle, half of its square in each of two axes.
    chance = (here**2 * np.repeat(weights, 2)).sum() * 2 / max(2 * len(points) - count, 1)
    covariance = np.linalg.inv(square) / 2 * max(chance, 1.0)
    error = np.sqrt(covariance[0, 0] + covariance[1, 1])
    inverse_error = np.sqrt(covariance[2, 2]) if near else abs(inverse)
    misfit = np.sqrt((here**2).sum() / len(points))
    return HaloOverlap(axis, float(error), float(inverse), float(inverse_error), float(misfit))


def converge(meetings: Sequence[HaloOverlap]) -> bool:
    """Return whether lights are near: whether rays of most of them converge by more than their errors tell."""
    return bool(meetings) and float(np.median([meeting.significance for meeting in meetings])) > SIGNIFICANT
