"""Creation of the phase of a resolved stage."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from ...core.errors import InputError
from ..settings.resolve import (
    Resolved,
    ResolvedIndirect,
    ResolvedMaterials,
    ResolvedPrefit,
    ResolvedRefinement,
    ResolvedSeparation,
    ResolvedSheen,
    ResolvedSpatialPrior,
    ResolvedSurface,
)
from ..state.prefit_measurements import PrefitMeasurements
from .acceptance import AcceptanceTest
from .indirect import IndirectPhase
from .phase import Phase, PhaseContext
from .prefit import PrefitPhase
from .refinement import RefinementPhase
from .separation import SeparationPhase
from .sequential_swarm import SequentialSwarmPhase
from .shared_materials import SharedMaterialsPhase
from .sheen import SheenPhase
from .spatial_prior import SpatialPriorPhase
from .surface import SurfacePhase
from .synchronous_swarm import SynchronousSwarmPhase

_SEEDS = 2**31  # a push constant holds 32 bits, one of them the sign
_SEED_STEP = 0x9E3779B1  # between the seeds of stages: odd, so that no two of 2³² stages share one
# Fields of PrefitMeasurements by the kind of the stage that makes them.
_MADE_BY: dict[type[Resolved], tuple[str, ...]] = {
    ResolvedPrefit: ("fitness", "indirect_misfit", "sheen"), ResolvedIndirect: ("shadow",),
    ResolvedSeparation: ("separation",), ResolvedSheen: ("sheen_chosen",),
}  # fmt: skip


def check_seed(seed: int) -> None:
    """Raise InputError unless a seed is a whole number from −2³¹ to 2³¹ − 1."""
    if not isinstance(seed, int) or not -_SEEDS <= seed < _SEEDS:
        raise InputError(f"seed: must be a whole number from {-_SEEDS} to {_SEEDS - 1}, not {seed!r}")


def create_phase(
    stage: Resolved,
    index: int,
    context: PhaseContext,
    seed: int,
    acceptance: Callable[[], AcceptanceTest | None],
    measurements: PrefitMeasurements,
) -> Phase:
    """Return the phase of stage ``index``.

    seed: of the recovery. acceptance: creates the test of the result. measurements: of the phases before.
    """
    # Every stage has its own random numbers: with equal ones each cycle would start at the same positions.
    seed = (seed + _SEED_STEP * index + _SEEDS) % (2 * _SEEDS) - _SEEDS
    if isinstance(stage, ResolvedRefinement):
        test = acceptance() if any(p.is_normal for p in stage.parameters) else None
        kind = SharedMaterialsPhase if isinstance(stage, ResolvedMaterials) else RefinementPhase
        return kind(stage, context, test)
    if isinstance(stage, ResolvedSpatialPrior):
        return SpatialPriorPhase(stage, context, acceptance())
    if isinstance(stage, ResolvedSurface):
        return SurfacePhase(stage, context, acceptance())
    if isinstance(stage, ResolvedPrefit):
        return PrefitPhase(stage, context, seed, measurements)
    if isinstance(stage, ResolvedSheen):
        return SheenPhase(stage, context, measurements)
    if isinstance(stage, ResolvedIndirect):
        return IndirectPhase(stage, context, measurements)
    if isinstance(stage, ResolvedSeparation):
        return SeparationPhase(stage, context, measurements)
    kind_of_swarm = SynchronousSwarmPhase if context.schedule.swarm.update == "all" else SequentialSwarmPhase
    return kind_of_swarm(stage, context, seed)


def made_by(stages: Sequence[Resolved], measurements: PrefitMeasurements) -> PrefitMeasurements:
    """Return the measurements that were made by ``stages``, the first ones of a recovery."""
    ended = {type(stage) for stage in stages}
    missing = [field for kind, fields in _MADE_BY.items() if kind not in ended for field in fields]
    return replace(measurements, **dict.fromkeys(missing))
