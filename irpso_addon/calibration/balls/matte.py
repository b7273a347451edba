"""Lights from matte balls: a robust fit of Lambert's law with shadow, ambient light and bounce."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from . import shading as shade
from .ball import tukey
from .shading import Shading

MAX_RADIUS = 24.0  # values; shading is smooth, and averaging reduces noise
_MIN_VALUES = 40  # usable values
_MIN_FOR_BOUNCE = 4  # photographs: in a single one a bounce looks like a rotated light

_ITERATIONS, _JOINT_ITERATIONS, _JACKKNIFE_ITERATIONS = 25, 40, 6
_DATA_ALONE = 5  # first iterations without a prior, whose weight is too great at the residuals of a poor bounce
_CHANNEL_ITERATIONS = 8
_MIN_SCALE = 0.002  # of the light's radiance: least scale of residuals
_GRID = 400  # start directions
_GRID_VALUES = 600
_BOUNCE_START = (0.0, 0.1, 0.15)  # a table below and behind the ball that reflects a fifth
_ALBEDO_START = (0.6,)  # of balls, where the table's light is known
_MIN_STRENGTH = 1e-3  # of the light's radiance, over the mean value; below, there is only ambient light
_SCATTER = 0.15  # deviation of residuals over the light's radiance; above, the light does not reach the ball
_MIN_BOUNCE = 0.01  # length of ``ground``; below, there is no table
_DAMPING = 1e-4  # weight of an unchanged bounce against the data
_BOUNCE_DEVIATION = 0.15  # of each component of ``ground`` before any photograph, about no table
_MODEL = 0.005  # of the light's radiance: least deviation of photographs from the model of a bounce
_INDEPENDENT = 300  # values of a photograph with independent errors; errors of the model are smooth over a ball
_HIDDEN = "the shading is not a ball's: the lamp does not reach it"


@dataclass(frozen=True)
class Fit:
    """A light from shading, in camera axes.

    direction: (3,) unit, from ``centre`` to the light. inverse: 1 / distance, 0 for a distant light. radiance: (3,)
    of a surface at ``centre`` that faces the light. error: of the direction, radians. inverse_error: of ``inverse``.
    misfit: RMS residual over the radiance. lit: fraction of the values that the light reaches. left_out: fraction
    with a weight below 0.1, in cast shadow or in a highlight.
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
    """One photograph's fit. grey, weights: (N,). parameters: see ``shading.direct``."""

    shading: Shading
    grey: np.ndarray
    parameters: np.ndarray
    weights: np.ndarray


def fit_lights(
    shadings: Sequence[Shading], centre: np.ndarray, near: bool, inverse: float = 0.0
) -> tuple[list[Fit | str], np.ndarray]:
    """Return the light of each photograph, or in words why there is none, and ``ground`` of ``shading.bounced``.

    Robust fit (Tukey 1960) of ambient + ``shading.direct`` + ``shading.bounced``. Each photograph has its own light and
    ambient radiance; all share one bounce, which in a single photograph looks like a rotated light. Measured in Cycles
    on a table that reflects 40 %: without the bounce directions err by 2.5° to 4.2° in the mean. Photographs that do
    not determine the bounce give none, and errors that include what one would do. near: fit distances;
    else ``inverse`` is 1 / distance of all lights, 0 for distant ones. The standard errors come from a jackknife over
    sectors of the balls, so they include errors of the model.
    """
    fits: list[_State | str] = [_initial_state(shading, centre, near, inverse) for shading in shadings]
    states = [state for state in fits if isinstance(state, _State)]
    ground, turns = np.zeros(3), np.zeros(len(states))
    if len(states) >= _MIN_FOR_BOUNCE:
        ground, turns = _joint(states, centre, near)
        for state in states:
            _refine(state, centre, ground, near, _ITERATIONS)
    lights = zip(_radiances(states, centre, ground), turns, strict=True)
    results: list[Fit | str] = []
    for begun in fits:
        if isinstance(begun, str):
            results.append(begun)
            continue
        radiance, turn = next(lights)
        hidden = _scatter(begun, centre, ground) > _SCATTER
        results.append(_HIDDEN if hidden else _fit(begun, centre, ground, radiance, near, turn))
    return results, ground


def _scatter(state: _State, centre: np.ndarray, ground: np.ndarray) -> float:
    residual = state.grey - shade.radiance(state.shading, centre, state.parameters, ground)
    return 1.4826 * float(np.median(np.abs(residual))) / float(np.linalg.norm(state.parameters[:3]))


