"""Coarse to fine: a recovery of the domain at half the size is the first guess of the next finer one."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import AbstractContextManager
from copy import copy
from dataclasses import replace

import numpy as np

from ...core.errors import InputError
from ...core.optional import present
from ...geometry.coarsen import coarser, coarser_map, finer_map
from ...geometry.domain import Domain
from ...gpu.passes import EntryChoice, Pass
from ...gpu.textures import Texture
from ...reflectance.model import ReflectanceModel
from ...results.maps import Maps
from ..phases.phase import Phase
from ..planning.cost import work_of
from ..settings.resolve import resolve
from ..settings.schedule import Schedule
from ..state import prepare
from ..state.checkpoint import Checkpoint
from .engine import Capabilities, RecoveryEngine
from .progress import Progress
from .reconfigure import given
from .recovery import Recovery

_AT = "pyramid"  # in a checkpoint: the level, and the evaluations of those before it


class Pyramid(RecoveryEngine):
    """A ``RecoveryEngine`` over ``levels`` sizes of a domain. With one level it is a Recovery.

    schedule: of 1 to 5 ``levels``; its ``level_iterations`` is the part of the iterations that all but the coarsest
    make. Arguments and errors are as for Recovery; a domain with a halo raises ValueError.
    """

    def __init__(
        self,
        domain: Domain,
        model: ReflectanceModel,
        schedule: Schedule,
        seed: int = 0,
        fixed: Mapping[str, np.ndarray] | None = None,
        entry: EntryChoice = "auto",
    ):
        super().__init__(domain, model, schedule, seed, fixed, entry)
        self._schedules = level_schedules(schedule)
        self._domains, self._fixed = _sizes(domain, model, self.fixed, schedule.levels)
        self._count()
        self._level, self._before = 0, 0  # evaluations of the levels that are done
        self._live = self._begin(None)

    def step(self, iterations: int | None = None, time_budget_s: float | None = None) -> Progress:
        """Advance as RecoveryEngine.step, through all levels: the step that ends a level begins the next."""
        deadline = None if time_budget_s is None else time.perf_counter() + time_budget_s
        left = iterations
        while True:
            before = self._live.progress
            budget = None if deadline is None else max(0.0, deadline - time.perf_counter())
            after = self._live.step(left if not left else 1, budget)
            if after.done and self._level < self.schedule.levels - 1:
                self._next()
            elif after.done:
                return self.progress
            made = after.iteration_in_all > before.iteration_in_all
            left = left - 1 if left and made else left
            placed = self._live.progress.iteration >= 0
            if (left == 0 and placed) or (deadline is not None and time.perf_counter() >= deadline):
                return self.progress

    @property
    def progress(self) -> Progress:
        """How far the run is: stages and iterations count through all levels, the fraction through their texels."""
        live, level = self._live.progress, self._level
        size = "" if level == self.schedule.levels - 1 else f" at 1/{2 ** (self.schedule.levels - 1 - level)}"
        done = sum(self._costs[:level]) + live.fraction * self._costs[level]
        return replace(
            live,
            stage=level * live.stages + live.stage,
            stages=self.schedule.levels * live.stages,
            title=live.title + size,
            iteration_in_all=sum(self._iterations[:level]) + live.iteration_in_all,
            iterations_in_all=sum(self._iterations),
            fraction=done / sum(self._costs),
            stage_end=(done + (live.stage_end - live.fraction) * self._costs[level]) / sum(self._costs),
            evaluations=self._before + live.evaluations,
            done=live.done and level == self.schedule.levels - 1,
        )

    def maps(self, confidence: bool = True) -> Maps:
        """Return the maps so far, as RecoveryEngine.maps; those of a coarse level are interpolated."""
        maps = self._live.maps(confidence)
        for level in range(self._level, self.schedule.levels - 1):
            maps = self._finer(maps, level)
        return maps

    def mean_error(self) -> float:
        return self._live.mean_error()

    def refresh_confidence(self, time_budget_s: float | None = None) -> bool:
        return self._live.refresh_confidence(time_budget_s)

    def view(self) -> AbstractContextManager[dict[str, Texture]]:
        """Lend the live textures of the current level, as RecoveryEngine.view."""
        return self._live.view()

    @property
    def capabilities(self) -> Capabilities:
        return self._live.capabilities

    @property
    def phase(self) -> Phase | None:
        return self._live.phase

    def deviation_pass(self) -> tuple[Pass, dict[str, int | float]]:
        return self._live.deviation_pass()

    def state(self) -> Checkpoint:
        """Return the state of the current level, its number, and the evaluations of those before it."""
        state = self._live.state()
        return replace(state, arrays=state.arrays | {_AT: np.array([self._level, self._before])})

    def restore(self, saved: Checkpoint) -> None:
        self._live.close()
        self._level, self._before = (int(number) for number in saved.arrays[_AT])
        self._live = self._begin(None)
        self._live.restore(replace(saved, arrays={n: a for n, a in saved.arrays.items() if n != _AT}))

    def reconfigure(self, schedule: Schedule, seed: int | None = None) -> Pyramid:
        """Return a run that continues from here, as Recovery.reconfigure; the number of levels must stay."""
        if schedule.levels != self.schedule.levels:
            raise InputError(f"levels = {schedule.levels}: this run has {self.schedule.levels}; begin another")
        result = copy(self)
        result.schedule, result.seed = schedule, self.seed if seed is None else seed
        result._schedules = level_schedules(schedule)
        result._live = self._live.reconfigure(result._schedules[self._level], seed)
        result._count()
        return result

    def close(self) -> None:
        self._live.close()

    def _count(self) -> None:
        fixed, observations = set(self.fixed), self.domain.observations
        self._iterations, self._costs = [], []
        for schedule, domain in zip(self._schedules, self._domains, strict=True):
            stages = resolve(schedule, self.model, fixed, observations)
            work = sum(sum(work_of(stage, self.model, schedule, observations)) for stage in stages)
            self._iterations.append(sum(stage.iterations for stage in stages))
            self._costs.append(work * int(np.count_nonzero(domain.solvable)))

    def _begin(self, guess: Maps | None) -> Recovery:
        """Return the recovery of the current level. guess: at its size, None for the coarsest."""
        domain, schedule = self._domains[self._level], self._schedules[self._level]
        prepared = prepare.prepare(domain, self.model, schedule)
        if guess is not None:
            prepared = replace(prepared, guess=guess.values)
        fixed = self._fixed[self._level]
        return Recovery(domain, self.model, schedule, self.seed, fixed, self.entry, prepared)

    def _next(self) -> None:
        guess = self._finer(self._live.maps(confidence=False), self._level)
        self._before += self._live.progress.evaluations
        self._live.close()
        self._level += 1
        self._live = self._begin(guess)

    def _finer(self, maps: Maps, level: int) -> Maps:
        """Return the maps of a level at the size of the next finer one."""
        coarse, domain = self._domains[level], self._domains[level + 1]
        values = {
            p.name: finer_map(coarse, domain, maps.values[p.name], np.asarray(p.default), p.is_normal)
            for p in self.model.parameters
        }
        residual = finer_map(coarse, domain, present(maps.residual)[..., None], 0.0)[..., 0]
        deviations, alternatives = (
            doubts and {name: finer_map(coarse, domain, value, 0.0) for name, value in doubts.items()}
            for doubts in (maps.confidence, maps.alternatives)
        )
        return Maps(self.model, values, domain.solvable, residual, deviations, alternatives=alternatives)


def level_schedules(schedule: Schedule) -> tuple[Schedule, ...]:
    """Return the schedules of the levels, coarsest first; the others begin at its estimates and are shorter."""
    first = schedule.replaced(levels=1)
    part = schedule.level_iterations
    stages = tuple(replace(stage, iterations=_part(stage.iterations, part)) for stage in first.stages)
    prefit = replace(first.prefit, iterations=_part(first.prefit.iterations, part))
    finer = replace(given(first.replaced(prefit=prefit)), stages=stages)
    return (first, *[finer] * (schedule.levels - 1))


def _part(iterations: int, part: float) -> int:
    return max(1, round(part * iterations)) if iterations else 0


def _sizes(
    domain: Domain, model: ReflectanceModel, fixed: dict[str, np.ndarray], levels: int
) -> tuple[list[Domain], list[dict[str, np.ndarray]]]:
    """Return the domains and the fixed maps of all levels, coarsest first."""
    domains, maps = [domain], [fixed]
    for _ in range(levels - 1):
        fine = domains[0]
        coarse = coarser(fine)
        values = {n: coarser_map(fine, coarse, value, model.parameter(n).is_normal) for n, value in maps[0].items()}
        domains.insert(0, coarse)
        maps.insert(0, values)
    return domains, maps
