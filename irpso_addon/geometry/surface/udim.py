"""From texture coordinates in UDIM tiles to one rectangle in which the tiles stand side by side, and its checks."""

from __future__ import annotations

import numpy as np

from ...core.errors import InputError
from ...core.udim import COLUMNS, ONE_SQUARE, ROWS, tile_number

# Texture coordinates this far outside a tile are rounding, not intent.
_UV_ROUNDING = 1e-5
# A millionth of a texel of the largest bake (16384²): no bake draws it.
SMALLEST_AREA = 1e-14
# Random numbers are keyed by 16 bits of a texel's column.
_WIDEST = 1 << 16


def lay_out(where: str, uvs: np.ndarray) -> tuple[tuple[int, ...], np.ndarray]:
    """Return the numbers of the UDIM tiles that triangles (T, 3, 2) lie in, ascending, and their place in the layout.

    The layout is a unit square (T, 3, 2) that holds the tiles from left to right, each as wide as the others. Only
    triangles that have an area make a tile. A coordinate on a border, to within 1e-5, belongs to the tile that holds
    the rest of its triangle. where: what the error is said of. Raises InputError, with how many there are, where
    triangles cross a border of tiles or lie where there are none.
    """
    column, row, fits = _places(uvs)
    there = (column >= 0) & (column < COLUMNS) & (row >= 0) & (row < ROWS)
    if not (fits & there).all():
        (u0, v0), (u1, v1) = uvs.min(axis=(0, 1)), uvs.max(axis=(0, 1))
        crossing = int((~fits).sum())
        raise InputError(
            f"{where}: {(~(fits & there)).sum()} of {len(uvs)} triangles do not lie in one UDIM tile"
            f" (u {u0:.4g} to {u1:.4g}, v {v0:.4g} to {v1:.4g}; {crossing} cross a border of tiles); move each island"
            " into a tile, 1001 to 2000, or pack all into the unit square"
        )
    numbers = tile_number(column, row)
    tiles = tuple(int(number) for number in np.unique(numbers[uv_areas(uvs) >= SMALLEST_AREA])) or ONE_SQUARE
    if tiles == ONE_SQUARE:
        return tiles, uvs
    # Those without an area may lie in a tile of their own; they draw nothing wherever they are.
    index = np.minimum(np.searchsorted(tiles, numbers), len(tiles) - 1)
    inside = uvs - np.stack([column, row], axis=-1)[:, None].astype(np.float64)
    inside[np.take(tiles, index) != numbers] = 0
    inside[..., 0] = (inside[..., 0] + index[:, None]) / len(tiles)
    return tiles, inside.astype(np.float32)


def uv_areas(uvs: np.ndarray) -> np.ndarray:
    """Return (T,) float64 twice the areas of triangles (T, 3, 2)."""
    flat = (uvs[:, 1:] - uvs[:, :1]).astype(np.float64)
    return np.abs(flat[:, 0, 0] * flat[:, 1, 1] - flat[:, 0, 1] * flat[:, 1, 0])


def layout_size(tiles: tuple[int, ...], width: int, height: int) -> tuple[int, int]:
    """Return (width, height) of the domain of tiles of so many texels each. Raises InputError where it is too wide."""
    if len(tiles) > 1 and len(tiles) * width >= _WIDEST:
        raise InputError(
            f"--resolution: {len(tiles)} UDIM tiles of {width} texels are {len(tiles) * width} side by side, at most"
            f" {_WIDEST - 1} can be; lower it, or recover the material slots one by one"
        )
    return len(tiles) * width, height


def _places(uvs: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return column and row (T,) of the tile of each triangle, and whether it lies wholly within that."""
    low, high = uvs.min(axis=1).astype(np.float64), uvs.max(axis=1).astype(np.float64)
    # What lies on a border alone belongs to the left and below, and 0 is the beginning of a tile.
    place = np.ceil(high - _UV_ROUNDING) - 1
    place = np.where((place < 0) & (low >= -_UV_ROUNDING), 0, place)
    fits = (low >= place - _UV_ROUNDING).all(axis=-1)
    column, row = place.T.astype(np.int64)
    return column, row, fits
