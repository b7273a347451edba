"""What a ball's surroundings tell: its rim, the light of its table, gloss; against numpy and closed forms."""

import numpy as np
import pytest

from irpso_addon.calibration.balls.ball import Ball, fit_ball, outline_of_circle
from irpso_addon.calibration.balls.crops import BallView, Surroundings
from irpso_addon.calibration.balls.detect import falloff
from irpso_addon.calibration.balls.detect.outline import measured
from irpso_addon.calibration.balls.detect.pictures import reduced_steps
from irpso_addon.calibration.balls.detect.rim import on_rim
from irpso_addon.calibration.balls.matte import fit_lights
from irpso_addon.calibration.balls.mirror import Sight, find_highlights, reflected
from irpso_addon.calibration.balls.shading import shading_of
from irpso_addon.calibration.balls.table import Table, radiance_from_table
from irpso_addon.capture.camera import Camera
from irpso_addon.core.steps import run_steps
from tests.builders.ball_scenes import Scene, Sphere, photographs, place
from tests.builders.balls import cap, degrees, matte_image, rays
from tests.builders.domains import unit

LIGHTS = cap(6, 55)[1:]
CAMERA = Camera.from_fov(240, 180, 40.0)
UP = unit(np.array([0.0, 0.4, 1.0]))
CENTRE, RADIUS = np.array([0.3, -0.2, -8.0]), 0.6
TABLE = Table(UP, 1.0)


def outline_ball(camera=CAMERA, centre=CENTRE, radius=RADIUS):
    """The true ball, with its radius in pixels."""
    ball = Ball("ball", camera, np.asarray(centre), radius, 1.0, (0.1, 0.1))
    points = ball.outline[:-1]
    return fit_ball(points, camera, "ball", radius), points.mean(axis=0)


def view_of(ball, values, usable=None):
    grid = np.meshgrid(np.arange(CAMERA.width) + 0.5, np.arange(CAMERA.height) + 0.5)
    usable = np.ones(values.shape[:3], bool) if usable is None else usable
    return BallView(ball, np.stack(grid, axis=-1), np.asarray(values, np.float32), usable, 1)


def test_a_lit_plane_gives_a_ball_the_share_of_the_hemisphere_below_it():
    ball, _ = outline_ball()
    view = view_of(ball, np.zeros((1, CAMERA.height, CAMERA.width, 3)))
    around = Surroundings(np.full((1, CAMERA.height, CAMERA.width, 3), 0.7, np.float32), np.zeros(2), 1)
    light = radiance_from_table(view, around, TABLE)
    normals = ball.surface(view.pixels)[1]
    np.testing.assert_allclose(light[0, view.inside, 0], 0.35 * (1 - normals @ UP)[view.inside], atol=0.04)
    assert not light[0, ~view.inside].any()


def test_the_dark_half_of_a_table_darkens_the_side_of_the_ball_that_faces_it():
    ball, middle = outline_ball()
    view = view_of(ball, np.zeros((1, CAMERA.height, CAMERA.width, 3)))
    dark = np.full((1, CAMERA.height, CAMERA.width, 3), 0.7, np.float32)
    dark[:, :, : int(middle[0])] = 0
    light = radiance_from_table(view, Surroundings(dark, np.zeros(2), 1), TABLE)[0, :, :, 0]
    row, reach = int(middle[1]), int(0.9 * ball.radius_px)
    assert light[row, int(middle[0]) - reach] < 0.25 * light[row, int(middle[0]) + reach]


