"""The solver's update rule (Eq. 2 and 3, shaders/swarm/update.glsl) for one synchronous swarm. numpy.

Random numbers are pure functions of (seed, iteration, particle, dimension): the result does not depend on the
distribution of the particles over ranks, threads or a GPU.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from irpso_addon.solver.settings.schedule import load_schedule

from .functions import Function

R1, R2, POSITION, VELOCITY = range(4)  # purposes, which separate the streams of random numbers


@dataclass(frozen=True)
class Rule:
    """The constants of Eq. 2; velocities as fractions of the range."""

    inertia: float
    c1: float
    c2: float
    v_max: float
    start_speed: float

    @staticmethod
    def of(preset: str = "constriction") -> Rule:
        """Return the constants of a preset, multiplied by its constriction."""
        swarm = load_schedule(preset).swarm
        chi = swarm.constriction
        return Rule(chi * swarm.inertia, chi * swarm.c1, chi * swarm.c2, swarm.v_max, swarm.start_speed)


@dataclass
class Swarm:
    """Particles ``first`` … of a swarm: x, v, best (P, D) in 0…1 of the range; value: (P,) of the bests.

    goal: (D,) position of the global best, goal_value its value, goal_particle the first particle with it.
    """

    first: int
    x: np.ndarray
    v: np.ndarray
    best: np.ndarray
    value: np.ndarray
    goal: np.ndarray
    goal_value: float = np.inf
    goal_particle: int = 0


def uniform(seed: int, iteration: int, particles: np.ndarray, dimensions: int, purpose: int) -> np.ndarray:
    """Return (P, D) numbers in [0, 1), multiples of 2⁻²⁴: pcg4d twice (Jarzynski & Olano 2020), four a hash."""
    blocks = np.arange(-(-dimensions // 4), dtype=np.uint32)
    shape = (len(particles), len(blocks))
    h = [
        np.broadcast_to(particles.astype(np.uint32)[:, None], shape).copy(),
        np.full(shape, iteration, np.uint32),
        np.broadcast_to(blocks * np.uint32(4) + np.uint32(purpose), shape).copy(),
        np.full(shape, seed, np.uint32),
    ]
    for _ in range(2):
        _pcg4d(h)
    bits = np.stack(h, axis=-1).reshape(len(particles), -1)[:, :dimensions]
    return (bits >> np.uint32(8)) * 2.0**-24


def _pcg4d(h: list[np.ndarray]) -> None:
    for a in h:
        a *= np.uint32(1664525)
        a += np.uint32(1013904223)
    for mixed in (False, True):
        if mixed:
            for a in h:
                a ^= a >> np.uint32(16)
        h[0] += h[1] * h[3]
        h[1] += h[2] * h[0]
        h[2] += h[0] * h[1]
        h[3] += h[1] * h[2]


def place(rule: Rule, function: Function, dimensions: int, first: int, count: int, seed: int) -> Swarm:
    """Return particles ``first`` to ``first + count`` at random positions, with their values."""
    particles = np.arange(first, first + count)
    x = uniform(seed, 0, particles, dimensions, POSITION)
    v = rule.start_speed * (2 * uniform(seed, 0, particles, dimensions, VELOCITY) - 1)
    swarm = Swarm(first, x, v, x.copy(), evaluate(function, x), np.zeros(dimensions))
    return swarm


def move(swarm: Swarm, rule: Rule, function: Function, seed: int, iteration: int) -> None:
    """Move every particle once, stop it at the walls, and update its best."""
    count, dimensions = swarm.x.shape
    particles = np.arange(swarm.first, swarm.first + count)
    r1, r2 = (uniform(seed, iteration, particles, dimensions, purpose) for purpose in (R1, R2))
    pull = rule.c1 * r1 * (swarm.best - swarm.x) + rule.c2 * r2 * (swarm.goal - swarm.x)
    swarm.v = np.clip(rule.inertia * swarm.v + pull, -rule.v_max, rule.v_max)
    target = swarm.x + swarm.v
    swarm.x = np.clip(target, 0.0, 1.0)
    swarm.v[swarm.x != target] = 0.0
    value = evaluate(function, swarm.x)
    better = value < swarm.value
    swarm.best[better], swarm.value[better] = swarm.x[better], value[better]


def evaluate(function: Function, x: np.ndarray) -> np.ndarray:
    """Return (P,) values at positions (P, D) in 0…1 of the range."""
    return function.values(function.reach * (2 * x - 1))


def found(swarm: Swarm) -> tuple[float, int]:
    """Return the least of the swarm's values, and the first particle with it."""
    at = int(np.argmin(swarm.value))
    return float(swarm.value[at]), swarm.first + at


def run(rule: Rule, function: Function, dimensions: int, particles: int, iterations: int, seed: int) -> Swarm:
    """Return the whole swarm after ``iterations`` iterations on one processor: the reference of the others."""
    swarm = place(rule, function, dimensions, 0, particles, seed)
    for iteration in range(1, iterations + 1):
        _aim(swarm)
        move(swarm, rule, function, seed, iteration)
    _aim(swarm)
    return swarm


def _aim(swarm: Swarm) -> None:
    swarm.goal_value, swarm.goal_particle = found(swarm)
    swarm.goal = swarm.best[swarm.goal_particle].copy()
