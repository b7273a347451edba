"""A recovery of a domain solved whole."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from ...core.errors import InputError
from ...core.steps import map_steps, run_steps
from ...geometry.domain import Domain
from ...gpu import context, textures
from ...gpu.bands import Bands
from ...gpu.kernel import EntryChoice
from ...gpu.passes import Pass
from ...gpu.textures import Texture
from ...reflectance.model import ReflectanceModel
from ...results.maps import Maps
from ..phases.acceptance import AcceptanceTest
from ..phases.create_phase import check_seed, create_phase, made_by
from ..phases.phase import BACKGROUND_BAND_SECONDS, Phase, PhaseContext, band_seconds
from ..phases.swarm import SwarmPhase
from ..planning.cost import phase_table, work_of
from ..settings.levels import warm_started
from ..settings.resolve import resolve
from ..settings.schedule import Schedule, refuse_interreflection
from ..state.checkpoint import NEVER, PHASE, Checkpoint, named
from ..state.layout import TexelLayout
from ..state.prefit_measurements import PrefitMeasurements
from ..state.prepare import Prepared, prepare_steps
from ..state.separation import separated_steps
from ..state.separation_record import Separation
from ..state.textures import SOLVED, Estimates, loss_constants, texel_states
from .confidence import deviation_pass
from .diagnostics import Diagnostics
from .engine import Capabilities, RecoveryEngine
from .progress import Course, Progress
from .reconfigure import Begin, first_begin, reusable, samples_of
from .watch import TexelRecord

_THRESHOLD_EVERY = 50  # iterations between comparisons of all swarms with the threshold


class Recovery(RecoveryEngine):
    """The ``RecoveryEngine`` of a domain solved whole (Nagano et al., Eq. 2–4; past them: settings/schedule.py).

    Needs a GPU context (GpuUnavailableError); a model that does not compile raises ShaderError, settings that do not
    fit InputError.

    seed: −2³¹ to 2³¹ − 1. prepared: from ``prepare``, made here where None. guess: parameter name → (H, W, components),
    where it begins instead of the preparation's guess. snapshot: from ``snapshot``, where it begins. The others are as
    for RecoveryEngine.
    """

    def __init__(
        self,
        domain: Domain,
        model: ReflectanceModel,
        schedule: Schedule,
        seed: int = 0,
        fixed: Mapping[str, np.ndarray] | None = None,
        entry: EntryChoice = "auto",
        prepared: Prepared | None = None,
        snapshot: Checkpoint | None = None,
        begin: Begin | None = None,
        guess: Mapping[str, np.ndarray] | None = None,
    ):
        _check(schedule, seed)
        context.ensure()
        super().__init__(domain, model, schedule, seed, fixed, entry)
        self._stages = resolve(schedule, model, set(self.fixed), domain.observations)
        works = [work_of(stage, model, schedule, domain.observations) for stage in self._stages]
        self._course = Course(self._stages, works)
        fresh = begin is None
        begin = begin or first_begin(domain, model, schedule, self.fixed, prepared, guess)
        self._textures, self._stack, self._estimates = begin.textures, begin.stack, begin.estimates
        self._packing = self._textures.packing
        self._separation = self._unpacked_separation()  # it outlives the textures
        self._solved = int((texel_states(domain) == SOLVED).sum())
        self._diagnostics = self._make_diagnostics()
        self._measured_at: tuple[int, int] | None = None  # stage and iteration of the last diagnostics
        self._confidence_at: tuple[int, int] | None = None  # … of the last deviations
        self._shown_at: tuple[int, int] | None = None  # … of a display's copy
        self._measuring: Iterator[None] | None = None
        self._bands = Bands()
        self._pending: Iterator[None] | None = None
        self._counts = False  # whether the last iteration was one of the stage's, not of its initialisation
        self._index, self._evaluations = begin.index, begin.evaluations
        self._begun = begin.evaluations  # at the begin of the stage
        self._repeats = True  # whether the stage, made again from the estimates, reaches the same result
        run_steps(self._take_measurements(begin.measurements))
        self._phase: Phase | None = None
        if snapshot is not None:
            self.restore_snapshot(snapshot)
        elif fresh:
            self._phase = self._begin(0, schedule)

    def preparation(self, domain: Domain, schedule: Schedule) -> Generator[None, None, Prepared | None]:
        return map_steps(prepare_steps(domain, self.model, schedule), lambda part: None)

    @property
    def capabilities(self) -> Capabilities:
        return Capabilities("whole", reconfigure=True)

    @property
    def phase(self) -> Phase | None:
        return self._phase

    @property
    def separation(self) -> Separation | None:
        return self._separation

    def step(self, iterations: int | None = None, time_budget_s: float | None = None) -> Progress:
        next(self.iteration_steps(iterations, time_budget_s), None)
        return self.progress

    def iteration_steps(self, iterations: int | None, time_budget_s: float | None) -> Iterator[None]:
        """Make exactly so many iterations, None for all, and place the swarms after them; yields when the time is over.

        Repeated calls of ``step`` are no substitute: one that stops while the next stage's swarms are initialised makes
        another iteration when it is called again.
        """
        self._bands.paced = time_budget_s is not None
        left, started = iterations, time.perf_counter()
        while self._phase is not None and (left is None or left > 0 or self._phase.iteration < 0):
            if self._pending is None:
                self._pending, self._measuring = self._iteration(self._phase, band_seconds(time_budget_s)), None
            for _ in self._pending:
                if time_budget_s is not None and time.perf_counter() >= started + time_budget_s:
                    yield
                    started = time.perf_counter()
            self._pending = None
            left = left - 1 if left is not None and self._counts else left

    @property
    def progress(self) -> Progress:
        iteration = None if self._phase is None else self._phase.iteration
        return self._course.at(self._index, iteration, self._bands.part, self._evaluations)

    def maps(self, confidence: bool = True) -> Maps:
        self._ensure_measured(confidence)
        return replace(self._diagnostics.maps(confidence), model=self.model)

    def record(self, rows: np.ndarray, columns: np.ndarray) -> TexelRecord:
        self._ensure_measured(confidence=False)
        return TexelRecord(self.progress.iteration_in_all, *self._diagnostics.at(rows, columns))

    def _ensure_measured(self, confidence: bool) -> None:
        """Measure what maps() returns, unless it has been measured."""
        at = self.at
        if self._pending is not None or self._measured_at != at or (confidence and self._confidence_at != at):
            for _ in self._measure(confidence, BACKGROUND_BAND_SECONDS, False):
                pass

    def refresh_confidence(self, time_budget_s: float | None = None) -> bool:
        """Work as RecoveryEngine.refresh_confidence, after the current iteration; a step in between starts it anew."""
        deadline = None if time_budget_s is None else time.perf_counter() + time_budget_s
        if self._measuring is None:
            if self._pending is None and self._measured_at == self._confidence_at == self.at:
                return True
            self._measuring = self._measure(True, band_seconds(time_budget_s), deadline is not None)
        for _ in self._measuring:
            if deadline is not None and time.perf_counter() >= deadline:
                return False
        self._measuring = None
        return True

    def mean_error(self) -> float:
        self.give_stack()
        return self._diagnostics.mean_error(self._show())

    @contextmanager
    def view(self) -> Iterator[dict[str, Texture]]:
        """Lend the live textures, as RecoveryEngine.view: of the current stage, before acceptance test and prior."""
        self.give_stack()
        yield {**self._textures.textures, **self._show()}

    def deviation_pass(self) -> tuple[Pass, dict[str, int | float]]:
        unsearched, fitness, defines = self.unsearched, self.schedule.fitness, self._textures.defines
        pass_ = deviation_pass(self._model_with_priors(self.schedule), unsearched, fitness, defines)
        return pass_, loss_constants(self._textures, fitness.delta)

    def give_stack(self) -> None:
        """Upload the packed samples, if they are still on the host: by default the first iteration does."""
        if self._stack is not None:
            stack, self._stack = self._stack, None
            self._textures.give_stack(stack)

    def state(self, running: bool = True) -> Checkpoint:
        saved = self.snapshot() if running or not self._repeats else self.snapshot(running=False).of_stage
        rows = TexelLayout(self.domain, self._packing).rows(saved.arrays, self.particle_tiles)
        return replace(saved, arrays=rows)

    def restore(self, saved: Checkpoint) -> None:
        """Continue from the state of all texels here: own and halo, row by row, then the ghosts."""
        layout = TexelLayout(self.domain, self._packing)
        self.restore_snapshot(replace(saved, arrays=layout.arrays(saved.arrays, context.max_texture_size())))

    @property
    def particle_tiles(self) -> int:
        """The number of W×H tiles in the atlas of the stage's particles; 1 where it has none."""
        return 1 if self._phase is None else phase_table(self._stages[self._index], self.model, self.schedule).tiles

    def snapshot(self, running: bool = True) -> Checkpoint:
        """Return the contents of all textures that outlive an iteration. running: as in ``state``."""
        self._finish_iteration()
        while not self._repeats and self._phase is not None and self._phase.iteration < 0:  # it may have begun warm
            self._pending = self._iteration(self._phase, band_seconds(None))
            self._finish_iteration()
        arrays = {f"estimate_{i}": textures.download(t) for i, t in enumerate(self._estimates.current)}
        if self._phase is not None and running:
            arrays |= {PHASE + name: array for name, array in self._phase.state().items()}
        begun = self._begun if self._repeats else NEVER
        return Checkpoint(*self.at, self._evaluations, arrays | self._measurements.arrays, begun=begun)

    def restore_snapshot(self, saved: Checkpoint) -> None:
        """Continue from what ``snapshot`` returned."""
        self._estimates.current = [textures.upload(saved.arrays[f"estimate_{i}"]) for i in range(self._estimates.count)]
        self._pending = self._measuring = self._measured_at = self._confidence_at = self._shown_at = None
        self._bands.part = 0.0
        self._index, self._evaluations = saved.stage, saved.evaluations
        self._begun, self._repeats = saved.begun, saved.begun != NEVER
        run_steps(self._take_measurements(PrefitMeasurements.of_arrays(saved.arrays)))
        if self._phase is not None:
            self._phase.close()
        self._phase = self._begin(self._index, self.schedule) if self._index < len(self._stages) else None
        running = named(saved.arrays, PHASE)
        if self._phase is not None and running:
            self._phase.restore(running, saved.iteration)

    def reconfigure(self, schedule: Schedule, seed: int | None = None, prepared: Prepared | None = None) -> Recovery:
        """Return a recovery that continues from here under another schedule; this one can then only be closed.

        Both share the domain's textures. Finished stages that the other schedule has too are not repeated, whatever
        their settings. The current stage continues where its swarms have as many particles and the fitness is the same;
        else it restarts around the current estimates, as does every stage from the first different one on. With another
        fitness the error can rise for a while. prepared: from ``prepare`` with the other schedule, where its percentile
        or shadow differ; made here where None, which may take a second. Raises InputError; then this one has at most
        finished its iteration.
        """
        seed = self.seed if seed is None else seed
        _check(schedule, seed)
        stages = resolve(schedule, self.model, set(self.fixed), self.domain.observations)
        self._finish_iteration()
        goes_on = reusable(self.schedule, schedule, self._stages, stages, self._index, self._phase, self.model)
        if seed != self.seed:
            goes_on = replace(goes_on, phase=False)
        domain_textures, stack = self._textures, self._stack
        if not goes_on.samples:
            domain_textures, stack, _ = samples_of(self.domain, self.model, schedule, prepared)
        estimates = self._estimates if goes_on.phase or goes_on.swarms else self._copied()
        known = made_by(self._stages[: goes_on.index], self._measurements)
        begin = Begin(domain_textures, stack, estimates, goes_on.index, self._evaluations, known)
        new = Recovery(self.domain, self.model, schedule, seed, self.fixed, self.entry, begin=begin)
        new._repeats = False  # it goes on with other swarms, or begins around what has been found
        if goes_on.phase:
            self._phase, new._phase = None, self._phase
        elif goes_on.index < len(stages):
            found = goes_on.index < self._index or self._phase is None or self._phase.has_result
            new._phase = new._begin(goes_on.index, warm_started(schedule) if found else schedule)
            if goes_on.swarms is not None and isinstance(new._phase, SwarmPhase):
                new._phase.inherit(goes_on.swarms)
        return new

    def _copied(self) -> Estimates:
        """Return a copy of the current estimates: this recovery stays as it is."""
        has_result = self._phase is not None and self._phase.has_result
        if has_result:
            self.give_stack()
            self._running().write_estimates_at_once()
        return Estimates(self.model, self._estimates.values(of_next=has_result))

    def close(self) -> None:
        self._pending = self._measuring = self._stack = None  # generators first: they hold textures
        if self._phase is not None:
            self._phase.close()
            self._phase = None
        if hasattr(self, "_diagnostics"):  # closed once
            self._diagnostics.close()
            del self._textures, self._estimates, self._diagnostics

    def _begin(self, index: int, schedule: Schedule) -> Phase:
        model = self._model_with_priors(schedule)
        shared = PhaseContext(model, schedule, self._textures, self._estimates, self.entry)
        return create_phase(self._stages[index], index, shared, self.seed, self._acceptance, self._measurements)

    def _take_measurements(self, measurements: PrefitMeasurements) -> Generator[None, None, None]:
        """Hold the measurements of the phases so far; apply them to the samples. Yields where that takes long."""
        separation = measurements.separation or Separation.none(self._textures.scale.shape)
        if not self._textures.separation.equals(separation):
            yield from self._separate_samples(separation)
        self._textures.raise_shadow(measurements.shadow_threshold)
        self._measurements = measurements

    def _separate_samples(self, separation: Separation) -> Generator[None, None, None]:
        """Replace the textures by those of the direct light. separation: (h, w), packed."""
        steps, before = separated_steps(self.domain, self._textures, separation, self.schedule), self._textures
        self._textures, self._stack = yield from map_steps(steps, lambda part: None)
        before.textures.pop("u_stack", None)  # a device need not hold two
        self._diagnostics.close()
        self._diagnostics = self._make_diagnostics()
        self._separation = self._unpacked_separation()

    def _unpacked_separation(self) -> Separation | None:
        separation = self._textures.separation
        return separation.unpacked(self._packing) if separation.any() else None

    def _make_diagnostics(self) -> Diagnostics:
        model = self._model_with_priors(self.schedule)
        return Diagnostics(model, self.schedule.fitness, self._textures, self._estimates, self.unsearched)

    def _model_with_priors(self, schedule: Schedule) -> ReflectanceModel:
        """Return the model with the priors that count: none if the schedule excludes them, none of fixed parameters."""
        everything = {p.name for p in self.model.parameters}
        return self.model.without_priors(self.fixed if schedule.fitness.priors else everything)

    def _acceptance(self) -> AcceptanceTest | None:
        if (fitness := self._measurements.fitness) is None:
            return None
        return AcceptanceTest(self.model, self.schedule, self._textures, self._estimates, fitness)

    @property
    def at(self) -> tuple[int, int]:
        """The stage and the iteration, as a checkpoint counts them."""
        return self._index, self._phase.iteration if self._phase is not None else 0

    def _iteration(self, phase: Phase, seconds: float) -> Iterator[None]:
        """Make the next iteration; after the last one of a stage begin the next stage. Yields often."""
        if self._stack is not None:
            self.give_stack()
            yield
        cost = self._solved * phase.evaluations
        yield from phase.advance(self._bands, seconds)
        self._bands.part = 0.0
        self._evaluations += cost
        self._counts = phase.iteration > 0
        if phase.done or self._reached_threshold():
            yield from self._end_stage(phase, seconds)

    def _end_stage(self, phase: Phase, seconds: float) -> Iterator[None]:
        yield from phase.write_estimates(self._bands, seconds)
        if not phase.keeps_estimates:
            self._estimates.swap()
        if (measurements := (yield from phase.measure_steps(self._bands, seconds))) is not None:
            yield from self._take_measurements(measurements)
            self.give_stack()
        yield  # the last one: view() must not see a closed phase
        phase.close()
        self._bands = Bands(self._bands.paced)  # another stage's passes have other costs
        self._index += 1
        self._begun, self._repeats = self._evaluations, True
        self._phase = self._begin(self._index, self.schedule) if self._index < len(self._stages) else None

    def _finish_iteration(self) -> None:
        if self._pending is not None:
            for _ in self._pending:
                pass
            self._pending = None

    def _measure(self, confidence: bool, seconds: float, paced: bool) -> Iterator[None]:
        """Finish the iteration, then measure what maps() returns."""
        self.give_stack()
        if self._pending is not None:
            self._bands.paced = paced
            for _ in self._pending:  # yield from would close it where a caller stops early
                yield
            self._pending = None
        at = self.at
        self._measured_at = self._confidence_at = None
        yield from self._diagnostics.measure_steps(self._phase, confidence, seconds, paced)
        self._measured_at, self._confidence_at = at, at if confidence else None

    def _show(self) -> dict[str, Texture]:
        """Return the current estimates by sampler name."""
        phase = self._phase
        if phase is None or not phase.has_result:
            return self._estimates.bindings()
        if self._shown_at != self.at:
            phase.preview(self._estimates.shown)
            self._shown_at = self.at
        return {f"u_estimate_{i}": texture for i, texture in enumerate(self._estimates.shown)}

    @property
    def checks_threshold(self) -> bool:
        """Whether swarms are compared with the threshold after the last iteration."""
        return self.schedule.threshold > 0 < self.at[1] and self.at[1] % _THRESHOLD_EVERY == 0

    def _reached_threshold(self) -> bool:
        return self.checks_threshold and self._running().reached(self.schedule.threshold)

    def _running(self) -> Phase:
        if self._phase is None:
            raise InputError("the recovery is done: its swarms are gone, read maps() instead")
        return self._phase


def _check(schedule: Schedule, seed: int) -> None:
    check_seed(seed)
    if schedule.levels > 1:
        raise InputError(f"levels = {schedule.levels}: a Recovery solves one size; use a Pyramid, or 1")
    refuse_interreflection(schedule, "a Recovery makes no rounds", "use InterreflectionRounds")
