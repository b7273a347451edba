"""The state of a recovery texel by texel, as no tile and no atlas has it: for whoever cuts the domain otherwise."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .state import plan_atlas


def rows_of(arrays: Mapping[str, np.ndarray], size: tuple[int, int], tiles: int, texels: int) -> dict[str, np.ndarray]:
    """Return (T, tiles or 1, C) float32 of each of a state's arrays: T packed texels, row by row, then the annex's.

    size: (w, h) of the packed grid. tiles: of the particles' atlas. texels: T.
    """
    return {name: _rows(array, size, tiles, texels) for name, array in arrays.items()}


def arrays_of(
    rows: Mapping[str, np.ndarray], size: tuple[int, int], tiles: int, limit: int, flat: frozenset[str] = frozenset()
) -> dict[str, np.ndarray]:
    """Return a state's arrays of what ``rows_of`` gave. limit: texels along a texture's side. flat: those without C."""
    return {name: _array(value, size, tiles, limit, name in flat) for name, value in rows.items()}


def _rows(array: np.ndarray, size: tuple[int, int], tiles: int, texels: int) -> np.ndarray:
    width, height = size
    array = array.reshape(*array.shape[:2], -1)
    down, across = array.shape[0] // height, array.shape[1] // width
    cells = array.reshape(down, height, across, width, -1).transpose(1, 3, 0, 2, 4)
    return np.ascontiguousarray(cells.reshape(height * width, down * across, -1)[:texels, :tiles])


def _array(rows: np.ndarray, size: tuple[int, int], tiles: int, limit: int, flat: bool) -> np.ndarray:
    width, height = size
    texels, held, channels = rows.shape
    down, across = 1, 1
    if held > 1:
        atlas = plan_atlas(width, height, tiles, limit)
        down, across = atlas.down, atlas.across
    cells = np.zeros((height * width, down * across, channels), np.float32)
    cells[:texels, :held] = rows
    array = cells.reshape(height, width, down, across, channels).transpose(2, 0, 3, 1, 4)
    array = np.ascontiguousarray(array).reshape(down * height, across * width, channels)
    return array[..., 0] if flat else array
