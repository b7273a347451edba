"""The iterative peers find materials that were rendered by the oracles, and tell the truth of how long it took them."""

import numpy as np
import pytest
from test_peers_models import problem

from benchmarks.peers.objective import Loss, Objective
from benchmarks.peers.per_texel import Trace, _joint_trace
from benchmarks.peers.problem import angles

pytest.importorskip("scipy.optimize", reason="scipy is not installed: its searches cannot be run")


def easy(model: str = "principled", texels: int = 4):
    return problem(model, texels, lights=60, seed=8)


def check(p, result, degrees, share):
    assert angles(result.values["normal"], p.truth["normal"]).max() < degrees
    assert np.abs(result.values["base_color"] - p.truth["base_color"]).max() < share
    assert (result.evaluations > 0).all() and result.seconds > 0 and result.memory_mb > 10
    budgets = [sample.evaluations for sample in result.trace]
    assert budgets == sorted(budgets) and len(budgets) > 3
    assert all(sample.seconds <= result.seconds * 1.5 for sample in result.trace)
    last = result.trace[-1].values["normal"]
    assert angles(last, result.values["normal"]).max() < degrees


def test_scipy_least_squares_finds_a_clean_material():
    from benchmarks.peers.least_squares import scipy_least_squares

    p = easy()
    check(p, scipy_least_squares(p, workers=1), 1e-3, 1e-4)


def test_the_differences_of_least_squares_are_the_derivatives():
    from benchmarks.peers.least_squares import STEP

    p = easy("cook_torrance_two_lobe")
    objective = Objective(p, Loss())
    x, size = objective.starts(False)[0][1], objective.box.size
    for i in range(size):
        unit = np.eye(size)[i]
        fine = objective.residuals(np.stack([x + STEP * unit, x - STEP * unit]), 1)
        coarse = objective.residuals(np.stack([x + 8e-5 * unit, x - 8e-5 * unit]), 1)
        np.testing.assert_allclose((fine[0] - fine[1]) / (2 * STEP), (coarse[0] - coarse[1]) / 1.6e-4, atol=1e-4)


def test_texels_solved_by_two_processes_are_those_solved_by_one():
    from benchmarks.peers.least_squares import scipy_least_squares

    p = easy(texels=3)
    one, two = (scipy_least_squares(p, restarts=False, workers=n) for n in (1, 2))
    for name, value in one.values.items():
        np.testing.assert_allclose(value, two.values[name], atol=1e-9)  # the linear algebra may use other threads


def test_differential_evolution_finds_a_clean_material():
    from benchmarks.peers.swarms import differential_evolution

    p = easy("lambert", texels=2)
    check(p, differential_evolution(p, workers=1, generations=80), 0.01, 1e-3)


def test_pyswarms_finds_a_clean_material_and_leaves_no_log_behind(tmp_path, monkeypatch):
    pytest.importorskip("pyswarms", reason="pyswarms is not installed: it is for benchmarks alone")
    from benchmarks.peers.swarms import pyswarms_global_best

    monkeypatch.chdir(tmp_path)
    p = easy("lambert", texels=2)
    check(p, pyswarms_global_best(p, workers=1, iterations=150), 0.01, 1e-3)
    assert list(tmp_path.iterdir()) == []


def test_a_trace_shows_every_texel_at_the_same_number_of_evaluations():
    p = problem("lambert", texels=2)
    objective = Objective(p, Loss())
    size = objective.box.size
    ways = [
        Trace([(0.1, 10, np.full(size, 0.1)), (0.4, 40, np.full(size, 0.4))], 100, began=0),
        Trace([(0.2, 20, np.full(size, 0.2)), (1.0, 100, np.full(size, 0.9))], 100, began=0),
    ]
    trace = _joint_trace(ways, objective, workers=1)
    assert trace[0].evaluations == 20 and trace[-1].evaluations == 100
    np.testing.assert_allclose(trace[0].values["base_color"][:, 0], [0.1, 0.2])
    np.testing.assert_allclose(trace[-1].values["base_color"][:, 0], [0.4, 0.9])
    assert trace[0].seconds == pytest.approx(0.2 + 0.2)


def test_a_way_keeps_only_what_is_better():
    trace = Trace()
    trace.record(np.array([[0.1], [0.2]]), np.array([3.0, 2.0]))
    trace.record(np.array([[0.3]]), np.array([2.5]))
    trace.record(np.array([[0.4]]), np.array([1.0]))
    assert [(row[1], row[2][0]) for row in trace.rows] == [(2, 0.2), (4, 0.4)]
