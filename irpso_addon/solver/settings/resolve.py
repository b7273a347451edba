"""The phases of a schedule for one model, in order."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cache

from ...core.errors import InputError
from ...core.paths import SHADERS
from ...reflectance.model import Parameter, ReflectanceModel, Start, load_model
from .groups import NormalSearch, Stage
from .refinement_groups import Materials, Refinement, SpatialPrior, Surface
from .schedule import ALL, MAX_DIMENSIONS, MAX_PARTICLES, REST, Schedule

PROPAGATE = -2  # instead of a start: the best materials of neighbours
BEST = -1  # instead of a start: the texel's best material so far, with its damping
_ROUNDS = 2  # rounds of a refinement with fixed normals, at most, and of a prefit with sheen, which has two optima
_USUAL_STAGES = {"diffuse", "normal", "specular"}  # a model need not have all of them


@dataclass(frozen=True)
class ResolvedSwarm:
    """A stage for one model: the searched parameters, in the table's order, and the number of iterations.

    solved: parameters that are solved in closed form for every particle.
    """

    parameters: tuple[Parameter, ...]
    iterations: int
    cycle: int = 0
    solved: tuple[Parameter, ...] = ()

    @property
    def title(self) -> str:
        """The searched parameters, for people."""
        return " + ".join(p.name for p in (*self.parameters, *self.solved))

    def dimensions(self, normal: NormalSearch) -> int:
        """Return n, the number of dimensions of a particle."""
        return sum(self.size(p, normal) for p in self.parameters)

    @staticmethod
    def size(parameter: Parameter, normal: NormalSearch) -> int:
        """Return the number of dimensions of a parameter."""
        return (2 if normal == "hemisphere" else 3) if parameter.is_normal else parameter.components


@dataclass(frozen=True)
class Track:
    """Iterations from one start: an index of the model's starts, BEST or PROPAGATE."""

    start: int
    iterations: int


@dataclass(frozen=True)
class ResolvedRefinement:
    """The refinement for one model: its parameters, and the starts besides the estimate."""

    parameters: tuple[Parameter, ...]
    refinement: Refinement
    starts: tuple[Start, ...]
    title: str = "refinement"

    @property
    def tracks(self) -> tuple[Track, ...]:
        """The tracks in their order; after each one every texel keeps its best material so far."""
        refinement, starts = self.refinement, range(len(self.starts))
        several: list[Track] = []
        if starts:
            raced = refinement.start_iterations + refinement.race_iterations
            several = [Track(BEST, refinement.start_iterations), *(Track(start, raced) for start in starts)]
        propagations = [Track(PROPAGATE, refinement.round_iterations)] * refinement.rounds
        return (*several, Track(BEST, refinement.iterations), *propagations)

    @property
    def iterations(self) -> int:
        """The number of all steps."""
        return sum(track.iterations for track in self.tracks)


@dataclass(frozen=True)
class ResolvedMaterials(ResolvedRefinement):
    """The phase of shared materials: a refinement whose rounds start from these materials."""

    materials: Materials = Materials()


@dataclass(frozen=True)
class ResolvedPrefit:
    """The prefit: swarms and a refinement with the prefit's own model.

    indirect: solves only texels with indirect light. seeks: also measures the misfit of indirect light. sheen: uses
    the model with sheen.
    """

    stage: ResolvedSwarm
    refinement: ResolvedRefinement
    indirect: bool = False
    seeks: bool = False
    sheen: bool = False

    @property
    def title(self) -> str:
        """The searched parameters, for people."""
        where = " in indirect light" if self.indirect else " with sheen" if self.sheen else ""
        return "prefit of the normals" + where

    @property
    def model(self) -> ReflectanceModel:
        """The prefit's own model."""
        return prefit_model(self.sheen)

    @property
    def iterations(self) -> int:
        """The number of all iterations."""
        return self.stage.iterations + self.refinement.iterations


@dataclass(frozen=True)
class ResolvedSheen:
    """Selects the texels at which the prefit with sheen replaces the first prefit."""

    title = "sheen"
    iterations = 1


@dataclass(frozen=True)
class ResolvedIndirect:
    """Selects the texels with mostly indirect light, between two prefits."""

    title = "indirect light"
    iterations = 1


@dataclass(frozen=True)
class ResolvedSeparation:
    """Separates direct from indirect light, by colour or by shadows, before the second of these two prefits."""

    title = "separation of indirect light"
    iterations = 1


@dataclass(frozen=True)
class ResolvedSpatialPrior:
    """The spatial prior for one model.

    parameters: all free ones. pooled: the scalars among them; colours are pooled, too. step: the steps after pooling.
    """

    parameters: tuple[Parameter, ...]
    pooled: tuple[Parameter, ...]
    prior: SpatialPrior
    step: ResolvedRefinement

    title = "prior"

    @property
    def iterations(self) -> int:
        """The number of iterations: the noise, the deviations, the rounds, and the steps."""
        return 2 + self.prior.rounds + self.prior.iterations


