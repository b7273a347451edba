"""Numbers drawn to those of texels of like colour, beside sums over all pairs of texels."""

import numpy as np

from irpso_addon.solver.interreflection.shrinkage import shrunk_to_similar_colours

CELLS, WIDTH = 24, 0.06


def by_pairs(values, deviations, root, counted):
    """The same with a sum over all pairs of texels, at colours whose roots lie on the cells."""
    apart = ((root[:, None] - root) ** 2).sum(axis=-1)
    like = np.exp(-apart / (2 * WIDTH**2)) * counted
    weight = 1 / deviations**2
    total = like @ weight
    mean = like @ (weight * values) / total
    spread = like @ (weight * values**2) / total - mean**2 - like.sum(axis=1) / total
    prior = 1 / np.maximum(spread, 1e-4)
    return (weight * values + prior * mean) / (weight + prior)


def test_the_means_are_those_over_all_pairs():
    rng = np.random.default_rng(5)
    root = rng.integers(8, 15, (300, 3)) / (CELLS - 1)
    values, deviations = rng.random(300), rng.uniform(0.01, 1, 300)
    counted = rng.random(300) < 0.8
    found = shrunk_to_similar_colours(values[:, None], deviations[:, None], root**2, counted)
    assert found.shape == (300, 1) and found.dtype == np.float32
    np.testing.assert_allclose(found[:, 0], by_pairs(values, deviations, root, counted), atol=1e-5)


def test_an_unsure_texel_takes_the_number_of_its_own_colour():
    colour = np.repeat([[0.6, 0.1, 0.1], [0.1, 0.1, 0.6]], 50, axis=0)
    values, deviations = np.repeat([[0.3], [0.8]], 50, axis=0), np.full((100, 1), 0.02)
    values[7], deviations[7] = 1.0, 1.0
    found = shrunk_to_similar_colours(values, deviations, colour, np.ones(100, bool))
    np.testing.assert_allclose(found[7], 0.3, atol=0.01)
    np.testing.assert_allclose(np.delete(found, 7, axis=0), np.delete(values, 7, axis=0), atol=0.01)


def test_of_one_colour_and_two_materials_the_sure_keep_their_own():
    values = np.repeat([[0.15], [0.6]], 50, axis=0)
    deviations = np.full((100, 1), 0.02)
    deviations[3] = 10.0
    found = shrunk_to_similar_colours(values, deviations, np.full((100, 3), 0.5), np.ones(100, bool))
    np.testing.assert_allclose(np.delete(found, 3, axis=0), np.delete(values, 3, axis=0), atol=0.003)
    assert 0.3 < found[3] < 0.45, "it may be either"


def test_without_a_texel_that_counts_all_keep_theirs():
    values = np.random.default_rng(1).random((20, 2)).astype(np.float32)
    found = shrunk_to_similar_colours(values, np.ones((20, 2)), np.full((20, 3), 0.5), np.zeros(20, bool))
    np.testing.assert_allclose(found, values, atol=1e-6)
