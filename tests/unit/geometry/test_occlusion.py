"""The sky that a relief leaves open, against rays in float64 and what is known of planes and walls."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from irpso_addon.exports.result import Result
from irpso_addon.geometry.relief.height import TEXELS, Height
from irpso_addon.geometry.relief.occlusion import open_sky
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import Maps


def relief(values):
    return Height(np.asarray(values, np.float32), np.ones(np.shape(values), bool), "texels")


def test_a_plane_sees_the_whole_sky_above_it_however_it_leans():
    x, y = np.meshgrid(np.arange(60.0), np.arange(50.0))
    for plane in (0 * x, 0.8 * x, -0.3 * x + 0.5 * y):
        np.testing.assert_allclose(open_sky(relief(plane)), 1, atol=1e-3)


def test_at_the_foot_of_a_high_wall_half_of_the_light_is_hidden():
    """A long vertical wall hides a quarter sphere, half of the cosine-weighted sky."""
    values = np.zeros((120, 120))
    values[:, 60:] = 1e4
    assert open_sky(relief(values))[60, 59 - 1] == pytest.approx(0.5, abs=0.05)
    values[:, 60:] = 5
    assert open_sky(relief(values))[60, 10] > 0.97, "a low wall far away"


def test_a_wall_across_a_narrow_strip_is_searched_along_the_strip():
    values = np.zeros((8, 200))
    values[:, 100:] = 40
    for distance in (10, 15):  # beyond the width of the strip
        assert open_sky(relief(values))[4, 99 - distance] < 0.98


def test_hollows_of_a_rough_relief_see_what_rays_see():
    random = np.random.default_rng(0)
    values = 45 * gaussian_filter(random.normal(size=(90, 90)), 4, mode="wrap")
    found = open_sky(relief(values), wraps=True)
    down, right = np.gradient(np.tile(values, (3, 3)))
    seen, wanted = [], []
    for row, column in random.integers(0, 90, (40, 2)):
        slope = np.array([right[90 + row, 90 + column], down[90 + row, 90 + column]])
        normal = np.array([-slope[0], -slope[1], 1]) / np.sqrt(1 + slope @ slope)
        rays = random.normal(size=(2000, 3))
        rays = rays / np.linalg.norm(rays, axis=1, keepdims=True) + normal  # cosine-weighted (Lambert)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        along = np.arange(1, 60, 0.5)[:, None] / np.maximum(np.hypot(rays[:, 0], rays[:, 1]), 0.05)
        places = [row + along * rays[:, 1], column + along * rays[:, 0]]
        ground = map_coordinates(values, places, order=1, mode="grid-wrap")
        free = (values[row, column] + 0.05 + along * rays[:, 2] >= ground).all(axis=0)
        wanted.append(free.mean())
        seen.append(found[row, column])
    assert np.std(wanted) > 0.05
    assert np.abs(np.array(seen) - wanted).mean() < 0.01


def test_the_margin_of_a_masked_card_is_as_open_as_its_border():
    values, covered = np.zeros((40, 40), np.float32), np.zeros((40, 40), bool)
    covered[:, :20] = True
    values[:, :17] = 40
    maps = Maps(load_model("lambert"), {}, covered, margin=~covered)  # as read from a folder
    sky = Result("leaf", maps, Height(values, covered, TEXELS)).open_sky
    assert sky[:, 19].max() < 0.9
    np.testing.assert_array_equal(sky[:, 20:28], np.repeat(sky[:, 19:20], 8, axis=1))


def test_a_hole_hides_nothing():
    values, covered = np.zeros((40, 40), np.float32), np.ones((40, 40), bool)
    values[20, 20], covered[20, 20] = 50, False
    np.testing.assert_allclose(open_sky(Height(values, covered, "texels")), 1, atol=1e-3)
