"""One big swarm on the GPU against the rule in numpy."""

import numpy as np
import pytest

from benchmarks.swarms import rule
from benchmarks.swarms.functions import FUNCTIONS
from benchmarks.swarms.on_gpu import GpuSwarm


@pytest.mark.parametrize("entry", ["fragment", "compute"])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_first_steps_are_those_of_the_rule(name, entry):
    particles, dimensions = 91, 6  # neither fills its grid
    wanted = rule.run(rule.Rule.of(), FUNCTIONS[name], dimensions, particles, 3, 5)
    swarm = GpuSwarm(rule.Rule.of(), FUNCTIONS[name], dimensions, particles, 5, entry)
    swarm.step(3)
    value, place = swarm.goal()
    np.testing.assert_allclose(swarm.best(), wanted.best, atol=2e-6)
    assert value == pytest.approx(wanted.goal_value, rel=1e-4, abs=1e-3)
    np.testing.assert_allclose(place, wanted.goal, atol=2e-6)


def test_without_a_reduction_the_particles_go_on_toward_the_place_before():
    def goal_after(every, steps):
        swarm = GpuSwarm(rule.Rule.of(), FUNCTIONS["sphere"], 4, 64, 1, every=every)
        swarm.step(steps)
        return swarm.best()

    held = rule.place(rule.Rule.of(), FUNCTIONS["sphere"], 4, 0, 64, 1)
    held.goal = held.best[rule.found(held)[1]].copy()
    for iteration in (1, 2, 3):
        rule.move(held, rule.Rule.of(), FUNCTIONS["sphere"], 1, iteration)
    np.testing.assert_allclose(goal_after(10, 3), held.best, atol=2e-6)
    assert np.abs(goal_after(1, 3) - held.best).max() > 1e-3
