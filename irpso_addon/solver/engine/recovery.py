"""The one engine of the program: a recovery, stepped by whoever drives it."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from ...core.errors import InputError
from ...geometry.domain import Domain
from ...gpu import context, probe, textures
from ...gpu.bands import Bands
from ...gpu.passes import Pass
from ...reflectance.model import ReflectanceModel
from ...results.maps import Maps
from ..phases.phase import BACKGROUND_BAND_SECONDS, BAND_SECONDS, Phase
from ..phases.prefit import AcceptanceTest, PrefitPhase
from ..phases.refinement import RefinementPhase
from ..phases.sequential_swarm import SequentialSwarmPhase
from ..phases.shared_materials import SharedMaterialsPhase
from ..phases.spatial_prior import SpatialPriorPhase
from ..phases.synchronous_swarm import SynchronousSwarmPhase
from ..planning.cost import particle_tiles, work_of
from ..settings.fixed import full_map
from ..settings.resolve import Resolved, ResolvedMaterials, ResolvedPrefit, ResolvedPrior, ResolvedRefinement, resolve
from ..settings.schedule import Schedule
from ..state import checkpoint, layout, prepare
from ..state.checkpoint import Checkpoint, named
from ..state.prepare import Prepared
from ..state.textures import SOLVED, DomainTextures, Estimates, loss_constants, packed_states, texel_states
from . import reconfigure as changes
from .confidence import deviation_pass
from .diagnostics import Diagnostics
from .progress import Progress

_SEEDS = 2**31  # a push constant holds 32 bits, one of them the sign
_SEED_STEP = 0x9E3779B1  # between the seeds of stages: odd, so that no two of 2³² stages share one
_PHASE = "phase_"  # before the names of a state's arrays that are the running phase's
_FLAT = frozenset({"prefit_fitness"})  # arrays of a state that have no channels
_WHOLE = frozenset({_PHASE + "materials"})  # and no texels: who goes on without them finds them again
_THRESHOLD_EVERY = 50  # iterations between looks whether all swarms have reached the threshold
_BANDS = 8  # that a long time budget is cut into
_SHARE = 0.5  # of a time budget that one band takes: the last one begins before the budget is spent


class Recovery:
    """One run: domain, model and schedule to maps (Nagano et al., Eq. 2–4; past them: settings/schedule.py).

    The same seed, settings and device give the same maps bit for bit, however the steps were sliced, the domain
    tiled or the run interrupted. Needs a GPU context (GpuUnavailableError); a model that does not compile raises
    ShaderError, settings that do not fit InputError.

    domain: what was observed. seed: −2³¹ to 2³¹ − 1. known: parameter name → (H, W, components) or (components,) in
    the parameter's own units, taken as given and not searched. entry: "fragment", "compute", or "auto" for what the
    probe finds faster. prepared: of ``prepare``, where it has been found already. state: where it begins, of
    ``state``.
    """

    def __init__(
        self,
        domain: Domain,
        model: ReflectanceModel,
        schedule: Schedule,
        seed: int = 0,
        fixed: Mapping[str, np.ndarray] | None = None,
        entry: Literal["auto", "fragment", "compute"] = "auto",
        prepared: Prepared | None = None,
        state: Checkpoint | None = None,
    ):
        self._check(schedule, seed)
        context.ensure()
        self.domain, self.model, self.schedule, self.seed = domain, model, schedule, seed
        self.entry = probe.faster_entry() if entry == "auto" else entry
        fixed = {name: full_map(model, name, value, domain.shape) for name, value in (fixed or {}).items()}
        stages = resolve(schedule, model, set(fixed), domain.observations)
        prepared = (prepared or prepare.prepare(domain, model, schedule)).packed(domain, schedule)
        packing, guess = prepared.packing, {**prepared.guess, **fixed}
        scale = packing.pack(prepared.scale)
        self._set_up(
            DomainTextures(domain, packing, None, scale, prepared.brightness, prepared.arrays),
            prepared.stack,
            Estimates(model, {name: packing.pack(value) for name, value in guess.items()}),
            fixed,
            stages,
        )
        if state is None:
            self._phase = self._begin(0, schedule)
        else:
            self.restore(state)

    def _set_up(
        self,
        textures: DomainTextures,
        stack: np.ndarray | None,
        estimates: Estimates,
        fixed: dict[str, np.ndarray],
        stages: tuple[Resolved, ...],
    ) -> None:
        """Take what a recovery works with. stack: of ``textures``, until it is on the GPU."""
        self._stages, self._fixed = stages, fixed
        observations = self.domain.observations
        works = [work_of(stage, self.model, self.schedule, observations) for stage in stages]
        total = sum(map(sum, works))
        self._work_done = [np.cumsum([0.0, *work]) / total for work in works]
        self._ends = np.cumsum([0.0, *(done[-1] for done in self._work_done)])
        self._textures, self._stack, self._estimates = textures, stack, estimates
        self._packing = textures.packing
        self._solved = int((texel_states(self.domain) == SOLVED).sum())
        self._diagnostics = Diagnostics(
            self._believing(self.schedule), self.schedule.fitness, textures, estimates, fixed
        )
        self._found: tuple[int, int] | None = None  # stage and iteration of which the findings are
        self._trusted: tuple[int, int] | None = None  # and of which the deviations
        self._shown: tuple[int, int] | None = None  # and of which a display's copy is
        self._finding: Iterator[None] | None = None
        self._bands = Bands()
        self._work: Iterator[None] | None = None
        self._counts = False  # whether the iteration that was made last is one of the stage's, not of its placing
        self._index = 0
        self._prefit_fitness: np.ndarray | None = None  # the prefit's fitness, packed, once there is one
        self._evaluations = 0
        self._phase: Phase | None = None

    def step(self, iterations: int | None = None, time_budget_s: float | None = None) -> Progress:
        """Advance by whole iterations, or for about so long, or to the end; return the progress.

        Placing a stage's swarms is no iteration: it comes with the step that begins the stage, and step(0) does no
        more. With a time budget it may stop inside an iteration, between bands of rows, and goes on there next time.
        """
        deadline = None if time_budget_s is None else time.perf_counter() + time_budget_s
        self._bands.paced = deadline is not None
        left = iterations
        while self._phase is not None and (left is None or left > 0 or self._phase.iteration < 0):
            if self._work is None:
                self._work, self._finding = self._iteration(_band_seconds(time_budget_s)), None
            for _ in self._work:
                if deadline is not None and time.perf_counter() >= deadline:
                    return self.progress
            self._work = None
            left = left - 1 if left is not None and self._counts else left
        return self.progress

    @property
    def progress(self) -> Progress:
        """How far the recovery is."""
        stages = self._stages
        total = sum(stage.iterations for stage in stages)
        before = sum(stage.iterations for stage in stages[: self._index])
        running = stages[min(self._index, len(stages) - 1)]
        iteration = self._phase.iteration if self._phase else running.iterations
        made = before + max(iteration, 0) if self._phase else total
        return Progress(
            min(self._index, len(stages) - 1), len(stages), running.title, iteration, running.iterations, made, total,
            *self._fractions(iteration), self._evaluations, self._phase is None,
        )  # fmt: skip

    def _fractions(self, iteration: int) -> tuple[float, float]:
        """Return how much of all work is done, bands of the iteration under way counted, and will be with the stage."""
        if self._phase is None:
            return 1.0, 1.0
        done = self._work_done[self._index]
        made = min(len(done) - 1 - self._stages[self._index].iterations + iteration, len(done) - 1)
        step = self._bands.part * (done[min(made + 1, len(done) - 1)] - done[made])
        return float(self._ends[self._index] + done[made] + step), float(self._ends[self._index + 1])

    def maps(self, confidence: bool = True) -> Maps:
        """Return what has been found so far, with the mean absolute error of its render.

        confidence: whether to tell standard deviations and alternatives too, which takes as long as ten to fifteen
        iterations.
        """
        at = self._at
        if self._work is not None or self._found != at or (confidence and self._trusted != at):
            for _ in self._look(confidence, BACKGROUND_BAND_SECONDS, False):
                pass
        return replace(self._diagnostics.maps(confidence), model=self.model)

    def refresh_confidence(self, time_budget_s: float | None = None) -> bool:
        """Find what ``maps`` tells, for about so long; return whether it is found: then maps() itself is quick.

        An iteration under way is finished first. A step in between begins it anew.
        """
        deadline = None if time_budget_s is None else time.perf_counter() + time_budget_s
        if self._finding is None:
            if self._work is None and self._found == self._trusted == self._at:
                return True
            self._finding = self._look(True, _band_seconds(time_budget_s), deadline is not None)
        for _ in self._finding:
            if deadline is not None and time.perf_counter() >= deadline:
                return False
        self._finding = None
        return True

    def mean_error(self) -> float:
        """Return the mean absolute error of the render of what has been found so far, over a few thousand texels.

        They are drawn at random, once; NaN where none is solved. It takes milliseconds, where maps() may take a second.
        """
        self._give_stack()
        return self._diagnostics.mean_error(self._show())

    @contextmanager
    def view(self) -> Iterator[dict[str, Any]]:
        """Lend the live textures, by sampler name, to a draw callback for the length of one draw.

        u_estimate_0 … hold the parameters' components in the model's order, densely packed: u_packed tells where a
        texel of the domain lies in them. No copy is read back. What a stage has found is brought up to date when its
        iteration is another; until it has found something they are what it began with, at first the seed. What the
        prefit thinks of a refinement, and the prior, show once they are done.
        """
        self._give_stack()
        yield {**self._textures.textures, **self._show()}

    @contextmanager
    def confidence_view(self) -> Iterator[dict[str, Any]]:
        """Lend u_deviation_0 …, the standard deviations that were found last, as ``view`` lends the estimates.

        A parameter's lie where its own components do; a normal has one. Empty before the first refresh_confidence() or
        maps().
        """
        yield self._diagnostics.deviations()

    def deviation_pass(self) -> tuple[Pass, dict[str, int | float]]:
        """Return the pass that tells the deviations of what ``view`` lends, and its constants."""
        fixed, fitness, defines = self._fixed, self.schedule.fitness, self._textures.defines
        made = deviation_pass(self._believing(self.schedule), fixed, fitness, defines)
        return made, loss_constants(self._textures, fitness.delta)

    def halo(self) -> np.ndarray:
        """Return (H, W, n): what this tile's texels have found, which neighbouring tiles need; NaN elsewhere."""
        self._finish_iteration()
        return self._running().halo()

    def set_halo(self, values: np.ndarray, ghosts: np.ndarray | float = 0.0) -> None:
        """Take (H, W, n) of what neighbouring tiles have found at their texels; others are left alone.

        ghosts: (M, n) of the texels that the domain's seams name in their ghosts.
        """
        self._finish_iteration()
        self._running().take_halo(values, ghosts)

    def sample(self) -> np.ndarray | None:
        """Return this tile's part of the sample that the next iteration needs of the whole domain; None for none."""
        self._finish_iteration()
        return self._phase.sample() if self.reach else None

    def take_sample(self, sample: np.ndarray) -> None:
        """Take the sample of the whole domain, of ``solver.mixture.merged``."""
        self._finish_iteration()
        self._running().take_sample(sample)

    @property
    def reach(self) -> int:
        """How many texels away the next iteration reads what others have found; 0 where no halo is needed before it."""
        return self._phase.reach if self._phase else 0

    def save(self, path: str | Path, notes: Mapping[str, np.ndarray] = MappingProxyType({})) -> None:
        """Write a checkpoint, from which ``load`` goes on to the same maps bit for bit. Written whole or not at all.

        notes: arrays of the caller's own, which ``load`` gives back. That of a whole domain does not tell how it was
        solved: as one, or by any number of ranks.
        """
        state = self.state() if self._is_tile else self.rows()
        checkpoint.write(Path(path), self._identity, replace(state, notes=notes))

    def load(self, path: str | Path) -> dict[str, np.ndarray]:
        """Go on from a checkpoint of the same domain, model, schedule and seed, and return its notes.

        Raises InputError for another's.
        """
        saved = checkpoint.read(Path(path), self._identity)
        (self.restore if self._is_tile else self.take_rows)(saved)
        return dict(saved.notes)

    def state(self) -> Checkpoint:
        """Return what a recovery of the same domain and settings needs to go on to the same maps bit for bit."""
        self._finish_iteration()
        arrays = {f"estimate_{i}": textures.download(t) for i, t in enumerate(self._estimates.current)}
        if self._phase is not None:
            arrays |= {_PHASE + name: array for name, array in self._phase.state().items()}
        if self._prefit_fitness is not None:
            arrays["prefit_fitness"] = self._prefit_fitness
        iteration = self._phase.iteration if self._phase else 0
        return Checkpoint(self._index, iteration, self._evaluations, arrays)

    def restore(self, saved: Checkpoint) -> None:
        """Go on from what ``state`` returned."""
        self._estimates.current = [textures.upload(saved.arrays[f"estimate_{i}"]) for i in range(self._estimates.count)]
        self._work = self._finding = self._found = self._trusted = self._shown = None
        self._bands.part = 0.0
        self._index, self._evaluations = saved.stage, saved.evaluations
        self._prefit_fitness = saved.arrays.get("prefit_fitness")
        if self._phase is not None:
            self._phase.close()
        self._phase = self._begin(self._index, self.schedule) if self._index < len(self._stages) else None
        if self._phase is not None:
            self._phase.restore(named(saved.arrays, _PHASE), saved.iteration)

    def rows(self) -> Checkpoint:
        """Return ``state`` texel by texel of those that are solved here, row by row, whatever the tile."""
        state, packing = self.state(), self._packing
        own = packed_states(self.domain, packing).ravel()[: packing.count] == SOLVED
        size = packing.width, packing.height
        texels = {name: array for name, array in state.arrays.items() if name not in _WHOLE}
        rows = layout.rows_of(texels, size, self._particle_tiles(state.stage), packing.count)
        return replace(state, arrays={name: value[own] for name, value in rows.items()})

    def take_rows(self, saved: Checkpoint) -> None:
        """Go on from what ``rows`` gave of all texels that this tile holds: own and halo, then the ghosts."""
        size, limit = (self._packing.width, self._packing.height), context.max_texture_size()
        tiles = self._particle_tiles(saved.stage)
        self.restore(replace(saved, arrays=layout.arrays_of(saved.arrays, size, tiles, limit, _FLAT)))

    @property
    def _is_tile(self) -> bool:
        seams = self.domain.seams
        return any(self.domain.halo) or (seams is not None and len(seams.ghosts) > 0)

    def _particle_tiles(self, stage: int) -> int:
        return particle_tiles(self._stages[stage], self.schedule) if stage < len(self._stages) else 1

    def changed(self, schedule: Schedule, seed: int | None = None, prepared: Prepared | None = None) -> Recovery:
        """Return a recovery that goes on from here under another schedule. This one can only be closed then.

        What the domain has on the GPU serves both. Stages that are finished, and that the other schedule has too, are
        not made again, whatever their settings are now. The stage under way goes on in mid-search where its swarms have
        as many particles and the fitness is the same: other constants then count from the next iteration on. Else it
        begins anew, as does every stage from the first on that is another: swarms around what has been found, the
        refinement and the prior from there. So the error can rise for a while where the fitness is another, and a prior
        that was under way is made from the start. A checkpoint goes on bit for bit
        once its swarms are placed. prepared: of ``prepare`` with the other schedule, where its
        percentile or shadow differ; found here otherwise, which may take a second. Raises InputError, with this one
        left as it was but for an iteration that was under way.
        """
        return changes.changed(self, schedule, seed, prepared)

    def close(self) -> None:
        """Free all that lies on the GPU."""
        self._work = self._finding = self._stack = None  # generators first: they hold what they work with
        if self._phase is not None:
            self._phase.close()
        if self._diagnostics is not None:
            self._diagnostics.close()
        self._phase = self._textures = self._estimates = self._diagnostics = None

    def __enter__(self) -> Recovery:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @staticmethod
    def _check(schedule: Schedule, seed: int) -> None:
        if not isinstance(seed, int) or not -_SEEDS <= seed < _SEEDS:
            raise InputError(f"seed: must be a whole number from {-_SEEDS} to {_SEEDS - 1}, not {seed!r}")
        if schedule.levels > 1:
            raise InputError(f"levels = {schedule.levels}: a Recovery solves one size; use a Pyramid, or 1")

    def _begin(self, index: int, schedule: Schedule) -> Phase:
        # Every stage draws numbers of its own: replaying the first one's would start each cycle at the same places.
        seed = (self.seed + _SEED_STEP * index + _SEEDS) % (2 * _SEEDS) - _SEEDS
        stage, model = self._stages[index], self._believing(schedule)
        domain, estimates = self._textures, self._estimates
        if isinstance(stage, ResolvedRefinement):
            acceptance = self._acceptance() if any(p.is_normal for p in stage.parameters) else None
            kind = SharedMaterialsPhase if isinstance(stage, ResolvedMaterials) else RefinementPhase
            return kind(stage, model, schedule, domain, estimates, self.entry, acceptance)
        if isinstance(stage, ResolvedPrior):
            return SpatialPriorPhase(stage, model, schedule, domain, estimates, self.entry, self._acceptance())
        if isinstance(stage, ResolvedPrefit):
            return PrefitPhase(stage, model, schedule, seed, domain, estimates, self.entry)
        kind = SynchronousSwarmPhase if schedule.swarm.update == "all" else SequentialSwarmPhase
        return kind(stage, model, schedule, seed, domain, estimates, self.entry)

    def _believing(self, schedule: Schedule) -> ReflectanceModel:
        """Return the model with the priors that count: none where the schedule says so, nor of what is known."""
        everything = {p.name for p in self.model.parameters}
        return self.model.without_priors(self._fixed if schedule.fitness.priors else everything)

    def _acceptance(self) -> AcceptanceTest | None:
        if self._prefit_fitness is None:
            return None
        return AcceptanceTest(self.model, self.schedule, self._textures, self._estimates, self._prefit_fitness)

    @property
    def _at(self) -> tuple[int, int]:
        return self._index, self._phase.iteration if self._phase is not None else 0

    def _give_stack(self) -> None:
        if self._stack is not None:
            stack, self._stack = self._stack, None
            self._textures.give_stack(stack)

    def _iteration(self, seconds: float) -> Iterator[None]:
        """Make the next iteration, and where it is the last one of its stage begin the next stage; yields often."""
        if self._stack is not None:
            self._give_stack()
            yield
        phase = self._phase
        cost = self._solved * phase.evaluations
        yield from phase.advance(self._bands, seconds)
        self._bands.part = 0.0
        self._evaluations += cost
        self._counts = phase.iteration > 0
        if phase.done or self._reached_threshold():
            yield from self._end_stage(seconds)

    def _end_stage(self, seconds: float) -> Iterator[None]:
        phase = self._phase
        yield from phase.conclude(self._bands, seconds)
        self._estimates.accept()
        if isinstance(phase, PrefitPhase):
            self._prefit_fitness = yield from phase.measuring(self._bands, seconds)
        yield  # nowhere below: view() must not come upon a phase that is closed
        phase.close()
        self._bands = Bands(self._bands.paced)  # another stage's passes cost something else
        self._index += 1
        self._phase = self._begin(self._index, self.schedule) if self._index < len(self._stages) else None

    def _finish_iteration(self) -> None:
        if self._work is not None:
            for _ in self._work:
                pass
            self._work = None

    def _look(self, confidence: bool, seconds: float, paced: bool) -> Iterator[None]:
        """Find what maps() tells, an iteration under way first."""
        self._give_stack()
        if self._work is not None:
            self._bands.paced = paced
            for _ in self._work:
                yield
            self._work = None
        at = self._at
        self._found = self._trusted = None
        yield from self._diagnostics.finding(self._phase, confidence, seconds, paced)
        self._found, self._trusted = at, at if confidence else None

    def _show(self) -> dict[str, Any]:
        """Return the estimates to look at, by sampler name, brought up to date."""
        phase = self._phase
        if phase is None or not phase.placed:
            return self._estimates.bindings()
        if self._shown != self._at:
            phase.preview(self._estimates.shown)
            self._shown = self._at
        return {f"u_estimate_{i}": texture for i, texture in enumerate(self._estimates.shown)}

    def _reached_threshold(self) -> bool:
        threshold, phase = self.schedule.threshold, self._phase
        if threshold == 0 or phase.iteration <= 0 or phase.iteration % _THRESHOLD_EVERY:
            return False
        return phase.reached(threshold)

    def _running(self) -> Phase:
        if self._phase is None:
            raise InputError("the recovery is done: its swarms are gone, read maps() instead")
        return self._phase

    @cached_property
    def _identity(self) -> dict[str, Any]:
        """Who this is to a checkpoint; found once: it reads all samples."""
        return checkpoint.identity(self.domain, self.model, self.schedule, self.seed, self.entry, self._fixed)


def _band_seconds(time_budget_s: float | None) -> float:
    if time_budget_s is None:
        return BACKGROUND_BAND_SECONDS
    return min(max(BAND_SECONDS, time_budget_s / _BANDS), _SHARE * time_budget_s)
