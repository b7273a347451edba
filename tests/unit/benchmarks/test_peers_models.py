"""The peers' own copy of the reflectance models, and the box of numbers that they search."""

import numpy as np
import pytest

from benchmarks.peers import models
from benchmarks.peers.objective import STARTS, Loss, Objective
from benchmarks.peers.problem import Problem, angles, percentile_of
from tests.oracles import reflectance as oracles

NAMES = ("lambert", "principled", "cook_torrance_two_lobe")


def random_values(model: str, count: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    values = {}
    for p in models.Box(model).model.parameters:
        if p.is_normal:
            values[p.name] = oracles.unit(rng.uniform(-0.5, 0.5, (count, 3)) + (0, 0, 1))
        else:
            low, high = max(p.range[0], 0.05), p.range[1]
            values[p.name] = rng.uniform(low, high, (count, p.components))
    return values


def shown(model: str, values: dict[str, np.ndarray], lights: np.ndarray, views: np.ndarray) -> np.ndarray:
    """(K, T, 3) by the oracles."""
    scalars = {name: v if v.shape[1] == 3 else v[:, 0] for name, v in values.items()}
    return np.stack([oracles.MODELS[model](scalars, light[None], views) for light in lights])


def problem(model: str, texels: int = 6, lights: int = 30, noise: float = 0.0, seed: int = 5) -> Problem:
    """Random materials under random lights, each texel from a direction of its own; some light or view grazes."""
    rng = np.random.default_rng(seed)
    light = oracles.unit(rng.uniform(-1, 1, (lights, 3)) + (0, 0, 1))
    views = oracles.unit(rng.uniform(-0.3, 0.3, (texels, 3)) + (0, 0, 1))
    values = random_values(model, texels, rng)
    radiance = shown(model, values, light, views) + noise * rng.normal(size=(lights, texels, 3))
    places = np.stack([np.zeros(texels, int), np.arange(texels)], axis=-1)
    return Problem(
        np.maximum(radiance, 0), np.ones((lights, texels)), light, np.ones((lights, 3)), views, places, model, values
    )


@pytest.mark.parametrize("model", NAMES)
def test_a_peer_renders_what_the_oracle_renders(model):
    p = problem(model, texels=200)
    diffuse, specular = models.radiance(np, model, p.truth, models.geometry_of(p))
    found = diffuse[..., None] * p.truth["base_color"] + specular[..., None]
    np.testing.assert_allclose(found, shown(model, p.truth, p.lights, p.views), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("model", NAMES)
def test_values_come_back_from_the_box(model):
    p = problem(model, texels=50)
    box = models.Box(model)
    numbers = box.numbers(p.truth)
    assert numbers.min() >= 0 and numbers.max() <= 1 and numbers.shape == (50, box.size)
    for name, value in box.values(np, numbers).items():
        np.testing.assert_allclose(value, p.truth[name], atol=1e-12)


def test_the_whole_hemisphere_lies_in_the_box():
    box = models.Box("lambert")
    turn = np.linspace(0, 6, 40)
    flat = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=-1)
    found = box.values(np, box.numbers({"normal": flat, "base_color": np.ones((40, 3))}))["normal"]
    assert angles(found, flat).max() < 1e-9


def test_lobes_are_put_in_order_and_their_weight_with_them():
    values = {name: np.array([[v]]) for name, v in {"r1": 0.5, "r2": 0.2, "w": 0.9}.items()}
    found = models.Box("cook_torrance_two_lobe").ordered(values)
    assert found["r1"] == 0.2 and found["r2"] == 0.5 and found["w"] == pytest.approx(0.1)


def test_the_loss_of_the_truth_is_zero_and_that_of_noise_is_its_definition():
    p = problem("principled", noise=0.01)
    for kind in ("cauchy", "linear"):
        objective = Objective(p, Loss(kind, delta=0.04, shadow=0.0))
        rendered = shown("principled", p.truth, p.lights, p.views)
        error = (rendered - p.radiance) / np.percentile(p.grey, 80, axis=0)[:, None]
        terms = error**2 if kind == "linear" else np.log(1 + (error / 0.04) ** 2)
        for t in range(p.count):
            x = objective.box.numbers({name: v[t : t + 1] for name, v in p.truth.items()})
            assert objective.cost(x, t)[0] == pytest.approx(terms[:, t].sum(), rel=1e-6)


def test_samples_in_shadow_leave_the_loss():
    p = problem("lambert")
    p.radiance[4, 2] = 1e-6
    objective = Objective(p, Loss(shadow=0.1))
    assert objective.weights[4, 2] == 0
    x = objective.box.numbers({name: v[2:3] for name, v in p.truth.items()})
    assert objective.cost(x, 2)[0] < 1e-12


def test_every_start_holds_the_roughness_that_it_names():
    p = problem("cook_torrance_two_lobe")
    objective = Objective(p, Loss())
    starts = [objective.box.values(np, start) for start in objective.starts(restarts=True)]
    assert len(starts) == 1 + len(STARTS["cook_torrance_two_lobe"])
    for row, start in zip(STARTS["cook_torrance_two_lobe"], starts[1:], strict=True):
        np.testing.assert_allclose(start["r1"], row["r1"])
        np.testing.assert_allclose(start["r2"], row["r2"])


def test_percentiles_of_a_part_of_a_column_are_numpy_s():
    rng = np.random.default_rng(2)
    values = rng.random((12, 5))
    count = np.array([12, 7, 3, 1, 2])
    held = np.sort(np.where(np.arange(12)[:, None] < count, values, np.inf), axis=0)
    for q in (0, 20, 80, 100):
        expected = [np.percentile(values[:n, i], q) for i, n in enumerate(count)]
        np.testing.assert_allclose(percentile_of(held, count, q), expected)
