"""How far a recovery is, and how long it has left."""

from __future__ import annotations

from dataclasses import dataclass

_LEAST_FRACTION = 0.003  # of the work, before a pace is believed
_LEAST_OF_STAGE = 0.02  # of the work, before a stage's own pace is


@dataclass(frozen=True)
class Progress:
    """How far a recovery is. iteration counts from 0 in the stage, negative while swarms are being placed.

    iteration_in_all, iterations_in_all: the same over all stages. fraction: of all the work, 0 to 1; stage_end: what
    that is where the stage ends. evaluations: renders of all observations at one texel, so far.
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


class TimeLeft:
    """The seconds that a run has left, from its progress at several times.

    The stage under way goes on at its own pace, once that is known, all others go at the run's. A run that goes on from
    a checkpoint is measured from where it was taken up.
    """

    def __init__(self) -> None:
        self._run: tuple[float, float] | None = None  # seconds and fraction where it began
        self._stage: tuple[float, float] = (0.0, 0.0)
        self._number = -1

    def after(self, seconds: float, progress: Progress) -> float | None:
        """Return the seconds left after so many that were worked; None while there is too little to tell from."""
        now = seconds, progress.fraction
        if self._run is None or now[0] < self._run[0]:
            self._run, self._number = now, -1
        if progress.stage != self._number:
            self._stage, self._number = now, progress.stage
        if progress.done:
            return 0.0
        pace = _pace(self._run, now, _LEAST_FRACTION)
        if pace is None:
            return None
        own = _pace(self._stage, now, _LEAST_OF_STAGE)
        here = max(0.0, progress.stage_end - progress.fraction)
        return here * (pace if own is None else own) + (1 - progress.fraction - here) * pace


def _pace(since: tuple[float, float], now: tuple[float, float], least: float) -> float | None:
    """Seconds for all of the work, None where less than ``least`` of it was made."""
    made = now[1] - since[1]
    return (now[0] - since[0]) / made if made >= least else None
