"""Resampling of maps. Plain numpy."""

from __future__ import annotations

import numpy as np


def resampled(values: np.ndarray, size: int, detail: int) -> np.ndarray:
    """Return (size, size, …) of a periodic square map: means over blocks, ``detail`` along a side, then enlarged.

    ``detail`` divides the side of the map, and ``size`` is a multiple of it. Enlarging is linear between texel centres,
    like a texture lookup.
    """
    step = values.shape[0] // detail
    small = values.reshape(detail, step, detail, step, *values.shape[2:]).mean(axis=(1, 3))
    return _enlarged(_enlarged(small, size, 0), size, 1)


def _enlarged(values: np.ndarray, size: int, axis: int) -> np.ndarray:
    count = values.shape[axis]
    place = (np.arange(size) + 0.5) * count / size - 0.5
    low = np.floor(place).astype(int)
    share = (place - low).reshape([-1 if n == axis else 1 for n in range(values.ndim)])
    below, above = (np.take(values, index % count, axis=axis) for index in (low, low + 1))
    return below + share * (above - below)