@pytest.mark.parametrize("known", [True, False])
def test_a_matte_ball_on_a_patterned_table_gives_its_lights_where_the_tables_light_is_gathered(known):
    """The table's radiance is higher to the right: as a plane of one brightness it turns every light."""
    ball, _ = outline_ball()
    shape = (len(LIGHTS), CAMERA.height, CAMERA.width, 3)
    pattern = np.broadcast_to(np.linspace(0.0, 1.2, CAMERA.width)[:, None], shape).astype(np.float32)
    normals = ball.surface(view_of(ball, np.zeros(shape)).pixels)[1]
    light = radiance_from_table(view_of(ball, np.zeros(shape)), Surroundings(pattern, np.zeros(2), 1), TABLE)
    direct = np.maximum(normals @ LIGHTS.T, 0).transpose(2, 0, 1)[..., None]
    rng = np.random.default_rng(0)
    view = view_of(ball, 0.6 * direct + 0.5 * light + 0.02 + 0.004 * rng.normal(size=shape))
    shadings = [shading_of([view], number, [light] if known else []) for number in range(len(LIGHTS))]
    fits, ground = fit_lights(shadings, ball.centre, False)
    off = degrees([fit.direction for fit in fits], LIGHTS)
    if known:
        assert off.max() < 0.2 and ground == pytest.approx(0.5, abs=0.02)
        np.testing.assert_allclose([fit.radiance for fit in fits], 0.6, rtol=0.01)
    else:
        assert off.mean() > 1.0


def fits_over_a_table(lights, albedo, noise=0.012, strength=0.6):
    """fit_lights of a ball by Lambert's law over an infinite lit plane of the albedo."""
    ball, _ = outline_ball()
    shape = (len(lights), CAMERA.height, CAMERA.width, 3)
    normals = ball.surface(view_of(ball, np.zeros(shape)).pixels)[1]
    direct = np.maximum(normals @ lights.T, 0).transpose(2, 0, 1)
    plane = albedo * (lights @ UP)[:, None, None] * (1 - normals @ UP) / 2
    values = strength * (direct + plane)[..., None] + 0.02
    view = view_of(ball, values + noise * np.random.default_rng(2).normal(size=shape))
    fits, ground = fit_lights([shading_of([view], number) for number in range(len(lights))], ball.centre, False)
    return degrees([fit.direction for fit in fits], lights), np.degrees([fit.error for fit in fits]), ground


@pytest.mark.parametrize(("count", "seed"), [(5, 2), (6, 0), (6, 2)])
def test_a_table_is_not_invented_where_the_lights_do_not_determine_one(count, seed):
    """Few terminators are visible, and without one a table's light is equal to a rotation of the lights."""
    off, _, ground = fits_over_a_table(cap(count, 35, seed), 0.0)
    assert off.max() < 1.0 and np.linalg.norm(ground) < 0.1


@pytest.mark.parametrize("albedo", [0.2, 0.4, 0.7])
def test_a_table_is_found_where_the_lights_determine_it(albedo):
    off, error, ground = fits_over_a_table(cap(6, 60), albedo, noise=0.008)
    assert off.max() < 0.6 and error.max() < 1.0
    np.testing.assert_allclose(ground, albedo * UP, atol=0.05)


def test_the_stated_error_includes_a_table_that_the_lights_do_not_determine():
    lights = cap(6, 15)
    off, error, _ = fits_over_a_table(lights, 0.3, noise=0.002)
    assert off.mean() > 1.0  # no photograph shows it
    assert (off < 2 * error).all() and error.max() < 10


