"""Coarse to fine: a recovery of the domain at half the size gives the first guess of the next finer one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...core.errors import InputError
from ...core.optional import present
from ...geometry.coarsen import coarser, coarser_map, finer_map
from ...geometry.domain import Domain
from ...gpu.kernel import EntryChoice
from ...reflectance.model import ReflectanceModel
from ...results.maps import Maps
from ..settings.levels import level_schedules
from ..settings.schedule import Schedule
from ..state.checkpoint import Checkpoint
from .recovery import Recovery
from .successive import Successive

_AT = "pyramid"  # checkpoint array: the level, and the evaluations of the levels before it


class Pyramid(Successive):
    """A ``RecoveryEngine`` over ``levels`` sizes of a domain. With one level it is a Recovery.

    schedule: of 1 to 5 ``levels``; its ``level_iterations`` is the part of the iterations that finer levels
    run. scratch: folder of a file for the coarse samples, None for memory. Other arguments and errors are as for
    Recovery; a domain with a halo raises ValueError.
    """

    def __init__(
        self,
        domain: Domain,
        model: ReflectanceModel,
        schedule: Schedule,
        seed: int = 0,
        fixed: Mapping[str, np.ndarray] | None = None,
        entry: EntryChoice = "auto",
        scratch: Path | None = None,
    ):
        super().__init__(domain, model, schedule, seed, fixed, entry, level_schedules(schedule))
        self._domains, self._fixed = _sizes(domain, model, self.fixed, schedule.levels, scratch)
        self._count()
        self._live = self._begin(None)

    def maps(self, confidence: bool = True) -> Maps:
        """Return the maps so far, as RecoveryEngine.maps; those of a coarse level are interpolated."""
        maps = self._live.maps(confidence)
        for level in range(self._at, self.schedule.levels - 1):
            maps = self._finer(maps, level)
        return maps

    def state(self, running: bool = True) -> Checkpoint:
        """Return the state of the current level, its number, and the evaluations of the levels before it."""
        state = self._live.state(running)
        return replace(state, arrays=state.arrays | {_AT: np.array([self._at, self._earlier_evaluations])})

    def restore(self, saved: Checkpoint) -> None:
        self.close()
        self._at, self._earlier_evaluations = (int(number) for number in saved.arrays[_AT])
        self._live = self._begin(None)
        self._live.restore(replace(saved, arrays={n: a for n, a in saved.arrays.items() if n != _AT}))

    def reconfigure(self, schedule: Schedule, seed: int | None = None) -> Pyramid:
        """Return a run that continues from here, as Recovery.reconfigure; the number of levels must stay."""
        if schedule.levels != self.schedule.levels:
            raise InputError(
                f"levels = {schedule.levels}: this run has {self.schedule.levels}; set that, or begin another run"
            )
        return self._reconfigured(schedule, level_schedules(schedule), seed)

    def _texels(self, number: int) -> int:
        return int(np.count_nonzero(self._domains[number].solvable))

    def _title_suffix(self, number: int) -> str:
        return "" if number == self.schedule.levels - 1 else f" at 1/{2 ** (self.schedule.levels - 1 - number)}"

    def _begin(self, guess: Maps | None) -> Recovery:
        """Return the recovery of the current level. guess: at its size, None for the coarsest."""
        domain, schedule = self._domains[self._at], self._schedules[self._at]
        fixed, values = self._fixed[self._at], None if guess is None else guess.values
        return Recovery(domain, self.model, schedule, self.seed, fixed, self.entry, guess=values)

    def _next(self) -> Iterator[None]:
        guess = self._finer(self._live.maps(confidence=False), self._at)
        self._earlier_evaluations += self._live.progress.evaluations
        self._live.close()
        self._at += 1
        self._live = self._begin(guess)
        yield from ()

    def _finer(self, maps: Maps, level: int) -> Maps:
        """Return the maps of a level at the size of the next finer one."""
        coarse, domain = self._domains[level], self._domains[level + 1]
        values = {
            p.name: finer_map(coarse, domain, maps.values[p.name], np.asarray(p.default), p.is_normal)
            for p in self.model.parameters
        }
        residual = finer_map(coarse, domain, present(maps.residual)[..., None], 0.0)[..., 0]
        deviations, alternatives = (
            measured and {name: finer_map(coarse, domain, value, 0.0) for name, value in measured.items()}
            for measured in (maps.confidence, maps.alternatives)
        )
        return Maps(self.model, values, domain.solvable, residual, deviations, alternatives=alternatives)


def _sizes(
    domain: Domain, model: ReflectanceModel, fixed: dict[str, np.ndarray], levels: int, scratch: Path | None
) -> tuple[list[Domain], list[dict[str, np.ndarray]]]:
    """Return the domains and the fixed maps of all levels, coarsest first."""
    domains, maps = [domain], [fixed]
    for _ in range(levels - 1):
        fine = domains[0]
        coarse = coarser(fine, scratch)
        values = {n: coarser_map(fine, coarse, value, model.parameter(n).is_normal) for n, value in maps[0].items()}
        domains.insert(0, coarse)
        maps.insert(0, values)
    return domains, maps
