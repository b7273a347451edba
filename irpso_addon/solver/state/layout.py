"""The state of a recovery, and what it was observed from, texel by texel: for whoever cuts the domain otherwise."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...geometry.domain import Domain
from .textures import plan_atlas

_ODD = np.uint64(0x9E3779B97F4A7C15)  # of Steele, Lea and Flood 2014 (SplitMix64), as are the two below
_MIX = ((30, np.uint64(0xBF58476D1CE4E5B9)), (27, np.uint64(0x94D049BB133111EB)))


def rows_of(arrays: Mapping[str, np.ndarray], size: tuple[int, int], tiles: int, texels: int) -> dict[str, np.ndarray]:
    """Return (T, tiles or 1, C) float32 of each of a state's arrays: T packed texels, row by row, then the ghosts's.

    size: (w, h) of the packed grid. tiles: of the particles' atlas. texels: T.
    """
    return {name: _rows(array, size, tiles, texels) for name, array in arrays.items()}


def arrays_of(
    rows: Mapping[str, np.ndarray], size: tuple[int, int], tiles: int, limit: int, flat: frozenset[str] = frozenset()
) -> dict[str, np.ndarray]:
    """Return a state's arrays of what ``rows_of`` gave. limit: texels along a texture's side. flat: those without C."""
    return {name: _array(value, size, tiles, limit, name in flat) for name, value in rows.items()}


def digest_of_texels(domain: Domain) -> int:
    """Return a 64-bit number of a tile's own solved texels, which add up, modulo 2⁶⁴, to the number of the whole.

    It tells one subject from another and a changed image from the one before; it is no protection against forgery.
    """
    left, right, bottom, top = domain.halo
    own = domain.solvable.copy()
    own[:bottom] = own[len(own) - top :] = False
    own[:, :left] = own[:, own.shape[1] - right :] = False
    rows, columns = np.nonzero(own)
    place = (rows + domain.origin[1]).astype(np.uint64) << np.uint64(32)
    place |= (columns + domain.origin[0]).astype(np.uint64)
    found = _mixed(place)
    for layer in domain.stack.layers():
        samples = np.where(layer[rows, columns, 3:] != 0, layer[rows, columns], np.float32(0))  # the rest is for show
        words = np.ascontiguousarray(samples).view(np.uint32)
        for word in words.T:
            found = (found ^ word) * _MIX[0][1]
            found ^= found >> np.uint64(29)
    return int(_mixed(found).sum(dtype=np.uint64))


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


def _mixed(values: np.ndarray) -> np.ndarray:
    values = values + _ODD
    for shift, factor in _MIX:
        values = (values ^ (values >> np.uint64(shift))) * factor
    return values ^ (values >> np.uint64(31))
