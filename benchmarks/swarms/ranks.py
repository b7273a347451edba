"""A swarm's particles dealt out to the ranks of an MPI job, each with one or more threads.

Usage: mpirun -n N python -m benchmarks.swarms.ranks FUNCTION [--particles 8192] [--dimensions 30] [--iterations 200]
[--threads 1] [--repeats 5]. Rank 0 prints one line of JSON. The result is the same for any number of ranks and threads.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import numpy as np

from . import rule, threads
from .functions import FUNCTIONS, Function

_MINIMUM = np.dtype([("value", np.float64), ("particle", np.int32)], align=True)  # MPI's DOUBLE_INT


def shares(particles: int, ranks: int) -> list[int]:
    """Return the first particle of each rank, and their number, for even shares."""
    return [particles * rank // ranks for rank in range(ranks + 1)]


def run(
    world: Any, constants: rule.Rule, function: Function, dimensions: int, particles: int, iterations: int, seed: int
) -> tuple[rule.Swarm, dict[str, float]]:
    """Return this rank's particles after ``iterations`` iterations, and the measurements.

    These are seconds, those of communication (told), and the iterations with a new best (news). An iteration: one
    reduction finds the least value and its first particle; its owner broadcasts the position; all ranks move.
    """
    bounds = shares(particles, world.size)
    first, last = bounds[world.rank : world.rank + 2]
    swarm = rule.place(constants, function, dimensions, first, last - first, seed)
    world.Barrier()
    began, communication, improvements = time.perf_counter(), 0.0, 0
    for iteration in range(1, iterations + 1):
        at = time.perf_counter()
        improvements += _aim(world, swarm, bounds)
        communication += time.perf_counter() - at
        threads.move(swarm, constants, function, seed, iteration)
    _aim(world, swarm, bounds)
    world.Barrier()
    return swarm, {"seconds": time.perf_counter() - began, "told": communication, "news": improvements}


def _aim(world: Any, swarm: rule.Swarm, bounds: list[int]) -> bool:
    """Distribute the global best to all ranks; return whether its value has changed.

    Reduces 16 bytes, and broadcasts 8 bytes a dimension if it has.
    """
    from mpi4py import MPI

    mine, least = (np.zeros(1, _MINIMUM) for _ in range(2))
    mine[0] = rule.found(swarm) if len(swarm.value) else (np.inf, np.iinfo(np.int32).max)
    world.Allreduce([mine, MPI.DOUBLE_INT], [least, MPI.DOUBLE_INT], op=MPI.MINLOC)
    value, particle = float(least[0]["value"]), int(least[0]["particle"])
    if value == swarm.goal_value:
        return False
    swarm.goal_value, swarm.goal_particle = value, particle
    owner = int(np.searchsorted(bounds, particle, side="right")) - 1
    if world.rank == owner:
        swarm.goal[:] = swarm.best[particle - swarm.first]
    world.Bcast(swarm.goal, root=owner)
    return True


def main() -> None:
    """Run the swarm of the command line, and print its measurements."""
    from mpi4py import MPI

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("function", choices=list(FUNCTIONS))
    parser.add_argument("--particles", type=int, default=8192)
    parser.add_argument("--dimensions", type=int, default=30)
    parser.add_argument("--iterations", type=int, default=200)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    world, constants, function = MPI.COMM_WORLD, rule.Rule.of(), FUNCTIONS[options.function]
    threads.use(options.threads)
    sizes = options.dimensions, options.particles
    run(world, constants, function, *sizes, 2, options.seed)  # compiles
    taken = []
    for _ in range(options.repeats):
        swarm, seconds = run(world, constants, function, *sizes, options.iterations, options.seed)
        taken.append(seconds)
    if world.rank == 0:
        result = {
            "ranks": world.size, "threads": options.threads, "layer": threads.layer(), "value": swarm.goal_value,
            "particle": swarm.goal_particle, "place": swarm.goal.tolist(), "runs": taken, "news": taken[-1]["news"],
        }  # fmt: skip
        print(json.dumps(result))


if __name__ == "__main__":
    main()
