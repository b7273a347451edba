"""The sample stack of a domain whose texels lie with many ranks, as rank 0 may read it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

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
