"""Ctrl-C and SIGTERM, delayed until an iteration is complete or a call of Blender has returned."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from .errors import InputError, IrpsoError

INTERRUPTED = 130  # the shell's own exit code for a program ended by Ctrl-C
SIGNALS = (signal.SIGINT, signal.SIGTERM)


def exit_code_of(error: BaseException) -> int:
    """Return the exit code of a command that ends with this error."""
    if isinstance(error, MemoryError):
        return InputError.exit_code
    return INTERRUPTED if isinstance(error, KeyboardInterrupt) else getattr(error, "exit_code", IrpsoError.exit_code)


def interrupt_on_signals() -> None:
    """Make SIGINT and SIGTERM raise KeyboardInterrupt. Blender has a SIGINT handler of its own."""
    for number in SIGNALS:
        signal.signal(number, signal.default_int_handler)


def ignore_signals() -> None:
    """Ignore SIGINT and SIGTERM from now on."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def signals_interrupt() -> bool:
    """Return whether SIGINT and SIGTERM raise KeyboardInterrupt, as in a command and not in Blender's window."""
    return all(signal.getsignal(number) is signal.default_int_handler for number in SIGNALS)


@contextmanager
def delayed_signals(notice: str = "") -> Iterator[Callable[[], bool]]:
    """Delay the first SIGINT or SIGTERM; yields a function that returns whether one has come.

    notice: a line to print on standard error at the first signal.

    An exception in the middle of an iteration leaves swarms partly advanced, which no checkpoint can continue. A second
    signal interrupts at once.
    """
    came = False

    def note(number: int, frame: object) -> None:
        nonlocal came
        if came:
            raise KeyboardInterrupt
        came = True
        if notice:
            os.write(2, f"\n{notice}\n".encode())

    before = {number: signal.signal(number, note) for number in SIGNALS}
    try:
        yield lambda: came
    finally:
        for number, handler in before.items():
            # None is a handler from outside Python, as Blender's own, which Python cannot put back.
            signal.signal(number, signal.default_int_handler if handler is None else handler)


@contextmanager
def interrupted_afterwards() -> Iterator[None]:
    """Raise the KeyboardInterrupt of a signal at the end. Without ``signals_interrupt`` nothing changes.

    Blender prints and drops exceptions of its Python parts, among them Cycles and the exporter of glTF.
    """
    if not signals_interrupt():
        yield
        return
    with delayed_signals() as interrupted:
        try:
            yield
        finally:
            if interrupted():
                raise KeyboardInterrupt