@dataclass(frozen=True)
class ResolvedSurface:
    """The phase that makes normals belong to one surface, for one model. parameters: all free ones."""

    parameters: tuple[Parameter, ...]
    surface: Surface

    title = "surface"

    @property
    def iterations(self) -> int:
        """The number of iterations: the noise, the covariance of the slopes, and the rounds."""
        return 2 + self.surface.rounds


Resolved = (
    ResolvedPrefit
    | ResolvedSheen
    | ResolvedIndirect
    | ResolvedSeparation
    | ResolvedSwarm
    | ResolvedRefinement
    | ResolvedSpatialPrior
    | ResolvedSurface
)


@cache
def prefit_model(sheen: bool = False) -> ReflectanceModel:
    """Return the prefit's own model, or that with sheen."""
    return load_model(SHADERS / "prefit" / f"base_lobe{'_sheen' if sheen else ''}.toml")


def _resolve_prefit(schedule: Schedule) -> list[Resolved]:
    prefit = schedule.prefit
    first = _prefit_with(prefit_model(), schedule)
    resolved: list[Resolved] = [replace(first, seeks=prefit.indirect_shadow > 0)]
    if prefit.sheen_gain:
        resolved += [replace(_prefit_with(prefit_model(sheen=True), schedule, _ROUNDS), sheen=True), ResolvedSheen()]
    if prefit.indirect_shadow:
        separation = [ResolvedSeparation()] if prefit.indirect_share else []
        resolved += [ResolvedIndirect(), *separation, replace(first, indirect=True)]
    return resolved


def _prefit_with(model: ReflectanceModel, schedule: Schedule, rounds: int = 0) -> ResolvedPrefit:
    prefit = schedule.prefit
    refinement = Refinement(prefit.refinement_iterations, starts=False, rounds=rounds)
    searched = tuple(p for p in model.parameters if p.kind == "search")
    solved = tuple(p for p in model.parameters if p.kind == "linear")
    stage = ResolvedSwarm(searched, prefit.iterations, solved=solved)
    _check_particles(schedule, stage)
    return ResolvedPrefit(stage, ResolvedRefinement(model.parameters, refinement, ()))


def _resolve_refinement(
    refinement: Refinement,
    model: ReflectanceModel,
    parameters: tuple[Parameter, ...],
    title: str = ResolvedRefinement.title,
) -> tuple[ResolvedRefinement, ...]:
    if refinement.iterations == 0:
        return ()
    names = {p.name for p in parameters}
    starts = (tuple(row for row in start if row[0] in names) for start in model.starts if refinement.starts)
    return (
        ResolvedRefinement(parameters, refinement, tuple(dict.fromkeys(start for start in starts if start)), title),
    )


def _resolve_refinement_with_fixed_normals(
    refinement: Refinement, model: ReflectanceModel, parameters: tuple[Parameter, ...]
) -> tuple[ResolvedRefinement, ...]:
    """Return a second refinement, with fixed normals. It is shorter than the first: most texels have converged.

    Where the acceptance test kept the prefit's normal, the other parameters come from the swarms alone, often in
    another local optimum than the neighbours'. Around the mouth of a real icon, roughness differed by 0.4 or more from
    its 5×5 median at 5.5 % of the texels; with this refinement at 0.24 %. More iterations or rounds do not lower that.
    """
    others = tuple(p for p in parameters if not p.is_normal)
    if not any(p.kind == "search" for p in others):  # the swarms have already solved linear parameters
        return ()
    shorter = replace(
        refinement, starts=False, iterations=refinement.start_iterations, rounds=min(refinement.rounds, _ROUNDS)
    )
    return _resolve_refinement(shorter, model, others, "refinement, normals fixed")


def _resolve_materials(schedule: Schedule, parameters: tuple[Parameter, ...]) -> tuple[ResolvedMaterials, ...]:
    settings = schedule.materials
    disabled = settings.rounds == 0 or schedule.refinement.iterations == 0
    if disabled or not any(p.kind == "search" and not p.is_normal for p in parameters):
        return ()
    # One step first: it measures the estimate's fitness, with which the shared materials are compared.
    rounds = replace(
        schedule.refinement, starts=False, iterations=1, rounds=settings.rounds, round_iterations=settings.iterations
    )
    return (ResolvedMaterials(parameters, rounds, (), "shared materials", settings),)


def _resolve_prior(schedule: Schedule, parameters: tuple[Parameter, ...]) -> tuple[ResolvedSpatialPrior, ...]:
    prior, pooled = schedule.prior, tuple(p for p in parameters if p.components == 1)
    if prior.rounds == 0 or not pooled:
        return ()
    moved = tuple(p for p in parameters if prior.normals or not p.is_normal)
    return (ResolvedSpatialPrior(parameters, pooled, prior, ResolvedRefinement(moved, schedule.refinement, ())),)


