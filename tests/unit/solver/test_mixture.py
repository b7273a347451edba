"""Materials that texels share: the texel subset of a domain, whatever its parts, and the mixture found in it."""

import numpy as np
import pytest

from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.phases.mixture import features_of, material_table, mixture
from irpso_addon.solver.state.texel_subset import MAX_TEXELS, chosen_texels, merged_subset

SIZES, MIDDLES, SPREADS = (1500, 900, 600), ((1.0, 2.0, 8.0), (6.0, 7.0, 1.0), (3.0, 9.0, 5.0)), (0.6, 0.8, 1.1)


@pytest.fixture(scope="module")
def groups():
    rng = np.random.default_rng(2)
    return [rng.normal(m, s, (n, 3)) for n, m, s in zip(SIZES, MIDDLES, SPREADS, strict=True)]


def share_at(table, point):
    """How much of the surface is like a point, of a table, in float64."""
    numbers = table.astype(np.float64)[:6].transpose(1, 0, 2).reshape(table.shape[1], 24)
    mean, inverse = numbers[:, : len(point)], numbers[:, 12 : 12 + len(point)]
    return (table[6, :, 0] * np.exp(-0.5 * ((point - mean) ** 2 * inverse).sum(axis=1))).sum()


def test_groups_that_lie_apart_are_found_with_their_shares_means_and_variances(groups):
    share, mean, variance = mixture(np.concatenate(groups), np.ones(sum(map(len, groups))), 3)
    order = np.argsort(-share)
    np.testing.assert_allclose(share[order], np.array(SIZES) / sum(SIZES), atol=0.01)
    np.testing.assert_allclose(mean[order], [group.mean(axis=0) for group in groups], atol=0.05)
    np.testing.assert_allclose(variance[order], [group.var(axis=0) for group in groups], rtol=0.15)


@pytest.mark.parametrize("count", [3, 8])
def test_the_share_of_a_material_is_how_many_of_the_texels_are_like_it(groups, count):
    x = np.concatenate(groups)
    table = material_table(x, np.ones(len(x)), count)
    for point in [*np.array(MIDDLES), (1.5, 2.5, 7.0), (3.5, 4.5, 4.5)]:
        alike = np.exp(-0.5 * ((x - point) ** 2).sum(axis=1)).mean()
        assert share_at(table, np.asarray(point)) == pytest.approx(alike, rel=0.1, abs=2e-3)


@pytest.mark.parametrize("texels", [1, 2, 500])
def test_a_surface_of_one_material_has_one(texels):
    table = material_table(np.tile([2.0, 5.0, 0.0, 1.0], (texels, 1)), np.ones(texels), 16)
    assert table.shape == (7, 1, 4)
    assert share_at(table, np.array([2.0, 5.0, 0.0, 1.0])) == pytest.approx(1 / 1.25**2)  # of the least variance


def test_a_texel_counts_by_its_weight(groups):
    """The mixture of weighted texels is that of texels which occur as often as their weights say."""
    times = np.random.default_rng(3).integers(1, 4, sum(map(len, groups)))
    x = np.concatenate(groups)
    weighted, repeated = mixture(x, 0.5 * times, 3), mixture(np.repeat(x, times, axis=0), np.ones(times.sum()), 3)
    for found, expected in zip(weighted, repeated, strict=True):
        np.testing.assert_allclose(np.sort(found, axis=0), np.sort(expected, axis=0), rtol=1e-3)


def test_texels_of_nan_are_no_material(groups):
    x = np.concatenate(groups)
    spoilt = np.concatenate([x[:1000], np.full((5, 3), np.nan), x[1000:]])
    np.testing.assert_array_equal(
        material_table(spoilt, np.ones(len(spoilt)), 4), material_table(x, np.ones(len(x)), 4)
    )
    assert np.isfinite(material_table(np.full((3, 3), np.nan), np.ones(3), 4)).all()


def test_the_texel_subset_is_that_of_the_whole_whatever_the_parts_and_their_order():
    rng = np.random.default_rng(5)
    rows, columns = (a.ravel() for a in np.mgrid[100:250, 7:97])
    values = rng.uniform(size=(len(rows), 4)).astype(np.float32)
    whole = chosen_texels(rows, columns, values)
    assert len(whole) == MAX_TEXELS < len(rows)
    part = rng.integers(0, 5, len(rows))
    parts = [chosen_texels(rows[part == i], columns[part == i], values[part == i]) for i in rng.permutation(5)]
    merged = merged_subset(parts)
    for name in ("ranks", "rows", "columns", "values"):
        assert getattr(merged, name).tobytes() == getattr(whole, name).tobytes()
    # From all over the domain: no eighth of its rows has a share much unlike another's.
    counts, _ = np.histogram(whole.rows, 8)
    assert counts.min() > 0.85 * MAX_TEXELS / 8
    at = (whole.rows - 100) * 90 + whole.columns - 7
    np.testing.assert_array_equal(whole.values, values[at])


def test_features_scale_each_parameter_by_its_unit():
    model = load_model("metallic_roughness")
    parameters = [p for p in model.parameters if p.name != "specular"]
    values = np.zeros((1, model.components))
    for name, value in {"base_color": (0.25, 0.04, 1.0), "normal": (0.1, 0.2, 0.97), "roughness": 0.51,
                        "metallic": 0.7}.items():  # fmt: skip
        at = model.offset(name)
        values[0, at : at + np.size(value)] = value
    # base_color by roots in units of 0.15, normal, roughness on its range from 0.02 to 1 and metallic in units of 0.1
    expected = [0.5 / 0.15, 0.2 / 0.15, 1 / 0.15, 0, 0, 5.0, 7.0]
    np.testing.assert_allclose(features_of(model, parameters, values)[0], expected)
