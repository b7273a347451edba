"""Near lamps from the fall-off of their light over a flat card of unknown albedo."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from ...core.optional import present
from .known import LampFit, Samples, fit_steps
from .lamps import Lamps

_STARTS = 1.2, 2.5, 5.0  # distances of lamps at the start of fits, in radii of the card
_STEEPEST = 0.85  # largest sine of the angle off the card's normal at a start
_NEAREST = 3.0  # largest radius / distance of a lamp
_GLOSS_ROUNDS, _GLOSSY = 2, 12.0  # degrees from the mirror direction
_ROUNDS = 5  # of the trends' reweighting


def falloff_steps(
    samples: Samples, views: np.ndarray, centre: np.ndarray, size: float
) -> Generator[None, None, LampFit]:
    """Yield often; return near lamps over a card, whose normals are all (0, 0, 1).

    views: (T, 3) unit directions to the camera. Samples near the mirror direction have no weight: gloss adds light.

    The logarithm of a lamp's irradiance is −1.5 log(|x − f|² + h²) plus a constant, with foot f and height h. The ratio
    of two photographs is one of two quadratics, which determines both, unless the lamps are so far that only its
    gradient is measurable. Of several starts, the fit with the least misfit is used. The standard errors include the
    difference from the fit to all samples.
    """
    best: LampFit | None = None
    for start in _starts(samples, centre, size):
        fit = yield from fit_steps(samples, start, near=True, nearest=_NEAREST)
        if best is None or fit.misfit < best.misfit:
            best = fit
    best = present(best)
    lamps = best.lamps
    for _ in range(_GLOSS_ROUNDS):
        matt = replace(samples, weight=samples.weight * (_half_angles(lamps, samples, views) > _GLOSSY))
        fit = yield from fit_steps(matt, lamps, near=True, nearest=_NEAREST)
        lamps = fit.lamps
    return replace(fit, errors=np.hypot(fit.errors, _difference(best.lamps, fit.lamps)))


def even_steps(samples: Samples, lamps: Lamps) -> Generator[None, None, LampFit]:
    """Yield often; return the fit of distant lamps along the normal: a card is evenly lit by any distant lamp."""
    count = len(lamps.inverses)
    up = replace(lamps, directions=np.tile((0.0, 0.0, 1.0), (count, 1)), inverses=np.zeros(count))
    return (yield from fit_steps(samples, up, near=False))


def _difference(one: Lamps, other: Lamps) -> np.ndarray:
    """Return the differences (K, FREE) between lamps, by parameter."""
    cosine = np.clip((one.directions * other.directions).sum(axis=-1), -1, 1)
    turned = np.arccos(cosine) / np.sqrt(2)
    strengths = np.log(one.strengths / other.strengths)
    return np.stack([turned, turned, one.inverses - other.inverses, strengths], axis=-1)


def _half_angles(lamps: Lamps, samples: Samples, views: np.ndarray) -> np.ndarray:
    """Return the angles (K, T), degrees, between normal and half vector: 0 at the mirror direction."""
    u, length = lamps.seen_from(samples.points)
    half = u / length[..., None] + views
    half /= np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-12)
    return np.degrees(np.arccos(np.clip(np.einsum("ktc,tc->kt", half, samples.normals), -1, 1)))


def _starts(samples: Samples, centre: np.ndarray, size: float) -> list[Lamps]:
    """Return lamps at several distances whose fall-off matches the photographs' gradients at the centre."""
    slopes, levels = _trends(samples, centre, size)
    starts = []
    for distance in _STARTS:
        # The gradient of −1.5 log(|x − f|² + h²) at the centre is 3 f / distance².
        tangential = slopes * distance / 3
        length = np.linalg.norm(tangential, axis=-1, keepdims=True)
        tangential = tangential * np.minimum(1, _STEEPEST / np.maximum(length, 1e-12))
        up = np.sqrt(1 - (tangential**2).sum(axis=-1, keepdims=True))
        strengths = np.exp(levels) / up[:, 0]
        strengths = strengths / np.exp(np.log(strengths).mean())
        directions = np.concatenate([tangential, up], axis=-1)
        starts.append(Lamps(centre, size, directions, np.full(len(slopes), 1 / distance), strengths))
    return starts


def _trends(samples: Samples, centre: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Fit planes robustly to each photograph's logarithm, less the median; return slopes (K, 2) and constants (K,)."""
    lit = (samples.weight > 0) & (samples.values > 0)
    logs = np.where(lit, np.log(np.where(lit, samples.values, 1)), np.nan)
    logs = logs - np.nanmedian(logs, axis=0)
    plane = np.concatenate([np.ones((logs.shape[1], 1)), (samples.points - centre)[:, :2] / size], axis=-1)
    rows = []
    for values in logs:
        known = np.isfinite(values)
        weight = np.ones(known.sum())
        for _ in range(_ROUNDS):
            root = np.sqrt(weight)[:, None]
            solution = np.linalg.lstsq(plane[known] * root, values[known] * root[:, 0], rcond=None)[0]
            residual = values[known] - plane[known] @ solution
            weight = 1 / (1 + (residual / max(2 * float(np.median(np.abs(residual))), 1e-3)) ** 2)
        rows.append(solution)
    trends = np.array(rows)
    return trends[:, 1:], trends[:, 0]
