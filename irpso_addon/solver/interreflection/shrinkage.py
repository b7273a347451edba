"""Shrinkage of uncertain material parameters toward texels of similar colour (empirical Bayes)."""

from __future__ import annotations

import numpy as np

_CELLS = 24  # along each axis of the colours
_WIDTH = 0.06  # standard deviation of the Gaussian of similarity, in square roots of colours, 0…1
_MIN_DEVIATION, _MIN_SPREAD = 1e-3, 0.01  # standard deviations: of a texel's value; within a colour


def shrunk_to_similar_colours(
    values: np.ndarray, deviations: np.ndarray, colour: np.ndarray, counted: np.ndarray
) -> np.ndarray:
    """Return (N, n) float32: the posterior means of texels' values, with a prior from texels of similar colour.

    values, deviations: (N, n) values and their standard deviations. colour: (N, 3) linear. counted: (N,) bool, the
    texels that determine the prior. Its variance is the spread of their values (empirical Bayes: Efron & Morris 1973):
    where texels of one colour have several materials, the certain values stay.
    """
    cell = np.rint(np.sqrt(np.clip(colour, 0, 1)) * (_CELLS - 1)).astype(np.intp)
    place = np.ravel_multi_index(tuple(cell.T), (_CELLS,) * 3)
    steps = np.arange(_CELLS) / (_CELLS - 1)
    smooth = np.exp(-((steps[:, None] - steps) ** 2) / (2 * _WIDTH**2))
    weight = 1 / np.maximum(deviations.astype(np.float64), _MIN_DEVIATION) ** 2
    result = values.astype(np.float64)
    for channel in range(values.shape[1]):
        own, value = weight[:, channel], result[:, channel].copy()

        def colour_sums(terms: np.ndarray) -> np.ndarray:
            sums = np.bincount(place[counted], terms[counted], minlength=_CELLS**3).reshape((_CELLS,) * 3)
            for _ in range(3):  # along the last axis, which becomes the first
                sums = np.einsum("ai,xyi->axy", smooth, sums)
            return np.asarray(sums.ravel()[place])

        total = colour_sums(own)
        known = total > 0
        mean = np.divide(colour_sums(own * value), total, out=value.copy(), where=known)
        square = np.divide(colour_sums(own * value**2), total, out=value**2, where=known)
        noise = np.divide(colour_sums(np.ones_like(own)), total, out=np.zeros_like(own), where=known)
        prior = 1 / np.maximum(square - mean**2 - noise, _MIN_SPREAD**2)
        result[:, channel] = (own * value + prior * mean) / (own + prior)
    return result.astype(np.float32)
