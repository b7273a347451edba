"""A swarm on the threads of one processor: numba with OpenMP (Lam, Pitrou & Seibert 2015)."""

from __future__ import annotations

import functools
import os
from typing import Any

import numpy as np

from . import particle, rule
from .functions import Function


@functools.cache
def _mover() -> Any:
    os.environ.setdefault("NUMBA_THREADING_LAYER", "omp")
    import numba

    step = particle.compiled(numba.njit(inline="never"))

    @numba.njit(parallel=True)
    def move(x, v, best, value, goal, first, seed, iteration, constants, number, reach):
        for i in numba.prange(x.shape[0]):
            step(i, x, v, best, value, goal, first, seed, iteration, constants, number, reach)

    return move


def constants_of(constants: rule.Rule) -> np.ndarray:
    """Return the array ``constants`` of particle.compiled."""
    return np.array([constants.inertia, constants.c1, constants.c2, constants.v_max])


def move(swarm: rule.Swarm, constants: rule.Rule, function: Function, seed: int, iteration: int) -> None:
    """Do the same as rule.move, on the threads that ``use`` has set."""
    _mover()(
        swarm.x, swarm.v, swarm.best, swarm.value, swarm.goal, swarm.first, seed, iteration, constants_of(constants),
        function.number, function.reach,
    )  # fmt: skip


def use(count: int) -> None:
    """Set the number of threads, at most as many as the machine has processors."""
    import numba

    numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))


def layer() -> str:
    """Return the name of numba's threading layer, after a first ``move``."""
    import numba

    return numba.threading_layer()
