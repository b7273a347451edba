"""Tile pyramids: each level has half the size of the previous one and is cut into squares with a margin."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

TILE = 512  # texels along a tile's side, with a margin of one texel that the neighbouring tiles share
INSIDE = TILE - 2


def level_shapes(height: int, width: int) -> list[tuple[int, int]]:
    """Return (height, width) of each level, the finest first; the last one fits a tile."""
    shapes = [(height, width)]
    while max(shapes[-1]) > INSIDE:
        shapes.append((-(-shapes[-1][0] // 2), -(-shapes[-1][1] // 2)))
    return shapes


def levels(
    values: np.ndarray, covered: np.ndarray, settle: Callable[[np.ndarray], np.ndarray] = lambda values: values
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield (values, covered) of each level, from (H, W, C) and (H, W) bool, rows from the top.

    A texel is the mean of the covered texels among the four that it replaces. settle: applied to each level's means.
    """
    yield values, covered
    for _ in level_shapes(*covered.shape)[1:]:
        values, covered = _halved(values, covered)
        values = settle(values)
        yield values, covered


def tile_places(height: int, width: int) -> list[tuple[int, int]]:
    """Return (column, row) of each tile of a level."""
    return [(column, row) for row in range(-(-height // INSIDE)) for column in range(-(-width // INSIDE))]


def tile_of(values: np.ndarray, column: int, row: int) -> np.ndarray:
    """Return (h, w, …) the tile of values (H, W, …); beyond the border its margin repeats the border."""
    height, width = values.shape[:2]
    y = np.arange(row * INSIDE - 1, min((row + 1) * INSIDE, height) + 1).clip(0, height - 1)
    x = np.arange(column * INSIDE - 1, min((column + 1) * INSIDE, width) + 1).clip(0, width - 1)
    return values[y[:, None], x]


def _halved(values: np.ndarray, covered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    weight = _block_sums(covered[..., None].astype(np.float32))
    total = _block_sums(np.where(covered[..., None], values, 0).astype(np.float32))
    return total / np.maximum(weight, 1e-9), weight[..., 0] > 0


def _block_sums(values: np.ndarray) -> np.ndarray:
    """Return the sums over 2 × 2 texels, padded with zeros at an odd row or column."""
    values = np.pad(values, [(0, values.shape[0] % 2), (0, values.shape[1] % 2), (0, 0)])
    return values[::2, ::2] + values[1::2, ::2] + values[::2, 1::2] + values[1::2, 1::2]
