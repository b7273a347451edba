"""What a person at a terminal sees of long work: a progress bar on standard error, and none of Blender's reports."""

from __future__ import annotations

import contextlib
import io
import sys
import time
from argparse import Namespace

_WIDTH = 28
_LINE_EVERY = 0.1  # of the work, where standard error is no terminal


def unseen_reports() -> contextlib.AbstractContextManager:
    """Keep Blender's own reports ("Info: Saved copy as …") off standard output; its errors come as exceptions."""
    return contextlib.redirect_stdout(io.StringIO())


def silent(options: Namespace) -> bool:
    """Return whether a command says nothing to people: --quiet, or --json, which speaks to programs."""
    return options.quiet or options.json


class ProgressBar:
    """Bar, rate and time left. On a terminal one line is drawn anew; elsewhere a line is written at every tenth."""

    def __init__(self, label: str, quiet: bool = False):
        self._label, self._quiet = label, quiet
        self._start = time.perf_counter()
        self._first: tuple[float, float] | None = None
        self._shown = -1.0
        self._terminal = sys.stderr.isatty()

    def show(self, fraction: float, detail: str = "") -> None:
        """Show that ``fraction`` (0…1) of the work is done."""
        if self._quiet or (not self._terminal and fraction < self._shown + _LINE_EVERY and fraction < 1):
            return
        self._shown = fraction
        now = time.perf_counter()
        if self._first is None:
            self._first = (now, fraction)
        full = round(_WIDTH * fraction)
        bar = "#" * full + "." * (_WIDTH - full)
        text = f"{self._label} [{bar}] {100 * fraction:3.0f} %  {detail}{self._left(now, fraction)}"
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

    def _left(self, now: float, fraction: float) -> str:
        start, first = self._first
        if fraction >= 1:
            return f"  {now - self._start:.1f} s"
        if fraction <= first:
            return ""
        left = (now - start) * (1 - fraction) / (fraction - first)
        return f"  {int(left // 60)}:{int(left % 60):02d} left"
