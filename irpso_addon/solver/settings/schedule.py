"""Schedules: which parameters are searched together, in which order, and with what constants. Read from presets/."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from ...core.errors import InputError
from ...core.files import load_shipped_table, shipped_names
from ...core.paths import PRESETS
from .limits import Limits, check_values, field_limits

Walls = Literal["clamp", "stop", "reflect"]
Loss = Literal["l1", "l2", "robust"]
Seed = Literal["random", "lambert", "given"]
NormalSearch = Literal["hemisphere", "cartesian"]
Update = Literal["one", "all"]
LinearKind = Literal["search", "solve"]
MAX_DIMENSIONS = 8  # two RGBA texels a particle
ALL = "all"
REST = "rest"  # what no stage of the schedule names
_TOP_KEYS = ("name", "title", "cycles", "threshold", "levels", "level_iterations")
_ITERATIONS = "iterations"  # of every stage
_GROUPS = ("swarm", "fitness")  # their settings go by their bare names, those of the others by the group's before it


@dataclass(frozen=True)
class Swarm:
    """Constants of the update (Eq. 2–4); places are in [0, 1], so speeds are fractions of a parameter's range.

    update: whether an iteration moves one random particle of every swarm, as in the paper, or all of them. linear:
    whether linear parameters are searched like the others, or solved in closed form for every particle (update "all").
    particles: m to a texel, or particles_per_dimension · n where that is more. inertia (Shi & Eberhart 1998) and
    constriction (Clerc & Kennedy 2002) are 1 in the paper. c1, c2, c3: Eq. 2; c3 falls to 0 over the fraction
    c3_until of the iterations, and stays where c3_until is 0. neighbourhood: the odd H of Eq. 4.
    neighbour_every: iterations between those in which the particle tries the best of one of the eight texels around (0:
    never, as in the paper). v_max: largest speed.
    walls: what a particle does that would leave the range. start_speed: largest speed of a new particle. seed: where
    the first particles stand (given: at a first guess, handed to the recovery, that tells all dimensions); seeded: the
    fraction of the swarm that stands within seed_spread of the seed.
    linear_reach: how many times its texel's scale (see Fitness) a linear parameter may be, 0 for its whole range.
    normal: two numbers on the hemisphere, or the paper's three that are normalised.
    """

    update: Update
    linear: LinearKind
    particles: int
    particles_per_dimension: float
    inertia: float
    constriction: float
    c1: float
    c2: float
    c3: float
    c3_until: float
    neighbourhood: int
    neighbour_every: int
    v_max: float
    walls: Walls
    start_speed: float
    seed: Seed
    seeded: float
    seed_spread: float
    linear_reach: float
    normal: NormalSearch


@dataclass(frozen=True)
class Fitness:
    """What a swarm minimises: the mean over observations of |e| (l1), e² (l2) or log(1 + (e/δ)²) (robust).

    delta: δ as a fraction of the texel's own scale, which is the ``percentile`` of its radiance per light intensity;
    shadow: under this fraction of it a sample is taken for cast shadow and weighs nothing (robust only). priors:
    whether what the model believes of its parameters counts too (reflectance.model.ParameterPrior). bounds: whether
    clipped samples count where the render is darker; else they weigh nothing. highlight_power: δ of a sample grows
    with this power of its radiance over the texel's scale, where it is brighter (robust only).
    """

    loss: Loss
    delta: float
    percentile: float
    shadow: float
    priors: bool
    bounds: bool
    highlight_power: float


@dataclass(frozen=True)
class Refinement:
    """Levenberg–Marquardt after the stages, of all that they search together (Marquardt 1963), on the same fitness.

    iterations: steps from the best that was found, 0 for no refinement at all. starts: whether to begin from the model's
    starts too; start_iterations: steps from each of them, and from the stages' estimate beside them. rounds: how often
    every texel then tries what its neighbours have found; round_iterations: steps after each. accept_ratio: a neighbour's
    material is refined where its fitness is under so many times the texel's own. votes: what the searched numbers of
    the texels around count (shaders/refine/votes.glsl): a material that many have is refined too, and kept where noise
    explains what it fits worse; 0 where the samples alone decide. damping: the first λ, of the diagonal of JᵀJ. A
    texel is done once two steps gain less than the fraction ftol of its fitness, or move nothing by more than the
    fraction xtol of its range. central: differences to both sides instead of one. widening: from the model's
    starts δ is so many times as wide at first, and falls to its own (graduated non-convexity; Blake & Zisserman 1987,
    Visual Reconstruction): a lobe that is far off must not pass for an outlier.
    """

    iterations: int = 0
    starts: bool = True
    start_iterations: int = 5
    rounds: int = 1
    round_iterations: int = 8
    accept_ratio: float = 1.0
    votes: float = 0.0
    damping: float = 0.01
    ftol: float = 1e-5
    xtol: float = 1e-5
    central: bool = False
    widening: float = 1.0


@dataclass(frozen=True)
class Prefit:
    """Normals first, on grey samples, by a model of few assumptions (shaders/prefit/falloff_lobe.toml).

    iterations: of its swarms, which move as a whole; 0 for no prefit. refinement_iterations: Levenberg–Marquardt steps
    after them. shadow: samples under this fraction of a texel's scale weigh nothing. observations: with fewer it is
    left out. acceptance_ratio: where the model that is asked for fits worse than the prefit's by more than this factor, its refinement
    must not turn the prefit's normal.
    """

    iterations: int = 0
    refinement_iterations: int = 5
    shadow: float = 0.3
    observations: int = 10
    acceptance_delta: float = 0.0125
    acceptance_ratio: float = 1.2


@dataclass(frozen=True)
class Materials:
    """Materials that texels share, wherever on the surface they lie: a mixture of Gaussians over a sample of them.

    rounds: how often every texel tries them, 0 for none of this: with its own normal at first, from then on with that
    which mirrors its brightest sample; iterations: Levenberg–Marquardt steps after each, the refinement's widening at
    first. count: of materials, at most. weight: a material that the whole surface is of counts like so many votes of
    neighbours (see Refinement).
    """

    rounds: int = 0
    iterations: int = 6
    count: int = 16
    weight: float = 1000.0


@dataclass(frozen=True)
class Prior:
    """What neighbours say of the numbers that a texel's own samples do not tell, after the refinement.

    rounds: how often colours and scalars are pooled over neighbours, 0 for no prior; scales: a round reaches 2^scales
    texels. iterations: Levenberg–Marquardt steps with the prior then, with the refinement's damping. likeness: neighbours
    are alike that differ by this fraction of a scalar's range, or by the fraction likeness_color of a colour. spread:
    numbers of like texels are taken to differ by this fraction of the range or more. noise_freedom: for how many
    samples of a texel's own the neighbours' noise counts with it. share: a texel is left alone of which the prior would
    have less. tolerance: by how many σ of the noise the fit may become worse. turn: whether normals are moved too.
    """

    rounds: int = 0
    scales: int = 4
    iterations: int = 6
    likeness: float = 0.1
    likeness_color: float = 0.1
    spread: float = 0.02
    noise_freedom: float = 10.0
    share: float = 0.02
    tolerance: float = 3.0
    turn: bool = True


@dataclass(frozen=True)
class Stage:
    """Parameters searched together, by name or by the stage that the model's table gives them; "all" for every one.

    iterations: 0 leaves them to the refinement.
    """

    search: tuple[str, ...]
    iterations: int


@dataclass(frozen=True)
class Schedule:
    """A preset: the stages in order, gone through ``cycles`` times, and the constants they share.

    threshold: the fitness h at which a swarm stops (0: never before the last iteration). prefit: what goes before the
    stages, which then hold to its normals. refinement: what follows them; prior: what follows that. levels: how many sizes
    are solved, each half the next, the first guess of which it is (engine/coarse_to_fine.py; 1: the domain alone).
    level_iterations: the fraction of the prefit's and the stages' iterations that all but the coarsest make.
    """

    name: str
    title: str
    swarm: Swarm
    fitness: Fitness
    stages: tuple[Stage, ...]
    cycles: int = 1
    threshold: float = 0.0
    levels: int = 1
    level_iterations: float = 0.4
    prefit: Prefit = Prefit()
    refinement: Refinement = Refinement()
    materials: Materials = Materials()
    prior: Prior = Prior()

    def settings(self) -> dict[str, Any]:
        """Return every setting that ``replaced`` takes, by its name there, but for ``search``; see SETTINGS.

        iterations: the most of any stage.
        """
        parts = {part: getattr(self, part) for part in (*_GROUPS, *_OPTIONAL)}
        named = {_prefix(part) + f.name: getattr(group, f.name) for part, group in parts.items()
                 for f in dataclasses.fields(group)}  # fmt: skip
        own = {name: getattr(self, name) for name in SETTINGS if name in _TOP_KEYS}
        return {**named, **own, _ITERATIONS: max((stage.iterations for stage in self.stages), default=0)}

    def replaced(self, **changes: Any) -> Schedule:
        """Return a copy with other settings; names of Swarm, Fitness or Schedule fields, checked. Raises InputError.

        ``iterations`` sets every stage's; ``search`` makes one stage of the names given. Prefit, refinement and prior
        are another's, whole (``refinement=``), or their settings by name with ``refinement_`` (…) before it.
        """
        result = self
        if (search := changes.pop("search", None)) is not None:
            most = max(stage.iterations for stage in self.stages)
            names = tuple(search) if isinstance(search, Iterable) and not isinstance(search, str) else search
            result = dataclasses.replace(result, stages=(Stage(names, most),))
        if (iterations := changes.pop("iterations", None)) is not None:
            stages = tuple(dataclasses.replace(stage, iterations=iterations) for stage in result.stages)
            result = dataclasses.replace(result, stages=stages)
        for part in _GROUPS:
            group = getattr(result, part)
            names = {f.name for f in dataclasses.fields(group)} & set(changes)
            values = {name: changes.pop(name) for name in names}
            result = dataclasses.replace(result, **{part: dataclasses.replace(group, **values)})
        for part in _OPTIONAL:
            group = getattr(result, part)
            names = {_prefix(part) + f.name: f.name for f in dataclasses.fields(group)}
            values = {names[name]: changes.pop(name) for name in names.keys() & set(changes)}
            result = dataclasses.replace(result, **{part: dataclasses.replace(group, **values)})
        for part, kind in _OPTIONAL.items():
            if part in changes and not isinstance(changes[part], kind):
                first = dataclasses.fields(kind)[0].name
                raise InputError(f"preset {self.name}: {part} has settings of its own, as in {part}_{first}=0")
        if unknown := set(changes) - {*_TOP_KEYS, *_OPTIONAL}:
            raise InputError(f"preset {self.name}: there is no setting '{sorted(unknown)[0]}'")
        result = dataclasses.replace(result, **changes)
        _check(result)
        return result


def refuse_levels(schedule: Schedule) -> None:
    """Raise InputError where a schedule of several levels would have to be solved in tiles."""
    if schedule.levels > 1:
        raise InputError(
            f"levels = {schedule.levels}: the domain does not fit in memory at once, and tiles are not solved coarse to"
            " fine; set levels = 1, or allow more with --memory"
        )


_OPTIONAL = {
    "prefit": Prefit,
    "refinement": Refinement,
    "materials": Materials,
    "prior": Prior,
}  # may be absent: there is none then


def _prefix(part: str) -> str:
    return "" if part in _GROUPS else f"{part}_"


_PARTS = ("name", "title", "stages", *_GROUPS, *_OPTIONAL)
SETTINGS: Mapping[str, Limits] = MappingProxyType({
    **field_limits(Swarm), **field_limits(Fitness), **field_limits(Stage, without=("search",)),
    **field_limits(Schedule, without=_PARTS),
    **{name: limits for part, kind in _OPTIONAL.items() for name, limits in field_limits(kind, _prefix(part)).items()},
})  # fmt: skip


def shipped_presets() -> list[str]:
    """Return the names of the presets that come with the program."""
    return shipped_names(PRESETS)


def load_schedule(name_or_path: str | Path) -> Schedule:
    """Read a shipped preset by name, or a .toml file of one's own by path.

    What each constant means and may be: Swarm, Fitness, Prefit, Refinement, Prior and SETTINGS, here; where the shipped
    values are from: the files in presets/. Raises InputError naming the file, the setting and what it may be.
    """
    table, path = load_shipped_table("preset", name_or_path, PRESETS)
    _refuse_unknown(table, [*_TOP_KEYS, "swarm", "fitness", "stage", *_OPTIONAL], str(path))
    rows = table.get("stage", [])
    if not isinstance(rows, list):
        raise InputError(f"{path}: stages are written [[stage]], with two brackets")
    schedule = Schedule(
        **{"name": path.stem, "title": path.stem, **{key: table[key] for key in _TOP_KEYS if key in table}},
        swarm=_build(Swarm, table.get("swarm"), f"{path}: [swarm]"),
        fitness=_build(Fitness, table.get("fitness"), f"{path}: [fitness]"),
        stages=tuple(_build(Stage, row, f"{path}: [[stage]]") for row in rows),
        **{part: _build(kind, table[part], f"{path}: [{part}]") for part, kind in _OPTIONAL.items() if part in table},
    )
    _check(schedule, str(path))
    return schedule


def _build(kind: type, table: Any, where: str) -> Any:
    if not isinstance(table, dict):
        raise InputError(f"{where} is not there, or no table; a preset sets every constant")
    fields = {f.name: f for f in dataclasses.fields(kind)}
    _refuse_unknown(table, fields, where)
    if missing := [name for name in fields if name not in table]:
        raise InputError(f"{where}: '{missing[0]}' is not set; a preset sets every constant")
    return kind(**{name: tuple(value) if isinstance(value, list) else value for name, value in table.items()})


def _refuse_unknown(table: dict[str, Any], allowed: Iterable[str], where: str) -> None:
    if unknown := sorted(set(table) - set(allowed)):
        raise InputError(f"{where}: unknown key '{unknown[0]}'; known are {', '.join(allowed)}")


def _check(schedule: Schedule, where: str = "") -> None:
    where = where or f"preset {schedule.name}"
    if not schedule.stages:
        raise InputError(f"{where}: it has no [[stage]]; add one with search and iterations")
    for stage in schedule.stages:
        SETTINGS[_ITERATIONS].check(_ITERATIONS, stage.iterations, where)
        names = stage.search
        if not isinstance(names, tuple) or not names or not all(isinstance(name, str) for name in names):
            raise InputError(f'{where}: search must be a list of names, as in search = ["normal"], not {names!r}')
    check_values(SETTINGS, schedule.settings(), where)
    if (schedule.swarm.update, schedule.swarm.linear) == ("one", "solve"):
        raise InputError(f'{where}: linear = "solve" needs update = "all"')
    if schedule.refinement.iterations == 0 and not any(stage.iterations for stage in schedule.stages):
        raise InputError(
            f"{where}: no stage has iterations, and there is no [refinement] either; give one of them some"
        )
