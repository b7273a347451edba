"""Other settings in mid-run: what of a recovery goes on as it is, and what begins anew around what has been found."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..kernels.encoding import build_encoding
from ..phases.sequential_swarm import SequentialSwarmPhase
from ..phases.swarm import particle_count
from ..phases.synchronous_swarm import SynchronousSwarmPhase
from ..settings.groups import Fitness
from ..settings.resolve import Resolved, ResolvedSwarm, resolve
from ..settings.schedule import Schedule
from ..state import prepare
from ..state.prepare import Prepared
from ..state.textures import DomainTextures, Estimates

if TYPE_CHECKING:
    from .recovery import Recovery

# Of the preset's spread around the seed, and of its first speeds, where the seed is what has been found: with 300
# iterations of ``swarm`` at 3 levels normals of bunny, cat and cow are 3.9, 2.1 and 1.5° off, not 4.3, 2.5 and 1.6.
NARROWER = 0.3


def changed(old: Recovery, schedule: Schedule, seed: int | None, prepared: Prepared | None) -> Recovery:
    """Return what Recovery.changed does."""
    old._check(schedule, old.seed if seed is None else seed)
    stages = resolve(schedule, old.model, set(old._fixed), old.domain.observations)
    old._finish_iteration()
    index = finished_alike(old._stages[: old._index], stages)
    stage = stages[index] if index < len(stages) else None
    goes_on = stage is not None and index == old._index and _goes_on(old, schedule, stage)
    inherits = stage is not None and index == old._index and not goes_on and _same_swarms(old, schedule, stage)

    new = object.__new__(type(old))
    new.domain, new.model, new.entry = old.domain, old.model, old.entry
    new.schedule, new.seed = schedule, old.seed if seed is None else seed
    textures, stack = old._textures, old._stack
    if _samples_differ(old.schedule.fitness, schedule.fitness):
        textures, stack = _new_samples(old, schedule, prepared)
    estimates = old._estimates if goes_on or inherits else _found(old)
    new._set_up(textures, stack, estimates, old._fixed, stages)
    new._index, new._evaluations = index, old._evaluations
    new._prefit_fitness = old._prefit_fitness if index > 0 else None
    if goes_on:
        old._phase, new._phase = None, old._phase
    elif stage is not None:
        found = index < old._index or old._phase.placed
        new._phase = new._begin(index, given(schedule) if found else schedule)
        if inherits:
            new._phase.inherit(old._phase)
    return new


def given(schedule: Schedule) -> Schedule:
    """Return a schedule whose swarms begin around the estimates that there are, closer than around a first guess."""
    swarm = schedule.swarm
    return schedule.replaced(
        seed="given", seed_spread=NARROWER * swarm.seed_spread, start_speed=NARROWER * swarm.start_speed
    )


def finished_alike(before: Sequence[Resolved], stages: Sequence[Resolved]) -> int:
    """Return how many of the stages that are finished another schedule begins with, whatever its constants are."""
    count = 0
    for done, stage in zip(before, stages, strict=False):
        if not _one_search(done, stage):
            break
        count += 1
    return count


def _one_search(a: Resolved, b: Resolved) -> bool:
    """Whether two phases are of one kind and look for the same."""
    cycles = (a.cycle, b.cycle) if isinstance(a, ResolvedSwarm) and isinstance(b, ResolvedSwarm) else (0, 0)
    return type(a) is type(b) and a.title == b.title and cycles[0] == cycles[1]


def _goes_on(old: Recovery, schedule: Schedule, stage: Resolved) -> bool:
    """Whether nothing is changed of all that the phase under way depends on."""

    def settings(schedule: Schedule, stage: Resolved) -> tuple:
        return stage, schedule.swarm, schedule.fitness, schedule.prefit, schedule.refinement

    return settings(old.schedule, old._stages[old._index]) == settings(schedule, stage)


def _same_swarms(old: Recovery, schedule: Schedule, stage: Resolved) -> bool:
    """Whether the swarms under way are what another schedule wants, with the same meaning of places and fitnesses."""
    phase, before, after = old._phase, old.schedule, schedule
    if not isinstance(phase, SequentialSwarmPhase | SynchronousSwarmPhase) or phase.iteration < 0:
        return False
    if not _one_search(phase.stage, stage) or before.fitness != after.fitness:
        return False
    if (before.swarm.update, before.swarm.linear_reach) != (after.swarm.update, after.swarm.linear_reach):
        return False
    encoding = build_encoding(old.model, stage, after.swarm.normal)
    same = encoding == phase.encoding and stage.solved == phase.stage.solved
    return same and particle_count(after, encoding.dimensions) == phase.particles


def _samples_differ(a: Fitness, b: Fitness) -> bool:
    """Whether scales or the weights of samples are others."""

    def dropped(fitness: Fitness) -> float:
        return fitness.shadow if fitness.loss == "robust" else 0.0

    return (a.percentile, a.bounds, dropped(a)) != (b.percentile, b.bounds, dropped(b))


def _new_samples(
    old: Recovery, schedule: Schedule, prepared: Prepared | None
) -> tuple[DomainTextures, np.ndarray | None]:
    prepared = (prepared or prepare.prepare(old.domain, old.model, schedule)).packed(old.domain, schedule)
    scale = prepared.packing.pack(prepared.scale)
    textures = DomainTextures(old.domain, prepared.packing, None, scale, prepared.brightness, prepared.arrays)
    return textures, prepared.stack


def _found(old: Recovery) -> Estimates:
    """What has been found so far, as estimates of their own: the old recovery stays as it is."""
    resolved = old._phase is not None and old._phase.placed
    if resolved:
        old._give_stack()
        old._phase.resolve()
    return Estimates(old.model, old._estimates.values(resolved))
