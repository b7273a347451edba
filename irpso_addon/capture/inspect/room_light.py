"""Detects room light: radiance that depends on no lamp of a capture."""

from __future__ import annotations

import numpy as np

PIXELS, _FEWEST_PIXELS = 400, 100  # most and fewest pixels in the test
_OFFSETS = np.linspace(-0.2, 0.6, 17)  # candidates, as fractions of a pixel's bright sample
_BRIGHT = 90.0  # percentile of a pixel's samples: its bright sample
_SUBJECT = 0.1  # of the brightest pixels' bright sample: darker pixels are background
_DARKEST = 0.02  # of the bright sample: darker samples are shadow
_FEWEST = 6  # least lit samples of a pixel
_WIDTH = 0.03  # of the Cauchy weight, of the bright sample
_ROUNDS = 5  # of reweighting
# Least offset, and least loss without it over the loss with it: on a metal ball in a dark room that is up to 1.25.
_LEAST, _BETTER = 0.08, 1.3


def room_light(values: np.ndarray, usable: np.ndarray, lamps: np.ndarray) -> float:
    """Return the fraction of the pixels' bright samples that depends on no lamp, 0 if uncertain.

    values: (K, T) radiance of T pixels in K photographs. usable: (K, T) bool. lamps: (K, T, 3) or (K, 1, 3) directions
    to the lamps times their irradiance. A robust fit (Cauchy) models samples by the shading of a matt surface and an
    offset, b·l + o, with one o for all pixels, as a fraction of a pixel's bright sample. No rendered capture of a dark
    room (gloss, metal, velvet, hollows) is positive; a room light of 0.1 is detected on matt and glazed subjects, of
    0.2 on metals, to within 0.05.
    """
    if values.shape[1] < _FEWEST_PIXELS:
        return 0.0
    values = np.where(usable, values, 0).astype(np.float64)
    bright = np.percentile(values, _BRIGHT, axis=0)
    used = usable & (values > _DARKEST * bright)
    chosen = (used.sum(axis=0) >= _FEWEST) & (bright > _SUBJECT * np.percentile(bright, 95))
    if chosen.sum() < _FEWEST_PIXELS:
        return 0.0
    relative, used = values[:, chosen] / bright[chosen], used[:, chosen]
    lamps = np.broadcast_to(lamps, (*values.shape, 3))[:, chosen]
    losses = np.array([_loss(relative, used, lamps, offset) for offset in _OFFSETS])
    best, without = int(losses.argmin()), losses[int(np.abs(_OFFSETS).argmin())]
    return float(_OFFSETS[best]) if _OFFSETS[best] >= _LEAST and without > _BETTER * losses[best] else 0.0


def message(part: float) -> str:
    """Return a warning of room light, "" for none."""
    if not part:
        return ""
    return (
        f"about {part:.0%} of the light on bright pixels comes from no lamp: the room was not dark; darken it, or take"
        " a photograph with the lamp off and subtract it (irpso develop --dark)"
    )


def _loss(relative: np.ndarray, used: np.ndarray, lamps: np.ndarray, offset: float) -> float:
    target = np.where(used, relative - offset, 0)
    weight = used.astype(np.float64)
    for _ in range(_ROUNDS):
        gram = np.einsum("kt,kti,ktj->tij", weight, lamps, lamps, optimize=True)
        gram += (1e-6 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-12) * np.eye(3)
        scaled = np.linalg.solve(gram, np.einsum("kt,kti->ti", weight * target, lamps)[..., None])[..., 0]
        shading = np.einsum("kti,ti->kt", lamps, scaled)
        error = np.where(used, np.maximum(shading, 0) - target, 0)
        weight = used * (shading > 0) / (1 + (error / _WIDTH) ** 2)
    return float(np.log1p((error / _WIDTH) ** 2).sum())
