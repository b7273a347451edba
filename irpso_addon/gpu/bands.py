"""Draws in bands of rows of limited time: drivers kill long draws, and a window must not stall."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

_FIRST_BANDS = 64  # bands of a pass without a measured rate
_GRAIN = 4  # rows that cost the same as one: software renderers shade blocks of 4 × 4
_GROWTH = 2  # largest ratio of the rows of successive bands
_DECAY = 0.8  # factor of the seconds per row after a faster band: the next region may be slow again
_TIMED_BANDS = 3  # per kind, before unpaced runs use its rate
_TIME_AGAIN = 64  # runs of a pass between later timings


class Bands:
    """Rows per band of every pass, from times measured with a fence. The bands do not change a pass's result.

    paced: wait for every band, so that the time between yields is the band's cost. part: drawn fraction, 0…1, of the
    last ``counted`` pass.
    """

    def __init__(self, paced: bool = False) -> None:
        self.paced = paced
        self.part = 0.0
        self._seconds_per_row: dict[str, float] = {}
        self._rows: dict[str, int] = {}
        self._timed: dict[str, int] = {}
        self._runs: dict[str, int] = {}

    def run(
        self,
        name: str,
        height: int,
        seconds: float,
        draw: Callable[[tuple[int, int]], None],
        fence: Callable[[], None],
        counted: bool = False,
    ) -> Iterator[None]:
        """Draw all rows in bands of about ``seconds`` each; yields after every band.

        The very first band is the smallest: drivers compile in it, so its time is ignored. counted: ``part`` shows
        this pass's progress.
        """
        runs = self._runs[name] = self._runs.get(name, 0) + 1
        row = 0
        if name not in self._timed:
            self._timed[name] = 0
            row = min(_GRAIN, height)
            yield from self.once(lambda: draw((0, row)), fence)
        if self.paced and row < height:
            fence()  # earlier work is not part of this pass
        while row < height:
            rows = self._next(name, height, seconds)
            stop = min(height, row + rows)
            timed = self._timed[name] < _TIMED_BANDS or runs % _TIME_AGAIN == 0
            if timed and not self.paced:
                fence()
            start = time.perf_counter()
            draw((row, stop))
            if timed or self.paced:
                fence()
                self._learn(name, rows, (time.perf_counter() - start) / (stop - row))
            row = stop
            if counted:
                self.part = row / height
            yield

    def once(self, draw: Callable[[], None], fence: Callable[[], None]) -> Iterator[None]:
        """Draw a short pass at once, then yield."""
        draw()
        if self.paced:
            fence()
        yield

    def _next(self, name: str, height: int, seconds: float) -> int:
        rate = self._seconds_per_row.get(name)
        rows = height // _FIRST_BANDS if rate is None else min(int(seconds / rate), _GROWTH * self._rows[name])
        return max(_GRAIN, rows - rows % _GRAIN)

    def _learn(self, name: str, rows: int, seconds_per_row: float) -> None:
        self._timed[name] += 1
        self._rows[name] = rows
        # 1e-7: a clock that did not advance must not give an endless band.
        rate = max(1e-7, seconds_per_row)
        before = self._seconds_per_row.get(name, rate)
        # Slower rates apply at once, faster ones gradually: an extra band costs less than a stall.
        self._seconds_per_row[name] = max(rate, _DECAY * before)
