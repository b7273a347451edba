"""Light that no lamp of a capture accounts for: a room that was not dark."""

from __future__ import annotations

import numpy as np

PIXELS, _FEWEST_PIXELS = 400, 100  # that are looked at
_OFFSETS = np.linspace(-0.2, 0.6, 17)  # tried, as parts of a pixel's bright sample
_BRIGHT = 90.0  # percentile of a pixel's samples
_SUBJECT = 0.1  # of the brightest pixels' bright sample: background
_DARKEST = 0.02  # of the bright sample: shadow
_FEWEST = 6  # lit samples of a pixel
_WIDTH = 0.03  # of the Cauchy weight, of the bright sample
_ROUNDS = 5  # of reweighting
# Offset that counts, and loss without it over the loss with it: on a metal ball in a dark room that is up to 1.25.
_LEAST, _BETTER = 0.08, 1.3


def room_light(values: np.ndarray, usable: np.ndarray, lamps: np.ndarray) -> float:
    """Return the part of the pixels' bright samples that follows no lamp, 0 where that is not sure.

    values: (K, T) radiance of T pixels in K photographs. usable: (K, T) bool. lamps: (K, T, 3) or (K, 1, 3) directions
    to the lamps times their irradiance. Samples are fitted, robustly (Cauchy), by the shading of a matt surface and an
    offset, b·l + o, with one o for all pixels, as a part of a pixel's bright sample. No rendered capture of a dark
    room (gloss, metal, velvet, hollows) is accused; a tenth of room light is found on matt and glazed subjects, a fifth
    on metals, to 0.05.
    """
    if values.shape[1] < _FEWEST_PIXELS:
        return 0.0
    values = np.where(usable, values, 0).astype(np.float64)
    bright = np.percentile(values, _BRIGHT, axis=0)
    used = usable & (values > _DARKEST * bright)
    lit = (used.sum(axis=0) >= _FEWEST) & (bright > _SUBJECT * np.percentile(bright, 95))
    if lit.sum() < _FEWEST_PIXELS:
        return 0.0
    relative, used = values[:, lit] / bright[lit], used[:, lit]
    lamps = np.broadcast_to(lamps, (*values.shape, 3))[:, lit]
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
    wanted = np.where(used, relative - offset, 0)
    weight = used.astype(np.float64)
    for _ in range(_ROUNDS):
        gram = np.einsum("kt,kti,ktj->tij", weight, lamps, lamps, optimize=True)
        gram += (1e-6 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-12) * np.eye(3)
        scaled = np.linalg.solve(gram, np.einsum("kt,kti->ti", weight * wanted, lamps)[..., None])[..., 0]
        shading = np.einsum("kti,ti->kt", lamps, scaled)
        error = np.where(used, np.maximum(shading, 0) - wanted, 0)
        weight = used * (shading > 0) / (1 + (error / _WIDTH) ** 2)
    return float(np.log1p((error / _WIDTH) ** 2).sum())
