"""The colour chart: published colours, and the picture that the sample photographs."""

import numpy as np
import pytest

from irpso_addon.calibration.radiometry.colour_chart import PATCHES, patch_colours
from irpso_addon.sample import layout
from irpso_addon.sample.chart import TALL, WIDE, chart_picture


def test_the_grey_patches_have_their_published_lightness():
    # L* of the maker's Lab values (D50). Its sRGB values, of 8 bits, are up to 1.24 off these, for black.
    published = (96.54, 81.26, 66.77, 50.87, 35.66, 20.46)
    luminance = patch_colours()[3] @ (0.2126, 0.7152, 0.0722)
    lightness = 116 * np.cbrt(luminance) - 16
    np.testing.assert_allclose(lightness, published, atol=1.3)
    assert np.ptp(patch_colours()[3], axis=-1).max() < 0.012


def test_patches_have_the_order_of_the_chart():
    assert [list(PATCHES).index(name) for name in ("dark skin", "bluish green", "white", "black")] == [0, 5, 18, 23]
    red, blue = patch_colours()[2, 2], patch_colours()[2, 0]
    assert (
        np.argmax(red) == 0 and np.argmax(blue) == 2 and red[0] == pytest.approx(((175 / 255 + 0.055) / 1.055) ** 2.4)
    )


def test_the_picture_has_each_patch_at_its_place():
    picture = chart_picture()
    size = np.array(picture.shape[1::-1]) / (WIDE, TALL)
    places = layout.chart_patches()[..., :2] - layout.CHART + np.array((WIDE, TALL)) / 2
    column, row = np.moveaxis((places * size).astype(int), -1, 0)
    np.testing.assert_array_equal(picture[row, column], patch_colours())
    gap = ((places + (layout.PITCH / 2, 0)) * size).astype(int)[:-1]
    assert picture[gap[..., 1], gap[..., 0]].max() < 0.02
    assert picture[[0, 0, -1, -1], [0, -1, 0, -1]].max() < 0.02


def test_the_corners_enclose_the_patches():
    low, high = layout.chart_corners()[:, :2].min(axis=0), layout.chart_corners()[:, :2].max(axis=0)
    middles = layout.chart_patches()[..., :2].reshape(-1, 2)
    np.testing.assert_allclose(middles.min(axis=0) - low, layout.PATCH / 2)
    np.testing.assert_allclose(high - middles.max(axis=0), layout.PATCH / 2)
    np.testing.assert_allclose(layout.chart_corners()[0, :2] + layout.PATCH / 2, layout.chart_patches()[0, 0, :2])
