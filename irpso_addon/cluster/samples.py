"""The distributed store of a sample stack: rank 0 reads the samples of many ranks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..geometry.samples import SampleStack
from ..solver.engine.halo import Part
from .worker import Orders, Worker


class RankedStack:
    """A ``SampleStack`` (geometry/samples.py) over all ranks: each read gathers from them.

    orders: the ``Leader``. observations: their numbers on the ranks. part: the window of the domain. second: whether
    the stack is the one that ``kept`` fills, not the photographs.
    """

    def __init__(self, orders: Orders, observations: Sequence[int] | np.ndarray, part: Part, second: bool = False):
        self._orders, self._part, self.second = orders, part, second
        self.observations = np.asarray(observations, np.intp)
        rows, columns = part
        self.shape = len(self.observations), rows.stop - rows.start, columns.stop - columns.start
        self._last: tuple[int, np.ndarray] | None = None

    def layer(self, observation: int) -> np.ndarray:
        """Return (H, W, 4) the samples of one observation; the last one is cached."""
        if self._last is None or self._last[0] != observation:
            number = int(self.observations[observation])
            self._last = observation, self._orders.ask(Worker.layer, number, self.second)[self._part]
        return self._last[1]

    def layers(self) -> Iterator[np.ndarray]:
        return map(self.layer, range(len(self.observations)))

    def kept(self, derived: SampleStack) -> RankedStack:
        """Copy a stack that is computed from this one to the second stack of the ranks, layer by layer."""
        self._orders.ask(Worker.make_second)
        for number, layer in zip(self.observations.tolist(), derived.layers(), strict=True):
            self._orders.scatter(Worker.put, (number, layer))
        return RankedStack(self._orders, self.observations, self._part, second=True)

    def texels(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        down, across = (side.start for side in self._part)
        selection = self.observations.tolist(), rows + down, columns + across
        return self._orders.ask(Worker.texels, *selection, self.second)

    def subset(self, observations: np.ndarray) -> RankedStack:
        return RankedStack(self._orders, self.observations[observations], self._part, self.second)

    def window(self, rows: slice, columns: slice) -> RankedStack:
        down, across = (side.start for side in self._part)
        part = slice(rows.start + down, rows.stop + down), slice(columns.start + across, columns.stop + across)
        return RankedStack(self._orders, self.observations, part, self.second)

    def lit(self, coverage: np.ndarray) -> np.ndarray:
        return coverage & self._orders.ask(Worker.lit, self.observations.tolist(), self.second)[self._part]
