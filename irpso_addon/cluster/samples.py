"""The sample stack of a domain whose texels lie with many ranks, as rank 0 may read it; and a digest of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from ..geometry.domain import Domain

_ODD = np.uint64(0x9E3779B97F4A7C15)  # of Steele, Lea and Flood 2014 (SplitMix64), as are the two below
_MIX = ((30, np.uint64(0xBF58476D1CE4E5B9)), (27, np.uint64(0x94D049BB133111EB)))

Part = tuple[slice, slice]  # rows, columns
Ask = Callable[..., np.ndarray]  # an order to all ranks, by name


class SharedStack:
    """(K, H, W, 4) samples that no process holds as a whole: each look gathers a layer, or some texels of all.

    ask: gives all ranks an order of Member's, by name. chosen: the observations, by the numbers they have with ranks.
    """

    dtype = np.dtype(np.float32)
    flags = np.zeros(0).reshape(0, 1)[:, ::2].flags  # not contiguous: there is nothing to take a view of

    def __init__(self, ask: Ask, chosen: Sequence[int], shape: tuple[int, int], part: Part | None = None):
        self._ask, self._chosen = ask, np.asarray(chosen, np.intp)
        self._part = part or (slice(0, shape[0]), slice(0, shape[1]))
        self.shape = (len(self._chosen), *(side.stop - side.start for side in self._part), 4)
        self._last: tuple[int, np.ndarray] | None = None

    def __len__(self) -> int:
        return len(self._chosen)

    def __iter__(self) -> Iterator[np.ndarray]:
        return (self[k] for k in range(len(self)))

    def __getitem__(self, index: Any) -> Any:
        """Return a layer, or a part of one; (:, rows, columns) of all; or the stack of some observations or a window.

        rows, columns: (N,) numbers, or slices with ends for a window.
        """
        first, *rest = index if isinstance(index, tuple) else (index,)
        if np.ndim(first) == 0 and not isinstance(first, slice):
            return self._layer(int(first))[tuple(rest)]
        some = self._chosen[first]
        if not rest:
            return SharedStack(self._ask, some, (0, 0), self._part)
        rows, columns = self._part
        if isinstance(rest[0], slice):
            part = tuple(
                slice(whole.start + side.start, whole.start + side.stop)
                for whole, side in zip(self._part, rest, strict=True)
            )
            return SharedStack(self._ask, some, (0, 0), part)
        return self._ask("samples", some.tolist(), rest[0] + rows.start, rest[1] + columns.start)

    def lit(self) -> np.ndarray:
        """Return (H, W) bool: covered texels that one of the observations sees lit."""
        return self._ask("lit", self._chosen.tolist())[self._part]

    def _layer(self, number: int) -> np.ndarray:
        if self._last is None or self._last[0] != number:
            self._last = number, self._ask("layer", int(self._chosen[number]))[self._part]
        return self._last[1]


def digest_of_texels(domain: Domain, own: tuple[slice, slice]) -> int:
    """Return a 64-bit number of a tile's own solved texels, which add up, modulo 2⁶⁴, to the number of the whole.

    It tells one subject from another and a changed image from the one before; it is no protection against forgery.
    """
    rows, columns = np.nonzero(domain.solvable[own])
    rows, columns = rows + own[0].start, columns + own[1].start
    place = (rows + domain.origin[1]).astype(np.uint64) << np.uint64(32)
    place |= (columns + domain.origin[0]).astype(np.uint64)
    found = _mixed(place)
    for layer in domain.stack:
        words = np.ascontiguousarray(layer[rows, columns]).view(np.uint32)
        for word in words.T:
            found = (found ^ word) * _MIX[0][1]
            found ^= found >> np.uint64(29)
    return int(_mixed(found).sum(dtype=np.uint64))


def _mixed(values: np.ndarray) -> np.ndarray:
    values = values + _ODD
    for shift, factor in _MIX:
        values = (values ^ (values >> np.uint64(shift))) * factor
    return values ^ (values >> np.uint64(31))
