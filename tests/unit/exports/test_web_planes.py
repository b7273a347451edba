"""The web page's bytes, decoded by hand: planes of maps, pyramids of tiles, the choice of photographs."""

import numpy as np
import pytest

from irpso_addon.exports.web import pyramid
from irpso_addon.exports.web.photographs import photographs_of, spread
from irpso_addon.exports.web.planes import components_of, material_planes, octahedral, share_planes
from irpso_addon.geometry.domain import GeometryBake, domain_of
from irpso_addon.reflectance.model import load_model
from tests.oracles import reflectance as oracles


def vectors(count, seed=0):
    return oracles.unit(np.random.default_rng(seed).normal(size=(1, count, 3)))


def from_octahedral(codes):
    """Cigolle et al. 2014, Survey of Efficient Representations for Independent Unit Vectors, listing 1 and 2."""
    r, g, b = np.moveaxis(np.asarray(codes, np.int64), -1, 0)
    u, v = (np.array([16 * r + b // 16, 16 * g + b % 16]) / 4095) * 2 - 1
    z = 1 - abs(u) - abs(v)
    u, v = (
        np.where(z < 0, (1 - abs(v)) * np.where(u >= 0, 1, -1), u),
        np.where(z < 0, (1 - abs(u)) * np.where(v >= 0, 1, -1), v),
    )
    return oracles.unit(np.stack([u, v, z], axis=-1))


def bake_at(position, covered=None):
    height, width = position.shape[:2]
    covered = np.ones((height, width), bool) if covered is None else covered
    flat = np.zeros((height, width, 4), np.float32)
    return GeometryBake(position.astype(np.float32), flat[..., :3], flat, covered, flat[..., :2])


def test_normals_come_back_within_six_hundredths_of_a_degree():
    normals = vectors(200_000)
    angle = np.degrees(np.linalg.norm(from_octahedral(octahedral(normals)) - normals, axis=-1))
    assert angle.max() < 0.06 and angle.mean() < 0.025


def test_a_normal_that_points_away_is_not_taken_for_a_hole():
    down = octahedral(np.array([[[-1e-6, -1e-6, -1.0]]]))
    assert down.any() and from_octahedral(down)[0, 0] @ [0, 0, -1] > 0.99999


def test_numbers_come_back_within_two_thousandths_of_their_range_and_small_ones_closer():
    model = load_model("metallic_roughness")
    rng = np.random.default_rng(1)
    values = {
        "base_color": rng.uniform(0, 1, (1, 5000, 3)),
        "normal": vectors(5000),
        "metallic": rng.uniform(0, 1, (1, 5000, 1)),
    }
    values["roughness"] = rng.uniform(0.02, 1, (1, 5000, 1))
    components = components_of(model, values, (1, 5000))
    planes = material_planes(model, components, np.ones((1, 5000), bool)) / 255.0
    assert np.abs(planes[1] ** 2 - values["base_color"]).max() < 0.004
    roughness = 0.02 + 0.98 * planes[2][..., :1] ** 2
    error = np.abs(roughness - values["roughness"])
    assert error.max() < 0.004 and error[values["roughness"] < 0.06].max() < 0.0008
    assert np.abs(planes[2][..., 1:2] ** 2 - values["metallic"]).max() < 0.004
    assert np.abs(planes[2][..., 2] ** 2 - 0.5).max() < 0.004  # what has no map has the default


def test_what_is_not_covered_is_zero_in_every_plane():
    covered = np.arange(50).reshape(1, 50) % 3 == 0
    model = load_model("lambert")
    planes = material_planes(model, components_of(model, {"normal": vectors(50)}, (1, 50)), covered)
    assert not planes[:, ~covered].any() and planes[0][covered].any(axis=-1).all()
    shares = share_planes(np.full((1, 50, 2), np.linspace(0, 2, 50)[None, :, None]), covered)
    assert not shares[:, ~covered].any() and (shares[0][covered][:, :2] >= 1).all() and shares.max() == 255


@pytest.mark.parametrize("shape", [(7, 5), (511, 510), (1300, 900)])
def test_tiles_hold_every_texel_once_and_a_margin_of_their_neighbours(shape):
    numbers = np.arange(np.prod(shape)).reshape(shape)
    seen = np.zeros(shape, int)
    for column, row in pyramid.tile_places(*shape):
        tile = pyramid.tile_of(numbers, column, row)
        height, width = tile.shape[0] - 2, tile.shape[1] - 2
        assert max(tile.shape) <= pyramid.TILE
        y, x = row * pyramid.INSIDE, column * pyramid.INSIDE
        seen[y : y + height, x : x + width] += 1
        rows = np.clip(np.arange(y - 1, y + height + 1), 0, shape[0] - 1)
        columns = np.clip(np.arange(x - 1, x + width + 1), 0, shape[1] - 1)
        assert (tile == rows[:, None] * shape[1] + columns).all()
    assert (seen == 1).all()


def test_a_coarser_level_is_the_mean_of_what_is_covered():
    rng = np.random.default_rng(2)
    values, covered = rng.uniform(size=(1021, 700, 2)), rng.uniform(size=(1021, 700)) < 0.6
    (_, _), (half, half_covered), *_ = pyramid.levels(values, covered)
    assert [half_covered.shape] == pyramid.level_shapes(1021, 700)[1:2] == [(511, 350)]
    for y, x in ((0, 0), (100, 37), (510, 349)):  # the last row has no partner
        block, shown = values[2 * y : 2 * y + 2, 2 * x : 2 * x + 2], covered[2 * y : 2 * y + 2, 2 * x : 2 * x + 2]
        assert half_covered[y, x] == shown.any()
        if shown.any():
            np.testing.assert_allclose(half[y, x], block[shown].mean(axis=0), rtol=1e-5)


def test_the_last_level_fits_one_tile():
    shapes = pyramid.level_shapes(3000, 4000)
    assert shapes == [(3000, 4000), (1500, 2000), (750, 1000), (375, 500)]


def test_unseen_photographs_come_first_then_the_lights_farthest_apart():
    angle = np.radians([0, 5, 10, 60, 65, 120, 125, 180])
    lights = np.stack([np.cos(angle), np.sin(angle), 0.3 * np.ones(8), np.zeros(8)], axis=-1)
    bake = bake_at(np.zeros((2, 2, 3)))
    assert spread(lights, bake, [1], 3) == [1, 5, 7] or spread(lights, bake, [1], 3) == [1, 4, 7]
    assert spread(lights, bake, [2, 3], 2) == [2, 3] and spread(lights, bake, [2, 3, 6], 2) == [2, 3]
    assert spread(lights, bake, [], 20) == list(range(8))


def test_near_lights_are_compared_as_seen_from_the_card():
    # As seen from the origin the second light is farthest from the first, from a card at x = 10 the third.
    lights = np.array([[9.0, 0, 1, 1], [2.0, 5, 1, 1], [14.0, 0, 1, 1]])
    assert spread(lights, bake_at(np.full((1, 1, 3), [10.0, 0, 0])), [0], 2) == [0, 2]


def test_the_place_of_every_texel_follows_from_the_upper_left_corner():
    y, x = np.meshgrid(np.arange(30), np.arange(40), indexing="ij")
    position = np.stack([0.1 * x - 3, 0.1 * y + 1, np.full(x.shape, -7.0)], axis=-1)
    domain = domain_of(
        bake_at(position),
        np.ones((1, 30, 40, 4), np.float32),
        np.array([[0, 0, 1, 0]]),
        np.ones((1, 3)),
        np.array([[0, 0, 0, 1]]),
    )
    found = photographs_of(domain, ["a"], [0])
    down, right = 4, 31  # of the texel in row 4 from the top, column 31
    place = found.place[0] + (right + 0.5) * found.place[1] + (down + 0.5) * found.place[2]
    np.testing.assert_allclose(place, position[29 - down, right], atol=1e-5)
    assert found.unseen.all() and not found.warnings


def test_a_lens_that_bends_the_card_is_reported():
    y, x = np.meshgrid(np.linspace(-1, 1, 30), np.linspace(-1, 1, 30), indexing="ij")
    bent = np.stack([x, y, -np.ones_like(x)], axis=-1) * (1 + 0.3 * (x**2 + y**2))[..., None]
    domain = domain_of(
        bake_at(bent),
        np.ones((1, 30, 30, 4), np.float32),
        np.array([[0, 0, 1, 0]]),
        np.ones((1, 3)),
        np.array([[0, 0, 0, 1]]),
    )
    assert "bends the card" in photographs_of(domain, ["a"], []).warnings[0]


def test_white_is_that_of_the_subject_however_small_it_is():
    rng = np.random.default_rng(5)
    stack = np.zeros((2, 30, 40, 4), np.float32)
    stack[:, 4:8, 6:10] = np.concatenate([rng.uniform(0.1, 0.8, (2, 4, 4, 3)), np.ones((2, 4, 4, 1))], axis=-1)
    stack[0, 4, 6] = [9.0, 9.0, 9.0, 0.0]  # a reflection without weight
    subject = stack[0, 4:8, 6:10].reshape(16, 4)[1:, :3], stack[1, 4:8, 6:10, :3]
    flat = bake_at(np.zeros((30, 40, 3)))
    lights = np.tile([[0.0, 0, 1, 0]], (2, 1))
    found = photographs_of(domain_of(flat, stack, lights, np.ones((2, 3)), lights), ["a", "b"], [])
    np.testing.assert_allclose(found.whites, [np.percentile(values, 99.5) for values in subject], rtol=1e-6)
