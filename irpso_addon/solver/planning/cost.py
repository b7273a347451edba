"""Per-texel cost of a recovery: memory, evaluations, neighbour reads."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

from ...geometry.light.light_transport import MAX_ELEMENTS
from ...reflectance.model import ReflectanceModel
from ..kernels import spatial_prior as prior_kernels
from ..kernels import surface as surface_kernels
from ..kernels.encoding import blocks_of
from ..kernels.refinement import PROPAGATION_RADIUS, renders
from ..phases import neighbour_test
from ..phases.swarm import stencil_radius_at
from ..settings.levels import level_schedules
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
    ResolvedSwarm,
    particle_count,
    resolve,
    unsearched_names,
)
from ..settings.round_schedules import RoundSchedules, round_schedules
from ..settings.schedule import Schedule
from ..state.alternatives import varied
from ..state.phase_textures import (
    TextureTable,
    indirect_table,
    refinement_table,
    sequential_swarm_table,
    shadow_light_table,
    sheen_table,
    spatial_prior_table,
    surface_table,
    synchronous_swarm_table,
)

FLOAT4, FLOAT2, FLOAT = 16, 8, 4  # bytes of a texel of RGBA32F, RG32F and R32F
_GEOMETRY = 4  # layers: position, normal, tangent, place
# Relative costs of iterations, measured on llvmpipe with 24 lights; a sample's render is 1.
STEP = 1.7  # of a Levenberg–Marquardt render, which accumulates normal equations
STEP_DECAY, MIN_STEP = 0.75, 0.2  # of a refinement step: cost relative to the previous step, and its lower limit
NEIGHBOUR_READ = 10.0  # of a prior or a test, per neighbour
SWEEP = 7.0  # of a surface: one sweep of its relaxation
OVERHEAD = 100  # samples whose renders take as long as the rest of an evaluation
INDIRECT = 0.1  # share of the texels whose light is indirect
RACING = 0.4  # share of the texels at which a start goes on in the race: from the sample's time with and without
BADLY_FITTED = 0.5  # share of the texels that the first prefit fits badly
_BEFORE_ROUNDS = prior_kernels.FIRST_ROUND  # iterations of a prior or a surface before its rounds
_Tests = ResolvedIndirect | ResolvedSheen
_SinglePhase = ResolvedSwarm | ResolvedRefinement | ResolvedSpatialPrior | ResolvedSurface | ResolvedSeparation | _Tests


@dataclass(frozen=True)
class PhaseCost:
    """Per-texel cost of one phase, without the domain and the estimates.

    atlas: W×H tiles of its largest textures, which hold all particles. textures: bytes of all textures. kept: bytes of
    the textures that persist between iterations and move with a tile that leaves the device. stencil_radius: largest
    distance, in texels, of neighbour reads. exchanges: iterations that read other tiles. evaluations: renders
    of all observations.
    """

    atlas: int
    textures: int
    kept: int
    stencil_radius: int = 0
    exchanges: int = 0
    evaluations: int = 0


@dataclass(frozen=True)
class Cost:
    """Per-texel cost of a recovery.

    observations: fitted ones. observed: fitted and held out. components: of the model. compute: passes are compute
    dispatches, whose results are read back through copies. alternatives: RGBA textures of the alternatives.
    recoveries: in turn, without those of matte rounds, which take little. rounds: of interreflection, over at most
    ``elements`` elements with ``rays`` rays each, cast at ``triangles``. levels: map sizes, of which each coarse one
    has samples of its own. work: per texel, as in ``work_of``, of all recoveries. most_work: with the full round that
    may follow matte ones.
    """

    observations: int
    observed: int
    components: int
    phases: tuple[PhaseCost, ...]
    compute: bool = False
    alternatives: int = 0
    recoveries: int = 1
    rounds: int = 0
    elements: int = 0
    rays: int = 0
    triangles: int = 0
    levels: int = 1
    work: float = 0.0
    most_work: float = 0.0

    @property
    def estimates(self) -> int:
        """Number of RGBA textures with the model's components."""
        return -(-self.components // 4)

    @property
    def stencil_radius(self) -> int:
        """Largest distance of neighbour reads of any phase: the halo of a tile."""
        return max(phase.stencil_radius for phase in self.phases)

    @property
    def exchanges(self) -> int:
        """Number of iterations that read other tiles: neighbours, or a subset of all texels."""
        return sum(phase.exchanges for phase in self.phases)

    @property
    def evaluations(self) -> int:
        """Renders of all observations per texel, in all phases of all rounds."""
        return self.recoveries * sum(phase.evaluations for phase in self.phases)

    @property
    def stacks(self) -> int:
        """Number of sample stacks on a rank: the second has no indirect light."""
        return 2 if self.rounds else 1

    @property
    def kept(self) -> int:
        """Bytes per texel that move with a tile that leaves the device."""
        return max(phase.kept for phase in self.phases) + FLOAT4 * self.estimates

    @property
    def device(self) -> int:
        """Bytes per texel of all textures except those of the domain's rectangle."""
        # Estimates before and after a stage, their deviations; the residual.
        each = FLOAT4 * (self.observations + _GEOMETRY + 3 * self.estimates + self.alternatives + 1)
        copies = FLOAT4 * (1 + max(phase.atlas for phase in self.phases)) if self.compute else 0
        return each + copies + max(phase.textures for phase in self.phases)


_Tested = ResolvedRefinement | ResolvedSpatialPrior | ResolvedSurface  # their results need the acceptance test


def recovery_cost(
    model: ReflectanceModel,
    schedule: Schedule,
    fixed: Collection[str],
    observations: int,
    held_out: int = 0,
    compute: bool = False,
    triangles: int = 0,
    known_shape: bool = False,
    tiles: int = 1,
) -> Cost:
    """Return the cost of a recovery of ``observations``, ``held_out`` of them not fitted. Raises InputError.

    triangles: of the surface of light transport. known_shape: whether that is a mesh. tiles: its UDIM tiles.
    """
    fitted = observations - held_out
    levels = [(level, resolve(level, model, set(fixed), fitted)) for level in level_schedules(schedule)]
    stages = levels[0][1]
    phases = tuple(phase_cost(stage, model, schedule) for stage in stages)
    if any(isinstance(stage, ResolvedPrefit) for stage in stages):  # the acceptance test's fitness and estimates
        test = 4 + FLOAT4 * -(-model.components // 4)
        phases = tuple(
            replace(phase, textures=phase.textures + test) if isinstance(stage, _Tested) else phase
            for stage, phase in zip(stages, phases, strict=True)
        )
    free = model.without_priors({p.name for p in model.parameters})
    numbers = sum(p.components for p in varied(free, unsearched_names(schedule, model, fixed), schedule.fitness))
    light = schedule.interreflection
    rounds = light.estimates + (light.matte_rounds > 0 and light.rounds == 0)  # a full round may follow matte ones
    elements = max(tiles * light.resolution**2, MAX_ELEMENTS)
    transport = (rounds, elements, light.rays, triangles) if rounds else (0, 0, 0, 0)
    counts = fitted, observations, model.components
    recoveries = 1 + light.rounds
    if schedule.levels > 1:
        of_levels = (work_of_search(level, model, fixed, fitted) for level, _ in reversed(levels))
        work = most_work = sum(level / 4**halvings for halvings, level in enumerate(of_levels))
    else:
        in_turn = round_schedules(schedule, model, fixed, known_shape)
        both = in_turn, in_turn.longest
        work, most_work = (sum(works_of_rounds(rounds, schedule, model, fixed, fitted)) for rounds in both)
    works = [each * (1 + OVERHEAD / fitted) for each in (work, most_work)]
    return Cost(*counts, phases, compute, -(-numbers // 4), recoveries, *transport, schedule.levels, *works)


def works_of_rounds(
    rounds: RoundSchedules, schedule: Schedule, model: ReflectanceModel, fixed: Collection[str], observations: int
) -> list[float]:
    """Return the work per texel of each recovery of rounds of interreflection, as ``work_of``."""
    return [
        work_of_search(own, model, {*fixed, *rounds.fixed_in(number, model)}, observations)
        for number, own in enumerate(rounds.schedules(schedule))
    ]


def work_of_search(schedule: Schedule, model: ReflectanceModel, fixed: Collection[str], observations: int) -> float:
    """Return the work per texel of all phases of one recovery, as ``work_of``."""
    stages = resolve(schedule, model, set(fixed), observations)
    return sum(sum(work_of(stage, model, schedule, observations)) for stage in stages)


def phase_cost(resolved: Resolved, model: ReflectanceModel, schedule: Schedule) -> PhaseCost:
    """Return the cost of one resolved phase."""
    if isinstance(resolved, ResolvedPrefit):
        return _prefit_cost(resolved, schedule)
    table = phase_table(resolved, model, schedule)
    geometry = FLOAT4 * _GEOMETRY if isinstance(resolved, ResolvedMaterials) else 0  # of the texels in the subset
    return PhaseCost(
        table.atlas_tiles, table.bytes_per_texel() + geometry, table.bytes_per_texel(kept=True),
        *_neighbour_reads(resolved, schedule), evaluations=_evaluations(resolved, model, schedule),
    )  # fmt: skip


def phase_table(resolved: Resolved, model: ReflectanceModel, schedule: Schedule) -> TextureTable:
    """Return the textures of a phase; of a prefit those of its swarms."""
    if isinstance(resolved, ResolvedPrefit):
        resolved, schedule = resolved.stage, schedule.replaced(update="all")
    if isinstance(resolved, ResolvedSwarm):
        dimensions = resolved.dimensions(schedule.swarm.normal)
        particles, blocks = particle_count(schedule, dimensions), blocks_of(dimensions)
        if schedule.swarm.update == "all":
            linear = -(-sum(p.components for p in resolved.solved) // 4)
            return synchronous_swarm_table(particles, blocks, linear)
        return sequential_swarm_table(particles, blocks)
    if isinstance(resolved, ResolvedIndirect):
        return indirect_table()
    if isinstance(resolved, ResolvedSeparation):
        return shadow_light_table()
    if isinstance(resolved, ResolvedSurface):
        return surface_table()
    if isinstance(resolved, ResolvedSheen):
        return sheen_table()
    kind = spatial_prior_table if isinstance(resolved, ResolvedSpatialPrior) else refinement_table
    return kind(-(-model.components // 4))


def work_of(resolved: Resolved, model: ReflectanceModel, schedule: Schedule, observations: int) -> tuple[float, ...]:
    """Return the work per texel of each iteration of a phase, in renders of a sample.

    The initialisation of swarms comes first. Work is roughly proportional to time; Progress uses it.
    """
    if isinstance(resolved, ResolvedPrefit):
        own, share = resolved.model, INDIRECT if resolved.indirect else BADLY_FITTED if resolved.sheen else 1.0
        prefit = (*_swarm_work(resolved.stage, schedule.replaced(update="all"), observations),
                *_refinement_work(resolved.refinement, own, observations, 1.0))  # fmt: skip
        return tuple(share * work for work in prefit)
    if isinstance(resolved, ResolvedSwarm):
        return _swarm_work(resolved, schedule, observations)
    if isinstance(resolved, ResolvedRefinement):
        return _refinement_work(resolved, model, observations, STEP)
    if isinstance(resolved, _Tests):
        return (NEIGHBOUR_READ * neighbour_test.TAPS,)
    if isinstance(resolved, ResolvedSeparation):
        return (float(observations),)
    if isinstance(resolved, ResolvedSurface):
        round_work, rounds = SWEEP * surface_kernels.SWEEPS, resolved.surface.rounds
    else:
        round_work, rounds = NEIGHBOUR_READ * prior_kernels.taps_of(resolved.prior), resolved.prior.rounds
    work = [n * observations for n in _renders_by_iteration(resolved, model, schedule)]
    before, after = work[:_BEFORE_ROUNDS], work[_BEFORE_ROUNDS + rounds :]
    return (*map(float, before), *[round_work] * rounds, *(STEP * renders for renders in after))


def _swarm_work(stage: ResolvedSwarm, schedule: Schedule, observations: int) -> tuple[float, ...]:
    particles = particle_count(schedule, stage.dimensions(schedule.swarm.normal))
    if schedule.swarm.update == "all":
        return (float(particles * (2 if stage.solved else 1) * observations),) * (1 + stage.iterations)
    return (float(observations),) * (particles + stage.iterations)


def _refinement_work(
    resolved: ResolvedRefinement, model: ReflectanceModel, observations: int, cost: float
) -> tuple[float, ...]:
    """Return the work of a refinement. From a start all texels step, in its race some; from the best, ever fewer."""
    settings, (step, propagation) = resolved.refinement, (cost * n * observations for n in renders(model, resolved))
    from_best = [step * max(MIN_STEP, STEP_DECAY**i) for i in range(settings.iterations)]
    after_propagation = [propagation + step * MIN_STEP, *[step * MIN_STEP] * (settings.round_iterations - 1)]
    from_starts: list[float] = []
    if resolved.starts:
        race = [*[step] * settings.start_iterations, *[step * RACING] * settings.race_iterations]
        from_starts = [step] * settings.start_iterations + race * len(resolved.starts)
    return (*from_starts, *from_best, *after_propagation * settings.rounds)


def _prefit_cost(resolved: ResolvedPrefit, schedule: Schedule) -> PhaseCost:
    """Return the cost of a prefit: the maximum of its two phases, plus the estimates of its own model."""
    model = resolved.model
    swarm = phase_cost(resolved.stage, model, schedule.replaced(update="all"))
    refinement = phase_cost(resolved.refinement, model, schedule)
    own = FLOAT4 * -(-model.components // 4)
    geometry = FLOAT4 * _GEOMETRY if resolved.indirect or resolved.sheen else 0  # with other states
    return PhaseCost(
        max(swarm.atlas, refinement.atlas),
        max(swarm.textures, refinement.textures) + 2 * own + geometry,
        max(swarm.kept, refinement.kept) + own,
        max(swarm.stencil_radius, refinement.stencil_radius),
        swarm.exchanges + refinement.exchanges,
        swarm.evaluations + refinement.evaluations,
    )


def _neighbour_reads(resolved: _SinglePhase, schedule: Schedule) -> tuple[int, int]:
    """Return the largest distance of neighbour reads, and the number of iterations that read other tiles."""
    if isinstance(resolved, ResolvedSwarm):
        radii = [stencil_radius_at(schedule, i, resolved.iterations) for i in range(resolved.iterations)]
        return max(radii), sum(radius > 0 for radius in radii)
    if isinstance(resolved, _Tests):
        return neighbour_test.STENCIL_RADIUS, 1
    if isinstance(resolved, ResolvedSeparation):
        return 0, 1  # a subset of all texels
    if isinstance(resolved, ResolvedSpatialPrior):
        return prior_kernels.stencil_radius_of(resolved.prior), 1 + resolved.prior.rounds
    if isinstance(resolved, ResolvedSurface):
        return surface_kernels.STENCIL_RADIUS, 1 + resolved.surface.rounds
    return PROPAGATION_RADIUS * int(resolved.refinement.rounds > 0), resolved.refinement.rounds


def _evaluations(resolved: _SinglePhase, model: ReflectanceModel, schedule: Schedule) -> int:
    if isinstance(resolved, _Tests | ResolvedSeparation):
        return 0
    if isinstance(resolved, ResolvedSwarm):
        particles = particle_count(schedule, resolved.dimensions(schedule.swarm.normal))
        if schedule.swarm.update == "all":
            return particles * (2 if resolved.solved else 1) * (1 + resolved.iterations)
        return particles + resolved.iterations
    if isinstance(resolved, ResolvedSpatialPrior | ResolvedSurface):
        return sum(_renders_by_iteration(resolved, model, schedule))
    step, propagation = renders(model, resolved)
    return resolved.iterations * step + resolved.refinement.rounds * propagation


def _renders_by_iteration(
    resolved: ResolvedSpatialPrior | ResolvedSurface, model: ReflectanceModel, schedule: Schedule
) -> list[int]:
    """Return the renders of all observations of each iteration."""
    if isinstance(resolved, ResolvedSurface):
        return [surface_kernels.evaluations_of(resolved, model, schedule, i) for i in range(resolved.iterations)]
    return [prior_kernels.evaluations_of(resolved, model, i) for i in range(resolved.iterations)]
