"""The Lambertian peers against scipy, against truth, and against the matrices of their papers."""

import numpy as np
import pytest

from benchmarks.peers import lambertian
from benchmarks.peers.problem import Problem, angles

scipy_optimize = pytest.importorskip("scipy.optimize", reason="scipy is not installed: nothing to compare ℓ1 with")

LIGHTS, TEXELS = 40, 60


def problem(outliers: float, seed: int = 3) -> Problem:
    """A Lambertian subject, lit everywhere, of whose samples a share is spoiled by up to three times its brightness."""
    rng = np.random.default_rng(seed)
    normal = rng.uniform(-0.4, 0.4, (TEXELS, 3)) + (0, 0, 1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    lights = rng.uniform(-0.5, 0.5, (LIGHTS, 3)) + (0, 0, 1)
    lights /= np.linalg.norm(lights, axis=-1, keepdims=True)
    color = rng.uniform(0.2, 0.9, (TEXELS, 3))
    intensities = rng.uniform(0.5, 2, (LIGHTS, 3))
    shade = lights @ normal.T
    spoiled = rng.random(shade.shape) < outliers
    radiance = color * shade[..., None] + np.where(spoiled, rng.uniform(0.3, 3, shade.shape), 0)[..., None]
    weights = np.ones((LIGHTS, TEXELS))
    views = np.tile((0.0, 0.0, 1.0), (TEXELS, 1))
    texels = np.stack([np.zeros(TEXELS, int), np.arange(TEXELS)], axis=-1)
    truth = {"normal": normal, "base_color": color}
    return Problem(radiance * intensities[:, None], weights, lights, intensities, views, texels, "lambert", truth)


@pytest.mark.parametrize("method", lambertian.METHODS.values(), ids=lambertian.METHODS)
def test_every_method_finds_a_clean_lambertian_surface(method):
    p = problem(0)
    result = method(p)
    assert angles(result.values["normal"], p.truth["normal"]).max() < 0.01
    np.testing.assert_allclose(result.values["base_color"], p.truth["base_color"], rtol=1e-3)


@pytest.mark.parametrize("name", ["l1", "sparse bayesian"])
def test_a_sparse_method_is_not_moved_by_a_sixth_of_outliers(name):
    p = problem(1 / 6)
    plain = angles(lambertian.least_squares(p).values["normal"], p.truth["normal"])
    assert plain.mean() > 5
    assert angles(lambertian.METHODS[name](p).values["normal"], p.truth["normal"]).max() < 0.1


def test_low_rank_and_trimming_lessen_what_outliers_do():
    p = problem(0.1)
    plain = angles(lambertian.least_squares(p).values["normal"], p.truth["normal"]).mean()
    for name in ("low rank", "trimmed"):
        assert angles(lambertian.METHODS[name](p).values["normal"], p.truth["normal"]).mean() < plain / 3


def test_the_l1_fit_is_the_linear_program_s():
    p = problem(0.45)
    result = lambertian.least_absolute(p, shadow=0)
    for t in range(8):
        y = p.grey[:, t]
        cost = np.concatenate([np.zeros(3), np.ones(LIGHTS)])
        L, one = p.lights, np.eye(LIGHTS)
        above = np.concatenate([np.hstack([L, -one]), np.hstack([-L, -one])])
        found = scipy_optimize.linprog(
            cost, above, np.concatenate([y, -y]), bounds=[(None, None)] * 3 + [(0, None)] * LIGHTS
        )
        b = result.values["normal"][t] * result.values["base_color"][t].mean()
        assert np.abs(y - L @ b).sum() == pytest.approx(found.fun, rel=1e-3)


def test_sparse_bayesian_updates_are_those_of_the_full_matrices():
    p = problem(0.2)
    steps, noise = 7, 1e-2
    found = lambertian.sparse_bayesian(p, noise=noise, iterations=steps).values["normal"]
    scale = np.percentile(p.grey, 80, axis=0)
    for t in range(5):
        y, L = p.grey[:, t] / scale[t], p.lights
        gamma = np.ones(LIGHTS)
        for _ in range(steps):
            prior = np.diag(np.concatenate([np.full(3, 1e7), gamma]))
            design = np.hstack([L, np.eye(LIGHTS)])
            gain = prior @ design.T @ np.linalg.inv(noise * np.eye(LIGHTS) + design @ prior @ design.T)
            mean, spread = gain @ y, prior - gain @ design @ prior
            gamma = mean[3:] ** 2 + np.diag(spread)[3:]
        weight = np.diag(1 / (gamma + noise))
        expected = np.linalg.solve(L.T @ weight @ L, L.T @ weight @ y)
        assert angles(found[t : t + 1], expected[None])[0] < 1e-2


def test_the_low_rank_part_restores_a_matrix_of_rank_three_with_gaps_and_spikes():
    rng = np.random.default_rng(0)
    truth = rng.random((50, 3)) @ rng.random((3, 400))
    fixed = rng.random(truth.shape) > 0.15
    spoiled = truth + np.where(rng.random(truth.shape) < 0.05, rng.uniform(1, 4, truth.shape), 0)
    found = lambertian._low_rank_part(spoiled, fixed, 1.0, 1e-7, 1000)
    assert np.abs(found - truth).max() < 1e-3


def test_samples_without_weight_or_in_shadow_are_not_looked_at():
    p = problem(0)
    lot = np.random.default_rng(1).random(p.weights.shape)
    weights = np.where(lot < 0.1, 0, p.weights)
    radiance = np.where(lot < 0.1, 100.0, np.where(lot < 0.2, 1e-3, 1))[..., None] * p.radiance
    changed = Problem(radiance, weights, p.lights, p.intensities, p.views, p.texels, p.model, p.truth)
    for method in lambertian.METHODS.values():
        assert angles(method(changed, shadow=0.1).values["normal"], p.truth["normal"]).max() < 0.01


def test_a_subset_of_a_problem_gives_the_same_answers_as_the_whole():
    p = problem(0.2)
    whole, part = lambertian.sparse_bayesian(p), lambertian.sparse_bayesian(p.subset([3, 11, 40]))
    np.testing.assert_allclose(part.values["normal"], whole.values["normal"][[3, 11, 40]], atol=1e-9)
