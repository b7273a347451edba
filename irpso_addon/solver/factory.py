"""The recovery of a plan and a schedule: whole, in tiles, coarse to fine, or in rounds of interreflection."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from ..geometry.domain import Domain
from ..geometry.light.interreflection_geometry import InterreflectionGeometry
from ..reflectance.model import ReflectanceModel
from .engine.coarse_to_fine import Pyramid
from .engine.engine import RecoveryEngine
from .engine.recovery import Recovery
from .engine.tiled import TiledRecovery
from .interreflection.rounds import InterreflectionRounds
from .planning.make_plan import untiled
from .planning.plan import Plan
from .settings.schedule import Schedule
from .state.prepare import Prepared


def planned_recovery(
    plan: Plan,
    domain: Domain,
    model: ReflectanceModel,
    schedule: Schedule,
    seed: int,
    fixed: Mapping[str, np.ndarray],
    entry: Literal["auto", "fragment", "compute"],
    scratch: Path,
    prepared: Prepared | None = None,
    geometry: InterreflectionGeometry | None = None,
) -> RecoveryEngine:
    """Return the recovery of the plan and the schedule.

    scratch: folder of scratch files. prepared: from ``prepare``, packed where the domain is one tile; a domain of
    several levels is prepared level by level. geometry: of interreflection; None without its rounds.
    """
    settings = (domain, model, schedule, seed, fixed, entry)
    stack_scratch = scratch if plan.stack_on == "scratch" else None
    if schedule.levels > 1 and untiled(plan):
        return Pyramid(*settings, stack_scratch)
    solve: Callable[..., RecoveryEngine] = Recovery
    if not untiled(plan):
        folder = scratch if plan.state_on == "scratch" else None
        solve = partial(TiledRecovery, boxes=plan.boxes, halo=plan.halo, on_device=plan.on_device, scratch=folder)
    if geometry is None:
        return solve(*settings, prepared=prepared)
    return InterreflectionRounds(*settings, geometry, prepared, solve)
