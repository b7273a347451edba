"""Ctrl-C, delayed until the current iteration is whole."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def held_back() -> Iterator[Callable[[], bool]]:
    """Hold back the first SIGINT or SIGTERM; yields a function that returns whether one has come.

    An exception in the middle of an iteration leaves swarms half moved: no checkpoint can continue from them. A second
    signal interrupts at once.
    """
    came = False

    def note(number: int, frame: object) -> None:
        nonlocal came
        if came:
            raise KeyboardInterrupt
        came = True

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: came
    finally:
        for number, handler in before.items():
            # None is a handler from outside Python, as Blender's own, which Python cannot put back.
            signal.signal(number, signal.default_int_handler if handler is None else handler)
