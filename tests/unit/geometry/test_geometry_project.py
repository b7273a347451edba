"""Camera images in texels: interpolation, visibility, and what a sample without weight does."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from irpso_addon.capture.bounds import bounded, weight_and_clipped
from irpso_addon.capture.camera import Camera
from irpso_addon.geometry.project import Projector
from irpso_addon.geometry.surface.footprint import texel_steps
from tests.oracles.geometry import bake_camera, bake_uv, joined, mesh_from_grid, plane, sphere, unit

ABOVE = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1.0]])


def projector(mesh, camera, size=(24, 24), **options):
    bake = bake_uv(mesh, *size)[0]
    return bake, Projector(bake, bake_camera(mesh, camera)[0], camera, **options)


def image_of(camera, rng=None):
    rng = rng or np.random.default_rng(3)
    image = rng.uniform(0.1, 1, (camera.height, camera.width, 4)).astype(np.float32)
    image[..., 3] = 1
    return image


@pytest.mark.parametrize("perspective", [True, False])
def test_samples_are_bilinear_between_pixel_centres(perspective):
    camera = Camera(31, 22, (30, 28), (14.2, 12.1), ABOVE, perspective)
    bake, p = projector(plane(2.0 if perspective else 0.6), camera, (19, 23), fall=False)
    image = image_of(camera)
    sampled = p.sample(image)
    place = camera.project(bake.position.astype(np.float64))[0] - 0.5
    for channel in range(3):
        expected = map_coordinates(image[..., channel].astype(float), [place[..., 1], place[..., 0]], order=1)
        np.testing.assert_allclose(sampled[..., channel][p.visible], expected[p.visible], atol=1e-6)
    assert p.visible.sum() > 300 and np.allclose(sampled[..., 3], p.visible, atol=1e-6)


def test_texels_outside_the_image_have_no_weight():
    camera = Camera.orthographic(20, 20, 1.0, ABOVE)
    bake, p = projector(plane(2.0), camera, (40, 40))
    x, y = bake.position[..., 0], bake.position[..., 1]
    inside = (np.abs(x) <= 0.475 + 1e-6) & (np.abs(y) <= 0.475 + 1e-6)
    assert (p.visible == inside).all()
    assert (p.sample(image_of(camera))[~inside] == 0).all()


def test_a_clipped_pixel_zeroes_the_weight_of_touched_texels():
    camera = Camera.orthographic(16, 16, 2.0, ABOVE)
    bake, p = projector(plane(2.0), camera, (37, 37))
    image = image_of(camera)
    image[8, 5] = (np.nan, 1e9, 0, 0)
    sampled = p.sample(image)
    place = camera.project(bake.position.astype(np.float64))[0] - 0.5
    touched = (np.abs(place - (5, 8)) < 1).all(-1) & p.visible
    assert 10 < touched.sum() < 40
    assert (sampled[touched] == 0).all()
    np.testing.assert_allclose(sampled[p.visible & ~touched][:, 3], 1, atol=1e-6)
    assert np.isfinite(sampled).all() and sampled.max() < 2


@pytest.mark.parametrize("texels", [37, 5])  # smaller than a pixel, and means of several
def test_a_texel_that_touches_a_clipped_pixel_is_a_lower_bound_in_its_channels(texels):
    camera, mesh = Camera.orthographic(16, 16, 2.0, ABOVE), plane(2.0)
    bake, p = projector(mesh, camera, (texels, texels), steps=texel_steps(mesh, texels, texels))
    image = image_of(camera)
    whole = p.sample(image)
    image[8, 5, 3] = bounded(np.float32(image[8, 5, 3]), np.array([True, False, True]))
    sampled = p.sample(image)
    weight, clipped = weight_and_clipped(sampled[..., 3])
    place = camera.project(bake.position.astype(np.float64))[0] - 0.5
    reach = np.maximum(1, 16 / texels / 2 + 0.5)
    near, at = (np.abs(place - (5, 8)) < reach).all(-1), (np.abs(place - (5, 8)) < 0.5).all(-1)
    assert (clipped[p.visible & at] == (True, False, True)).all() and not clipped[~near].any()
    assert clipped.any(axis=-1).sum() >= 1
    np.testing.assert_array_equal(sampled[..., :3], whole[..., :3])
    np.testing.assert_allclose(weight, whole[..., 3], atol=1e-6)


@pytest.mark.parametrize("texels", [37, 5])  # smaller than a pixel, and means of several
def test_a_texel_that_touches_a_clipped_pixel_has_its_radiance_without_weight(texels):
    camera, mesh = Camera.orthographic(16, 16, 2.0, ABOVE), plane(2.0)
    _, p = projector(mesh, camera, (texels, texels), steps=texel_steps(mesh, texels, texels))
    image = image_of(camera)
    whole = p.sample(image)
    image[6:11, 3:9, 3] = 0
    sampled = p.sample(image)
    lost = (whole[..., 3] > 0) & (sampled[..., 3] == 0)
    assert lost.sum() >= 2
    np.testing.assert_array_equal(sampled[lost][:, :3], whole[lost][:, :3])


def test_rounding_at_a_pixel_centre_reads_no_further_pixel():
    camera = Camera(16, 16, (8.0, 8.0), (8.0004, 7.9996), ABOVE, False)
    _, p = projector(plane(2.0), camera, (16, 16))
    image = image_of(camera)
    image[3, 4, 3] = 0
    np.testing.assert_allclose(p.sample(image), image, atol=1e-6)


def test_texels_on_pixel_centres_read_the_pixel_itself_even_at_the_border():
    camera = Camera.orthographic(16, 16, 2.0, ABOVE)
    _, p = projector(plane(2.0), camera, (16, 16))
    image = image_of(camera)
    image[3, 4, 3] = 0
    np.testing.assert_allclose(p.sample(image), image, atol=1e-6)


@pytest.mark.parametrize("gap", [0.5, 0.12])
def test_a_plane_behind_another_is_hidden_where_the_other_covers_it(gap):
    near, far = plane(1.0, z=gap, u_span=(0, 0.5)), plane(2.0, z=0, u_span=(0.5, 1))
    camera = Camera.from_fov(60, 60, 40, ABOVE)
    bake, p = projector(joined(near, far), camera, (80, 40))
    x, y, z = np.moveaxis(bake.position, -1, 0)
    # Where the ray from the camera at height 4 to a point of the far plane crosses the near one.
    edge = np.maximum(np.abs(x), np.abs(y)) * np.where(z > gap / 2, 1, (4 - gap) / 4)
    pixel = 4 / camera.scale[0]
    margin = 1.5 * pixel
    on_near = z > gap / 2
    assert p.visible[on_near & (edge < 0.5 - margin)].all()
    hidden = bake.coverage & ~on_near & (edge < 0.5 + 0.01)
    assert hidden.sum() > 200 and not p.visible[hidden].any()
    assert p.visible[~on_near & (edge > 0.5 + margin) & (edge < 0.95)].all()


@pytest.mark.parametrize("perspective", [True, False])
def test_only_the_near_side_of_a_sphere_is_seen(perspective):
    mesh = sphere(columns=32, rows=16)
    camera = Camera.from_fov(60, 60, 40, ABOVE) if perspective else Camera.orthographic(60, 60, 2.4, ABOVE)
    bake, p = projector(mesh, camera, (64, 32), grazing=0.1)
    toward = unit(ABOVE[:3, 3] - bake.position) if perspective else np.array([0, 0, 1.0])
    cosine = (bake.face_normal * toward).sum(-1)
    assert not p.visible[cosine < 0.1].any()
    # A pixel inside the silhouette; between, a neighbouring pixel may already miss the sphere.
    assert p.visible[cosine > 0.3].all()
    assert p.visible[cosine > 0.1].mean() > 0.9


def test_grazing_is_measured_against_the_face_and_not_the_shading_normal():
    mesh = mesh_from_grid(
        lambda u, v: np.stack([2 * u - 1, 2 * v - 1, 0 * u], -1),
        lambda u, v: np.stack([np.ones_like(u), 0 * u, 0.05 + 0 * u], -1),
        2, 2,
    )  # fmt: skip
    _, p = projector(mesh, Camera.orthographic(20, 20, 2.4, ABOVE), (8, 8), grazing=0.5)
    assert p.visible.all()


def test_the_part_of_a_floor_that_is_behind_the_camera_is_not_seen():
    level = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0.5], [0, 0, 0, 1.0]])  # looks along +y
    tilted = level.copy()
    tilted[:3, 1:3] = np.array([[0, 0], [0.28, -0.96], [0.96, 0.28]])
    bake, p = projector(plane(20.0, columns=1, rows=1), Camera.from_fov(41, 41, 60, tilted), (40, 40), grazing=0.01)
    ahead = bake.position[..., 1] > 0
    assert p.visible[ahead].sum() > 20 and not p.visible[~ahead].any()


def test_a_hard_edge_does_not_mix_the_two_sides():
    def roof(u, v):
        return np.stack([2 * u - 1, 2 * v - 1, 1 - np.abs(2 * u - 1)], -1)

    def normal(u, v):
        # Faces are flat; which side a corner belongs to does not matter here, only the face normals do.
        return np.stack([0 * u, 0 * u, 1 + 0 * u], -1)

    camera = Camera.orthographic(20, 20, 2.0, ABOVE)
    bake, p = projector(mesh_from_grid(roof, normal, 2, 1), camera, (64, 16), grazing=0.05)
    image = np.ones((20, 20, 4), np.float32)
    image[..., 0] = np.where(camera.points(1)[..., 0] < 0, 0, 1)
    red = p.sample(image)[..., 0][p.visible]
    side = bake.position[..., 0][p.visible]
    np.testing.assert_array_equal(red, side > 0)
    assert p.visible.mean() > 0.75


def test_an_image_of_another_size_is_refused():
    camera = Camera.orthographic(16, 12, 2.0, ABOVE)
    _, p = projector(plane(1.0), camera, (4, 4))
    with pytest.raises(ValueError, match="image"):
        p.sample(np.zeros((16, 12, 4), np.float32))
