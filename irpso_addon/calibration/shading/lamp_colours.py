"""Colours of lamps over a matt surface of unknown albedo and shading, from the ratios of channels."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...capture.types import Light, triple

_ROUNDS = 10  # of median polish
_SHADED = 0.1  # of a texel's median radiance: below, light from elsewhere may have another colour
_LEAST = 50  # samples with which a photograph shows its lamp's colour
_ALIKE = 0.1  # logarithm: lamps whose channels all differ by less have one colour; gloss changes ratios so much


def whitened(radiance: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return radiances (K, T) as under white lamps, means of the channels, and the lamps' colours (K, 3).

    radiance: (K, T, 3) of T texels in K photographs. weight: (K, T), 0 where a sample is none; radiance is 0 there.
    """
    colours = lamp_colours(radiance, weight)
    return np.where(weight > 0, (radiance / colours[:, None]).mean(axis=-1), 0), colours


def lamp_colours(radiance: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return (K, 3) factors of the lamps' channels: their geometric mean is 1 for each lamp, and over all lamps.

    The logarithms of a matt sample's channels, less their mean, are a sum of the texel's and the lamp's, whatever the
    shading. Both by median polish (Tukey 1977, Exploratory Data Analysis).
    """
    brightness = np.where(weight > 0, radiance.min(axis=-1), np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # texels and photographs without samples are NaN
        seen = brightness > np.maximum(_SHADED * np.nanmedian(brightness, axis=0), 0)
        logarithms = np.log(np.where(seen[..., None], radiance, np.nan))
        left = logarithms - logarithms.mean(axis=-1, keepdims=True)
        of_lamps = np.zeros((len(radiance), 1, 3))
        for _ in range(_ROUNDS):
            left = left - np.nanmedian(left, axis=0, keepdims=True)
            step = np.nanmedian(left, axis=1, keepdims=True)
            left, of_lamps = left - step, of_lamps + step
    of_lamps = np.where(seen.sum(axis=1)[:, None] < _LEAST, 0, of_lamps[:, 0])
    of_lamps -= of_lamps.mean(axis=-1, keepdims=True)
    of_lamps -= of_lamps.mean(axis=0)
    return np.ones_like(of_lamps) if np.abs(of_lamps).max() < _ALIKE else np.exp(of_lamps)


def coloured(lights: Sequence[Light], colours: np.ndarray) -> list[Light]:
    """Return lights of one intensity for all channels, with colours (K, 3)."""
    return [
        replace(light, intensity=triple(light.intensity[0] * colour))
        for light, colour in zip(lights, colours, strict=True)
    ]
