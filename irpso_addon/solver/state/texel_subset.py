"""A random subset of a domain's texels that does not depend on how the domain is divided."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

MAX_TEXELS = 8192  # of the whole domain
_MIX = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9)  # SplitMix64 (Steele, Lea and Flood 2014)


@dataclass(frozen=True)
class TexelSubset:
    """Places of texels, and values there.

    ranks: (n,) float64, ascending; a texel's rank depends on its place only, and the MAX_TEXELS lowest are the subset.
    rows, columns: (n,) in the whole domain. values: (n, C) float64.
    """

    ranks: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    values: np.ndarray

    @classmethod
    def none(cls) -> TexelSubset:
        """Return a subset without texels."""
        return chosen_texels(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 0)))

    def __len__(self) -> int:
        return len(self.ranks)


def chosen_texels(rows: np.ndarray, columns: np.ndarray, values: np.ndarray) -> TexelSubset:
    """Return the subset of some texels. rows, columns: (T,) in the whole domain. values: (T, C)."""
    place = (rows.astype(np.uint64) << np.uint64(32)) | columns.astype(np.uint64)
    ranks = (place + np.uint64(1)) * _MIX[0]
    ranks = (ranks ^ (ranks >> np.uint64(29))) * _MIX[1]
    ranks = (ranks >> np.uint64(16)).astype(np.float64)  # 48 bits: float64 holds whole numbers of up to 53
    if len(ranks) > MAX_TEXELS:
        lowest = ranks <= np.partition(ranks, MAX_TEXELS)[MAX_TEXELS]  # sorting all takes a second for a million
        ranks, rows, columns, values = (array[lowest] for array in (ranks, rows, columns, values))
    return merged_subset([TexelSubset(ranks, rows, columns, values.astype(np.float64))])


def merged_subset(parts: Sequence[TexelSubset]) -> TexelSubset:
    """Return the subset of a domain from those of its disjoint parts, in an order that depends on the texels alone."""
    ranks, rows, columns, values = (
        np.concatenate([getattr(part, name) for part in parts]) for name in TexelSubset.__dataclass_fields__
    )
    order = np.lexsort((columns, rows, ranks))[:MAX_TEXELS]
    return TexelSubset(ranks[order], rows[order], columns[order], values[order])