def test_a_photograph_whose_shading_is_no_balls_gives_no_light():
    ball, _ = outline_ball()
    images = [matte_image(CAMERA, [(CENTRE, RADIUS)], light) for light in LIGHTS]
    images[2] = images[2] * (np.arange(CAMERA.width) // 3 % 2)[:, None]  # the shadow of a grille
    view = view_of(ball, np.array(images))
    fits, _ = fit_lights([shading_of([view], number) for number in range(len(images))], ball.centre, False)
    assert fits[2] == "the shading is not a ball's: the lamp does not reach it"
    others = [number for number in range(len(images)) if number != 2]
    assert degrees([fits[number].direction for number in others], LIGHTS[others]).max() < 0.5


def test_a_matte_balls_rim_shows_its_place_where_edges_are_off():
    """On black cloth under lamps of one side the dark rim has its edge inside, the bright one outside."""
    camera = Scene().camera
    sphere = Sphere("matte", place(Scene(), 0.4, 0.3, 0.5), 0.5)
    lights = unit(np.array([[0.8, 0.1, 0.5], [0.7, 0.5, 0.6], [0.6, -0.5, 0.5], [0.8, -0.1, 0.3]]))
    images = photographs(Scene(spheres=(sphere,), albedo=0.004), lights, fine=4)
    pictures = run_steps(reduced_steps([lambda i=i: i for i in images], camera))
    truth, middle = outline_ball(camera, np.asarray(sphere.centre), sphere.radius)
    start = fit_ball(outline_of_circle(*(middle + 0.4), 1.02 * truth.radius_px), camera, measured=False)

    def off(points):
        found = fit_ball(points, camera)
        return np.linalg.norm(found.outline[:-1].mean(axis=0) - middle) / truth.radius_px

    edges = off(measured(pictures.strong, *middle, truth.radius_px).points)
    assert off(on_rim(pictures, start)[1]) < 0.6 * edges < 0.005


def test_a_ball_as_bright_as_its_table_has_no_rim():
    camera = Scene().camera
    grey = [np.dstack([np.full((camera.height, camera.width, 3), 0.4), np.ones((camera.height, camera.width))])] * 3
    pictures = run_steps(reduced_steps([lambda i=i: i.astype(np.float32) for i in grey], camera))
    assert on_rim(pictures, fit_ball(outline_of_circle(150, 120, 20), camera, measured=False)) is None


def test_a_spot_below_the_table_is_no_lamp():
    """A glossy table shows a mirror ball the lamp a second time, as bright where both are clipped."""
    ball, _ = outline_ball()
    grid = view_of(ball, np.zeros((1, CAMERA.height, CAMERA.width, 3))).pixels
    _, shown, _ = reflected(ball, grid)
    lights = LIGHTS
    values, clipped = [], []
    for light in lights:
        twin = light - 2 * (light @ UP) * UP
        lamp = view_of(ball, np.zeros((1, CAMERA.height, CAMERA.width, 3))).inside & (
            (shown @ light > np.cos(0.10)) | (shown @ twin > np.cos(0.25))
        )
        values.append(np.repeat(np.where(lamp, 1.0, 0.05)[..., None], 3, axis=-1))
        clipped.append(lamp)
    view = view_of(ball, np.array(values), ~np.array(clipped))
    seen = find_highlights(view, UP)
    assert all(isinstance(sight, Sight) for sight in seen)
    assert degrees([sight.direction for sight in seen], lights).max() < 1.5
    blind = find_highlights(view)
    wrong = [
        not isinstance(s, Sight) or degrees(s.direction, light) > 5 for s, light in zip(blind, lights, strict=True)
    ]
    assert any(wrong)


@pytest.mark.parametrize(("gloss", "near"), [(1.5, False), (1.5, True), (0.0, True)])
def test_the_lobe_of_a_glossy_table_is_no_near_lamp(gloss, near):
    ball, _ = outline_ball()
    lamps = CENTRE + (14 if near else 1e6) * LIGHTS
    _, ray = rays(CAMERA)
    foot = CENTRE - RADIUS * UP
    point = ray * ((foot @ UP) / (ray @ UP))[..., None]
    stack = []
    for lamp in lamps:
        away = lamp - point
        toward = unit(away)
        half = unit(toward - ray)
        lobe = (1 + (1 / (half @ UP) ** 2 - 1) / 0.35**2) ** -2
        lit = np.linalg.norm(np.cross(toward, CENTRE - point), axis=-1) > RADIUS  # no ball on the way to the lamp
        stack.append(lit * ((lamp - foot) @ UP) / np.linalg.norm(away, axis=-1) ** 3 * np.exp(gloss * lobe))
    stack = np.array(stack) / np.max(stack)
    inverse, _ = falloff.inverse_distance(stack, np.zeros(stack.shape, bool), ball, LIGHTS, TABLE)
    assert inverse == pytest.approx(RADIUS / 14 if near else 0.0, rel=0.1, abs=0.002)
