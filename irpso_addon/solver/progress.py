"""How far a recovery is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """How far a recovery is. iteration counts from 0 in the stage, negative while swarms are being placed.

    iteration_in_all, iterations_in_all: the same over all stages. fraction: of all the work, 0 to 1. evaluations:
    renders of all observations at one texel, so far.
    """

    stage: int
    stages: int
    title: str
    iteration: int
    iterations: int
    iteration_in_all: int
    iterations_in_all: int
    fraction: float
    evaluations: int
    done: bool
