"""Oracle of the alternatives' maps: how well values far from the estimates fit the samples, in float64."""

from __future__ import annotations

import numpy as np

from irpso_addon.solver.settings.resolve import ResolvedSwarm
from tests.oracles import confidence as confidence_oracle
from tests.oracles import synchronous_swarm as generation

_FRACTIONS = (0.01, 0.04, 0.1, 0.25, 0.5, 0.75, 1.0)  # tried values, as fractions of a range
_FAR, _MAX_LOG, _FLOOR = 0.3, 9.0, 0.01


def log_ratios(domain, model, values, schedule, scale, fixed=()):
    """Return name → (H, W, 1), within ±9: n log((F + 0.01) / (F₀ + 0.01)) of each scalar's best alternative."""
    linear = tuple(p for p in model.parameters if p.kind == "linear" and p.name not in fixed)
    problem = generation.SynchronousSwarm(
        domain, model, ResolvedSwarm((), 0, solved=linear), schedule, values, scale, 1
    )
    own, counted = generation.fitness(problem, values), generation.sample_weights(problem, values)
    n = _degrees_of_freedom(problem, values, len(confidence_oracle.unknowns(model, fixed)))
    result = {}
    for p in model.parameters:
        skipped = p.name in fixed or p.is_normal or p.components > 1 or p.kind == "linear"
        if skipped or p.prior is not None and p.prior.kind == "normal":
            continue
        low, width = p.range[0], p.range[1] - p.range[0]
        lowest = np.full(domain.shape, np.inf)
        for fraction in _FRACTIONS:
            trial = {**values, p.name: np.full((*domain.shape, 1), low + fraction * width)}
            far = np.abs(trial[p.name] - values[p.name])[..., 0] >= _FAR * width
            if linear:
                trial = problem.with_weights(trial, generation.solve(problem, trial, counted))
            lowest = np.where(far, np.minimum(lowest, generation.fitness(problem, trial)), lowest)
        result[p.name] = np.clip(n * np.log((lowest + _FLOOR) / (own + _FLOOR)), -_MAX_LOG, _MAX_LOG)[..., None]
    return result


def _degrees_of_freedom(problem, values, unknowns):
    """Return (H, W): samples minus the ``unknowns`` free parameters; correlated channels count once."""
    residual, w = generation.error(problem, values), problem.domain.stack.values[..., 3].astype(np.float64)
    errors = (w[..., None] * residual**2).sum(axis=(0, -1))
    correlation = np.clip((w * residual.sum(axis=-1) ** 2).sum(axis=0) / np.where(errors > 0, errors, 1), 1, 3)
    return np.maximum(3 * w.sum(axis=0) - (1 + correlation) / 2 * unknowns, 0) / correlation
