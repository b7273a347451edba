"""Encoding of maps against formulas and a brute-force nearest-texel search."""

import numpy as np
import pytest

from irpso_addon.core.encode import encode_normal, fill_margin, linear_from_srgb, srgb_from_linear


def test_the_srgb_curve_goes_through_the_points_of_the_standard():
    # IEC 61966-2-1: the linear segment ends at 0.0031308; 8-bit code 118 is 0.1812 and code 188 is 0.5029.
    linear = np.array([0.0, 0.0031308, 0.18116424, 0.50288645, 1.0])
    expected = np.array([0.0, 0.0031308 * 12.92, 118 / 255, 188 / 255, 1.0])
    np.testing.assert_allclose(srgb_from_linear(linear), expected, atol=2e-7)


def test_srgb_decoding_undoes_encoding():
    values = np.linspace(0, 1, 4001)
    np.testing.assert_allclose(linear_from_srgb(srgb_from_linear(values)), values, atol=3e-7)


def test_negative_radiance_encodes_to_black():
    assert srgb_from_linear(np.array([-0.5]))[0] == 0


def test_normals_are_normalised_before_they_are_encoded_and_no_vector_is_the_flat_normal():
    vectors = np.array([[0, 0, 2.0], [-3, 0, 0], [0, 0, 0], [0.6, 0, 0.8]])
    expected = [[0.5, 0.5, 1], [0, 0.5, 0.5], [0.5, 0.5, 1], [0.8, 0.5, 0.9]]
    np.testing.assert_allclose(encode_normal(vectors), expected, atol=1e-6)


@pytest.fixture
def islands():
    rng = np.random.default_rng(7)
    covered = np.zeros((40, 57), bool)
    covered[5:9, 3:20] = covered[25:33, 40:45] = True
    covered[0, 56] = covered[38, 2] = True
    values = rng.random((40, 57, 3)).astype(np.float32)
    values[~covered] = np.nan
    return values, covered


def test_a_margin_texel_takes_the_value_of_a_nearest_covered_texel(islands):
    values, covered = islands
    filled = fill_margin(values, covered, texels=8)
    rows, columns = np.nonzero(covered)
    for y, x in np.argwhere(~covered):
        distance = (rows - y) ** 2 + (columns - x) ** 2
        if distance.min() <= 64:
            nearest = values[rows[distance == distance.min()], columns[distance == distance.min()]]
            assert (nearest == filled[y, x]).all(axis=1).any(), (y, x)


def test_texels_beyond_the_margin_hold_the_mean_or_the_given_value(islands):
    values, covered = islands
    rows, columns = np.nonzero(covered)
    y, x = np.mgrid[:40, :57]
    distance = ((y[..., None] - rows) ** 2 + (x[..., None] - columns) ** 2).min(axis=-1)
    mean = values[covered].astype(np.float64).mean(axis=0)
    np.testing.assert_allclose(
        fill_margin(values, covered)[distance > 64], np.broadcast_to(mean, (np.sum(distance > 64), 3)), atol=1e-6
    )
    assert (fill_margin(values, covered, far=(0, 0, 1))[distance > 64] == (0, 0, 1)).all()


def test_a_margin_of_no_texels_fills_everything_with_the_far_value(islands):
    values, covered = islands
    filled = fill_margin(values, covered, texels=0, far=(0, 0, 1))
    np.testing.assert_array_equal(filled, np.where(covered[..., None], values, np.float32((0, 0, 1))))


def test_covered_texels_are_left_as_they_are(islands):
    values, covered = islands
    np.testing.assert_array_equal(fill_margin(values, covered)[covered], values[covered])
    everywhere = np.ones_like(covered)
    np.testing.assert_array_equal(fill_margin(np.nan_to_num(values), everywhere), np.nan_to_num(values))


def test_a_map_with_nothing_covered_is_black():
    assert not fill_margin(np.full((4, 4, 2), np.nan), np.zeros((4, 4), bool)).any()
