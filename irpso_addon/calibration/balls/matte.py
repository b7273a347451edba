"""Lights from matte balls: a robust fit of Lambert's law to their shading, with shadow, ambient light and bounce."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from . import shading as shade
from .shading import Shading

LARGEST_RADIUS = 24.0  # values; shading is smooth, and a mean has less noise
_FEWEST = 40  # values that can be used
_FEWEST_FOR_BOUNCE = 4  # photographs: one alone cannot tell bounce from a turned light

_ITERATIONS, _JOINT_ITERATIONS, _JACKKNIFE_ITERATIONS = 25, 40, 6
_CHANNEL_ITERATIONS = 8
_TUKEY = 4.685
_LEAST_SCALE = 0.002  # of the light's radiance: what no fit is better than
_GRID = 400  # directions that are tried as a start
_GRID_VALUES = 600
_BOUNCE_START = (0.0, 0.1, 0.15)  # a table below and behind the ball, that reflects a fifth
_LEAST_BOUNCE = 0.01  # a table that reflects less is none
_BOUNCE_PRIOR = 1e-4  # of what the data say: what keeps a bounce that nothing tells of near its start


@dataclass(frozen=True)
class Fit:
    """A light as the shading tells it, in the camera's axes.

    direction: (3,) unit, from ``centre`` to the light. inverse: 1 / distance to it, 0 for a distant one. radiance: (3,)
    of a surface at ``centre`` that faces the light. error: of the direction, radians. inverse_error: of ``inverse``.
    misfit: root mean square of what is left, of the radiance. lit: the part of the values that the light reaches.
    left_out: the part that hardly counts, in cast shadow or in a highlight.
    """

    direction: np.ndarray
    inverse: float
    radiance: np.ndarray
    error: float
    inverse_error: float
    misfit: float
    lit: float
    left_out: float


@dataclass
class _State:
    """One photograph while it is solved. unknowns: k times the direction, inverse distance, ambient of each ball."""

    shading: Shading
    grey: np.ndarray
    unknowns: np.ndarray
    weights: np.ndarray


def fit_lights(
    shadings: Sequence[Shading], centre: np.ndarray, near: bool, inverse: float = 0.0
) -> tuple[list[Fit | str], np.ndarray]:
    """Return the light of each photograph, or in words why there is none, and (3,) the bounce.

    Fitted to the values of the balls is their ambient radiance + what ``shading.direct`` and ``shading.bounced`` say,
    robustly (Tukey 1960): for each photograph light and ambient, for all of them one bounce, which a single photograph
    could not tell from a turned light. Measured in Cycles on a table that reflects 40 %: without the bounce directions
    are off by 2.5° to 4.2° in the mean. near: whether distances are fitted too; else ``inverse`` is 1 / that of all
    lights, 0 for distant ones. Errors are a jackknife's over sectors of the balls, which tells of what the model does
    not hold too.
    """
    found: list[_State | str] = [_begun(shading, centre, near, inverse) for shading in shadings]
    states = [state for state in found if isinstance(state, _State)]
    ground = np.zeros(3)
    if len(states) >= _FEWEST_FOR_BOUNCE:
        ground = _joint(states, centre, near)
        for state in states:
            _refine(state, centre, ground, near, _ITERATIONS)
    radiances = iter(_radiances(states, centre, ground))
    return [s if isinstance(s, str) else _fit(s, centre, ground, next(radiances), near) for s in found], ground


def _begun(shading: Shading, centre: np.ndarray, near: bool, inverse: float) -> _State | str:
    if len(shading.values) < _FEWEST:
        return "hardly a value is neither clipped nor masked out; expose less"
    grey = shading.values.mean(axis=-1)
    unknowns = _start(shading, grey, centre, inverse)
    if unknowns is None:
        return "no shading"
    state = _State(shading, grey, unknowns, np.ones(len(grey)))
    _refine(state, centre, np.zeros(3), near, _ITERATIONS)
    return state if np.linalg.norm(state.unknowns[:3]) > 0 else "no shading"


def _start(shading: Shading, grey: np.ndarray, centre: np.ndarray, inverse: float) -> np.ndarray | None:
    """Return the best of many directions, each with its strength and ambient by least squares; None where all is flat.

    What is least is the sum of absolute residuals: a cast shadow must not win.
    """
    every = max(1, len(grey) // _GRID_VALUES)
    some, value = replace(shading, points=shading.points[::every], normals=shading.normals[::every]), grey[::every]
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(_GRID)
    height = 1 - 1.9 * (np.arange(_GRID) + 0.5) / _GRID
    flat = np.sqrt(1 - height**2)
    directions = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=-1)
    shapes = np.stack([shade.direct(some, centre, np.append(d, inverse)) for d in directions])
    spread = shapes - shapes.mean(axis=1, keepdims=True)
    power = (spread**2).sum(axis=1)
    strength = (spread @ value) / np.maximum(power, 1e-12)
    ambient = np.maximum(value.mean() - strength * shapes.mean(axis=1), 0)
    cost = np.abs(value - ambient[:, None] - strength[:, None] * shapes).sum(axis=1)
    cost[(strength <= 0) | (power < 1e-9)] = np.inf
    best = int(np.argmin(cost))
    if not np.isfinite(cost[best]):
        return None
    return np.concatenate([strength[best] * directions[best], [inverse], np.full(shading.balls, ambient[best])])


def _refine(
    state: _State, centre: np.ndarray, ground: np.ndarray, near: bool, iterations: int, keep: np.ndarray | None = None
) -> None:
    """Improve a photograph's unknowns by Gauss–Newton with Tukey's weights, the bounce being known."""
    free = _free(state, near)
    for _ in range(iterations):
        residual = state.grey - shade.radiance(state.shading, centre, state.unknowns, ground)
        state.weights = _tukey(residual, state.unknowns, keep)
        jacobian = shade.jacobian(state.shading, centre, state.unknowns, ground)[:, free]
        step = _solved(jacobian, state.weights, residual)
        state.unknowns[free] += step
        if np.linalg.norm(step) < 1e-5 * np.linalg.norm(state.unknowns[:3]):
            break


def _joint(states: Sequence[_State], centre: np.ndarray, near: bool) -> np.ndarray:
    """Return the bounce (3,) after Gauss–Newton over all photographs, and improve the states.

    Each photograph's own unknowns are eliminated (Schur's complement), so that a system of three is left.
    """
    ground = np.array(_BOUNCE_START)
    for _ in range(_JOINT_ITERATIONS):
        left, right, solved = np.zeros((3, 3)), np.zeros(3), []
        for state in states:
            free = _free(state, near)
            residual = state.grey - shade.radiance(state.shading, centre, state.unknowns, ground)
            state.weights = _tukey(residual, state.unknowns)
            own = shade.jacobian(state.shading, centre, state.unknowns, ground)[:, free]
            common = shade.ground_jacobian(state.shading, state.unknowns, ground)
            by_common = _solved(own, state.weights, common)
            by_residual = _solved(own, state.weights, residual)
            projected = common - own @ by_common
            left += (projected * state.weights[:, None]).T @ common
            right += (projected * state.weights[:, None]).T @ residual
            solved.append((state, free, by_common, by_residual))
        if not np.trace(left) > 0:  # no light reaches the table
            return np.zeros(3)
        left += _BOUNCE_PRIOR * np.trace(left) * np.eye(3)
        step = np.linalg.solve(left, right)
        step *= min(1.0, 0.1 / max(float(np.linalg.norm(step)), 1e-300))
        ground = ground + step
        if np.linalg.norm(ground) < _LEAST_BOUNCE:
            return np.zeros(3)
        for state, free, by_common, by_residual in solved:
            state.unknowns[free] += by_residual - by_common @ step
        if np.linalg.norm(step) < 1e-4:
            break
    return ground


def _free(state: _State, near: bool) -> np.ndarray:
    free = np.ones(len(state.unknowns), bool)
    free[3] = near
    return free


def _solved(jacobian: np.ndarray, weights: np.ndarray, right: np.ndarray) -> np.ndarray:
    weighted = jacobian * weights[:, None]
    square = weighted.T @ jacobian
    return np.linalg.solve(square + 1e-9 * np.trace(square) * np.eye(len(square)), weighted.T @ right)


def _tukey(residual: np.ndarray, unknowns: np.ndarray, keep: np.ndarray | None = None) -> np.ndarray:
    keep = np.ones(len(residual), bool) if keep is None else keep
    strength = np.linalg.norm(unknowns[:3])
    scale = max(1.4826 * np.median(np.abs(residual[keep])), _LEAST_SCALE * strength, 1e-12)
    return keep * np.maximum(1 - (residual / (_TUKEY * scale)) ** 2, 0) ** 2


def _fit(state: _State, centre: np.ndarray, ground: np.ndarray, radiance: np.ndarray, near: bool) -> Fit:
    shading, found = state.shading, state.unknowns
    strength = np.linalg.norm(found[:3])
    direction = found[:3] / strength
    apart, inverse_apart = [], []
    for sector in range(shade.SECTORS):
        other = replace(state, unknowns=found.copy())
        _refine(other, centre, ground, near, _JACKKNIFE_ITERATIONS, shading.sector != sector)
        apart.append(np.linalg.norm(other.unknowns[:3] / np.linalg.norm(other.unknowns[:3]) - direction))
        inverse_apart.append(other.unknowns[3] - found[3])
    count = np.sqrt((shade.SECTORS - 1) / shade.SECTORS)
    residual = state.grey - shade.radiance(shading, centre, found, ground)
    return Fit(
        direction,
        float(found[3]),
        radiance,
        float(count * np.linalg.norm(apart)),
        float(count * np.linalg.norm(inverse_apart)),
        float(np.sqrt(np.mean(residual**2)) / strength),
        float((shade.direct(shading, centre, found) > 0).mean()),
        float((state.weights < 0.1).mean()),
    )


def _radiances(states: Sequence[_State], centre: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Return (K, 3) the radiance in each channel of what faces the light; the table's colour is fitted with it."""
    sums = np.array([_products(state, centre, ground) for state in states])  # (K, channels, 5)
    if not len(sums):
        return np.zeros((0, 3))
    ss, sb, bb, sy, by = np.moveaxis(sums, -1, 0)
    tint = np.ones(3)
    for _ in range(_CHANNEL_ITERATIONS if ground.any() else 1):
        k = (sy + tint * by) / np.maximum(ss + 2 * tint * sb + tint**2 * bb, 1e-300)
        tint = np.maximum((k * (by - k * sb)).sum(axis=0) / np.maximum((k**2 * bb).sum(axis=0), 1e-300), 0)
    return k


def _products(state: _State, centre: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Return (3, 5) products of a light's direct shape s, its bounced one b and the values y, ambient taken out."""
    size = np.linalg.norm(state.unknowns[:3])
    shapes = np.stack(
        [
            shade.direct(state.shading, centre, state.unknowns) / size,
            shade.bounced(state.shading, state.unknowns, ground) / size,
            *state.shading.values.T,
        ],
        axis=-1,
    )
    shapes -= state.shading.own @ _solved(state.shading.own, state.weights, shapes)
    square = (shapes * state.weights[:, None]).T @ shapes
    return np.array([[square[0, 0], square[0, 1], square[1, 1], square[0, c], square[1, c]] for c in (2, 3, 4)])
