"""Reduced photographs: codes for the search for points, radiance for the fit of the flash, and sharpness."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from ...capture.frame.find import display_codes
from ...capture.types import Capture
from ...core.filters import block_means

_WORKING = 1600  # pixels: largest longer side of codes


@dataclass(frozen=True)
class Pictures:
    """codes: (h, w) uint8 of each photograph, row 0 at the TOP. radiance: (h, w) grey, smaller, row 0 at the bottom.

    NaN where it is clipped. factor: size of codes over that of the photographs. sharp: (K,) sharpness.
    """

    codes: list[np.ndarray]
    radiance: list[np.ndarray]
    factor: float
    sharp: np.ndarray


def picture_steps(capture: Capture) -> Generator[float, None, Pictures]:
    """Yield the fraction done; return the reduced photographs. Each is read once."""
    longer = max(capture.cameras[0].width, capture.cameras[0].height)
    factor = max(1, int(np.ceil(longer / _WORKING)))
    codes, radiance, sharp = [], [], []
    for number, observation in enumerate(capture.observations):
        yield number / len(capture.observations)
        rgba = observation.read()
        grey = np.nan_to_num(rgba[..., :3].mean(axis=-1), posinf=0.0)
        reduced = _reduced(grey, factor)
        codes.append(display_codes(reduced))
        sharp.append(_sharpness(codes[-1]))
        known = (rgba[..., 3] > 0) & (grey > 0)
        part = _reduced(np.where(known, grey, np.nan), 2 * factor)
        radiance.append(part)
    return Pictures(codes, radiance, 1 / factor, np.array(sharp))


def _reduced(image: np.ndarray, factor: int) -> np.ndarray:
    """Return means over blocks of factor × factor pixels from the upper left corner, without partial blocks."""
    return block_means(image[image.shape[0] % factor :], factor)


def _sharpness(codes: np.ndarray) -> float:
    """Return the energy of the finest details over that of larger ones, in the direction of its minimum.

    A photograph with motion blur is sharp across the motion.
    """
    image = codes.astype(np.float32)

    def energy(step: int, x: int, y: int) -> float:
        part = [np.roll(image, (sign * step * y, sign * step * x), axis=(0, 1)) for sign in (-1, 1)]
        curved = (2 * image - part[0] - part[1])[step:-step, step:-step]
        return float((curved**2).mean())

    return min(energy(1, x, y) / max(energy(4, x, y), 1e-6) for x, y in ((1, 0), (0, 1), (1, 1), (1, -1)))
