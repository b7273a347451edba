"""The progress of a recovery, and its time left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..settings.resolve import Resolved

_MIN_FRACTION = 0.003  # of the work: least sample for the pace of the run
_MIN_STAGE_FRACTION = 0.02  # of the work: least sample for the pace of the stage


@dataclass(frozen=True)
class Progress:
    """The progress of a recovery. iteration counts from 0 in the stage, negative while swarms are being initialised.

    iteration_in_all, iterations_in_all: the same over all stages. fraction: of all the work, 0 to 1; stage_end: the
    fraction at the end of the stage. evaluations: renders of all observations at one texel so far.
    """

    stage: int
    stages: int
    title: str
    iteration: int
    iterations: int
    iteration_in_all: int
    iterations_in_all: int
    fraction: float
    stage_end: float
    evaluations: int
    done: bool


class Course:
    """The stages of a recovery and their shares of the work.

    works: for each stage the work of each iteration; the initialisation of swarms comes first.
    """

    def __init__(self, stages: Sequence[Resolved], works: Sequence[Sequence[float]]):
        total = sum(map(sum, works))
        self._stages = stages
        self._done = [np.cumsum([0.0, *work]) / total for work in works]
        self._ends = np.minimum(np.cumsum([0.0, *(done[-1] for done in self._done)]), 1.0)  # not above by rounding

    def at(self, index: int, iteration: int | None, part: float, evaluations: int) -> Progress:
        """Return the progress at an iteration of stage ``index``, None if all are done. part: of the iteration, 0…1."""
        stages, done = self._stages, iteration is None
        total = sum(stage.iterations for stage in stages)
        index = min(index, len(stages) - 1)
        running = stages[index]
        if iteration is None:
            iteration, made, fractions = running.iterations, total, (1.0, 1.0)
        else:
            made = sum(stage.iterations for stage in stages[:index]) + max(iteration, 0)
            fractions = self._fractions(index, iteration, part)
        return Progress(
            index, len(stages), running.title, iteration, running.iterations, made, total, *fractions, evaluations, done
        )

    def _fractions(self, index: int, iteration: int, part: float) -> tuple[float, float]:
        """Return the fractions of all work that are done, now and at the end of the stage."""
        done = self._done[index]
        made = min(len(done) - 1 - self._stages[index].iterations + iteration, len(done) - 1)
        following = done[min(made + 1, len(done) - 1)]
        now = self._ends[index] + min(done[made] + part * (following - done[made]), following)
        return float(min(now, self._ends[index + 1])), float(self._ends[index + 1])


class TimeLeft:
    """The seconds that a run has left, from its progress at several times.

    The current stage uses its own pace once that is known, the other stages the pace of the run. A resumed run is timed
    from its checkpoint.
    """

    def __init__(self) -> None:
        self._run: tuple[float, float] | None = None  # seconds and fraction at its begin
        self._stage: tuple[float, float] = (0.0, 0.0)
        self._number = -1

    def after(self, seconds: float, progress: Progress) -> float | None:
        """Return the seconds left after ``seconds`` of work; None while the pace is unknown."""
        now = seconds, progress.fraction
        if self._run is None or now[0] < self._run[0]:
            self._run, self._number = now, -1
        if progress.stage != self._number:
            self._stage, self._number = now, progress.stage
        if progress.done:
            return 0.0
        pace = _pace(self._run, now, _MIN_FRACTION)
        if pace is None:
            return None
        stage_pace = _pace(self._stage, now, _MIN_STAGE_FRACTION)
        stage_left = max(0.0, progress.stage_end - progress.fraction)
        return stage_left * (pace if stage_pace is None else stage_pace) + (1 - progress.fraction - stage_left) * pace


def _pace(since: tuple[float, float], now: tuple[float, float], least: float) -> float | None:
    """Return the seconds for all of the work; None if less than ``least`` of it has been timed."""
    made = now[1] - since[1]
    return (now[0] - since[0]) / made if made >= least else None
