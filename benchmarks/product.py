"""Runs the program for the benchmarks: recoveries with traces, and schedules derived from presets."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from benchmarks.peers.problem import Sample, Values
from irpso_addon.geometry.domain import Domain
from irpso_addon.gpu import context, textures
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.phases.phase import Phase
from irpso_addon.solver.phases.prefit import PrefitPhase
from irpso_addon.solver.phases.refinement import RefinementPhase
from irpso_addon.solver.settings.schedule import Schedule, load_schedule

LM_ALONE = "LM alone"
ONE_PARTICLE = ("paper", "constriction", "swarm")  # presets whose iterations move one particle a texel


@dataclass(frozen=True)
class Run:
    """A recovery's result. values: name → (H, W, components). seconds: from the images to the maps, with setup and
    compilation. evaluations: a texel, at most. made: a texel, without those that converged texels did not need.

    work: seconds of work, see ``now``; trace_work: the same for every sample of the trace.
    """

    values: Values
    residual: np.ndarray
    seconds: float
    evaluations: float
    made: float
    trace: tuple[Sample, ...] = ()
    work: float = 0.0
    trace_work: tuple[float, ...] = ()


def schedule_of(name: str) -> Schedule:
    """Return a preset by name, or ``LM_ALONE``: the refinement of ``standard`` alone, from all its starts."""
    if name != LM_ALONE:
        return load_schedule(name)
    schedule = load_schedule("standard")
    alone = schedule.replaced(iterations=0, prefit_iterations=0, refinement_starts=True)
    return replace(alone, name=LM_ALONE)


def jointly(schedule: Schedule, iterations: int | None = None) -> Schedule:
    """Return the schedule with all parameters searched together, in one stage, once."""
    total = iterations or sum(stage.iterations for stage in schedule.stages) * schedule.cycles
    return schedule.replaced(search=["all"], cycles=1).replaced(iterations=total)


def in_stages(schedule: Schedule, iterations: int | None = None) -> Schedule:
    """Return the schedule with the paper's three stages and cycles, each on the current estimates."""
    paper = load_schedule("paper")
    total = iterations or sum(stage.iterations for stage in schedule.stages) * schedule.cycles
    each = max(1, total // (len(paper.stages) * paper.cycles))
    return replace(schedule, stages=paper.stages, cycles=paper.cycles).replaced(iterations=each)


def recover(
    domain: Domain,
    model: str,
    schedule: Schedule,
    seed: int = 0,
    fixed: Mapping[str, np.ndarray] | None = None,
    points: Sequence[int] = (),
    entry: str = "auto",
) -> Run:
    """Run a recovery to its end. points: total iterations after which a sample is added to the trace.

    The seconds exclude reading the maps: each sample reads them twice, the second time to measure its duration.
    """
    context.ensure()
    trace, works = [], []
    overhead, start = np.zeros(2), now()
    texels = max(int(domain.solvable.sum()), 1)
    with _Counted(domain, load_model(model), schedule, seed, fixed, entry) as recovery:
        total = recovery.progress.iterations_in_all
        for point in [*sorted({p for p in points if p < total}), total]:
            # None runs to the end: a threshold may have ended stages early.
            recovery.step(iterations=None if point == total else point - recovery.progress.iteration_in_all)
            maps = recovery.maps(confidence=False)
            read_at = now()
            recovery.maps(confidence=False)
            read_time = now() - read_at
            seconds, work = read_at - read_time - start - overhead
            trace.append(Sample(float(seconds), recovery.progress.evaluations / texels, maps.values))
            works.append(float(work))
            overhead += 2 * read_time
    last = trace[-1]
    return Run(
        maps.values, maps.residual, last.seconds, last.evaluations, recovery.made, tuple(trace), works[-1], tuple(works)
    )


class _Counted(Recovery):
    """Counts the evaluations that texels made. made: a texel, in the finished stages.

    A texel that has converged makes none, nor one that a second prefit skips. Spatial phases count in full.
    """

    made = 0.0

    def _end_stage(self, phase: Phase, seconds: float) -> Iterator[None]:
        self.made += self._made_in(phase)
        yield from super()._end_stage(phase, seconds)

    def _made_in(self, phase: Phase) -> float:
        at_most = (self._evaluations - self._begun) / self._solved
        refinement = phase.inner if isinstance(phase, PrefitPhase) else phase
        if not isinstance(refinement, RefinementPhase):
            return at_most
        counts = np.maximum(*(textures.download(t[-1])[..., 3] for t in (refinement.best, refinement.work)))
        made = counts.sum() / self._solved
        if refinement is not phase:
            swarms = at_most - refinement.iterations * refinement.passes.evaluations
            made += swarms * np.count_nonzero(counts) / self._solved
        return float(made)


def now() -> np.ndarray:
    """Return seconds by the clock, and seconds of work.

    Work is the processor time of this process, which includes a software renderer and hardly depends on other load;
    with a GPU it is the clock again.
    """
    clock = time.perf_counter()
    return np.array([clock, time.process_time() if software_renderer() else clock])


@cache
def software_renderer() -> bool:
    """Return whether shaders run on the CPU."""
    return any(name in str(context.describe()["renderer"]).lower() for name in ("llvmpipe", "softpipe", "lavapipe"))


def iterations_of(domain: Domain, model: str, schedule: Schedule) -> int:
    """Return the total iterations of a recovery."""
    context.ensure()
    with Recovery(domain, load_model(model), schedule, entry="fragment") as recovery:
        return recovery.progress.iterations_in_all


def spaced(total: int, count: int) -> list[int]:
    """Return up to ``count`` whole numbers from 1 to ``total``, evenly spaced in their logarithms."""
    return sorted({int(round(x)) for x in np.geomspace(1, max(total, 1), count)})
