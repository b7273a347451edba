"""Lens distortion against OpenCV's documented formulas in OpenCV's own axes; and lights that differ with direction."""

import numpy as np
import pytest

from irpso_addon.capture import Camera, CaptureError, Light
from irpso_addon.capture.distortion import reach

RNG = np.random.default_rng(11)
WIDTH, HEIGHT = 40, 30
# k1, k2, p1, p2, k3, k4, k5, k6: what OpenCV calls distCoeffs.
LENSES = {
    "barrel": (-0.32, 0.11, 0.0, 0.0, -0.01),
    "pincushion": (0.45, 0.2),
    "tangential": (0.02, -0.01, 0.03, -0.02),
    "rational": (0.9, -0.3, 0.004, -0.003, 0.05, 1.1, -0.2, 0.03),
    "everything strong": (-0.25, 0.3, 0.012, 0.017, -0.15, 0.05, 0.02, -0.01),
}


def opencv_pixels(points, matrix, distortion, focal, centre):
    """Return OpenCV's (u, v) of world points: x right, y down, z forward, pixel centres at whole numbers."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*distortion, *(0,) * (8 - len(distortion)))
    local = (points - matrix[:3, 3]) @ matrix[:3, :3] * (1, -1, -1)
    pixels = []
    for x, y, z in local:
        x, y = x / z, y / z
        r = np.hypot(x, y)
        radial = (1 + k1 * r**2 + k2 * r**4 + k3 * r**6) / (1 + k4 * r**2 + k5 * r**4 + k6 * r**6)
        u = x * radial + 2 * p1 * x * y + p2 * (r**2 + 2 * x**2)
        v = y * radial + p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y
        pixels.append((focal[0] * u + centre[0], focal[1] * v + centre[1]))
    return np.array(pixels)


ANYWHERE = np.array([[0.36, 0.48, -0.8, 1.5], [-0.8, 0.6, 0, -2.0], [0.48, 0.64, 0.6, 3.25], [0, 0, 0, 1]])


def camera_of(lens):
    """Return our camera of OpenCV's (cx, cy) = (17.7, 13.4): its pixel centres are whole numbers, from the top."""
    return Camera(WIDTH, HEIGHT, (31.0, 29.0), (17.7 + 0.5, HEIGHT - (13.4 + 0.5)), ANYWHERE, True, LENSES[lens])


@pytest.mark.parametrize("lens", LENSES)
def test_distortion_matches_opencv(lens):
    camera = camera_of(lens)
    depth = RNG.uniform(1, 9, 60)
    seen = RNG.uniform(-0.6, 0.6, (60, 2)) * depth[:, None]
    points = np.c_[seen, -depth] @ ANYWHERE[:3, :3].T + ANYWHERE[:3, 3]
    found, depths = camera.project(points)
    u, v = opencv_pixels(points, ANYWHERE, LENSES[lens], (31.0, 29.0), (17.7, 13.4)).T
    np.testing.assert_allclose(found, np.c_[u + 0.5, HEIGHT - (v + 0.5)], atol=1e-11)
    np.testing.assert_allclose(depths, depth, atol=1e-12)


@pytest.mark.parametrize("lens", LENSES)
def test_undistortion_inverts_distortion(lens):
    camera = camera_of(lens)
    points = camera.points(2.5)
    assert np.isfinite(points).all()
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    np.testing.assert_allclose(camera.project(points)[0], np.stack([x, y], axis=-1), rtol=0, atol=1e-10)
    # And it bends: by more than a pixel somewhere.
    straight = Camera(WIDTH, HEIGHT, camera.scale, camera.centre, ANYWHERE)
    assert np.abs(straight.project(points)[0] - np.stack([x, y], axis=-1)).max() > 0.5


