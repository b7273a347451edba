"""What a person at a terminal sees of long work: a progress bar on standard error, and none of Blender's reports."""

from __future__ import annotations

import contextlib
import io
import itertools
import sys
import time
from argparse import Namespace
from collections.abc import Generator
from typing import Any, TypeVar

from ..core.steps import run_steps

T = TypeVar("T")
_WIDTH = 28
_LINE_EVERY, _LINE_SECONDS = 0.1, 60  # of the work, and between lines, where standard error is no terminal


def unseen_reports() -> contextlib.AbstractContextManager:
    """Keep Blender's own reports ("Info: Saved copy as …") off standard output; its errors come as exceptions."""
    return contextlib.redirect_stdout(io.StringIO())


def silent(options: Namespace) -> bool:
    """Return whether a command says nothing to people: --quiet, or --json, which speaks to programs."""
    return options.quiet or options.json


def counted(steps: Generator[Any, None, T], label: str, count: int, quiet: bool) -> T:
    """Run about ``count`` steps, showing how many are made; return what they return."""
    bar, made = ProgressBar(label, quiet, tenths=False), itertools.count()
    found = run_steps(steps, lambda _: bar.show(min(1.0, next(made) / count)))
    bar.close()
    return found


class ProgressBar:
    """Bar, rate and time left. On a terminal one line is drawn anew, elsewhere a line is written every minute.

    tenths: whether one is written there at every tenth, too.
    """

    def __init__(self, label: str, quiet: bool = False, tenths: bool = True):
        self._label, self._quiet, self._tenths = label, quiet, tenths
        self._start = self._written = time.perf_counter()
        self._first: tuple[float, float] | None = None
        self._shown = -1.0
        self._terminal = sys.stderr.isatty()

    def show(self, fraction: float, detail: str = "", left: float | None = None) -> None:
        """Show that ``fraction`` (0…1) of the work is done. left: seconds, where they are known better than by that."""
        now = time.perf_counter()
        self._first = self._first or (now, fraction)
        tenth = self._tenths and (fraction >= self._shown + _LINE_EVERY or fraction >= 1)
        if self._quiet or not (self._terminal or tenth or now - self._written >= _LINE_SECONDS):
            return
        self._shown, self._written = fraction, now
        full = round(_WIDTH * fraction)
        bar = "#" * full + "." * (_WIDTH - full)
        text = f"{self._label} [{bar}] {100 * fraction:3.0f} %  {detail}{self._left(now, fraction, left)}"
        # \x1b[K clears what a longer line before this one has left.
        sys.stderr.write(f"\r{text}\x1b[K" if self._terminal else text + "\n")
        sys.stderr.flush()

    def close(self) -> None:
        """End the line."""
        if self._terminal and not self._quiet and self._shown >= 0:
            sys.stderr.write("\n")

    @property
    def seconds(self) -> float:
        """Wall-clock seconds since the bar was made."""
        return time.perf_counter() - self._start

    def _left(self, now: float, fraction: float, left: float | None) -> str:
        start, first = self._first
        if fraction >= 1:
            return f"  {now - self._start:.1f} s"
        if left is None and fraction <= first:
            return ""
        left = (now - start) * (1 - fraction) / (fraction - first) if left is None else left
        return f"  {int(left // 60)}:{int(left % 60):02d} left"
