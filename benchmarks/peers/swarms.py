"""Population methods per texel: pyswarms' global-best particle swarm and scipy's differential evolution."""

from __future__ import annotations

import json
import os
import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from .objective import Loss, Objective
from .per_texel import Trace, run
from .problem import PeerResult, Problem


def pyswarms_global_best(
    problem: Problem,
    loss: Loss = Loss(),  # noqa: B008
    workers: int = 2,
    particles: int = 24,
    iterations: int = 300,
    inertia: float = 0.7298,
    pull: float = 1.496,
    seed: int = 0,
) -> PeerResult:
    """GlobalBestPSO of pyswarms (Miranda 2018) with Clerc & Kennedy's 2002 constants, half the swarm near the seed."""
    settings = {"particles": particles, "iterations": iterations, "inertia": inertia, "pull": pull}
    return run("pyswarms", problem, loss, swarm_texel, True, workers, seed, **settings)


def differential_evolution(
    problem: Problem,
    loss: Loss = Loss(),  # noqa: B008
    workers: int = 2,
    population: int = 8,
    generations: int = 150,
    polish: bool = True,
    seed: int = 0,
) -> PeerResult:
    """scipy's differential evolution (Storn & Price 1997), from the seed; population: members per dimension."""
    settings = {"population": population, "generations": generations, "polish": polish}
    return run("differential evolution", problem, loss, evolve_texel, False, workers, seed, **settings)


def swarm_texel(
    objective: Objective, t: int, starts: np.ndarray, seed: int, particles: int, iterations: int, inertia: float,
    pull: float,
) -> Trace:  # fmt: skip
    """Return one texel's trace. pyswarms draws from numpy's global generator, which is seeded here."""
    GlobalBestPSO = _global_best_class()
    np.random.seed(seed % 2**32)
    trace, size = Trace(), objective.box.size
    place = np.random.random((particles, size))
    near = starts[np.arange(particles // 2) % len(starts)]
    place[: particles // 2] = np.clip(near + np.random.normal(size=near.shape) * 0.05, 0, 1)
    place[0] = starts[0]

    def cost(x: np.ndarray) -> np.ndarray:
        costs = objective.cost(x, t)
        trace.record(x, costs)
        return costs

    swarm = GlobalBestPSO(
        particles, size, {"w": inertia, "c1": pull, "c2": pull}, bounds=(np.zeros(size), np.ones(size)),
        bh_strategy="nearest", init_pos=place,
    )  # fmt: skip
    swarm.optimize(cost, iterations, verbose=False)
    return trace


def evolve_texel(
    objective: Objective, t: int, starts: np.ndarray, seed: int, population: int, generations: int, polish: bool
) -> Trace:
    """Return one texel's trace."""
    from scipy.optimize import differential_evolution as evolve

    trace, size = Trace(), objective.box.size

    def cost(x: np.ndarray) -> np.ndarray:
        tries = np.atleast_2d(x.T)
        costs = objective.cost(tries, t)
        trace.record(tries, costs)
        return costs if x.ndim == 2 else costs[0]

    evolve(
        cost, [(0, 1)] * size, x0=starts[0], popsize=population, maxiter=generations, polish=polish, vectorized=True,
        updating="deferred", rng=seed, tol=1e-8, atol=0,
    )  # fmt: skip
    return trace


@cache
def _global_best_class() -> type:
    """Import pyswarms without its report.log, which every swarm would open in the current folder."""
    quiet = {"version": 1, "disable_existing_loggers": False}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "logging.yml"
        path.write_text(json.dumps(quiet), encoding="utf-8")
        os.environ["LOG_CFG"] = str(path)
        from pyswarms.single import GlobalBestPSO
        from pyswarms.utils.reporter import Reporter
    Reporter._setup_logger = lambda self, path=None: None
    return GlobalBestPSO
