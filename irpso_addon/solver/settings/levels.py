"""Schedules of the levels of a domain that is solved coarse to fine, and of a recovery that goes on from a result."""

from __future__ import annotations

from dataclasses import replace

from ...core.errors import InputError
from .schedule import Schedule

# A factor on the preset's start_spread and start_speed, where the swarms start from an earlier result: with
# 300 iterations of ``swarm`` at 3 levels normals of bunny, cat and cow are 3.9, 2.1 and 1.5° off, not 4.3, 2.5 and 1.6.
NARROWER = 0.3


def level_schedules(schedule: Schedule) -> tuple[Schedule, ...]:
    """Return the schedules of the levels, coarsest first; finer ones start from earlier estimates and are shorter."""
    first = schedule.replaced(levels=1)
    part = schedule.level_iterations
    stages = tuple(replace(stage, iterations=_shortened(stage.iterations, part)) for stage in first.stages)
    prefit = replace(first.prefit, iterations=_shortened(first.prefit.iterations, part))
    finer = replace(warm_started(first.replaced(prefit=prefit)), stages=stages)
    return (first, *[finer] * (schedule.levels - 1))


def _shortened(iterations: int, part: float) -> int:
    return max(1, round(part * iterations)) if iterations else 0


def refuse_levels(
    schedule: Schedule, why: str = "the domain does not fit in memory at once", remedy: str = "allow more with --memory"
) -> None:
    """Raise InputError where a schedule of several levels would have to be solved in tiles."""
    if schedule.levels > 1:
        raise InputError(
            f"levels = {schedule.levels}: {why}, and tiles are not solved coarse to fine; set levels = 1, or {remedy}"
        )


def warm_started(schedule: Schedule) -> Schedule:
    """Return a schedule whose swarms begin around the current estimates, closer than around a first guess."""
    swarm = schedule.swarm
    return schedule.replaced(
        start="given", start_spread=NARROWER * swarm.start_spread, start_speed=NARROWER * swarm.start_speed
    )
