"""Sensor model: exposure, noise, saturation and 16-bit quantisation of radiance. Plain numpy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_WHITE = 65535


@dataclass(frozen=True)
class Sensor:
    """gain: signal of radiance 1, as fraction of full scale. read, shot: standard deviations of read noise, and of
    photon noise at full scale (its variance is proportional to the signal), as fractions of full scale."""

    gain: float
    read: float = 0.001
    shot: float = 0.003

    def expose(self, radiance: np.ndarray, seed: int) -> np.ndarray:
        """Return fractions of full scale in 0…1, in steps of 1/65535, of radiance of any shape; saturated at 1."""
        signal = np.maximum(self.gain * np.asarray(radiance, np.float64), 0)
        deviation = np.sqrt(self.read**2 + self.shot**2 * np.minimum(signal, 1))
        noisy = signal + deviation * np.random.default_rng(seed).standard_normal(signal.shape)
        return np.round(np.clip(noisy, 0, 1) * _WHITE) / _WHITE
