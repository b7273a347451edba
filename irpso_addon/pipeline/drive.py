"""Driving a recovery to its end: progress bar, Ctrl-C and checkpoints."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.errors import InputError
from ..core.files import remove_partials
from ..core.interrupt import held_back
from ..core.progress_bar import ProgressBar
from ..solver.engine.engine import RecoveryEngine
from ..solver.engine.progress import TimeLeft
from ..solver.views.history import History

CHECKPOINT = "checkpoint.npz"
_SLICE_SECONDS = 0.5  # between looks at the progress bar and Ctrl-C
_LONG, _MOST_SAVING = 1.0, 0.05  # seconds of a checkpoint from which on they take at most this part of the time
_SECONDS = "seconds"  # the note in a checkpoint of how long the run has taken
_SLICE = 100  # iterations at most between them: a GPU queues work without having done it


@dataclass(frozen=True)
class Saving:
    """Checkpoints. path: None for none. resume: from the one there. every: seconds, None for the last alone."""

    path: Path | None
    resume: bool = False
    every: float | None = None


def check_every(seconds: float | None) -> None:
    """Raise InputError where --checkpoint-every is no time."""
    if seconds is not None and not 0 <= seconds < float("inf"):
        raise InputError(f"--checkpoint-every {seconds:g}: give seconds, 0 or more, as in --checkpoint-every 60")


def drive(recovery: RecoveryEngine, history: History, saving: Saving, quiet: bool) -> tuple[float, list[str]]:
    """Run a recovery to its end; return the seconds, with those before a resume, and a warning of unsaved checkpoints.

    A checkpoint that fails (a full disk) does not stop the run, and leaves the one before as it was. An interrupt ends
    in KeyboardInterrupt after a last checkpoint, or in InputError where that fails.
    """
    saver = _Saver(recovery, history, saving)
    if saving.resume and saving.path:
        notes = recovery.load(saving.path)
        saver.before = float(notes.pop(_SECONDS, 0.0))
        history.take(notes)
    bar, time_left = ProgressBar("recover", quiet), TimeLeft()
    iterations = 1
    with held_back() as interrupted:
        progress = recovery.progress
        before = progress.evaluations
        bar.show(progress.fraction, f"{progress.title}  placing the swarms", time_left.after(bar.seconds, progress))
        while not (progress.done or interrupted()):
            started = bar.seconds
            if saver.turns:  # a tile makes all the iterations it can before the next one's turn
                progress = recovery.step(history.until_next(None), _SLICE_SECONDS)
            else:
                # One iteration of a large domain may take minutes; waiting for the bands of short ones would cost.
                budget = _SLICE_SECONDS if iterations == 1 else None
                progress = recovery.step(history.until_next(iterations), budget)
            history.look()
            rate = (progress.evaluations - before) / max(bar.seconds, 1e-9) / 1e6
            left = time_left.after(bar.seconds, progress)
            bar.show(progress.fraction, f"{progress.title}  {rate:.2f} M evaluations/s", left)
            wanted = iterations * _SLICE_SECONDS / max(bar.seconds - started, 1e-9)
            iterations = max(1, min(2 * iterations, int(wanted), _SLICE))
            if not progress.done:
                saver.save_when_due()
        bar.close()
        if not progress.done:
            if saving.path is None:
                raise KeyboardInterrupt
            saver.save(saving.path, running=True)
            raise KeyboardInterrupt(f"{saving.path} holds the run so far, go on with --resume")
    return saver.seconds, saver.warnings


class _Saver:
    """Writes checkpoints of one run, and removes the partial files of a killed one. before: seconds before a resume."""

    def __init__(self, recovery: RecoveryEngine, history: History, saving: Saving):
        self._recovery, self._history, self._saving = recovery, history, saving
        self.turns = recovery.capabilities.turns
        self.warnings: list[str] = []
        self.before = 0.0
        self._began = self._last = time.perf_counter()
        self._took = 0.0
        self._saved: int | None = None  # a stage of which nothing more would be saved
        if saving.path is not None:
            remove_partials(saving.path)

    @property
    def seconds(self) -> float:
        """The run's seconds so far."""
        return self.before + time.perf_counter() - self._began

    def save(self, path: Path, running: bool | None = None) -> None:
        """Write a checkpoint. Raises InputError where it cannot be written."""
        if self.turns:  # tiles that are behind catch up: the history would miss a measurement after a resume
            self._recovery.step(0)
            self._history.look()
        more = self._recovery.save(path, {**self._history.notes, _SECONDS: np.array(self.seconds)}, running)
        self._saved = None if more else self._recovery.progress.stage

    def save_when_due(self) -> None:
        """Write a checkpoint if it is due; where it cannot be written, warn once and continue."""
        now, path, every = time.perf_counter(), self._saving.path, self._saving.every
        if path is None or every is None or not self._recovery.settled:
            return
        if self._saved == self._recovery.progress.stage:
            return
        if now - self._last < max(every, self._took / _MOST_SAVING if self._took > _LONG else 0.0):
            return
        try:
            self.save(path)
        except InputError as error:
            if not self.warnings:
                self.warnings.append(f"no checkpoint: {error}")
                sys.stderr.write(f"irpso: warning: {self.warnings[0]}\n")
        self._last = time.perf_counter()
        self._took = self._last - now
