"""The sample's tile: materials where they belong, and a relief that is a function of the place."""

import numpy as np

from irpso_addon.sample.relief import HALF, THICKNESS, height, tile


def at(x, y):
    found = tile(np.array([x]), np.array([y]))
    return found.base_color[0], float(found.roughness[0]), float(found.metallic[0]), float(found.height[0])


def test_the_ring_the_rope_and_the_beads_are_gold():
    for x, y in ((14.0, 0.0), (0.0, -14.0), (HALF - 23, 4.0), (HALF - 13, 0.0), (58.5, 0.0)):
        colour, roughness, metallic, tall = at(x, y)
        assert metallic == 1 and 0.3 < roughness < 0.45 and colour[0] > colour[1] > colour[2]
        assert tall > THICKNESS + 1


def test_glaze_is_smooth_and_no_metal_and_clay_is_matt():
    for x, y in ((0.0, 0.0), (33.0, 4.0), (75.0 - 8, 30.0), (HALF - 13, 8.7)):
        _, roughness, metallic, _ = at(x, y)
        assert metallic == 0 and 0.1 < roughness < 0.2
    for x, y in ((HALF - 4, 20.0), (86 / np.sqrt(2) + 2, 86 / np.sqrt(2) - 2)):
        _, roughness, metallic, _ = at(x, y)
        assert metallic == 0 and roughness > 0.78


def test_the_field_is_turquoise_and_the_petals_are_ivory():
    field, petal = at(66.0, 20.0)[0], at(42.0, 4.0)[0]
    assert field[1] > 1.3 * field[0] and field[2] > 1.3 * field[0]
    assert petal.min() > 0.15 and petal[0] > petal[2]


def test_values_lie_in_their_ranges_and_do_not_depend_on_the_other_places():
    x, y = np.meshgrid(np.linspace(-HALF, HALF, 81), np.linspace(-HALF, HALF, 81))
    found = tile(x, y)
    for values in (found.base_color, found.roughness, found.metallic):
        assert np.isfinite(values).all() and values.min() >= 0 and values.max() <= 1
    assert found.height.min() > 5 and found.height.max() < 16
    np.testing.assert_array_equal(height(x[10:12, 3:9], y[10:12, 3:9]), found.height[10:12, 3:9])


def test_the_rosette_returns_after_an_eighth_of_a_turn():
    # But for the waves of the glaze, of 0.12 and 0.04 mm.
    around, turn = np.linspace(20, 65, 40), np.radians(45)
    first = height(around * np.cos(0.2), around * np.sin(0.2))
    second = height(around * np.cos(0.2 + turn), around * np.sin(0.2 + turn))
    assert np.abs(first - second).max() < 0.9 and np.ptp(first) > 1.5
