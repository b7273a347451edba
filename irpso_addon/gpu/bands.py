"""Cutting a long draw into bands of rows: drivers kill what runs too long, and a window must not stall."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

_FIRST_BANDS = 8  # into how many bands a pass that has never been timed is cut
_TIMED_BANDS = 3  # of each kind, before its rate is believed
_TIME_AGAIN = 64  # runs of a pass between later timings


class Bands:
    """Rows per band of every pass, from its time measured with a fence. Never changes what a pass computes."""

    def __init__(self) -> None:
        self._seconds_per_row: dict[str, float] = {}
        self._timed: dict[str, int] = {}
        self._runs: dict[str, int] = {}

    def run(
        self, name: str, height: int, seconds: float, draw: Callable[[tuple[int, int]], None], fence: Callable[[], None]
    ) -> Iterator[None]:
        """Draw all rows in bands of about ``seconds`` each; yields after every band."""
        runs = self._runs[name] = self._runs.get(name, 0) + 1
        row = 0
        while row < height:
            rate = self._seconds_per_row.get(name)
            rows = height // _FIRST_BANDS if rate is None else int(seconds / rate)
            stop = min(height, row + max(1, rows))
            if self._timed.get(name, 0) < _TIMED_BANDS or runs % _TIME_AGAIN == 0:
                fence()
                start = time.perf_counter()
                draw((row, stop))
                fence()
                self._learn(name, (time.perf_counter() - start) / (stop - row))
            else:
                draw((row, stop))
            row = stop
            yield

    def _learn(self, name: str, seconds_per_row: float) -> None:
        self._timed[name] = self._timed.get(name, 0) + 1
        before = self._seconds_per_row.get(name, seconds_per_row)
        # 1e-7: a clock that did not advance must not make a band of endless rows.
        self._seconds_per_row[name] = max(1e-7, 0.5 * (before + seconds_per_row))
