"""Descent in PyTorch: its model, its gradients and what it finds. Skipped where PyTorch is not installed."""

import numpy as np
import pytest
from test_peers_models import problem, shown

torch = pytest.importorskip("torch", reason="PyTorch is not installed: it is for benchmarks alone")

from benchmarks.peers import descent, models  # noqa: E402
from benchmarks.peers.objective import Loss, Objective  # noqa: E402
from benchmarks.peers.problem import angles  # noqa: E402

NAMES = ("lambert", "principled", "cook_torrance_two_lobe")


@pytest.mark.parametrize("model", NAMES)
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-6), (torch.float32, 2e-3)])
def test_pytorch_renders_what_the_oracle_renders(model, dtype, tolerance):
    p = problem(model, texels=100)
    g = models.geometry_of(p)
    tensors = [torch.as_tensor(a, dtype=dtype) for a in (g.lights, g.views, g.half, g.between)]
    values = {name: torch.as_tensor(v, dtype=dtype) for name, v in p.truth.items()}
    diffuse, specular = models.radiance(torch, model, values, models.Geometry(*tensors))
    found = (diffuse[..., None] * values["base_color"] + specular[..., None]).numpy()
    np.testing.assert_allclose(found, shown(model, p.truth, p.lights, p.views), rtol=tolerance, atol=tolerance / 10)


@pytest.mark.parametrize("model", NAMES)
@pytest.mark.parametrize("kind", ["cauchy", "linear"])
def test_the_loss_and_its_gradient_are_numpy_s(model, kind):
    p = problem(model, texels=3)
    loss = Loss(kind)
    fit = descent._Fit(p, loss, torch.float64, False, "cpu")
    objective = Objective(p, loss)
    start = np.random.default_rng(6).uniform(0.35, 0.65, (3, objective.box.size))
    found, slope = fit.gradient(torch.as_tensor(start))
    size = objective.box.size
    for t in range(3):
        assert found[t].item() == pytest.approx(objective.cost(start[t : t + 1], t)[0], rel=1e-9)
        steps = np.concatenate([np.eye(size), -np.eye(size)]) * 1e-6
        costs = objective.cost(start[t] + steps, t)
        expected = (costs[:size] - costs[size:]) / 2e-6
        np.testing.assert_allclose(slope[t], expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize("method", descent.METHODS.values(), ids=descent.METHODS)
def test_descent_finds_a_clean_lambertian_surface(method):
    p = problem("lambert", texels=5, lights=40)
    result = method(p, Loss(), iterations=150, restarts=False, threads=1, trace_every=2)
    assert angles(result.values["normal"], p.truth["normal"]).max() < 0.1
    assert np.abs(result.values["base_color"] - p.truth["base_color"]).max() < 0.01
    seconds = [sample.seconds for sample in result.trace]
    assert seconds == sorted(seconds) and seconds[0] > 0 and seconds[-1] <= result.seconds
    errors = [angles(sample.values["normal"], p.truth["normal"]).mean() for sample in result.trace]
    assert errors[-1] < 0.1


def test_line_searches_of_each_texel_find_a_clean_glossy_material():
    p = problem("principled", texels=4, lights=60, seed=8)
    result = descent.lbfgs_per_texel(p, iterations=150, dtype=torch.float64, threads=1)
    assert angles(result.values["normal"], p.truth["normal"]).max() < 0.01
    assert np.abs(result.values["roughness"] - p.truth["roughness"]).max() < 1e-3


def test_more_starts_never_end_higher():
    p = problem("cook_torrance_two_lobe", texels=6, lights=50)
    objective = Objective(p, Loss())
    ends = []
    for restarts in (False, True):
        result = descent.adam(p, iterations=60, restarts=restarts, dtype=torch.float64, threads=1)
        x = objective.box.numbers(result.values)
        ends.append(np.array([objective.cost(x[t : t + 1], t)[0] for t in range(p.count)]))
    assert (ends[1] <= ends[0] * (1 + 1e-9)).all()
