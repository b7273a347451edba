"""Numbers of a material that a texel's own photographs hardly tell, from texels of like colour."""

from __future__ import annotations

import numpy as np

_CELLS = 24  # along each axis of the colours
_WIDTH = 0.06  # deviation of what counts as like, of root colours from 0 to 1
_SUREST, _MOST_ALIKE = 1e-3, 0.01  # least deviations of a number, and of the numbers of like texels


def drawn_to_alike(values: np.ndarray, deviations: np.ndarray, colour: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """Return (N, n) values of texels, each drawn to the mean of those of like colour, as far as its own is unsure.

    values, deviations: (N, n) numbers and their standard deviations. colour: (N, 3) linear. counted: (N,) bool, those
    that the means are of. The spread of like texels about their mean is that of the prior (empirical Bayes: Efron &
    Morris 1973), so that among texels of one colour and several materials the sure ones keep theirs.
    """
    cell = np.rint(np.sqrt(np.clip(colour, 0, 1)) * (_CELLS - 1)).astype(np.intp)
    place = np.ravel_multi_index(tuple(cell.T), (_CELLS,) * 3)
    steps = np.arange(_CELLS) / (_CELLS - 1)
    smooth = np.exp(-((steps[:, None] - steps) ** 2) / (2 * _WIDTH**2))
    weight = 1 / np.maximum(deviations.astype(np.float64), _SUREST) ** 2
    result = values.astype(np.float64)
    for channel in range(values.shape[1]):
        own, value = weight[:, channel], result[:, channel].copy()

        def over(numbers: np.ndarray) -> np.ndarray:
            sums = np.bincount(place[counted], numbers[counted], minlength=_CELLS**3).reshape((_CELLS,) * 3)
            for _ in range(3):  # along the last axis, which becomes the first
                sums = np.einsum("ai,xyi->axy", smooth, sums)
            return np.asarray(sums.ravel()[place])

        total = over(own)
        there = total > 0
        mean = np.divide(over(own * value), total, out=value.copy(), where=there)
        square = np.divide(over(own * value**2), total, out=value**2, where=there)
        noise = np.divide(over(np.ones_like(own)), total, out=np.zeros_like(own), where=there)
        prior = 1 / np.maximum(square - mean**2 - noise, _MOST_ALIKE**2)
        result[:, channel] = (own * value + prior * mean) / (own + prior)
    return result.astype(np.float32)
