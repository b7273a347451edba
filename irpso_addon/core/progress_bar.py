"""A progress bar on standard error."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Generator

from .steps import Step, T, run_steps

_WIDTH = 28
_LINE_EVERY, _LINE_SECONDS = 0.1, 60  # part of the work, and seconds, from line to line without a terminal


class ProgressBar:
    """Bar and time left: one updated line on a terminal, elsewhere a line per minute.

    tenths: without a terminal also a line per tenth of the work. extrapolated: whether the bar estimates the time left
    where ``show`` gets none.
    """

    def __init__(self, label: str, silent: bool = False, tenths: bool = True, extrapolated: bool = True):
        self._label, self._silent, self._tenths, self._extrapolated = label, silent, tenths, extrapolated
        self._start = self._written = time.perf_counter()
        self._first: tuple[float, float] | None = None
        self._shown = -1.0
        self._terminal = sys.stderr.isatty()

    def show(self, fraction: float, detail: str = "", left: float | None = None) -> None:
        """Show that ``fraction`` (0…1) of the work is done. left: seconds; None where unknown."""
        now = time.perf_counter()
        self._first = self._first or (now, fraction)
        tenth = self._tenths and (fraction >= self._shown + _LINE_EVERY or fraction >= 1)
        if self._silent or not (self._terminal or tenth or now - self._written >= _LINE_SECONDS):
            return
        self._shown, self._written = fraction, now
        full = round(_WIDTH * fraction)
        bar = "#" * full + "." * (_WIDTH - full)
        text = f"{self._label} [{bar}] {100 * fraction:3.0f} %  {detail}{self._left(now, fraction, left)}"
        # \x1b[K clears the rest of a longer former line.
        sys.stderr.write(f"\r{text}\x1b[K" if self._terminal else text + "\n")
        sys.stderr.flush()

    def close(self) -> None:
        """End the line."""
        if self._terminal and not self._silent and self._shown >= 0:
            sys.stderr.write("\n")

    def run(self, steps: Generator[Step, None, T], shown: Callable[[Step], tuple[float, str]]) -> T:
        """Run steps to the end and return their result. shown: returns the fraction and detail of a step."""
        result = run_steps(steps, lambda step: self.show(*shown(step)))
        self.show(1.0, "done")
        self.close()
        return result

    @property
    def seconds(self) -> float:
        """Wall-clock seconds since the bar was made."""
        return time.perf_counter() - self._start

    def _left(self, now: float, fraction: float, left: float | None) -> str:
        start, first = self._first or (now, fraction)
        if fraction >= 1:
            return f"  {now - self._start:.1f} s"
        if left is None and (fraction <= first or not self._extrapolated):
            return ""
        left = (now - start) * (1 - fraction) / (fraction - first) if left is None else left
        return f"  {int(left // 60)}:{int(left % 60):02d} left"


class StepBars:
    """One progress bar per step of a run; callable with a step and its fraction."""

    def __init__(self, silent: bool = False):
        self._silent = silent
        self._step, self._bar = "", ProgressBar("", silent)

    def __call__(self, step: str, fraction: float) -> None:
        """Show that ``fraction`` (0…1) of a step is done."""
        if step != self._step:
            self._bar.close()
            self._step, self._bar = step, ProgressBar(step, self._silent, tenths=False)
        self._bar.show(fraction)

    def close(self) -> None:
        """End the last line."""
        self._bar.close()
