"""The distributed store of a sample stack: samples that lie with many ranks, as rank 0 reads them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from .worker import Ask, Worker

Part = tuple[slice, slice]  # rows, columns


class RankedStack:
    """A ``SampleStack`` (geometry/samples.py) that no process holds as a whole: each read gathers from all ranks.

    ask: of the ``Leader``. observations: by the numbers that they have with the ranks. part: the window of the domain.
    """

    def __init__(self, ask: Ask, observations: Sequence[int] | np.ndarray, part: Part):
        self._ask, self._part = ask, part
        self._observations = np.asarray(observations, np.intp)
        rows, columns = part
        self.shape = len(self._observations), rows.stop - rows.start, columns.stop - columns.start
        self._last: tuple[int, np.ndarray] | None = None

    def layer(self, observation: int) -> np.ndarray:
        """Return (H, W, 4) the samples of one observation; the last one is kept."""
        if self._last is None or self._last[0] != observation:
            self._last = observation, self._ask(Worker.layer, int(self._observations[observation]))[self._part]
        return self._last[1]

    def layers(self) -> Iterator[np.ndarray]:
        """Yield the samples of every observation."""
        return map(self.layer, range(len(self._observations)))

    def texels(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return (K, N, 4) the samples at N texels."""
        down, across = (side.start for side in self._part)
        return self._ask(Worker.texels, self._observations.tolist(), rows + down, columns + across)

    def subset(self, observations: np.ndarray) -> RankedStack:
        """Return the stack of some observations."""
        return RankedStack(self._ask, self._observations[observations], self._part)

    def window(self, rows: slice, columns: slice) -> RankedStack:
        """Return the stack of a window's texels."""
        down, across = (side.start for side in self._part)
        part = slice(rows.start + down, rows.stop + down), slice(columns.start + across, columns.stop + across)
        return RankedStack(self._ask, self._observations, part)

    def lit(self, coverage: np.ndarray) -> np.ndarray:
        """Return (H, W) bool: covered texels that at least one observation sees lit."""
        return coverage & self._ask(Worker.lit, self._observations.tolist())[self._part]
