"""The benchmarks' synthetic captures against their formulas, and the bound of what they tell against the oracle."""

from dataclasses import replace

import numpy as np
import pytest

ndimage = pytest.importorskip("scipy.ndimage", reason="scipy is not installed: interreflection is blurred by it")

from benchmarks import subjects  # noqa: E402
from benchmarks.identifiable import bounds  # noqa: E402
from irpso_addon.reflectance.model import load_model  # noqa: E402
from tests.oracles import confidence as confidence_oracle  # noqa: E402

MODELS = (subjects.TWO_LOBES, "principled")


@pytest.mark.parametrize("model", MODELS)
def test_a_clean_card_is_what_the_oracle_renders(model):
    card = subjects.make_card((5, 7), 20, subjects.CLEAN, seed=4, model=model)
    wanted = confidence_oracle.radiance(card.domain, model, card.truth)
    np.testing.assert_allclose(card.domain.stack.values[..., :3], wanted, rtol=2e-6, atol=1e-7)
    assert (card.domain.stack.values[..., 3] == 1).all() and card.domain.solvable.all()


def test_lights_are_even_over_the_sphere_above_the_lowest():
    lights = subjects.spiral_lights(400, lowest=0.3)
    np.testing.assert_allclose(np.linalg.norm(lights, axis=1), 1)
    # Archimedes: even over a sphere is even in z, and no side has more than another.
    np.testing.assert_allclose(np.sort(lights[:, 2]), np.linspace(0.3, 1, 401)[:-1] + 0.7 / 800, atol=1e-12)
    assert np.abs(lights[:, :2].mean(axis=0)).max() < 0.01


def test_cast_shadow_takes_a_connected_part_of_the_lights_of_every_texel():
    card = subjects.make_card(6, 40, subjects.SHADOWED, seed=2)
    lights = card.domain.lights[:, :3]
    assert (card.shadowed.sum(axis=0) == 6).all()  # 15 % of 40
    for row, column in np.ndindex(6, 6):
        missing = card.shadowed[:, row, column]
        # The cap around one of them holds them all, and no other light.
        apart = [
            (lights[missing] @ lights[k]).min() - (lights[~missing] @ lights[k]).max() for k in np.flatnonzero(missing)
        ]
        assert max(apart) >= -1e-6
    assert len(np.unique(card.shadowed.reshape(40, -1), axis=1).T) > 12  # drawn for each texel alone
    assert (card.domain.stack.values[..., :3][card.shadowed] < 0.02).all()


def test_interreflection_adds_its_part_of_the_blurred_surroundings():
    degradation = subjects.Degradation("", 0.0, 0.15, 0.1)
    card = subjects.make_card((20, 25), 12, degradation, seed=5)
    direct = confidence_oracle.radiance(card.domain, card.model, card.truth)
    direct[card.shadowed] = 0
    wide = 25 * subjects.BLUR
    blurred = ndimage.gaussian_filter(direct, (0, wide, wide, 0), mode="reflect")
    np.testing.assert_allclose(card.domain.stack.values[..., :3], direct + 0.1 * blurred, rtol=1e-4, atol=1e-6)


def test_noise_has_its_deviation_and_no_sample_is_negative():
    clean, noisy = (subjects.make_card(24, 50, degradation, seed=6).domain.stack.values[..., :3] for degradation in (
        subjects.CLEAN, replace(subjects.CLEAN, noise=0.01)))  # fmt: skip
    lit = clean > 0.1
    assert (noisy - clean)[lit].std() == pytest.approx(0.01, rel=0.02) and noisy.min() == 0


@pytest.mark.parametrize("model", MODELS)
def test_the_bound_is_that_of_the_oracles_jacobian(model):
    card = subjects.make_card((4, 5), 60, subjects.CLEAN, seed=7, model=model)
    table = load_model(model)
    matrix, variance = confidence_oracle.normal_matrix(card.domain, table, card.truth)
    inverse = 0.003**2 * np.linalg.inv(matrix.reshape(-1, *matrix.shape[-2:]))
    wanted = confidence_oracle.unknowns(table)
    found = bounds(card, 0.003)
    for p in table.parameters:
        own = [i for i, (q, _, _) in enumerate(wanted) if q.name == p.name]
        if p.is_normal:  # of other tangents: both angles together are the same in any
            total = np.sqrt(inverse[:, own, own].sum(axis=1))
            assert (found[p.name] <= total * 1.001).all() and (found[p.name] >= total * 0.7).all()
        else:
            np.testing.assert_allclose(found[p.name], np.sqrt(inverse[:, own, own].max(axis=1)), rtol=1e-3)


def test_errors_are_degrees_and_parts_of_the_range():
    model = subjects.TWO_LOBES
    truth = {"normal": np.array([[0.0, 0, 1]]), "r1": np.array([[0.2]]), "base_color": np.array([[0.5, 0.5, 0.5]])}
    tilted = np.array([[0, np.sin(0.1), np.cos(0.1)]])
    values = {"normal": tilted, "r1": np.array([[0.275]]), "base_color": np.array([[0.5, 0.48, 0.51]])}
    found = subjects.errors_of(model, values, truth)
    assert found["normal"] == pytest.approx(np.degrees(0.1))
    assert found["r1"] == pytest.approx(10.0)  # of 0.75
    assert found["base_color"] == pytest.approx(2.0)  # the worst channel


def test_fewer_sampled_texels_are_a_part_of_more():
    more, fewer = subjects.sample(1000, 64), subjects.sample(1000, 16)
    assert set(fewer) <= set(more) and len(set(more)) == 64
