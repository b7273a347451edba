"""Schedules of rounds of interreflection: matte rounds, full rounds, and a last recovery."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from ...reflectance.model import ReflectanceModel
from .levels import warm_started
from .schedule import Schedule

_MATTE_STEPS = 6  # of Levenberg–Marquardt in a matte round


@dataclass(frozen=True)
class RoundSchedules:
    """What the recoveries of a run find: matte rounds first, then full ones, then a last recovery.

    matte, full: numbers of rounds. A matte round finds base colours alone. fixes_normals: whether all recoveries but
    the last fix the normals of a known shape; then the last starts from their materials. end: number of the last
    recovery if the run ends early, which then starts anew; else None.
    """

    matte: int
    full: int
    fixes_normals: bool
    end: int | None = None

    @property
    def count(self) -> int:
        """Number of recoveries."""
        return 1 + (self.matte + self.full if self.end is None else self.end)

    @property
    def longest(self) -> RoundSchedules:
        """The rounds with the full one that may follow matte ones."""
        return replace(self, full=1) if self.matte and not self.full and self.end is None else self

    def normals_fixed_in(self, number: int) -> bool:
        """Return whether a recovery fixes the normals of the known shape."""
        return self.fixes_normals and number < self.count - 1

    def is_matte(self, number: int) -> bool:
        """Return whether a recovery finds base colours alone."""
        return number < self.matte and self.normals_fixed_in(number)

    def fixed_in(self, number: int, model: ReflectanceModel) -> dict[str, np.ndarray]:
        """Return the parameters that a recovery fixes: to the mesh's normals, in a matte round to the defaults."""
        fixed: dict[str, np.ndarray] = {}
        for p in model.parameters:
            if p.is_normal and self.normals_fixed_in(number):
                fixed[p.name] = np.array((0, 0, 1), np.float32)
            elif not (p.is_normal or p.is_albedo) and self.is_matte(number):
                fixed[p.name] = np.atleast_1d(np.asarray(p.default, np.float32))
        return fixed

    def schedules(self, schedule: Schedule) -> tuple[Schedule, ...]:
        """Return the schedule of each recovery."""
        single = schedule.without_rounds()
        earlier = (_matte(single) if number < self.matte else single for number in range(self.count - 1))
        warm = self.fixes_normals and self.full and self.end is None
        return (*earlier, warm_started(single) if warm else single)


def round_schedules(
    schedule: Schedule, model: ReflectanceModel, fixed: Collection[str], known_shape: bool
) -> RoundSchedules:
    """Return the rounds that a schedule asks for. fixed: names of parameters. known_shape: of the geometry."""
    free = [p for p in model.parameters if not p.is_normal and p.name not in fixed]
    fixes_normals = known_shape and bool(free)
    matte = schedule.interreflection.matte_rounds if fixes_normals and any(p.is_albedo for p in free) else 0
    return RoundSchedules(matte, schedule.interreflection.rounds, fixes_normals)


def _matte(schedule: Schedule) -> Schedule:
    """Return the schedule of a matte round: robust least squares, as base colours are linear weights."""
    settings = {
        "prefit_iterations": 0, "refinement_iterations": _MATTE_STEPS, "refinement_starts": False,
        "refinement_rounds": 0, "materials_rounds": 0, "prior_rounds": 0, "surface_rounds": 0,
    }  # fmt: skip
    stages = tuple(replace(stage, iterations=0) for stage in schedule.stages)
    return replace(schedule.replaced(**settings), stages=stages)