def _initial_state(shading: Shading, centre: np.ndarray, near: bool, inverse: float) -> _State | str:
    if len(shading.values) < _MIN_VALUES:
        return "nearly all values are clipped or masked out; expose less"
    grey = shading.values.mean(axis=-1)
    parameters = _start(shading, grey, centre, inverse)
    if parameters is None:
        return "no shading"
    state = _State(shading, grey, parameters, np.ones(len(grey)))
    _refine(state, centre, np.zeros(3), near, _ITERATIONS)
    strength = np.linalg.norm(state.parameters[:3])
    return state if strength > _MIN_STRENGTH * abs(float(grey.mean())) else "no shading"


def _start(shading: Shading, grey: np.ndarray, centre: np.ndarray, inverse: float) -> np.ndarray | None:
    """Return the best of 400 directions, with strength and ambient by least squares; None if none fits.

    The best has the least sum of absolute residuals, which is robust against cast shadows.
    """
    every = max(1, len(grey) // _GRID_VALUES)
    sparse, value = replace(shading, points=shading.points[::every], normals=shading.normals[::every]), grey[::every]
    azimuth = np.pi * (3 - np.sqrt(5)) * np.arange(_GRID)
    height = 1 - 1.9 * (np.arange(_GRID) + 0.5) / _GRID
    sine = np.sqrt(1 - height**2)
    directions = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), height], axis=-1)
    shapes = np.stack([shade.direct(sparse, centre, np.append(d, inverse)) for d in directions])
    centred = shapes - shapes.mean(axis=1, keepdims=True)
    power = (centred**2).sum(axis=1)
    strength = (centred @ value) / np.maximum(power, 1e-12)
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
    """Refine a photograph's free parameters by Gauss–Newton with Tukey's weights; keep: (N,) bool, the values used."""
    free = _free(state, near)
    for _ in range(iterations):
        residual = state.grey - shade.radiance(state.shading, centre, state.parameters, ground)
        state.weights = _tukey(residual, state.parameters, keep)
        jacobian = shade.jacobian(state.shading, centre, state.parameters, ground)[:, free]
        step = _solved(jacobian, state.weights, residual)
        state.parameters[free] += step
        if np.linalg.norm(step) < 1e-5 * np.linalg.norm(state.parameters[:3]):
            break


