"""The distributed store of a sample stack: rank 0 reads the samples of many ranks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..solver.engine.halo import Part
from .worker import Ask, Worker


class RankedStack:
    """A ``SampleStack`` (geometry/samples.py) over all ranks: each read gathers from them.

    ask: of the ``Leader``. observations: their numbers on the ranks. part: the window of the domain.
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
        return map(self.layer, range(len(self._observations)))

    def texels(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        down, across = (side.start for side in self._part)
        return self._ask(Worker.texels, self._observations.tolist(), rows + down, columns + across)

    def subset(self, observations: np.ndarray) -> RankedStack:
        return RankedStack(self._ask, self._observations[observations], self._part)

    def window(self, rows: slice, columns: slice) -> RankedStack:
        down, across = (side.start for side in self._part)
        part = slice(rows.start + down, rows.stop + down), slice(columns.start + across, columns.stop + across)
        return RankedStack(self._ask, self._observations, part)

    def lit(self, coverage: np.ndarray) -> np.ndarray:
        return coverage & self._ask(Worker.lit, self._observations.tolist())[self._part]
