"""Context managers around Blender's operators: no output on the terminal, no lost signal, no data block left behind."""

from __future__ import annotations

import contextlib
import io
import os
import re
import signal
import sys
import threading
from collections.abc import Iterator
from typing import Any

from ..core.files import remove_unfinished
from ..core.interrupt import INTERRUPTED, SIGNALS, interrupted_afterwards, signals_interrupt
from ..gpu.context import exit_process
from ..gpu.output import caught_output

_PATIENCE = 3.0  # seconds from a signal to the end of the process, where Cycles goes on
_ERROR = re.compile(r"^Error\b|\bERROR\b")  # Cycles also logs "unknown error" for GPUs that a machine lacks


@contextlib.contextmanager
def quiet_operator() -> Iterator[None]:
    """Keep Blender's lines off the terminal, except errors. A signal meanwhile raises KeyboardInterrupt at the end."""
    with interrupted_afterwards():
        lines: list[str] = []
        try:
            with caught_output() as text, contextlib.redirect_stdout(io.StringIO()):
                try:
                    yield
                finally:
                    lines = text().splitlines()
        finally:
            sys.stderr.writelines(f"{line}\n" for line in lines if _ERROR.search(line))


@contextlib.contextmanager
def cycles_operator() -> Iterator[None]:
    """Work as ``quiet_operator`` around renders and bakes; a signal ends the process after ``_PATIENCE``.

    Cycles cannot be stopped from Python, and one picture may take it minutes. In the window nothing ends.
    """
    with _ended_by_signals() if signals_interrupt() else contextlib.nullcontext(), quiet_operator():
        yield


@contextlib.contextmanager
def removed_afterwards() -> Iterator[list[Any]]:
    """Yield a list; the data blocks appended to it are removed from the open file at the end."""
    import bpy

    made: list[Any] = []
    try:
        yield made
    finally:
        bpy.data.batch_remove(made)


@contextlib.contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Have a thread end the process if a signal comes and this context lasts for more than ``_PATIENCE`` after it."""
    terminal = os.dup(2)  # standard error is caught meanwhile
    read_end, write_end = os.pipe()
    if os.name != "nt":  # which has no such call
        os.set_blocking(write_end, False)
    returned = threading.Event()

    def watch() -> None:
        while (byte := os.read(read_end, 1)) and byte[0] not in SIGNALS:  # nothing is read once the pipe is closed
            pass
        if byte and not returned.wait(_PATIENCE):
            remove_unfinished()
            os.write(terminal, b"\nirpso: interrupted\n")
            exit_process(INTERRUPTED)

    watcher = threading.Thread(target=watch, daemon=True)
    before = signal.set_wakeup_fd(write_end)
    watcher.start()
    try:
        yield
    finally:
        returned.set()
        signal.set_wakeup_fd(before)
        os.close(write_end)
        watcher.join()
        os.close(read_end)
        os.close(terminal)
