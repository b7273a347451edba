"""A large swarm by CUDA, with numba-cuda: a thread a particle, in double precision.

NUMBA_ENABLE_CUDASIM=1 runs it, slowly, in numba's simulator.
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
def _aim(best, value, goal, least):
    """Reduce in one block: each thread the least of every _BLOCK-th value, then pairs of threads, in a tree."""
    values = cuda.shared.array(_BLOCK, float64)  # one line each: the simulator identifies arrays by their lines
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
        least[0] = values[0]


class CudaSwarm:
    """One swarm of ``rule`` on the CUDA device, with the same start. every: steps between updates of its best."""

    def __init__(
        self, constants: rule.Rule, function: Function, dimensions: int, particles: int, seed: int, every: int = 1
    ):
        swarm = rule.place(constants, function, dimensions, 0, particles, seed)
        arrays = (swarm.x, swarm.v, swarm.best, swarm.value, swarm.goal)
        self._x, self._v, self._best, self._value, self._goal = map(cuda.to_device, arrays)
        self._least, self._constants = cuda.to_device(np.zeros(1)), cuda.to_device(threads.constants_of(constants))
        self._blocks, self._seed, self._every, self._made = -(-particles // _BLOCK), seed, every, 0
        self._function = function.number, function.reach
        self._update_goal()

    def step(self, iterations: int) -> None:
        """Run iterations, and wait for their end."""
        for _ in range(iterations):
            self._made += 1
            _move[self._blocks, _BLOCK](
                self._x, self._v, self._best, self._value, self._goal, self._seed, self._made, self._constants,
                *self._function,
            )  # fmt: skip
            if self._made % self._every == 0:
                self._update_goal()
        cuda.synchronize()

    def goal(self) -> tuple[float, np.ndarray]:
        """Return the least value and its position (D,)."""
        self._update_goal()
        return float(self._least.copy_to_host()[0]), self._goal.copy_to_host()

    def _update_goal(self) -> None:
        _aim[1, _BLOCK](self._best, self._value, self._goal, self._least)
