"""Runs a recovery to its end, with progress bar, Ctrl-C and checkpoints."""

from __future__ import annotations

import signal
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.errors import CheckpointError, InputError
from ..core.files import remove_partials
from ..core.interrupt import delayed_signals
from ..core.progress_bar import ProgressBar
from ..solver.engine.engine import RecoveryEngine
from ..solver.engine.progress import TimeLeft
from ..solver.state.checkpoint import read_extra_array
from ..solver.views.history import History

CHECKPOINT = "checkpoint.npz"
_SLICE_SECONDS = 0.5  # between updates of the progress bar and checks for Ctrl-C
_SLOW_SAVE, _MAX_SAVING = 1.0, 0.05  # checkpoints that take more seconds get at most this share of the run's time
_ELAPSED, _PREVIEWED = "seconds", "previewed"  # a checkpoint's extra arrays: the run's seconds, its preview
_MAX_ITERATIONS = 100  # in a slice: a driver queues work that the GPU has not done yet


@dataclass(frozen=True)
class Saving:
    """When to save checkpoints. path: None for never. resume: from it. every: seconds; None: only on an interrupt.

    previewed: whether this run, or the one that it resumes, wrote a preview; its checkpoints say so.
    """

    path: Path | None
    resume: bool = False
    every: float | None = None
    previewed: bool = False


def was_previewed(path: Path) -> bool:
    """Return whether the run of a checkpoint wrote a preview; True if it does not say."""
    with suppress(CheckpointError):
        return bool(read_extra_array(path, _PREVIEWED))
    return True


def check_every(seconds: float | None) -> None:
    """Raise InputError unless --checkpoint-every is None or finite and 0 or more."""
    if seconds is not None and not 0 <= seconds < float("inf"):
        raise InputError(f"--checkpoint-every {seconds:g}: give seconds, 0 or more, as in --checkpoint-every 60")


def drive(recovery: RecoveryEngine, history: History, saving: Saving, silent: bool) -> tuple[float, list[str]]:
    """Run a recovery to its end; return its seconds, with those before a resume, and at most one warning.

    A checkpoint that fails (a full disk) adds the warning, does not stop the run, and leaves the former file unchanged.
    SIGINT and SIGTERM write a last checkpoint and raise KeyboardInterrupt, or InputError where it cannot be written.
    One that comes during the last iterations is raised again at the end.
    """
    saver = _Saver(recovery, history, saving)
    if saving.resume and saving.path:
        arrays = recovery.load(saving.path)
        saver.before = float(arrays.pop(_ELAPSED, 0.0))
        arrays.pop(_PREVIEWED, None)
        history.take(arrays)
    bar, time_left = ProgressBar("recover", silent, extrapolated=False), TimeLeft()
    iterations = 1
    with delayed_signals() as interrupted:
        progress = recovery.progress
        evaluations_before = progress.evaluations
        bar.show(progress.fraction, f"{progress.title}  placing the swarms", time_left.after(bar.seconds, progress))
        while not (progress.done or interrupted()):
            started = bar.seconds
            if saver.turns:  # each tile makes all the iterations it can before the next tile's turn
                progress = recovery.step(history.until_next(None), _SLICE_SECONDS)
            else:
                # One iteration of a large domain may take minutes, so it is cut into bands; whole ones are faster.
                budget = _SLICE_SECONDS if iterations == 1 else None
                progress = recovery.step(history.until_next(iterations), budget)
            history.record_due()
            rate = (progress.evaluations - evaluations_before) / max(bar.seconds, 1e-9) / 1e6
            left = time_left.after(bar.seconds, progress)
            bar.show(progress.fraction, f"{progress.title}  {rate:.2f} M evaluations/s", left)
            affordable = iterations * _SLICE_SECONDS / max(bar.seconds - started, 1e-9)
            iterations = max(1, min(2 * iterations, int(affordable), _MAX_ITERATIONS))
            if not progress.done:
                saver.save_when_due()
        bar.close()
        if not progress.done:
            if saving.path is None:
                raise KeyboardInterrupt
            saver.save(saving.path, running=True)
            raise KeyboardInterrupt(f"{saving.path} holds the run so far, go on with --resume")
    if interrupted():
        signal.raise_signal(signal.SIGINT)
    return saver.seconds, saver.warnings


class _Saver:
    """Writes checkpoints of one run, and removes the partial files of a killed one. before: seconds before a resume."""

    def __init__(self, recovery: RecoveryEngine, history: History, saving: Saving):
        self._recovery, self._history, self._saving = recovery, history, saving
        self.turns = recovery.capabilities.turns
        self.warnings: list[str] = []
        self.before = 0.0
        self._began = self._last_save = time.perf_counter()
        self._save_time = 0.0  # seconds of the last one
        self._saved_stage: int | None = None  # a stage that the last checkpoint holds whole
        if saving.path is not None:
            remove_partials(saving.path)

    @property
    def seconds(self) -> float:
        """The run's seconds so far."""
        return self.before + time.perf_counter() - self._began

    def save(self, path: Path, running: bool | None = None) -> None:
        """Write a checkpoint. Raises InputError where it cannot be written."""
        if self.turns:  # late tiles catch up; else the history misses a measurement after a resume
            self._recovery.step(0)
            self._history.record_due()
        own = {_ELAPSED: np.array(self.seconds), _PREVIEWED: np.array(self._saving.previewed)}
        more = self._recovery.save(path, {**self._history.arrays, **own}, running)
        self._saved_stage = None if more else self._recovery.progress.stage

    def save_when_due(self) -> None:
        """Write a checkpoint if it is due; where it cannot be written, warn once and continue."""
        now, path, every = time.perf_counter(), self._saving.path, self._saving.every
        if path is None or every is None or not self._recovery.settled:
            return
        if self._saved_stage == self._recovery.progress.stage:
            return
        if now - self._last_save < max(every, self._save_time / _MAX_SAVING if self._save_time > _SLOW_SAVE else 0.0):
            return
        try:
            self.save(path)
        except InputError as error:
            if not self.warnings:
                self.warnings.append(f"no checkpoint: {error}")
                sys.stderr.write(f"irpso: warning: {self.warnings[0]}\n")
        self._last_save = time.perf_counter()
        self._save_time = self._last_save - now
