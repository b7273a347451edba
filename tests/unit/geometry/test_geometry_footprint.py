"""Texels of several pixels against exact area means, what hides or spoils a part of them, and the weight of slants."""

import numpy as np
import pytest

from irpso_addon.capture.camera import Camera
from irpso_addon.geometry.project import Projector
from irpso_addon.geometry.surface.footprint import jacobian, slant_weight, texel_steps
from tests.oracles.geometry import bake_camera, bake_uv, joined, plane

ABOVE = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1.0]])


def projector(mesh, camera, size, **options):
    bake = bake_uv(mesh, *size)[0]
    options.setdefault("steps", texel_steps(mesh, *size))
    return bake, Projector(bake, bake_camera(mesh, camera)[0], camera, **options)


def area_means(image, texels, low, ratio):
    """Return (texels, texels) exact means of square pixels (H, W) over squares of ``ratio`` pixels from ``low`` on."""
    edges = low + ratio * np.arange(texels + 1)
    overlap = np.minimum(edges[1:, None], np.arange(1, len(image) + 1)) - np.maximum(
        edges[:-1, None], np.arange(len(image))
    )
    weights = np.maximum(overlap, 0) / ratio
    return weights @ image @ weights.T


def picture(kind, size):
    y, x = np.mgrid[:size, :size]
    value = {
        "checkers": ((x + y) % 2).astype(float),
        "wide checkers": ((x // 3 + y // 3) % 2).astype(float),
        "noise": np.random.default_rng(2).uniform(size=(size, size)),
    }[kind]
    return np.repeat(value[..., None], 4, axis=-1).astype(np.float32) * [1, 1, 1, 0] + np.float32([0, 0, 0, 1]), value


def read(kind, pixels, texels, ratio, steps=True):
    """Return what the texels of a plane seen head-on hold, and the exact means over their areas."""
    camera = Camera.orthographic(pixels, pixels, 2.0, ABOVE)
    options = {} if steps else {"steps": None}
    _, p = projector(plane(2.0 * texels * ratio / pixels, columns=1, rows=1), camera, (texels, texels), **options)
    image, value = picture(kind, pixels)
    sampled = p.sample(np.float32(image))
    assert p.visible.all() and np.allclose(sampled[..., 3], 1, atol=1e-6)
    return sampled[..., 0], area_means(value, texels, (pixels - texels * ratio) / 2, ratio)


@pytest.mark.parametrize("kind", ["checkers", "noise"])
@pytest.mark.parametrize("ratio", [2, 4])
def test_texels_of_whole_pixels_hold_their_exact_mean(kind, ratio):
    sampled, expected = read(kind, 16 * ratio + 2 * ratio, 16, ratio)
    np.testing.assert_allclose(sampled, expected, atol=1e-6)


@pytest.mark.parametrize(("kind", "most"), [("checkers", 0.03), ("wide checkers", 0.05), ("noise", 0.04)])
def test_texels_of_3_5_pixels_hold_their_mean(kind, most):
    sampled, expected = read(kind, 64, 16, 3.45)
    centres, _ = read(kind, 64, 16, 3.45, steps=False)
    off, before = (np.sqrt(np.mean((values - expected) ** 2)) for values in (sampled, centres))
    print(f"{kind}: rms error {off:.4f}, read at the centres {before:.4f}")
    assert off < most and before > 4 * off


def test_texels_up_to_a_pixel_are_bilinear():
    camera = Camera.orthographic(16, 16, 2.0, ABOVE)
    mesh = plane(1.6)
    image = np.float32(picture("noise", 16)[0])
    (_, areas), (_, centres) = (projector(mesh, camera, (20, 20), **o) for o in ({}, {"steps": None}))
    np.testing.assert_array_equal(areas.sample(image), centres.sample(image))


def test_the_jacobian_is_a_texels_extent_in_the_image():
    mesh = plane(2.0)
    tilt = np.deg2rad(35)
    matrix = np.array(
        [[1, 0, 0, 0.2], [0, np.cos(tilt), -np.sin(tilt), -2], [0, np.sin(tilt), np.cos(tilt), 3], [0, 0, 0, 1]]
    )
    camera = Camera(64, 64, (80.0, 90.0), (31.0, 30.0), matrix)
    bake = bake_uv(mesh, 8, 16)[0]
    points = bake.position.reshape(-1, 3).astype(float)
    found = jacobian(camera, points, texel_steps(mesh, 8, 16)[bake.triangle.ravel()])
    for axis, side in enumerate((2 / 8, 2 / 16)):
        step = np.eye(3)[axis] * 1e-5
        slope = (camera.project(points + step)[0] - camera.project(points - step)[0]) / 2e-5
        np.testing.assert_allclose(found[:, :, axis], slope * side, rtol=2e-3, atol=2e-3)


def test_a_texels_weight_is_its_usable_part_and_0_below_three_quarters():
    camera = Camera.orthographic(36, 36, 2.0, ABOVE)
    _, p = projector(plane(2.0, columns=1, rows=1), camera, (9, 9))
    image = np.float32(picture("noise", 36)[0])
    image[8:9, 8:11] = (9, 9, 9, 0)  # 3 of the 16 pixels of texel (2, 2)
    image[8:10, 16:20] = np.nan  # 8 of those of texel (4, 2)
    mask = np.ones((36, 36), bool)
    mask[20:22, 20:22] = False  # 4 of texel (5, 5)
    sampled = p.sample(image, mask)
    expected = image[:, :, 0].reshape(9, 4, 9, 4)
    assert sampled[2, 2, 3] == pytest.approx(13 / 16, abs=1e-6)
    rest = np.concatenate([image[9:12, 8:12, 0].ravel(), image[8:9, 11:12, 0].ravel()])
    assert sampled[2, 2, 0] == pytest.approx(rest.mean(), abs=1e-6)
    assert (sampled[2, 4] == 0).all()
    assert sampled[5, 5, 3] == pytest.approx(12 / 16, abs=1e-6)
    np.testing.assert_allclose(sampled[7, 7, 0], expected[7, :, 7].mean(), atol=1e-6)


def test_pixels_that_show_another_surface_do_not_count():
    # A plate hides a part of a floor whose texels are four pixels wide.
    plate = plane(0.98, z=0.5, u_span=(0, 0.5))
    floor = plane(2.0, u_span=(0.5, 1.0))
    camera = Camera.orthographic(74, 74, 2.0, ABOVE)
    bake, p = projector(joined(plate, floor), camera, (36, 18))
    image = np.zeros((74, 74, 4), np.float32)
    x, y = np.moveaxis(camera.points(1)[..., :2], -1, 0)
    on_plate = (np.abs(x) < 0.49) & (np.abs(y) < 0.49)
    image[..., :3] = np.where(on_plate, 100.0, 1.0)[..., None]
    image[..., 3] = 1
    sampled = p.sample(image)
    floor_texel = bake.position[..., 2] < 0.25
    seen = sampled[..., 3] > 0
    assert (sampled[..., 0][seen & floor_texel] == pytest.approx(1.0, abs=1e-5)) and (seen & floor_texel).sum() > 150
    assert sampled[..., 0][seen & ~floor_texel] == pytest.approx(100.0, abs=1e-3)
    reach = np.maximum(np.abs(bake.position[..., 0]), np.abs(bake.position[..., 1]))
    assert not seen[floor_texel & (reach < 0.49)].any() and seen[floor_texel & (reach > 0.62) & (reach < 0.95)].all()


def tilted(degrees, distance=4.0):
    """Return the matrix of a camera that looks at the origin from so far off the z axis."""
    a = np.deg2rad(degrees)
    back = np.array([np.sin(a), 0, np.cos(a)])
    matrix = np.eye(4)
    matrix[:3] = np.stack([(np.cos(a), 0, -np.sin(a)), (0, 1, 0), back, distance * back], axis=1)
    return matrix


@pytest.mark.parametrize("degrees", [0, 45, 70, 80, 83])
def test_a_slanted_view_loses_weight_to_0_at_the_limit(degrees):
    camera = Camera.orthographic(40, 40, 3.0, tilted(degrees))
    _, p = projector(plane(2.0), camera, (64, 64), grazing=0.1)
    weights = p.sample(np.ones((40, 40, 4), np.float32))[..., 3][p.visible]
    c = np.cos(np.deg2rad(degrees))
    # κ = 0.1: the part of the variance that comes from the footprint.
    expected = (1 - (0.1 / c) ** 2) / (1 - 0.01) / (1 + 0.1 * (1 / c**2 - 1))
    assert len(weights) > 300
    np.testing.assert_allclose(weights, expected, rtol=1e-3)
    _, even = projector(plane(2.0), camera, (64, 64), grazing=0.1, fall=False)
    np.testing.assert_allclose(even.sample(np.ones((40, 40, 4), np.float32))[..., 3][even.visible], 1, atol=1e-6)


def test_the_weight_of_a_slant_reaches_zero_without_a_step():
    cosine = np.linspace(0.1, 1, 2000)
    weight = slant_weight(cosine, 0.1, None)
    assert weight[0] == 0 and weight[-1] == pytest.approx(1) and (np.diff(weight) > 0).all()
    assert np.diff(weight).max() < 0.004


def test_a_texel_longer_than_a_slanted_pixel_loses_only_near_the_limit():
    wide = np.tile(3 * np.eye(2), (2, 1, 1))  # three pixels a texel, along the slant too
    cosine = np.array([0.3, 0.6])
    np.testing.assert_allclose(slant_weight(cosine, 0.1, wide), (1 - (0.1 / cosine) ** 2) / 0.99, rtol=1e-6)