def test_points_beyond_a_barrels_turning_point_are_not_in_the_image():
    # r (1 − 0.25 r²) rises up to r² = 4/3 and is back at the middle at r = 2.
    assert reach((-0.25,)) == pytest.approx(np.sqrt(4 / 3), rel=1e-12)
    camera = Camera(100, 100, (50.0, 50.0), (50.0, 50.0), np.eye(4), True, (-0.25,))
    points = np.array([[1.15, 0, -1], [1.16, 0, -1], [2, 0, -1], [0, 3, -1.2]], float)  # the last is turned over twice
    found, _ = camera.project(points)
    np.testing.assert_allclose(found[0], (50 + 50 * 1.15 * (1 - 0.25 * 1.15**2), 50), atol=1e-12)
    assert np.isnan(found[1:]).all()
    # The image's edge shows less than the lens reaches in the distorted picture: 2/3 · √(4/3) = 0.77 of 1.
    shown = camera.points()
    assert np.isnan(shown[50, 0]).all() and np.isfinite(shown[50, 20]).all()


def test_the_reach_ends_before_a_pole_and_is_endless_for_a_pincushion():
    assert reach((0.4, 0.1)) == np.inf and reach(()) == np.inf
    assert reach((0, 0, 0, 0, 0, -0.25)) == pytest.approx(2.0, rel=1e-12)  # 1 / (1 − r²/4)


def test_a_lens_that_tangential_terms_fold_shows_no_point_twice():
    camera = Camera(64, 64, (32.0, 32.0), (32.0, 32.0), np.eye(4), True, (0.0, 0.0, 0.2))
    # Along x = 0, y down: v = y + 0.6 y², which turns at y = −1/1.2; up is positive here.
    found, _ = camera.project(np.array([[0, 0.82, -1], [0, 0.85, -1], [0, 1.5, -1]], float))
    np.testing.assert_allclose(found[0], (32, 32 + 32 * (0.82 - 0.6 * 0.82**2)), atol=1e-12)
    assert np.isnan(found[1:]).all()


@pytest.mark.parametrize("distortion", [(0.0,) * 9, (float("nan"),), (0.1, float("inf"))])
def test_an_invalid_list_of_coefficients_is_refused(distortion):
    with pytest.raises(CaptureError, match="up to 8 finite numbers: k1, k2, p1, p2, k3"):
        Camera(4, 4, (4.0, 4.0), (2.0, 2.0), np.eye(4), True, distortion)


def test_an_orthographic_camera_has_no_distortion():
    with pytest.raises(CaptureError, match="orthographic camera has no lens distortion"):
        Camera(4, 4, (4.0, 4.0), (2.0, 2.0), np.eye(4), False, (0.1,))


def test_a_spot_gives_nothing_outside_its_cone_and_a_flat_lamp_falls_with_the_cosine():
    place, down = (0.0, 0.0, 2.0), (0.0, 0.0, -1.0)
    angles = np.radians([0, 29.9, 30, 30.1, 60, 89, 91, 180])
    points = np.array(place) + 3 * np.stack([np.sin(angles), 0 * angles, -np.cos(angles)], axis=-1)
    assert Light(place, distant=False).relative_intensity(points).tolist() == [1] * 8
    assert Light(place, (1, 1, 1), False, down, 30.0).relative_intensity(points).tolist() == [1, 1, 1, 0, 0, 0, 0, 0]
    flat = Light(place, (1, 1, 1), False, down, None, True).relative_intensity(points)
    np.testing.assert_allclose(flat, np.maximum(np.cos(angles), 0), atol=1e-15)
    flash = Light(place, (1, 1, 1), False, down, None, 2.5).relative_intensity(points)
    np.testing.assert_allclose(flash, np.maximum(np.cos(angles), 0) ** 2.5, atol=1e-15)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"distant": False, "cone": 20.0}, "has an axis"),
        ({"distant": False, "cosine": True}, "has an axis"),
        ({"distant": False, "axis": (0, 0, -1), "cosine": -1.0}, "a power of 0 or more"),
        ({"axis": (0, 0, -1)}, "a distant light has no axis"),
        ({"distant": False, "axis": (0, 0, -1), "cone": 0.0}, "above 0"),
        ({"distant": False, "axis": (0, 0, -1), "cone": float("nan")}, "above 0"),
    ],
)
def test_a_light_that_contradicts_itself_is_refused(given, words):
    with pytest.raises(CaptureError, match=words):
        Light((0.0, 0.0, 1.0), **given)
