"""One big swarm (benchmarks/swarms): its functions and its rule by hand; threads, ranks and CUDA like it."""

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import recovery_scaling, swarm_scaling
from benchmarks.swarms import ranks, rule
from benchmarks.swarms.functions import FUNCTIONS

ROOT = Path(__file__).resolve().parents[3]
RULE = rule.Rule(inertia=0.7, c1=1.4, c2=1.5, v_max=0.3, start_speed=0.5)
# By a pocket calculator, at (1, 2, 3).
BY_HAND = {
    "sphere": 14.0,
    "rosenbrock": 100 * (2 - 1) ** 2 + 0 + 100 * (3 - 4) ** 2 + 1,
    "rastrigin": 14.0,
    "griewank": 14 / 4000 - math.cos(1) * math.cos(2 / math.sqrt(2)) * math.cos(3 / math.sqrt(3)) + 1,
    "ackley": -20 * math.exp(-0.2 * math.sqrt(14 / 3)) - math.exp(1) + 20 + math.e,
    "schwefel": 3 * 418.98288727243369 - sum(x * math.sin(math.sqrt(x)) for x in (1, 2, 3)),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_has_its_values_and_its_least_one_where_the_literature_has_it(name):
    function = FUNCTIONS[name]
    assert function.values(np.array([[1.0, 2.0, 3.0]]))[0] == pytest.approx(BY_HAND[name], rel=1e-12)
    for dimensions in (2, 30):
        best = np.full(dimensions, function.optimum)
        assert function.values(best[None])[0] == pytest.approx(0, abs=1e-9)
        near = best + np.random.default_rng(1).uniform(-0.01, 0.01, (500, dimensions)) * function.reach
        assert (function.values(np.clip(near, -function.reach, function.reach)) > 0).all()


def pcg4d(words):
    """Jarzynski & Olano 2020, with Python's whole numbers."""
    most = 2**32
    a, b, c, d = ((word * 1664525 + 1013904223) % most for word in words)
    for turn in range(2):
        if turn:
            a, b, c, d = (word ^ (word >> 16) for word in (a, b, c, d))
        a = (a + b * d) % most
        b = (b + c * a) % most
        c = (c + a * b) % most
        d = (d + b * c) % most
    return a, b, c, d


def drawn(seed, iteration, particle, d, purpose):
    return (pcg4d(pcg4d((particle, iteration, 4 * (d // 4) + purpose, seed)))[d % 4] >> 8) / 2**24


def test_random_numbers_are_the_hash_of_seed_iteration_particle_and_dimension():
    found = rule.uniform(7, 5, np.array([0, 3, 70000]), 6, rule.R2)
    wanted = [[drawn(7, 5, p, d, rule.R2) for d in range(6)] for p in (0, 3, 70000)]
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("name", ["griewank", "schwefel"])
def test_the_rule_is_equations_2_and_3_with_walls_that_stop(name):
    function, dimensions, count, seed = FUNCTIONS[name], 5, 9, 4

    def value(place):
        return float(function.values(function.reach * (2 * np.array([place]) - 1))[0])

    x = [[drawn(seed, 0, i, d, rule.POSITION) for d in range(dimensions)] for i in range(count)]
    v = [[0.5 * (2 * drawn(seed, 0, i, d, rule.VELOCITY) - 1) for d in range(dimensions)] for i in range(count)]
    best = [(value(place), list(place)) for place in x]
    stopped = 0
    for iteration in range(1, 13):
        goal = min(best, key=lambda one: one[0])[1]
        for i in range(count):
            for d in range(dimensions):
                r1, r2 = (drawn(seed, iteration, i, d, purpose) for purpose in (rule.R1, rule.R2))
                speed = 0.7 * v[i][d] + 1.4 * r1 * (best[i][1][d] - x[i][d]) + 1.5 * r2 * (goal[d] - x[i][d])
                speed = min(max(speed, -0.3), 0.3)
                target = x[i][d] + speed
                x[i][d] = min(max(target, 0.0), 1.0)
                v[i][d] = speed if x[i][d] == target else 0.0
                stopped += x[i][d] != target
            if value(x[i]) < best[i][0]:
                best[i] = value(x[i]), list(x[i])
    swarm = rule.run(RULE, function, dimensions, count, 12, seed)
    assert stopped > 3 or name == "griewank"  # whose least place lies in the middle
    np.testing.assert_allclose(swarm.x, x, atol=1e-12)
    assert swarm.goal_value == pytest.approx(min(best, key=lambda one: one[0])[0], rel=1e-12)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_threads_move_every_particle_as_the_rule_does(name):
    pytest.importorskip("numba", reason="numba is not installed")
    from benchmarks.swarms import threads

    one, other = (rule.place(RULE, FUNCTIONS[name], 7, 20, 33, 2) for _ in range(2))
    for iteration in (1, 2, 3):
        for swarm in (one, other):
            swarm.goal = swarm.best[4].copy()
        rule.move(one, RULE, FUNCTIONS[name], 2, iteration)
        threads.move(other, RULE, FUNCTIONS[name], 2, iteration)
    np.testing.assert_allclose(other.x, one.x, atol=1e-12)
    np.testing.assert_allclose(other.value, one.value, rtol=1e-12)


def test_shares_are_even_and_lose_no_particle():
    for particles, count in ((10, 3), (8192, 7), (2, 5)):
        bounds = ranks.shares(particles, count)
        sizes = np.diff(bounds)
        assert (bounds[0], bounds[-1]) == (0, particles) and sizes.max() - sizes.min() <= 1


def test_two_ranks_find_what_one_process_does():
    pytest.importorskip("mpi4py", reason="mpi4py is not installed")
    pytest.importorskip("numba", reason="numba is not installed")
    if swarm_scaling.launcher() is None:
        pytest.skip("mpirun is not installed")
    alone = rule.run(rule.Rule.of(), FUNCTIONS["griewank"], 30, 50, 5, 1)
    found = swarm_scaling.on_ranks(50, 2, 1, 5, 1)
    assert found["ranks"] == 2 and found["particle"] == alone.goal_particle
    assert found["value"] == pytest.approx(alone.goal_value, rel=1e-12)
    np.testing.assert_allclose(found["place"], alone.goal, atol=1e-12)


def test_cuda_finds_the_same_in_its_simulator():
    pytest.importorskip("numba.cuda", reason="numba has no CUDA here")
    script = (
        "from benchmarks.swarms import on_cuda, rule; from benchmarks.swarms.functions import FUNCTIONS\n"
        "for f, members in (*((f, 17) for f in FUNCTIONS.values()), (FUNCTIONS['sphere'], 300)):\n"
        "    one = rule.run(rule.Rule.of(), f, 5, members, 2, 1)\n"
        "    swarm = on_cuda.CudaSwarm(rule.Rule.of(), f, 5, members, 1)\n"
        "    swarm.step(2)\n"
        "    value, place = swarm.goal()\n"
        "    assert abs(value - one.goal_value) <= 1e-12 * abs(value) and abs(place - one.goal).max() < 1e-12, f.name\n"
    )
    environment = os.environ | {"NUMBA_ENABLE_CUDASIM": "1", "PYTHONWARNINGS": "ignore", "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_model_of_more_ranks_is_the_sum_of_its_messages():
    network = swarm_scaling.Network("", latency=1e-5, bandwidth=1e9)
    assert swarm_scaling.modelled(8.0, 100, 0.5, 1, network) == 8.0
    messages = 2 * 3 * (1e-5 + 16e-9) + 0.5 * 3 * (1e-5 + 240e-9)
    assert swarm_scaling.modelled(8.0, 100, 0.5, 8, network) == pytest.approx(1.0 + 100 * messages, rel=1e-12)


@pytest.mark.parametrize(
    ("ranks", "texels", "neighbours", "border"), [(1, 49152, 0, 0), (2, 24576, 1, 192), (4, 12288, 3, 128 + 96 + 1)]
)
def test_the_model_of_a_recovery_sends_the_bests_along_the_borders(ranks, texels, neighbours, border):
    """Swarms of 7 dimensions look one texel far while c3 lasts, 0.3 · 60 iterations, and in 5 tenth ones after: 23."""
    sent = recovery_scaling.traffic((192, 256), ranks, "swarm", 60)
    assert sent == recovery_scaling.Traffic(texels, 23 * neighbours, 23 * border * 7 * 4)
    network = swarm_scaling.Network("", latency=1e-3, bandwidth=1e6)
    expected = 1e-3 * texels + 2 * 23 * neighbours * 1e-3 + 2 * 23 * border * 28 / 1e6
    assert recovery_scaling.modelled(1e-3, sent, network) == pytest.approx(expected, rel=1e-12)
