"""What a camera makes of radiance: exposure, noise, saturation and steps of 16 bits. Plain numpy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_WHITE = 65535


@dataclass(frozen=True)
class Sensor:
    """gain: the share of full scale that radiance 1 gives. read, shot: standard deviations of the noise in shares of
    full scale: of a black pixel, and of what photons add at full scale (its square grows with the exposure)."""

    gain: float
    read: float = 0.001
    shot: float = 0.003

    def expose(self, radiance: np.ndarray, seed: int) -> np.ndarray:
        """Return shares of full scale in 0…1, in steps of 1/65535, saturated at 1, of radiance of any shape."""
        signal = np.maximum(self.gain * np.asarray(radiance, np.float64), 0)
        deviation = np.sqrt(self.read**2 + self.shot**2 * np.minimum(signal, 1))
        noisy = signal + deviation * np.random.default_rng(seed).standard_normal(signal.shape)
        return np.round(np.clip(noisy, 0, 1) * _WHITE) / _WHITE
