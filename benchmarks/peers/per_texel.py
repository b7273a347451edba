"""Runs methods that solve one texel after another, on some processes, and merges their traces."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from .objective import Loss, Objective
from .problem import PeerResult, Problem, Sample, peak_memory_mb


@dataclass
class Trace:
    """Trace of one texel's search: rows of (seconds, evaluations, x), each better than the last.

    Methods report their evaluations to ``record``, at most once a generation.
    """

    rows: list[tuple[float, int, np.ndarray]] = field(default_factory=list)
    evaluations: int = 0
    best: float = np.inf
    began: float = field(default_factory=time.perf_counter)

    def record(self, x: np.ndarray, costs: np.ndarray) -> None:
        """Count S candidates x (S, size); add a row if one is the best so far."""
        self.evaluations += len(costs)
        at = int(np.argmin(costs))
        if costs[at] < self.best:
            self.best = float(costs[at])
            self.rows.append((time.perf_counter() - self.began, self.evaluations, x[at].copy()))


Solve = Callable[..., Trace]  # (objective, texel, start (S, size), seed, **settings)


def run(
    name: str, problem: Problem, loss: Loss, solve: Solve, restarts: bool, workers: int, seed: int, **settings
) -> PeerResult:
    """Solve all texels of a problem. solve: a function at module level, because processes import it.

    The time to start the processes is not counted.
    """
    groups = np.array_split(np.arange(problem.count), min(workers, problem.count))
    jobs = [(problem.subset(group), loss, solve, restarts, seed + int(group[0]), settings) for group in groups]
    if workers == 1:
        start = time.perf_counter()
        parts = [_solve_some(*job) for job in jobs]
        seconds = time.perf_counter() - start
    else:
        with _pool(workers) as pool:
            list(pool.map(_wake, range(workers)))
            start = time.perf_counter()
            parts = list(pool.map(_solve_some, *zip(*jobs, strict=True)))
            seconds = time.perf_counter() - start
    objective = Objective(problem, loss)
    traces = [trace for part, _ in parts for trace in part]
    trace = _joint_trace(traces, objective, workers)
    values = objective.box.ordered(objective.box.values(np, np.array([trace.rows[-1][2] for trace in traces])))
    evaluations = np.array([trace.evaluations for trace in traces])
    memory = max(memory for _, memory in parts)
    described = {"loss": loss, "restarts": restarts, "workers": workers, "seed": seed, **settings}
    return PeerResult(name, values, evaluations, seconds, memory, described, trace)


def _solve_some(
    problem: Problem, loss: Loss, solve: Solve, restarts: bool, seed: int, settings: dict
) -> tuple[list[Trace], float]:
    objective = Objective(problem, loss)
    starts = np.stack(objective.starts(restarts), axis=1)
    traces = [solve(objective, t, starts[t], seed + t, **settings) for t in range(problem.count)]
    return traces, peak_memory_mb()


def _joint_trace(traces: list[Trace], objective: Objective, workers: int, points: int = 24) -> tuple[Sample, ...]:
    """Return the joint trace: the values of all texels after the same number of evaluations each."""
    first = max(trace.rows[0][1] for trace in traces)
    last = max(trace.evaluations for trace in traces)
    samples = []
    for budget in np.unique(np.geomspace(first, max(last, first + 1), points).astype(int)):
        rows = [[row for row in trace.rows if row[1] <= budget][-1] for trace in traces]
        # A texel without a better row since then has gone on searching.
        spent = [min(row[0] * budget / row[1], trace.rows[-1][0]) for row, trace in zip(rows, traces, strict=True)]
        values = objective.box.ordered(objective.box.values(np, np.array([row[2] for row in rows])))
        samples.append(Sample(float(np.sum(spent)) / workers, float(budget), values))
    return tuple(samples)


def _pool(workers: int) -> ProcessPoolExecutor:
    # One core a process: more threads of the linear algebra would compete for it.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    return ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))


def _wake(number: int) -> int:
    time.sleep(0.2)  # so that every process gets one
    return number
