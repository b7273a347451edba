"""Colours of lamps over a matt surface of unknown albedo and shading, from the ratios of channels."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...capture.types import Light, triple

_ROUNDS = 10  # of median polish
_SHADED = 0.1  # of a texel's median radiance: below, light from elsewhere may have another colour
_DARK = 0.05  # of the brightest channel: a texel's channel below hardly exceeds the noise
_GROUPS = 16  # of texels
_LEAST = 50  # samples with which a photograph shows its lamp's colour
_ALIKE, _SURE = 0.1, 5.0  # logarithms, in all and over their scatter: lamps that differ by less have one colour


def whitened(radiance: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return radiances (K, T) as under white lamps, means of the channels, and the lamps' colours (K, 3).

    radiance: (K, T, 3) of T texels in K photographs. weight: (K, T), 0 where a sample is none; radiance is 0 there.
    """
    colours = lamp_colours(radiance, weight)
    return np.where(weight > 0, (radiance / colours[:, None]).mean(axis=-1), 0), colours


def lamp_colours(radiance: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return (K, 3) factors of the lamps' channels: their geometric mean is 1 for each lamp, and over all lamps.

    A channel that the texels hardly reflect has the mean of the others.
    """
    samples = np.where(weight[..., None] > 0, radiance, 0)
    first = int(samples.sum(axis=(0, 1)).argmax())
    over_first = np.zeros((len(radiance), 3))
    known, spread = np.ones(3, bool), 0.0
    for channel in {0, 1, 2} - {first}:
        ratios = _ratios(samples[..., channel], samples[..., first])
        known[channel] = ratios is not None
        if ratios is not None:
            over_first[:, channel], spread = ratios[0], max(spread, ratios[1])
    over_first[:, ~known] = over_first[:, known].mean(axis=-1, keepdims=True)
    over_first -= over_first.mean(axis=-1, keepdims=True)
    over_first -= over_first.mean(axis=0)
    one_colour = np.abs(over_first).max() < max(_ALIKE, _SURE * spread)
    return np.ones_like(over_first) if one_colour else np.exp(over_first)


def _ratios(values: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Return (K,) logarithms of the lamps' ratio of two channels (K, T), and their scatter over parts of the subject.

    The logarithm of the ratio of a matt sample's channels is a sum of the texel's and the lamp's, whatever the shading.
    Both by median polish (Tukey 1977, Exploratory Data Analysis). Gloss has the lamp's colour in another part of every
    sample, so its ratios scatter. 0 for photographs with few samples. None if the texels hardly reflect ``values``.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # texels and photographs without samples are NaN
        level = np.nanmedian(np.where(first > 0, first, np.nan), axis=0)
        lit = first > _SHADED * level
        reflected = np.nanmedian(np.where(lit, values, np.nan), axis=0) > _DARK * level
        seen = lit & reflected & (values > 0)
        if not reflected.any() or np.median(seen.sum(axis=1)) < _LEAST:
            return None
        left = np.log(np.where(seen, values, np.nan)) - np.log(np.where(seen, first, np.nan))
        of_lamps = np.zeros((len(values), 1))
        for _ in range(_ROUNDS):
            left = left - np.nanmedian(left, axis=0)
            step = np.nanmedian(left, axis=1, keepdims=True)
            left, of_lamps = left - step, of_lamps + step
        groups = np.array_split(left, _GROUPS, axis=1)  # neighbours, as of noise little is left in their medians
        scatter = float(np.nanmedian(np.abs([np.nanmedian(group, axis=1) for group in groups])))
    return np.where(seen.sum(axis=1) < _LEAST, 0, of_lamps[:, 0]), scatter


def coloured(lights: Sequence[Light], colours: np.ndarray) -> list[Light]:
    """Return lights of one intensity for all channels, with colours (K, 3)."""
    return [
        replace(light, intensity=triple(light.intensity[0] * colour))
        for light, colour in zip(lights, colours, strict=True)
    ]
