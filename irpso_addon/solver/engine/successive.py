"""Base class of engines that run several recoveries in turn, each from the results of the one before."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from copy import copy
from dataclasses import replace
from typing import Self

import numpy as np

from ...geometry.domain import Domain
from ...gpu.kernel import EntryChoice
from ...gpu.passes import Pass
from ...gpu.program import ProgramCache
from ...gpu.textures import Texture
from ...reflectance.model import ReflectanceModel
from ..phases.phase import Phase
from ..planning.cost import work_of_search
from ..settings.resolve import resolve
from ..settings.schedule import Schedule
from ..state.separation_record import Separation
from .engine import Capabilities, RecoveryEngine
from .halo import Box
from .progress import Progress


class Successive(RecoveryEngine):
    """A ``RecoveryEngine`` that runs one recovery after another. A subclass makes them.

    _live: the running one, number ``_at`` of ``_schedules``. _earlier_evaluations: evaluations of the finished ones.
    """

    def __init__(
        self,
        domain: Domain,
        model: ReflectanceModel,
        schedule: Schedule,
        seed: int,
        fixed: Mapping[str, np.ndarray] | None,
        entry: EntryChoice,
        schedules: Sequence[Schedule],
    ):
        """Store the arguments; nothing runs yet. schedules: of the recoveries. Others as for RecoveryEngine."""
        super().__init__(domain, model, schedule, seed, fixed, entry)
        self._schedules = tuple(schedules)
        self._at, self._earlier_evaluations = 0, 0
        self._transition: Iterator[None] | None = None
        self._programs = ProgramCache()
        self._live: RecoveryEngine

    @abstractmethod
    def _texels(self, number: int) -> int:
        """Return how many texels a recovery solves."""

    @abstractmethod
    def _title_suffix(self, number: int) -> str:
        """Return the suffix of the titles of a recovery's stages."""

    @abstractmethod
    def _next(self) -> Iterator[None]:
        """Close the live recovery, which is done, and start the next; yields often before the live one closes."""

    def step(self, iterations: int | None = None, time_budget_s: float | None = None) -> Progress:
        """Advance as RecoveryEngine.step, through all recoveries: the step that ends one begins the next."""
        deadline = None if time_budget_s is None else time.perf_counter() + time_budget_s
        left = iterations
        while True:
            before = self._live.progress
            budget = None if deadline is None else max(0.0, deadline - time.perf_counter())
            # Single iterations count exactly where a threshold ends a stage; tiles that take turns run all at once.
            requested = left if not left or self.capabilities.turns else 1
            after = self._live.step(requested, budget)
            if after.done and self._at == len(self._schedules) - 1:
                return self.progress
            if after.done and not self._finish_transition(deadline):
                return self.progress
            made = after.iteration_in_all - before.iteration_in_all
            left = left - min(made, requested) if left and requested else left
            initialised = self._live.progress.iteration >= 0
            if (left == 0 and initialised) or (deadline is not None and time.perf_counter() >= deadline):
                return self.progress

    def _finish_transition(self, deadline: float | None) -> bool:
        """Run the transition between two recoveries until a deadline; return whether the next one is live."""
        self._transition = self._transition or self._next()
        for _ in self._transition:
            if deadline is not None and time.perf_counter() >= deadline:
                return False
        self._transition = None
        return True

    @property
    def progress(self) -> Progress:
        """The progress of the run: stages and iterations of all recoveries, and the fraction weighted by texels."""
        live, at = self._live.progress, self._at
        done = sum(self._costs[:at]) + live.fraction * self._costs[at]
        return replace(
            live,
            stage=sum(self._stages[:at]) + live.stage,
            stages=sum(self._stages),
            title=live.title + self._title_suffix(at),
            iteration_in_all=sum(self._iterations[:at]) + live.iteration_in_all,
            iterations_in_all=sum(self._iterations),
            fraction=done / self._cost_of_all,
            stage_end=(done + (live.stage_end - live.fraction) * self._costs[at]) / self._cost_of_all,
            evaluations=self._earlier_evaluations + live.evaluations,
            done=live.done and at == len(self._schedules) - 1,
        )

    def mean_error(self) -> float:
        return self._live.mean_error()

    def refresh_confidence(self, time_budget_s: float | None = None) -> bool:
        return self._live.refresh_confidence(time_budget_s)

    def view(self) -> AbstractContextManager[dict[str, Texture]]:
        """Lend the live textures of the current recovery, as RecoveryEngine.view."""
        return self._live.view()

    @property
    def capabilities(self) -> Capabilities:
        return replace(self._live.capabilities, watches=False)  # its maps may differ from the live recovery's

    @property
    def separation(self) -> Separation | None:
        return self._live.separation if self._live.domain.shape == self.domain.shape else None

    @property
    def unsearched(self) -> frozenset[str]:
        return self._live.unsearched

    @property
    def settled(self) -> bool:
        return self._live.settled

    @property
    def phase(self) -> Phase | None:
        return self._live.phase

    def tiles(self) -> list[tuple[Box, RecoveryEngine]]:
        return self._live.tiles()

    def deviation_pass(self) -> tuple[Pass, dict[str, int | float]]:
        return self._live.deviation_pass()

    def close(self) -> None:
        self._transition = None
        self._live.close()
        self._programs.close()

    def _end_transition(self) -> None:
        """Finish a transition between two recoveries, if one has begun, or is due where a saved run was loaded."""
        due = self._live.progress.done and self._at < len(self._schedules) - 1
        if due or self._transition is not None:
            self._finish_transition(None)

    def _reconfigured(self, schedule: Schedule, schedules: Sequence[Schedule], seed: int | None) -> Self:
        """Return a run that continues from here, or from the next recovery if between two, under other schedules."""
        self._end_transition()
        result = copy(self)
        result.schedule, result.seed = schedule, self.seed if seed is None else seed
        result._schedules = tuple(schedules)[: len(self._schedules)]
        result._live = self._live.reconfigure(result._schedules[self._at], seed)
        result._count()
        return result

    def _fixed_in(self, number: int) -> Mapping[str, np.ndarray]:
        """Return the fixed parameters of a recovery."""
        return self.fixed

    def _count(self) -> None:
        """Count stages, iterations and costs of all recoveries."""
        observations = self.domain.observations
        self._stages, self._iterations, self._costs = [], [], []
        for number, schedule in enumerate(self._schedules):
            fixed = self._fixed_in(number)
            stages = resolve(schedule, self.model, set(fixed), observations)
            self._stages.append(len(stages))
            self._iterations.append(sum(stage.iterations for stage in stages))
            self._costs.append(work_of_search(schedule, self.model, fixed, observations) * self._texels(number))

    @property
    def _cost_of_all(self) -> float:
        """The cost of all recoveries, including those that may be added."""
        return sum(self._costs)