def _resolve_surface(schedule: Schedule, parameters: tuple[Parameter, ...]) -> tuple[ResolvedSurface, ...]:
    if schedule.surface.rounds == 0 or not any(p.is_normal for p in parameters):
        return ()
    return (ResolvedSurface(parameters, schedule.surface),)


def resolve(
    schedule: Schedule, model: ReflectanceModel, fixed: set[str], observations: int = 0
) -> tuple[Resolved, ...]:
    """Return the phases that estimate a model's free parameters: prefit, stages, refinement, shared materials, prior,
    surface.

    observations: number of fitted ones. A prefit needs at least ``schedule.prefit.min_observations``; starts race with
    at most ``schedule.refinement.race_max_observations``. Raises InputError.
    """
    names, unsearched = _searched_names(schedule, model), unsearched_names(schedule, model, fixed)
    free = [p for p in model.parameters if p.name not in unsearched]
    prefit = schedule.prefit
    has_prefit = prefit.iterations > 0 and observations >= prefit.min_observations and any(p.is_normal for p in free)
    resolved: list[Resolved] = _resolve_prefit(schedule) if has_prefit else []
    for cycle in range(schedule.cycles):
        for stage in schedule.stages:
            searched = [p for p in free if _in_stage(p, stage, names) and not (has_prefit and p.is_normal)]
            if searched and stage.iterations:
                resolved.append(_resolve_swarm(schedule, model, searched, stage.iterations, cycle))
    if free:
        parameters, refinement = tuple(free), schedule.refinement
        if observations > refinement.race_max_observations:
            refinement = replace(refinement, race_iterations=0)
        resolved += _resolve_refinement(refinement, model, parameters)
        if has_prefit:
            resolved += _resolve_refinement_with_fixed_normals(schedule.refinement, model, parameters)
        resolved += _resolve_materials(schedule, parameters)
        resolved += _resolve_prior(schedule, parameters)
        resolved += _resolve_surface(schedule, parameters)
    if not resolved:
        raise InputError("search: every searched parameter is fixed; leave one of them free")
    return tuple(resolved)


def particle_count(schedule: Schedule, dimensions: int) -> int:
    """Return m, the particles of a swarm in a space of ``dimensions``."""
    swarm = schedule.swarm
    return max(swarm.particles, math.ceil(swarm.particles_per_dimension * dimensions))


def unsearched_names(schedule: Schedule, model: ReflectanceModel, fixed: Collection[str]) -> frozenset[str]:
    """Return the parameters that are not estimated: fixed ones, and those of no stage. Raises InputError."""
    names = _searched_names(schedule, model)
    searched = {p.name for p in model.parameters if any(_in_stage(p, stage, names) for stage in schedule.stages)}
    return frozenset(p.name for p in model.parameters if p.name in fixed or p.name not in searched)


def _searched_names(schedule: Schedule, model: ReflectanceModel) -> set[str]:
    """Return the names of parameters and stages that the schedule searches. Raises InputError for an unknown one."""
    names = {p.stage for p in model.parameters} | {p.name for p in model.parameters}
    searched = {name for stage in schedule.stages for name in stage.search}
    if unknown := sorted(searched - names - _USUAL_STAGES - {ALL, REST}):
        offered = ", ".join(p.name for p in model.parameters)
        raise InputError(f"search: model {model.name} has no parameter or stage '{unknown[0]}'; it has: {offered}")
    return searched


def _resolve_swarm(
    schedule: Schedule, model: ReflectanceModel, parameters: list[Parameter], iterations: int, cycle: int
) -> ResolvedSwarm:
    solve = schedule.swarm.linear == "solve"
    solved = [p for p in parameters if solve and p.kind == "linear" and p.name in model.bases]
    searched = tuple(p for p in parameters if p not in solved)
    result = ResolvedSwarm(searched, iterations, cycle, tuple(solved))
    if (n := result.dimensions(schedule.swarm.normal)) > MAX_DIMENSIONS:
        raise InputError(
            f"search: {result.title} are {n} dimensions together, at most {MAX_DIMENSIONS} fit;"
            ' search fewer, set linear = "solve", fix some (--fixed), or search the normal on the hemisphere'
        )
    if schedule.swarm.update == "all":
        _check_particles(schedule, result)
    return result


def _check_particles(schedule: Schedule, stage: ResolvedSwarm) -> None:
    """Raise InputError if a stage whose particles move together has more than fit."""
    particles = particle_count(schedule, stage.dimensions(schedule.swarm.normal))
    if particles > MAX_PARTICLES:
        raise InputError(
            f'particles: update = "all", and the prefit, move at most {MAX_PARTICLES} together, not {particles}; lower'
            " particles or particles_per_dimension, or for the prefit set prefit_iterations = 0"
        )


def _in_stage(parameter: Parameter, stage: Stage, searched: set[str]) -> bool:
    names = {parameter.name, parameter.stage}
    return bool(({ALL} | names) & set(stage.search)) or (REST in stage.search and not names & searched)
