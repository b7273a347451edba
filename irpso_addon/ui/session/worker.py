"""Runs numpy work in a thread, so that the window stays responsive."""

from __future__ import annotations

from collections.abc import Callable, Generator
from concurrent import futures
from typing import TypeVar

T = TypeVar("T")
_POLL_SECONDS = 0.002


class Worker:
    """Runs one function at a time, each in a new thread."""

    def __init__(self) -> None:
        self._work: futures.Future | None = None

    @property
    def busy(self) -> bool:
        """Whether work is unfinished."""
        return self._work is not None

    def run(self, function: Callable[[], T]) -> Generator[None, None, T]:
        """Run a function in the thread, yielding until it ends. Return its result, or raise its exception."""
        with futures.ThreadPoolExecutor(1, "irpso prepare") as pool:
            self._work = work = pool.submit(function)
            while not work.done():
                futures.wait([work], _POLL_SECONDS)
                yield
        self._work = None  # a finished future would keep the result's arrays
        return work.result()

    def wait(self) -> None:
        """Wait for the end of unfinished work, so that its arrays may be freed.

        Without a timeout: a thread cannot be stopped, and the work is numpy on arrays at hand, which ends by itself.
        """
        if self._work is not None:
            futures.wait([self._work])
            self._work = None
