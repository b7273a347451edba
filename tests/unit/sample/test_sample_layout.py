"""The sample's places: what the camera sees of them, and where the lamp was held."""

import numpy as np
import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.sample import layout
from irpso_addon.sample.render_sample import Request

SIZES = ((720, 540), (160, 120), (1000, 400), (300, 800))


def outline(camera, middle, radius):
    """Return (N, 2) pixels, from the upper left corner, of the circle in which the camera's rays touch a sphere."""
    toward = camera.position - middle
    far = np.linalg.norm(toward)
    axis = toward / far
    across = np.cross(axis, (0.3, 0.9, 0.1))
    across /= np.linalg.norm(across)
    turn = np.linspace(0, 2 * np.pi, 2000, endpoint=False)[:, None]
    around = np.cos(turn) * across + np.sin(turn) * np.cross(axis, across)
    touched = middle + radius * (radius / far * axis + np.sqrt(1 - (radius / far) ** 2) * around)
    return layout.seen_from_upper_left(camera, touched)


@pytest.mark.parametrize("size", SIZES)
def test_the_balls_circle_is_the_mean_of_its_outline(size):
    camera = layout.make_layout(size, 4, 0).camera
    seen = outline(camera, layout.ball_middle(), layout.BALL_RADIUS)
    x, y, radius = layout.ball_circle(camera)
    centre = (seen.min(axis=0) + seen.max(axis=0)) / 2
    np.testing.assert_allclose((x, y), centre, atol=0.02 * radius)
    away = np.hypot(*(seen - (x, y)).T)
    assert radius == pytest.approx((away.min() + away.max()) / 2, rel=1e-4)
    assert away.max() - away.min() < 0.06 * radius


@pytest.mark.parametrize("size", SIZES)
def test_everything_is_in_the_picture(size):
    camera = layout.make_layout(size, 4, 0).camera
    ball = outline(camera, layout.ball_middle(), layout.BALL_RADIUS)
    others = [layout.seen_from_upper_left(camera, p) for p in (layout.tile_corners(), layout.chart_corners())]
    seen = np.concatenate([ball, *others])
    assert (seen > 0.01 * min(size)).all() and (seen < np.array(size) - 0.01 * min(size)).all()


def test_the_tiles_first_corner_is_the_upper_left_one():
    camera = layout.make_layout((720, 540), 4, 0).camera
    seen = layout.seen_from_upper_left(camera, layout.tile_corners())
    assert seen[0].tolist() == seen.min(axis=0).tolist() and seen[2].tolist() == seen.max(axis=0).tolist()


def test_the_crop_lies_inside_the_tile_and_misses_less_than_two_pixels_of_it():
    camera = layout.make_layout((640, 480), 4, 0).camera
    x, y, width, height = layout.tile_crop(camera)
    low, _, high, _ = layout.seen_from_upper_left(camera, layout.tile_corners())
    assert (low <= (x, y)).all() and (high >= (x + width, y + height)).all()
    assert np.abs(high - low - (width, height)).max() < 2


def test_the_focal_length_of_exif_is_that_of_the_camera():
    found = layout.make_layout((720, 540), 4, 0)
    diagonal = 2 * np.arctan(np.hypot(36, 24) / 2 / layout.FOCAL_35MM)
    assert np.tan(np.radians(found.fov_degrees) / 2) == pytest.approx(np.tan(diagonal / 2) * 720 / np.hypot(720, 540))


def test_the_lamp_stays_over_the_table_and_near_its_distance_and_moves_with_the_seed():
    found = layout.make_layout((720, 540), 16, 3)
    away = found.lamps - layout.ball_middle()
    far = np.linalg.norm(away, axis=-1)
    assert 0.02 < np.ptp(far) / layout.LAMP_DISTANCE < 0.045
    assert far.mean() == pytest.approx(layout.LAMP_DISTANCE, rel=0.01)
    assert (away[:, 2] / far).min() > np.cos(np.radians(72))
    np.testing.assert_array_equal(found.lamps, layout.make_layout((160, 120), 16, 3).lamps)
    assert np.abs(found.lamps - layout.make_layout((720, 540), 16, 4).lamps).max() > 10


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        ({"photographs": 2}, "--photographs 2: give a whole number from 3"),
        ({"photographs": 1000}, "--photographs 1000"),
        ({"size": (40, 100)}, "--size 40x100: give sides of 80"),
        ({"size": (1000, 100)}, "--size 1000x100"),
    ],
)
def test_a_bad_request_is_refused_in_one_line(bad, said):
    with pytest.raises(InputError) as refused:
        Request(**bad)
    assert str(refused.value).startswith(said) and "\n" not in str(refused.value)
