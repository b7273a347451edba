"""Near lamps from their fall-off over a flat card of unknown albedo."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from ...core.optional import present
from .known import Found, Samples, fit_steps
from .lamps import Lamps

_STARTS = 1.2, 2.5, 5.0  # distances of lamps, in radii of the card, from which the fit begins
_STEEPEST = 0.85  # sine of the largest angle off the card's normal at a start
_NEAREST = 3.0  # largest radius / distance of a lamp
_GLOSS_ROUNDS, _GLOSSY = 2, 12.0  # degrees from the mirror direction
_ROUNDS = 5  # of the trends' robust fit


def falloff_steps(samples: Samples, views: np.ndarray, centre: np.ndarray, size: float) -> Generator[None, None, Found]:
    """Yield often; return near lamps over a card, whose normals are all (0, 0, 1).

    views: (T, 3) unit directions to the camera: samples near the mirror direction, where gloss adds its own light, do
    not count.

    The logarithm of a lamp's light is −1.5 log(|x − f|² + h²) and a constant, with foot f and height h: the ratio of
    two photographs is one of two quadratics, which tells both, unless lamps are so far that nothing but its gradient
    is left. Several starts; the one that explains the photographs best counts. The standard errors include how far the
    lamps differ from those that all samples tell.
    """
    best: Found | None = None
    for start in _starts(samples, centre, size):
        found = yield from fit_steps(samples, start, near=True, nearest=_NEAREST)
        if best is None or found.misfit < best.misfit:
            best = found
    best = present(best)
    lamps = best.lamps
    for _ in range(_GLOSS_ROUNDS):
        matt = replace(samples, weight=samples.weight * (_half_angles(lamps, samples, views) > _GLOSSY))
        found = yield from fit_steps(matt, lamps, near=True, nearest=_NEAREST)
        lamps = found.lamps
    return replace(found, errors=np.hypot(found.errors, _difference(best.lamps, found.lamps)))


def even_steps(samples: Samples, lamps: Lamps) -> Generator[None, None, Found]:
    """Yield often; return the fit of distant lamps, which light a card evenly, as near ones in one place do."""
    count = len(lamps.inverses)
    up = replace(lamps, directions=np.tile((0.0, 0.0, 1.0), (count, 1)), inverses=np.zeros(count))
    return (yield from fit_steps(samples, up, near=False))


def _difference(one: Lamps, other: Lamps) -> np.ndarray:
    """Return (K, FREE) differences between lamps: in a common model of gloss and relief they would be 0."""
    cosine = np.clip((one.directions * other.directions).sum(axis=-1), -1, 1)
    turned = np.arccos(cosine) / np.sqrt(2)
    strengths = np.log(one.strengths / other.strengths)
    return np.stack([turned, turned, one.inverses - other.inverses, strengths], axis=-1)


def _half_angles(lamps: Lamps, samples: Samples, views: np.ndarray) -> np.ndarray:
    """Return (K, T) degrees between the normal and the half vector of lamp and view: 0 at the mirror direction."""
    u, length = lamps.seen_from(samples.points)
    half = u / length[..., None] + views
    half /= np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-12)
    return np.degrees(np.arccos(np.clip(np.einsum("ktc,tc->kt", half, samples.normals), -1, 1)))


def _starts(samples: Samples, centre: np.ndarray, size: float) -> list[Lamps]:
    """Return lamps at several distances whose fall-off has the gradients of the photographs at the centre."""
    slopes, levels = _trends(samples, centre, size)
    starts = []
    for far in _STARTS:
        # The gradient of −1.5 log(|x − f|² + h²) at the centre is 3 f / distance².
        across = slopes * far / 3
        length = np.linalg.norm(across, axis=-1, keepdims=True)
        across = across * np.minimum(1, _STEEPEST / np.maximum(length, 1e-12))
        up = np.sqrt(1 - (across**2).sum(axis=-1, keepdims=True))
        strengths = np.exp(levels) / up[:, 0]
        strengths = strengths / np.exp(np.log(strengths).mean())
        directions = np.concatenate([across, up], axis=-1)
        starts.append(Lamps(centre, size, directions, np.full(len(slopes), 1 / far), strengths))
    return starts


def _trends(samples: Samples, centre: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (K, 2) gradients and (K,) constants of the logarithm of each photograph over the mean of all, robustly."""
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
            answer = np.linalg.lstsq(plane[known] * root, values[known] * root[:, 0], rcond=None)[0]
            off = values[known] - plane[known] @ answer
            weight = 1 / (1 + (off / max(2 * float(np.median(np.abs(off))), 1e-3)) ** 2)
        rows.append(answer)
    trends = np.array(rows)
    return trends[:, 1:], trends[:, 0]
