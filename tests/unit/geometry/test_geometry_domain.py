"""Domains: cards made from captures, their parts and tiles."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from irpso_addon.capture.camera import Camera
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.core.errors import InputError
from irpso_addon.geometry.build import domain_from_card
from irpso_addon.geometry.domain import GeometryBake, subset, tile
from irpso_addon.geometry.surface.mesh import check_uvs
from irpso_addon.geometry.surface.udim import lay_out
from tests.oracles.geometry import plane

# A camera turned a quarter about z and moved: its x axis is the world's y, its y axis the world's −x.
TURNED = np.array([[0, -1, 0, 10], [1, 0, 0, 20], [0, 0, 1, 30], [0, 0, 0, 1.0]])


def capture(count=3, width=7, height=5, matrix=None, perspective=True, mask=None, lights=None, images=None):
    rng = np.random.default_rng(1)
    matrix = np.eye(4) if matrix is None else matrix
    camera = Camera(width, height, (6.0, 6.0), (3.0, 2.0), matrix, perspective)
    pictures = images or [rng.uniform(0.1, 1, (height, width, 4)).astype(np.float32) for _ in range(count)]
    lights = lights or [Light((0.6, 0, 0.8), (1, 2, 3))] * count
    observations = tuple(Observation(f"image {k}", lambda k=k: pictures[k], light) for k, light in enumerate(lights))
    mask = np.ones((height, width), bool) if mask is None else mask
    return Capture("test", observations, (camera,), (mask,)), pictures


def test_a_card_lies_pixel_for_pixel_on_the_image():
    taken, pictures = capture()
    domain = domain_from_card(replace(taken, card_distance=2.0))
    assert domain.card and domain.shape == (5, 7) and domain.observations == 3
    np.testing.assert_array_equal(domain.stack.values, np.stack(pictures))
    np.testing.assert_allclose(domain.bake.position[2, 3], [(3.5 - 3) / 6 * 2, (2.5 - 2) / 6 * 2, -2], atol=1e-6)
    assert (domain.bake.normal == (0, 0, 1)).all() and (domain.bake.tangent == (1, 0, 0, 1)).all()
    np.testing.assert_allclose(domain.bake.uv[4, 0], [0.5 / 7, 4.5 / 5])
    np.testing.assert_array_equal(domain.views, [[0, 0, 0, 1]] * 3)
    np.testing.assert_array_equal(domain.intensities, [[1, 2, 3]] * 3)


def test_lights_of_a_card_are_turned_into_the_cameras_frame():
    lights = [Light((0, 0.6, 0.8)), Light((10, 21, 31), distant=False), Light((3, 0, 4))]
    domain = domain_from_card(replace(capture(matrix=TURNED, lights=lights, perspective=False)[0], card_distance=1.0))
    np.testing.assert_allclose(domain.lights, [[0.6, 0, 0.8, 0], [1, 0, 1, 1], [0, -0.6, 0.8, 0]], atol=1e-6)
    np.testing.assert_array_equal(domain.views, [[0, 0, 1, 0]] * 3)


def test_beams_of_a_card_are_turned_into_the_cameras_frame():
    lights = [Light((10, 21, 31), distant=False, axis=(0, 0.6, -0.8), cone=30.0, cosine=2.0), Light((0, 0, 1))]
    domain = domain_from_card(replace(capture(matrix=TURNED, lights=lights)[0], card_distance=1.0))
    spot = [*domain.lights[0, :3], 0.6, 0, -0.8, np.sqrt(0.75), 2]
    np.testing.assert_allclose(domain.beams, [spot, [*domain.lights[1, :3], 0, 0, 0, -1, 0]], atol=1e-6)
    np.testing.assert_array_equal(subset(domain, [1]).beams, domain.beams[1:])
    assert domain_from_card(capture()[0]).beams is None


def test_the_stack_is_zero_outside_the_mask_and_at_nan():
    mask = np.ones((5, 7), bool)
    mask[0] = False
    taken, pictures = capture(mask=mask)
    pictures[1][3, 3] = (np.nan, np.inf, 1, 0)
    domain = domain_from_card(taken)
    assert (domain.stack.values[:, 0] == 0).all() and (domain.stack.values[1, 3, 3] == 0).all()
    assert (domain.bake.coverage == mask).all() and domain.solvable.sum() == 28


def test_a_clipped_pixel_of_a_card_keeps_its_radiance_and_has_no_weight():
    taken, pictures = capture()
    pictures[1][3, 3, 3] = 0
    domain = domain_from_card(taken)
    np.testing.assert_array_equal(domain.stack.values[1, 3, 3], [*pictures[1][3, 3, :3], 0])


def test_a_card_keeps_its_radiance_outside_a_spots_cone():
    spot = Light((0, 0, 0), (1, 1, 1), distant=False, axis=(0, 0, -1), cone=10.0)
    taken, pictures = capture(lights=[spot] * 3)
    domain = domain_from_card(replace(taken, card_distance=1.0))
    dark = domain.stack.values[0, ..., 3] == 0
    assert dark.any() and not dark.all()
    np.testing.assert_array_equal(domain.stack.values[0, ..., :3][dark], pictures[0][..., :3][dark])


def test_a_texel_that_is_black_under_every_light_is_not_solvable():
    taken, pictures = capture()
    for picture in pictures:
        picture[2, 2, :3] = picture[4, 1, :3] = 0
    pictures[1][4, 1, 2] = 1e-6  # one channel of one frame is enough
    expected = np.ones((5, 7), bool)
    expected[2, 2] = False
    np.testing.assert_array_equal(domain_from_card(taken).solvable, expected)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mask": np.zeros((5, 7), bool)}, "covers nothing"),
        ({"mask": np.ones((7, 5), bool)}, "5 × 7"),
        ({"images": [np.ones((4, 7, 4), np.float32)] * 3}, "'image 0' is 7 × 4, its camera 7 × 5"),
        ({"images": [np.ones((5, 7, 3), np.float32)] * 3}, r"'image 0' has the shape \(5, 7, 3\); give \(H, W, 4\)"),
        ({"images": [np.zeros((5, 7, 4), np.float32)] * 3}, "shows the card"),
        ({"images": [np.zeros((5, 7, 4), np.float32)], "lights": [], "count": 0}, "no images"),
    ],
)
def test_an_invalid_card_is_refused_with_the_reason(change, message):
    with pytest.raises(InputError, match=message):
        domain_from_card(capture(**change)[0])


@pytest.mark.parametrize("vector", [(0, 0, 0), (0, np.nan, 1), (np.inf, 0, 1)])
def test_a_light_without_a_direction_is_refused(vector):
    with pytest.raises(InputError, match="three finite numbers, a direction not all zero"):
        Light(vector)
    with pytest.raises(InputError, match="three finite numbers"):
        Light((0, np.nan, 1), distant=False)


def test_a_card_of_two_cameras_is_refused():
    one, _ = capture()
    with pytest.raises(InputError, match="2 cameras"):
        domain_from_card(Capture("test", one.observations, one.cameras * 2, one.masks * 2))


@pytest.mark.parametrize("chosen", [[2, 0], np.array([True, False, True])])
def test_a_subset_keeps_the_chosen_observations(chosen):
    lights = [Light((0, 0, 1), (k, k, k)) for k in range(3)]
    domain = domain_from_card(capture(lights=lights)[0])
    part = subset(domain, chosen)
    expected = [2, 0] if isinstance(chosen, list) else [0, 2]
    assert part.intensities[:, 0].tolist() == expected
    np.testing.assert_array_equal(part.stack.values, domain.stack.values[expected])


def test_tiles_without_halos_make_up_the_domain():
    domain = domain_from_card(capture(width=23, height=17)[0])
    whole = np.full_like(domain.stack.values, np.nan)
    for y0 in range(0, 17, 6):
        for x0 in range(0, 23, 8):
            width, height = min(8, 23 - x0), min(6, 17 - y0)
            part = tile(domain, x0, y0, width, height, halo=3)
            left, right, bottom, top = part.halo
            assert part.origin == (x0 - left, y0 - bottom)
            assert part.halo == (min(3, x0), min(3, 23 - x0 - width), min(3, y0), min(3, 17 - y0 - height))
            assert part.shape == part.stack.values.shape[1:3] == (height + bottom + top, width + left + right)
            ox, oy = part.origin
            h, w = part.shape
            np.testing.assert_array_equal(part.bake.uv, domain.bake.uv[oy : oy + h, ox : ox + w])
            inner = part.stack.values[:, bottom : h - top, left : w - right]
            whole[:, y0 : y0 + height, x0 : x0 + width] = inner
    np.testing.assert_array_equal(whole, domain.stack.values)


@pytest.mark.parametrize("box", [(-1, 0, 4, 4), (4, 0, 4, 4), (0, 0, 0, 4), (0, 3, 2, 3)])
def test_a_tile_outside_the_domain_is_an_error(box):
    with pytest.raises(ValueError, match="leaves the domain"):
        tile(domain_from_card(capture()[0]), *box)


def test_texture_coordinates_across_the_squares_border_are_refused_with_count_and_range():
    mesh = plane(columns=2, rows=1, u_span=(0.4, 1.4))
    with pytest.raises(InputError, match=r"Rock: 2 of 4 triangles do not lie .* \(u 0.4 to 1.4, v 0 to 1; 2 cross"):
        lay_out("Rock", mesh.uvs)


def test_texture_coordinates_within_rounding_of_the_square_are_accepted():
    mesh = plane(u_span=(0.0, 1 + 5e-6))
    tiles, uvs = lay_out("Rock", mesh.uvs)
    assert tiles == (1001,) and uvs is mesh.uvs


def test_collapsed_texture_coordinates_are_refused_with_their_share_of_the_surface():
    mesh = plane(columns=2, rows=1)
    uvs = mesh.uvs.copy()
    uvs[0] = uvs[0, 0]
    with pytest.raises(InputError, match="no area to 25 % of the surface"):
        check_uvs("Rock", "UVMap", mesh.positions, uvs)
    with pytest.raises(InputError, match="not numbers"):
        check_uvs("Rock", "UVMap", mesh.positions, uvs * np.nan)


def test_texel_frames_follow_the_tangent_sign():
    rng = np.random.default_rng(5)
    # Columns: tangent, bitangent, normal of a right-handed frame.
    turns = Rotation.from_rotvec(2 * rng.normal(size=(12, 3))).as_matrix()
    sign = np.resize([1.0, -1, -1], 12)
    tangent = np.concatenate([turns[..., 0], sign[:, None]], axis=1).reshape(3, 4, 4).astype(np.float32)
    normal = turns[..., 2].reshape(3, 4, 3).astype(np.float32)
    empty = np.zeros((3, 4, 0), np.float32)
    bake = GeometryBake(empty, normal, tangent, np.ones((3, 4), bool), empty)
    wanted = turns.transpose(0, 2, 1) * np.stack([np.ones(12), sign, np.ones(12)], axis=1)[..., None]
    found = bake.frames()
    assert found.dtype == np.float64
    np.testing.assert_allclose(found, wanted.reshape(3, 4, 3, 3), atol=2e-7)
    np.testing.assert_allclose(np.linalg.det(found).ravel(), sign, atol=1e-6)
    np.testing.assert_array_equal(bake.frames((np.array([2, 0]), np.array([1, 3]))), found[[2, 0], [1, 3]])