def _joint(states: Sequence[_State], centre: np.ndarray, near: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounce by Gauss–Newton over all photographs, and refine the states.

    The Schur complement eliminates each photograph's parameters and leaves three unknowns, or one. An unknown table has
    a normal prior about zero: where a ball shows no terminator, a bounce is equal to a rotation of the lights. Also
    returns (K,) the standard error of each direction by that of the bounce, radians; 0 where the table is known.
    """
    table_known = states[0].shading.table is not None
    ground = np.array(_ALBEDO_START if table_known else _BOUNCE_START)
    count, no_turns = len(ground), np.zeros(len(states))
    for iteration in range(_JOINT_ITERATIONS):
        left, right, solutions, variance = np.zeros((count, count)), np.zeros(count), [], 0.0
        for state in states:
            free = _free(state, near)
            residual = state.grey - shade.radiance(state.shading, centre, state.parameters, ground)
            state.weights = _tukey(residual, state.parameters)
            deviation = max(_scale(residual, state.parameters), _MODEL * float(np.linalg.norm(state.parameters[:3])))
            variance += deviation**2 * len(residual) / _INDEPENDENT / len(states)
            own = shade.jacobian(state.shading, centre, state.parameters, ground)[:, free]
            common = shade.ground_jacobian(state.shading, state.parameters, ground)
            by_common, by_residual = (_solved(own, state.weights, b) for b in (common, residual))
            projected = common - own @ by_common
            left += (projected * state.weights[:, None]).T @ common
            right += (projected * state.weights[:, None]).T @ residual
            solutions.append((state, free, by_common, by_residual))
        if not np.trace(left) > 0:  # no light reaches the table
            return np.zeros(count), no_turns
        alone = table_known or iteration < _DATA_ALONE
        prior = _DAMPING * np.trace(left) if alone else variance / _BOUNCE_DEVIATION**2
        left += prior * np.eye(count)
        step = np.linalg.solve(left, right if alone else right - prior * ground)
        step *= min(1.0, 0.1 / max(float(np.linalg.norm(step)), 1e-300))
        if table_known:
            step = np.clip(ground + step, 0.0, 1.0) - ground
        ground = ground + step
        absent = not alone and np.linalg.norm(ground) < _MIN_BOUNCE
        for state, free, by_common, by_residual in solutions:
            state.parameters[free] += by_residual - by_common @ step
        if absent or (np.linalg.norm(step) < 1e-4 and (table_known or not alone)):
            break
    covariance = variance * np.linalg.inv(left)
    turns = [_turn(state, by_common, covariance) for state, _, by_common, _ in solutions]
    return np.zeros(count) if absent else ground, no_turns if table_known else np.array(turns)


def _turn(state: _State, by_ground: np.ndarray, covariance: np.ndarray) -> float:
    """Return the standard error of a direction by that of the bounce, radians. by_ground: of the free parameters."""
    strength = np.linalg.norm(state.parameters[:3])
    direction = state.parameters[:3] / strength
    across = (np.eye(3) - np.outer(direction, direction)) @ by_ground[:3] / strength
    return float(np.sqrt(np.trace(across @ covariance @ across.T)))


def _free(state: _State, near: bool) -> np.ndarray:
    free = np.ones(len(state.parameters), bool)
    free[3] = near
    return free


def _solved(jacobian: np.ndarray, weights: np.ndarray, right: np.ndarray) -> np.ndarray:
    weighted = jacobian * weights[:, None]
    square = weighted.T @ jacobian
    return np.linalg.solve(square + 1e-9 * np.trace(square) * np.eye(len(square)), weighted.T @ right)


def _tukey(residual: np.ndarray, parameters: np.ndarray, keep: np.ndarray | None = None) -> np.ndarray:
    keep = np.ones(len(residual), bool) if keep is None else keep
    return keep * tukey(residual, _scale(residual[keep], parameters))


def _scale(residual: np.ndarray, parameters: np.ndarray) -> float:
    deviation = 1.4826 * float(np.median(np.abs(residual)))
    return max(deviation, _MIN_SCALE * float(np.linalg.norm(parameters[:3])), 1e-12)


def _fit(state: _State, centre: np.ndarray, ground: np.ndarray, radiance: np.ndarray, near: bool, turn: float) -> Fit:
    """Return a state's light. turn: standard error of its direction by that of the bounce, radians."""
    shading, values = state.shading, state.parameters
    strength = np.linalg.norm(values[:3])
    direction = values[:3] / strength
    turns, inverse_changes = [], []
    for sector in range(shade.SECTORS):
        refit = replace(state, parameters=values.copy())
        _refine(refit, centre, ground, near, _JACKKNIFE_ITERATIONS, shading.sector != sector)
        turns.append(np.linalg.norm(refit.parameters[:3] / np.linalg.norm(refit.parameters[:3]) - direction))
        inverse_changes.append(refit.parameters[3] - values[3])
    factor = np.sqrt((shade.SECTORS - 1) / shade.SECTORS)
    residual = state.grey - shade.radiance(shading, centre, values, ground)
    return Fit(
        direction,
        float(values[3]),
        radiance,
        float(np.hypot(factor * np.linalg.norm(turns), turn)),
        float(factor * np.linalg.norm(inverse_changes)),
        float(np.sqrt(np.mean(residual**2)) / strength),
        float((shade.direct(shading, centre, values) > 0).mean()),
        float((state.weights < 0.1).mean()),
    )


def _radiances(states: Sequence[_State], centre: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Return the radiance (K, 3) of a surface that faces the light, fitted jointly with the table's colour."""
    sums = np.array([_products(state, centre, ground) for state in states])  # (K, channels, 5)
    if not len(sums):
        return np.zeros((0, 3))
    ss, sb, bb, sy, by = np.moveaxis(sums, -1, 0)
    if states[0].shading.table is not None:
        albedo = (by - sb * sy / ss).sum(axis=0) / np.maximum((bb - sb**2 / ss).sum(axis=0), 1e-300)
        return (sy - np.clip(albedo, 0, 1) * sb) / ss
    tint = np.ones(3)
    for _ in range(_CHANNEL_ITERATIONS if ground.any() else 1):
        k = (sy + tint * by) / np.maximum(ss + 2 * tint * sb + tint**2 * bb, 1e-300)
        tint = np.maximum((k * (by - k * sb)).sum(axis=0) / np.maximum((k**2 * bb).sum(axis=0), 1e-300), 0)
    return k


def _products(state: _State, centre: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Return weighted products (3, 5) ss, sb, bb, sy, by of direct shading s, bounce b and values y, less ambient."""
    shading, size = state.shading, np.linalg.norm(state.parameters[:3])
    direct = shade.direct(shading, centre, state.parameters) / size
    bounced = shading.table
    if bounced is None:
        bounced = np.repeat((shade.bounced(shading, state.parameters, ground) / size)[:, None], 3, axis=1)
    shapes = np.column_stack([direct, bounced, shading.values])
    shapes -= shading.own @ _solved(shading.own, state.weights, shapes)
    square = (shapes * state.weights[:, None]).T @ shapes
    pairs = [(1 + c, 4 + c) for c in range(3)]
    return np.array([[square[0, 0], square[0, b], square[b, b], square[0, y], square[b, y]] for b, y in pairs])
