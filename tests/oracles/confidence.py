"""Oracle of the confidence maps: standard deviations in float64."""

from __future__ import annotations

import numpy as np

from tests.oracles import reflectance as oracles
from tests.oracles.swarm import direction_to, frames, turned

_STEP = 1e-5  # of a range, in float64: differences are precise to 1e-9


def tangents(normal):
    """Two unit vectors (…, 3) perpendicular to a normal and to each other, at 45° to the usual choice."""
    first = np.cross(normal, np.where(np.abs(normal[..., 2:]) < 0.8, [0.0, 0, 1], [0.0, 1, 0]))
    second = np.cross(normal, oracles.unit(first))
    return oracles.unit(oracles.unit(first) + second), oracles.unit(oracles.unit(first) - second)


def unknowns(model, fixed=()):
    """Return [(parameter, component, width)] of the free parameters; a normal has two angles with a range of π/2."""
    free = []
    for p in model.parameters:
        if p.name not in fixed:
            width = np.pi / 2 if p.is_normal else p.range[1] - p.range[0]
            free += [(p, i, width) for i in range(2 if p.is_normal else p.components)]
    return free


def moved(values, parameter, component, by):
    """Return the values with one component moved by ``by`` in its own units; a normal is rotated by that angle."""
    value = np.array(values[parameter.name], np.float64)
    if parameter.is_normal:
        value = np.cos(by)[..., None] * value + np.sin(by)[..., None] * tangents(value)[component]
    else:
        value[..., component] += by
    return {**values, parameter.name: value}


def radiance(domain, model_name, values):
    """(K, H, W, 3) float64 radiance of every observation. values: name → (H, W, components)."""
    frame, position = frames(domain.bake), domain.bake.position.astype(np.float64)
    flat = {name: v[..., 0] if v.shape[-1] == 1 else v for name, v in values.items()}
    layers = []
    for k in range(domain.observations):
        light, squared = direction_to(domain.lights[k], position)
        view, _ = direction_to(domain.views[k], position)
        render = oracles.MODELS[model_name](flat, turned(frame, light), turned(frame, view))
        layers.append(render * domain.intensities[k] / squared)
    return np.array(layers)


def jacobian(domain, model, values, fixed=()):
    """Return (n, K, H, W, 3) derivatives of the radiance by every free parameter, per range; one-sided at its ends."""
    columns = []
    for p, i, width in unknowns(model, fixed):
        x = np.zeros(domain.shape) if p.is_normal else (values[p.name][..., i] - p.range[0]) / width
        low = np.where(p.is_normal | (x > 2 * _STEP), -_STEP, 0) * width
        high = np.where(p.is_normal | (x < 1 - 2 * _STEP), _STEP, 0) * width
        ends = [radiance(domain, model.name, moved(values, p, i, by)) for by in (low, high)]
        columns.append((ends[1] - ends[0]) / ((high - low) / width)[..., None])
    return np.array(columns)


def normal_matrix(domain, model, values, fixed=()):
    """Return JᵀJ (H, W, n, n) per range and the noise variance (H, W): a Σ w e² / (3 Σ w − n (1 + a) / 2)."""
    j = jacobian(domain, model, values, fixed)
    w = domain.stack.values[..., 3].astype(np.float64)
    error = np.where(w[..., None] > 0, radiance(domain, model.name, values) - domain.stack.values[..., :3], 0)
    errors = np.einsum("khw,khwc->hw", w, error**2)
    correlation = np.clip(np.einsum("khw,khw->hw", w, error.sum(axis=-1) ** 2) / np.where(errors > 0, errors, 1), 1, 3)
    freedom = 3 * w.sum(axis=0) - (1 + correlation) / 2 * len(j)
    variance = correlation * errors / np.where(freedom > 0, freedom, np.nan)
    return np.einsum("khw,akhwc,bkhwc->hwab", w, j, j), variance


def deviations(model, matrix, variance, fixed=()):
    """Return name → (H, W, components) σ, at most the range; one for a normal. NaN where ``matrix`` is singular."""
    regular = np.isfinite(variance) & (np.linalg.cond(matrix) < 1e12)
    inverse = np.linalg.inv(np.where(regular[..., None, None], matrix, np.eye(matrix.shape[-1])))
    squared = np.where(regular, variance, np.nan)[..., None] * np.einsum("hwaa->hwa", inverse)
    sigma = {p.name: np.zeros((*variance.shape, 1 if p.is_normal else p.components)) for p in model.parameters}
    for (p, i, width), square in zip(unknowns(model, fixed), np.moveaxis(squared, -1, 0), strict=True):
        own = width * np.minimum(1, np.sqrt(square))
        at = 0 if p.is_normal else i
        sigma[p.name][..., at] = np.minimum(width, np.hypot(sigma[p.name][..., at], own))
    return sigma
