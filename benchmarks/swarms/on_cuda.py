"""A big swarm by CUDA, through numba-cuda: a thread a particle, in double precision.

Where no CUDA device is present ``available`` says so; with NUMBA_ENABLE_CUDASIM=1 numba's simulator runs it, slowly.
"""

from __future__ import annotations

import numpy as np
from numba import cuda, float64, int32

from . import particle, rule, threads
from .functions import Function

_BLOCK = 128  # threads
_step = particle.compiled(cuda.jit(device=True))


def available() -> bool:
    """Return whether numba finds a CUDA device, or its simulator."""
    return bool(cuda.is_available())


@cuda.jit
def _move(x, v, best, value, goal, seed, iteration, constants, number, reach):
    i = cuda.grid(1)
    if i < x.shape[0]:
        _step(i, x, v, best, value, goal, 0, seed, iteration, constants, number, reach)


@cuda.jit
def _aim(best, value, goal, found):
    """One block: each thread looks through every _BLOCK-th value, then halves of the block compare what they have."""
    values = cuda.shared.array(_BLOCK, float64)  # a line each: the simulator knows them by their lines
    owners = cuda.shared.array(_BLOCK, int32)
    t = cuda.threadIdx.x
    values[t], owners[t] = np.inf, 0
    for i in range(t, value.shape[0], _BLOCK):
        if value[i] < values[t]:
            values[t], owners[t] = value[i], i
    cuda.syncthreads()
    half = _BLOCK // 2
    while half > 0:
        if t < half:
            a, b = values[t], values[t + half]
            if b < a or (b == a and owners[t + half] < owners[t]):
                values[t], owners[t] = b, owners[t + half]
        cuda.syncthreads()
        half //= 2
    for d in range(t, goal.shape[0], _BLOCK):
        goal[d] = best[owners[0], d]
    if t == 0:
        found[0] = values[0]


def run(
    constants: rule.Rule,
    function: Function,
    dimensions: int,
    particles: int,
    iterations: int,
    seed: int,
    every: int = 1,
) -> tuple[float, np.ndarray]:
    """Return the least value and its place (D,). every: the steps after which the best place is looked for."""
    swarm = rule.place(constants, function, dimensions, 0, particles, seed)
    x, v, best, value, goal = map(cuda.to_device, (swarm.x, swarm.v, swarm.best, swarm.value, swarm.goal))
    found, given = cuda.to_device(np.zeros(1)), cuda.to_device(threads.constants_of(constants))
    _aim[1, _BLOCK](best, value, goal, found)
    for iteration in range(1, iterations + 1):
        _move[-(-particles // _BLOCK), _BLOCK](
            x, v, best, value, goal, seed, iteration, given, function.number, function.reach
        )
        if iteration % every == 0:
            _aim[1, _BLOCK](best, value, goal, found)
    _aim[1, _BLOCK](best, value, goal, found)
    return float(found.copy_to_host()[0]), goal.copy_to_host()
