"""UDIM tiles: texture coordinates mapped to one rectangle with the tiles side by side, and its checks."""

from __future__ import annotations

import numpy as np

from ...core.errors import InputError
from ...core.udim import COLUMNS, ONE_SQUARE, ROWS, tile_number

# Texture coordinates this far outside a tile are rounding, not intent.
_UV_ROUNDING = 1e-5
# A millionth of a texel of the largest bake (16384²), which no bake draws.
MIN_AREA = 1e-14
# Random numbers are keyed by 16 bits of a texel's column.
_WIDEST = 1 << 16


def lay_out(where: str, uvs: np.ndarray) -> tuple[tuple[int, ...], np.ndarray]:
    """Return the ascending numbers of the UDIM tiles of triangles (T, 3, 2), and the triangles in the layout.

    The layout is a unit square with the tiles from left to right, equally wide. Only triangles with an area occupy a
    tile. A coordinate within 1e-5 of a border belongs to the tile of the rest of its triangle. where: subject of the
    error. Raises InputError, with their number, where triangles cross a border of tiles or lie outside all tiles.
    """
    column, row, fits = _places(uvs)
    drawn = uv_areas(uvs) >= MIN_AREA
    out = drawn & ~(fits & (column >= 0) & (column < COLUMNS) & (row >= 0) & (row < ROWS))
    if out.any():
        (u0, v0), (u1, v1) = uvs[drawn].min(axis=(0, 1)), uvs[drawn].max(axis=(0, 1))
        crossing = int((drawn & ~fits).sum())
        raise InputError(
            f"{where}: {out.sum()} of {len(uvs)} triangles do not lie in one UDIM tile"
            f" (u {u0:.4g} to {u1:.4g}, v {v0:.4g} to {v1:.4g}; {crossing} cross a border of tiles); move each island"
            " into a tile, 1001 to 2000, or pack all into the unit square"
        )
    numbers = tile_number(column, row)
    tiles = tuple(int(number) for number in np.unique(numbers[drawn])) or ONE_SQUARE
    if tiles == ONE_SQUARE:
        return tiles, uvs
    # Triangles without an area may lie outside these tiles; they draw no texel.
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
    """Return (width, height) of the domain, from those of a tile. Raises InputError where it is too wide."""
    if len(tiles) > 1 and len(tiles) * width >= _WIDEST:
        raise InputError(
            f"--resolution: {len(tiles)} UDIM tiles of {width} texels are {len(tiles) * width} side by side; the limit"
            f" is {_WIDEST - 1}: lower it, or recover the material slots one by one"
        )
    return len(tiles) * width, height


def _places(uvs: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return column and row (T,) of each triangle's tile, and whether the triangle lies inside it."""
    low, high = uvs.min(axis=1).astype(np.float64), uvs.max(axis=1).astype(np.float64)
    # A triangle on a border only belongs to the left or lower tile; 0 starts a tile.
    place = np.ceil(high - _UV_ROUNDING) - 1
    place = np.where((place < 0) & (low >= -_UV_ROUNDING), 0, place)
    fits = (low >= place - _UV_ROUNDING).all(axis=-1)
    column, row = place.T.astype(np.int64)
    return column, row, fits
