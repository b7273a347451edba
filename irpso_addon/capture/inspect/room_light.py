"""Detects room light: radiance that depends on no lamp of a capture."""

from __future__ import annotations

import numpy as np

from .shading import WIDTH, bright_samples, shading_errors, with_factors

_OFFSETS = np.linspace(-0.2, 0.6, 17)  # candidates, as fractions of a pixel's bright sample
# Least offset, and least loss without it over the loss with it: on a metal ball in a dark room that is up to 1.25.
_MIN_OFFSET, _BETTER = 0.08, 1.3


def room_light(values: np.ndarray, usable: np.ndarray, lamps: np.ndarray) -> float:
    """Return the fraction of the pixels' bright samples that depends on no lamp, 0 if uncertain.

    values, usable, lamps: as of ``shading.bright_samples``. A robust fit models samples by the shading of a matt
    surface and an offset, b·l + o, with one o for all pixels, as a fraction of a pixel's bright sample. No rendered
    capture of a dark room (gloss, metal, velvet, hollows) is positive; a room light of 0.1 is detected on matt and
    glazed subjects, of 0.2 on metals, to within 0.05.
    """
    samples = bright_samples(values, usable, lamps)
    if samples is None:
        return 0.0
    relative, used, lamps = samples
    losses = np.array([_loss(shading_errors(relative - offset, used, lamps)[0]) for offset in _OFFSETS])
    best, without = int(losses.argmin()), losses[int(np.abs(_OFFSETS).argmin())]
    if _OFFSETS[best] < _MIN_OFFSET or without <= _BETTER * losses[best]:
        return 0.0
    # On a nearly flat card lamps of unequal strength look like an offset.
    unequal = _loss(shading_errors(with_factors(relative, used, lamps), used, lamps)[0])
    return float(_OFFSETS[best]) if unequal > losses[best] else 0.0


def room_light_message(part: float) -> str:
    """Return a warning of room light, "" for none."""
    if not part:
        return ""
    return (
        f"about {part:.0%} of the light on bright pixels comes from no lamp: the room was not dark; darken it, or take"
        " a photograph with the lamp off and subtract it (irpso develop --dark)"
    )


def _loss(errors: np.ndarray) -> float:
    return float(np.log1p((errors / WIDTH) ** 2).sum())
