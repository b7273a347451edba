"""Standard test functions of swarm optimisation, over many points at once. numpy in float64.

Bounds and minima as in Yao, Liu & Lin 1999, Evolutionary Programming Made Faster; all minima are 0 here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

# Of Schwefel's function: the offset per dimension that makes its minimum 0, and the coordinate of the minimum.
SCHWEFEL_VALUE, SCHWEFEL_PLACE = 418.98288727243369, 420.96874635998205


@dataclass(frozen=True)
class Function:
    """A function to minimise. number: its index in every implementation. reach: the range is −reach…reach.

    optimum: the coordinate of the minimum, the same in every dimension. values: (P, D) → (P,).
    """

    name: str
    number: int
    reach: float
    optimum: float
    values: Callable[[np.ndarray], np.ndarray]


def _sphere(x: np.ndarray) -> np.ndarray:
    return (x * x).sum(axis=1)


def _rosenbrock(x: np.ndarray) -> np.ndarray:
    a, b = x[:, :-1], x[:, 1:]
    return (100.0 * (b - a * a) ** 2 + (1.0 - a) ** 2).sum(axis=1)


def _rastrigin(x: np.ndarray) -> np.ndarray:
    return (x * x - 10.0 * np.cos(2 * np.pi * x) + 10.0).sum(axis=1)


def _griewank(x: np.ndarray) -> np.ndarray:
    root = np.sqrt(np.arange(1, x.shape[1] + 1))
    return (x * x).sum(axis=1) / 4000.0 - np.cos(x / root).prod(axis=1) + 1.0


def _ackley(x: np.ndarray) -> np.ndarray:
    count = x.shape[1]
    near = -20.0 * np.exp(-0.2 * np.sqrt((x * x).sum(axis=1) / count))
    return near - np.exp(np.cos(2 * np.pi * x).sum(axis=1) / count) + 20.0 + np.e


def _schwefel(x: np.ndarray) -> np.ndarray:
    return (SCHWEFEL_VALUE - x * np.sin(np.sqrt(np.abs(x)))).sum(axis=1)


FUNCTIONS = {
    name: Function(name, number, reach, optimum, values)
    for number, (name, reach, optimum, values) in enumerate(
        (
            ("sphere", 100.0, 0.0, _sphere),
            ("rosenbrock", 30.0, 1.0, _rosenbrock),
            ("rastrigin", 5.12, 0.0, _rastrigin),
            ("griewank", 600.0, 0.0, _griewank),
            ("ackley", 32.0, 0.0, _ackley),
            ("schwefel", 500.0, SCHWEFEL_PLACE, _schwefel),
        )
    )
}
