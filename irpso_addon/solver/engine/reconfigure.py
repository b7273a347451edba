"""The start of a recovery: a new one, or one that continues another's estimates under other settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...core.optional import present
from ...geometry.domain import Domain
from ...reflectance.model import ReflectanceModel
from ..kernels.encoding import build_encoding
from ..phases.phase import Phase
from ..phases.swarm import SwarmPhase
from ..settings.groups import Fitness
from ..settings.resolve import (
    Resolved,
    ResolvedIndirect,
    ResolvedPrefit,
    ResolvedSheen,
    ResolvedSurface,
    ResolvedSwarm,
    particle_count,
)
from ..settings.schedule import Schedule
from ..state import prepare
from ..state.prefit_measurements import PrefitMeasurements
from ..state.prepare import Prepared
from ..state.textures import DomainTextures, Estimates


@dataclass
class Begin:
    """The begin of a recovery, or the end of the one before it. stack: of the textures, until it is uploaded."""

    textures: DomainTextures
    stack: np.ndarray | None
    estimates: Estimates
    index: int = 0
    evaluations: int = 0
    measurements: PrefitMeasurements = PrefitMeasurements()


@dataclass(frozen=True)
class Reuse:
    """The parts of a recovery that continue under another schedule.

    index: of the stage that it begins with. phase: the current phase continues. swarms: the phase whose swarms the next
    one inherits. samples: the samples on the GPU stay.
    """

    index: int
    phase: bool
    swarms: SwarmPhase | None
    samples: bool


def first_begin(
    domain: Domain,
    model: ReflectanceModel,
    schedule: Schedule,
    fixed: Mapping[str, np.ndarray],
    prepared: Prepared | None,
    guess: Mapping[str, np.ndarray] | None,
) -> Begin:
    """Return the begin of a new recovery. The arguments are as for a Recovery."""
    domain_textures, stack, found = samples_of(domain, model, schedule, prepared)
    values = {name: domain_textures.packing.pack(value) for name, value in {**(guess or found), **fixed}.items()}
    return Begin(domain_textures, stack, Estimates(model, values))


def samples_of(
    domain: Domain, model: ReflectanceModel, schedule: Schedule, prepared: Prepared | None
) -> tuple[DomainTextures, np.ndarray | None, dict[str, np.ndarray]]:
    """Return the domain on the GPU, the sample stack to upload later, and the first guess."""
    prepared = (prepared or prepare.prepare(domain, model, schedule)).packed(domain, schedule)
    packing = present(prepared.packing)
    numbers = packing.pack(prepared.scale), prepared.mean_irradiance, prepared.arrays
    domain_textures = DomainTextures(domain, packing, None, *numbers)
    return domain_textures, prepared.stack, prepared.guess


def reusable(
    before: Schedule,
    after: Schedule,
    old: Sequence[Resolved],
    stages: tuple[Resolved, ...],
    running: int,
    phase: Phase | None,
    model: ReflectanceModel,
) -> Reuse:
    """Return the parts that continue. old, stages: of the schedules before and after. running: index of the stage."""
    index = finished_alike(old[:running], stages)
    phase_continues, swarms = False, None
    if index == running < min(len(old), len(stages)):  # of a recovery that is done no phase is left
        phase_continues = _settings_of(before, old[running]) == _settings_of(after, stages[index])
        swarms = None if phase_continues else _same_swarms(phase, model, before, after, stages[index])
    return Reuse(index, phase_continues, swarms, not _samples_differ(before.fitness, after.fitness))


def finished_alike(before: Sequence[Resolved], stages: Sequence[Resolved]) -> int:
    """Return the number of finished stages with which another schedule begins, too; constants may differ.

    0 where a finished test of the prefit has replaced a measurement that the other schedule needs.
    """
    count = 0
    for done, stage in zip(before, stages, strict=False):
        if not _same_search(done, stage):
            break
        count += 1
    undone, left = before[count:], stages[count:]
    seeks = any(isinstance(stage, ResolvedIndirect) for stage in left)
    replaced = ResolvedSheen | ResolvedIndirect if seeks else ResolvedSheen
    return 0 if any(isinstance(stage, replaced) for stage in undone) else count


def _same_search(a: Resolved, b: Resolved) -> bool:
    """Return whether two phases have one kind and one search, and the first makes all measurements of the second."""
    if isinstance(a, ResolvedPrefit) and isinstance(b, ResolvedPrefit) and b.seeks and not a.seeks:
        return False
    cycles = (a.cycle, b.cycle) if isinstance(a, ResolvedSwarm) and isinstance(b, ResolvedSwarm) else (0, 0)
    return type(a) is type(b) and a.title == b.title and cycles[0] == cycles[1]


def _settings_of(schedule: Schedule, stage: Resolved) -> tuple[object, ...]:
    """Return all settings of the current phase."""
    of_kind: object = None
    if isinstance(stage, ResolvedSwarm):
        of_kind = schedule.threshold
    elif isinstance(stage, ResolvedSurface):
        of_kind = schedule.prior.noise_samples
    return stage, schedule.swarm, schedule.fitness, schedule.prefit, schedule.refinement, of_kind


def _same_swarms(
    phase: Phase | None, model: ReflectanceModel, before: Schedule, after: Schedule, stage: Resolved
) -> SwarmPhase | None:
    """Return the current swarms if another schedule can use them: positions and fitnesses have the same meaning."""
    if not isinstance(phase, SwarmPhase) or not isinstance(stage, ResolvedSwarm) or phase.iteration < 0:
        return None
    encoding = build_encoding(model, stage, after.swarm.normal)
    same = (
        _same_search(phase.stage, stage)
        and stage.solved == phase.stage.solved
        and before.fitness == after.fitness
        and (before.swarm.update, before.swarm.linear_limit) == (after.swarm.update, after.swarm.linear_limit)
        and (encoding, particle_count(after, encoding.dimensions)) == (phase.encoding, phase.particles)
    )
    return phase if same else None


def _samples_differ(a: Fitness, b: Fitness) -> bool:
    """Return whether scales or the weights of samples differ."""

    def shadow_limit(fitness: Fitness) -> float:
        return fitness.shadow if fitness.loss == "cauchy" else 0.0

    return (a.scale_percentile, a.clipped_samples, shadow_limit(a)) != (
        b.scale_percentile,
        b.clipped_samples,
        shadow_limit(b),
    )
