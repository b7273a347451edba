"""Smooth random fields: sums of plane waves, functions of the position alone."""

from __future__ import annotations

import numpy as np

_WAVES = 28  # per field: with so many no direction stands out


def wave_field(p: np.ndarray, wavelength: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a smooth random field of about unit variance at positions (…, 3), and its gradient of about unit slope.

    wavelength: in the unit of the positions; the waves have 0.8 to 1.25 times this length.
    """
    numbers, phases = _waves(wavelength, seed)
    gradient = np.zeros(p.shape)
    for number, phase in zip(numbers, phases, strict=True):
        gradient += np.cos(p @ number + phase)[..., None] * (number / np.linalg.norm(number))
    # Two of the gradient's three directions lie in the surface.
    return wave_values(p, wavelength, seed), gradient * np.sqrt(3 / _WAVES)


def wave_values(p: np.ndarray, wavelength: float, seed: int) -> np.ndarray:
    """Return the values (…) of ``wave_field`` alone."""
    value = np.zeros(p.shape[:-1])
    for number, phase in zip(*_waves(wavelength, seed), strict=True):
        value += np.sin(p @ number + phase)
    return value * np.sqrt(2 / _WAVES)  # each wave has variance 1/2


def _waves(wavelength: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the wave vectors (_WAVES, 3) and phases (_WAVES,) of a field."""
    random = np.random.default_rng(seed)
    axes = random.normal(size=(_WAVES, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    numbers = 2 * np.pi / (wavelength * random.uniform(0.8, 1.25, _WAVES))
    return numbers[:, None] * axes, random.uniform(0, 2 * np.pi, _WAVES)
