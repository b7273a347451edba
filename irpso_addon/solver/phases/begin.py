"""Creation of the phase of a resolved stage."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ...core.errors import InputError
from ...gpu.kernel import Entry
from ...reflectance.model import ReflectanceModel
from ..settings.resolve import (
    Resolved,
    ResolvedIndirect,
    ResolvedMaterials,
    ResolvedPrefit,
    ResolvedPrior,
    ResolvedRefinement,
    ResolvedSeparation,
    ResolvedSheen,
    ResolvedSurface,
)
from ..settings.schedule import Schedule
from ..state.textures import DomainTextures, Estimates
from .indirect import SHADOW, IndirectPhase
from .phase import Phase
from .prefit import EVIDENCE, FITNESS, SHEEN, AcceptanceTest, PrefitPhase
from .refinement import RefinementPhase
from .separation import SEPARATION, SeparationPhase
from .sequential_swarm import SequentialSwarmPhase
from .shared_materials import SharedMaterialsPhase
from .sheen import CHOSEN, SheenPhase
from .spatial_prior import SpatialPriorPhase
from .surface import SurfacePhase
from .synchronous_swarm import SynchronousSwarmPhase

_SEEDS = 2**31  # a push constant holds 32 bits, one of them the sign
_SEED_STEP = 0x9E3779B1  # between the seeds of stages: odd, so that no two of 2³² stages share one
# Measurements of prefits and of the phases between them: name → kind of the stage that makes it.
MEASURED = {
    FITNESS: ResolvedPrefit, EVIDENCE: ResolvedPrefit, SHEEN: ResolvedPrefit, SHADOW: ResolvedIndirect,
    SEPARATION: ResolvedSeparation, CHOSEN: ResolvedSheen,
}  # fmt: skip


def check_seed(seed: int) -> None:
    """Raise InputError unless a seed is a whole number from −2³¹ to 2³¹ − 1."""
    if not isinstance(seed, int) or not -_SEEDS <= seed < _SEEDS:
        raise InputError(f"seed: must be a whole number from {-_SEEDS} to {_SEEDS - 1}, not {seed!r}")


def begin_phase(
    stage: Resolved,
    index: int,
    model: ReflectanceModel,
    schedule: Schedule,
    seed: int,
    domain: DomainTextures,
    estimates: Estimates,
    entry: Entry,
    acceptance: Callable[[], AcceptanceTest | None],
    prefit: Mapping[str, np.ndarray],
) -> Phase:
    """Return the phase of stage ``index``.

    seed: of the recovery. acceptance: creates the test of the result. prefit: measurements of earlier prefits.
    """
    # Every stage has its own random numbers: with equal ones each cycle would start at the same positions.
    seed = (seed + _SEED_STEP * index + _SEEDS) % (2 * _SEEDS) - _SEEDS
    if isinstance(stage, ResolvedRefinement):
        test = acceptance() if any(p.is_normal for p in stage.parameters) else None
        kind = SharedMaterialsPhase if isinstance(stage, ResolvedMaterials) else RefinementPhase
        return kind(stage, model, schedule, domain, estimates, entry, test)
    if isinstance(stage, ResolvedPrior):
        return SpatialPriorPhase(stage, model, schedule, domain, estimates, entry, acceptance())
    if isinstance(stage, ResolvedSurface):
        return SurfacePhase(stage, model, schedule, domain, estimates, entry, acceptance())
    if isinstance(stage, ResolvedPrefit):
        return PrefitPhase(stage, model, schedule, seed, domain, estimates, entry, prefit)
    if isinstance(stage, ResolvedSheen):
        return SheenPhase(stage, model, schedule, domain, estimates, entry, prefit)
    if isinstance(stage, ResolvedIndirect):
        return IndirectPhase(stage, model, schedule, domain, estimates, entry, prefit)
    if isinstance(stage, ResolvedSeparation):
        return SeparationPhase(stage, model, schedule, domain, estimates, entry, prefit)
    kind_of_swarm = SynchronousSwarmPhase if schedule.swarm.update == "all" else SequentialSwarmPhase
    return kind_of_swarm(stage, model, schedule, seed, domain, estimates, entry)


def measured_by(stages: Sequence[Resolved], measured: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the measurements that were made by ``stages``, the first ones of a recovery."""
    ended = {type(stage) for stage in stages}
    return {name: array for name, array in measured.items() if MEASURED[name] in ended}
