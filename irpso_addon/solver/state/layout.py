"""Layout of checkpoints: one row per texel, independent of tiles and ranks; and the digest of a domain's samples."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from ...geometry.domain import Domain
from .packing import Packing
from .phase_textures import Atlas, plan_atlas
from .prefit_measurements import FLAT_ARRAYS
from .textures import SOLVED, packed_states

_TABLE = "phase_materials"  # no rows of texels; a phase without it computes it again

# SplitMix64 (Steele, Lea and Flood 2014, Fast Splittable Pseudorandom Number Generators).
_ODD = np.uint64(0x9E3779B97F4A7C15)
_MIX = ((30, np.uint64(0xBF58476D1CE4E5B9)), (27, np.uint64(0x94D049BB133111EB)))


class TexelLayout:
    """Converts a recovery's textures to rows of texels and back. All kinds of recoveries share the rows.

    A row is (tiles or 1, C) float32 of one solvable texel; texels come row by row, then the ghosts. packing: of the
    domain, None to make one.
    """

    def __init__(self, domain: Domain, packing: Packing | None = None):
        self._packing = packing or Packing(domain.solvable, domain.seams)
        self._own = packed_states(domain, self._packing).ravel()[: self._packing.count] == SOLVED

    def rows(self, arrays: Mapping[str, np.ndarray], tiles: int) -> dict[str, np.ndarray]:
        """Return the rows of the tile's own texels. tiles: of the particles' atlas."""
        size = self._packing.width, self._packing.height
        texels = {name: _rows(array, size, tiles) for name, array in arrays.items() if name != _TABLE}
        return {name: rows[: len(self._own)][self._own] for name, rows in texels.items()}

    def arrays(self, rows: Mapping[str, np.ndarray], limit: int) -> dict[str, np.ndarray]:
        """Return textures from the rows of all texels, with halo and ghosts. limit: largest side of a texture."""
        size = self._packing.width, self._packing.height
        return {name: _array(value, size, limit, name in FLAT_ARRAYS) for name, value in rows.items()}


def numbered(solvable: np.ndarray) -> np.ndarray:
    """Return (H, W): the row number of each solvable texel, −1 elsewhere."""
    return np.where(solvable, np.cumsum(solvable).reshape(solvable.shape) - 1, -1)


def joined(
    total: int,
    parts: Iterable[tuple[np.ndarray, Mapping[str, np.ndarray]]],
    empty: Callable[[tuple[int, ...]], np.ndarray] = lambda shape: np.zeros(shape, np.float32),
) -> dict[str, np.ndarray]:
    """Return the rows of ``total`` texels from parts: (row numbers, rows by name)."""
    whole: dict[str, np.ndarray] = {}
    for chosen, rows in parts:
        for name, value in rows.items():
            if name not in whole:
                whole[name] = empty((total, *value.shape[1:]))
            whole[name][chosen] = value
    return whole


def digest_of_texels(domain: Domain) -> int:
    """Return a 64-bit digest of a tile's own solved texels. The sum over all tiles, modulo 2⁶⁴, is the domain's.

    It detects another subject or a changed image, not forgery.
    """
    left, right, bottom, top = domain.halo
    own = domain.solvable.copy()
    own[:bottom] = own[len(own) - top :] = False
    own[:, :left] = own[:, own.shape[1] - right :] = False
    rows, columns = np.nonzero(own)
    place = (rows + domain.origin[1]).astype(np.uint64) << np.uint64(32)
    place |= (columns + domain.origin[0]).astype(np.uint64)
    digest = _mixed(place)
    for layer in domain.stack.layers():
        samples = np.where(layer[rows, columns, 3:] != 0, layer[rows, columns], np.float32(0))  # weight 0: never read
        words = np.ascontiguousarray(samples).view(np.uint32)
        for word in words.T:
            digest = (digest ^ word) * _MIX[0][1]
            digest ^= digest >> np.uint64(29)
    return int(_mixed(digest).sum(dtype=np.uint64))


def _rows(array: np.ndarray, size: tuple[int, int], tiles: int) -> np.ndarray:
    width, height = size
    array = array.reshape(*array.shape[:2], -1)
    down, across = array.shape[0] // height, array.shape[1] // width
    cells = array.reshape(down, height, across, width, -1).transpose(1, 3, 0, 2, 4)
    return cells.reshape(height * width, down * across, -1)[:, :tiles]


def _array(rows: np.ndarray, size: tuple[int, int], limit: int, flat: bool) -> np.ndarray:
    width, height = size
    texels, tiles, channels = rows.shape
    atlas = plan_atlas(width, height, tiles, limit) if tiles > 1 else Atlas(1, 1)
    cells = np.zeros((height * width, atlas.down * atlas.across, channels), np.float32)
    cells[:texels, :tiles] = rows
    array = cells.reshape(height, width, atlas.down, atlas.across, channels).transpose(2, 0, 3, 1, 4)
    array = np.ascontiguousarray(array).reshape(atlas.down * height, atlas.across * width, channels)
    return array[..., 0] if flat else array


def _mixed(values: np.ndarray) -> np.ndarray:
    values = values + _ODD
    for shift, factor in _MIX:
        values = (values ^ (values >> np.uint64(shift))) * factor
    return values ^ (values >> np.uint64(31))
