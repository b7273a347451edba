"""Balls found without being pointed at, in scenes ray traced in numpy."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from irpso_addon.calibration.balls.ball import Ball
from irpso_addon.calibration.balls.checks import ball_warnings, near_lamps, unknown_lens
from irpso_addon.calibration.balls.detect import evidence, falloff, shadow
from irpso_addon.calibration.balls.detect.edges import Edges
from irpso_addon.calibration.balls.detect.found import FoundBall, as_ball, known_tables, usable_balls
from irpso_addon.calibration.balls.detect.outline import fitted
from irpso_addon.calibration.balls.detect.search import search_steps
from irpso_addon.calibration.balls.lights import FoundLight, Request, calibration_steps
from irpso_addon.calibration.balls.second_opinion import contradiction
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.types import Light
from irpso_addon.core.errors import InputError
from irpso_addon.core.filters import blurred, sampled
from irpso_addon.core.steps import run_steps
from tests.builders.ball_scenes import Scene, Sphere, photographs, place
from tests.builders.balls import cap, degrees
from tests.builders.domains import unit

LIGHTS = cap(6, 55)[1:]
KINDS = ("mirror", "matte")
EMPTY = Scene()
DISC, BOWL = (-0.8, -0.9, 0.4, 0.9), Sphere("matte", place(EMPTY, 1.3, 0.8, 0.4), 0.4, hollow=True)
BALLS = (Sphere("mirror", place(EMPTY, -1.0, 0.5, 0.45), 0.45, 0.8), Sphere("matte", place(EMPTY, 1.2, -0.6, 0.4), 0.4))


def searched(images, kinds=KINDS):
    return run_steps(search_steps([lambda i=i: i for i in images], EMPTY.camera, kinds))


def circle_of(sphere):
    """Centre (2,) and radius of a sphere's outline in pixels."""
    outline = Ball("truth", EMPTY.camera, np.asarray(sphere.centre), sphere.radius, 1.0, (0.0, 0.0)).outline[:-1]
    middle = (outline.max(axis=0) + outline.min(axis=0)) / 2
    return middle, np.linalg.norm(outline - middle, axis=1).mean()


@pytest.fixture(scope="module")
def table():
    """Photographs of a mirror ball, a matte ball, a bowl and a printed disc on a table with a pattern."""
    return photographs(Scene(spheres=(*BALLS, BOWL), discs=(DISC,), texture=0.3), LIGHTS)


@pytest.fixture(scope="module")
def found(table):
    return searched(table)


def test_both_balls_are_found_and_neither_the_bowl_nor_the_disc(found):
    assert sorted(ball.kind for ball in found) == ["matte", "mirror"]
    for sphere in BALLS:
        middle, radius = circle_of(sphere)
        ball = next(ball for ball in found if ball.kind == sphere.kind)
        assert np.hypot(*(ball.centre - middle)) < 0.03 * radius and abs(ball.radius / radius - 1) < 0.03
        assert ball.shadow > 0.7 and ball.support > 0.7


@pytest.mark.parametrize("number", range(2))
def test_the_lights_of_a_found_ball_are_within_three_degrees(table, found, number):
    ball = as_ball(next(ball for ball in found if ball.kind == KINDS[number]), EMPTY.camera, "ball", None)
    result = run_steps(calibration_steps([lambda i=i: i for i in table], [ball], Request(KINDS[number])))
    off = degrees([light.light.vector for light in result.lights], LIGHTS)
    assert off.mean() < 1.5 and off.max() < 3.0


def lights_of(table, ball):
    request = Request(ball.kind, tables=known_tables([ball]))
    readers = [lambda i=i: i for i in table]
    return run_steps(calibration_steps(readers, [as_ball(ball, EMPTY.camera, "ball", None)], request)).lights


@pytest.mark.parametrize("factor", [1.0, 1.2])
def test_a_ball_of_the_other_kind_contradicts_one_that_was_measured_too_large(table, found, factor):
    mirror, matte = (next(ball for ball in found if ball.kind == kind) for kind in KINDS)
    wrong = replace(mirror, points=mirror.centre + factor * (mirror.points - mirror.centre))
    said = contradiction(mirror, lights_of(table, wrong), matte, lights_of(table, matte), EMPTY.camera)
    assert (said is None) == (factor == 1)
    assert said is None or said.startswith(f"the matte ball of radius {matte.radius:.0f} pixels shows the lights")


@pytest.mark.parametrize(("known", "contradicts"), [(True, False), (False, True)])
def test_the_parallax_of_near_lamps_is_no_contradiction(known, contradicts):
    """Lamps 8 radii away, the balls 3 radii apart in a camera that is turned: directions differ by some 15°."""
    matrix = np.eye(4)
    matrix[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    camera = Camera.from_fov(240, 180, 40.0, matrix=matrix)
    rim = 20 * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    inverse = (1 / 8 if known else 0.0, 0.001)
    one, two = (FoundBall(kind, rim + place, 20.0, 1.0, 0.9, inverse=inverse)
                for kind, place in zip(KINDS, ([100, 90], [160, 90]), strict=True))  # fmt: skip
    places = matrix[:3, :3] @ np.array([3.0, 0, 0])
    lights = [[FoundLight(Light(tuple(unit(8 * light - at)), (1.0,) * 3), 0.5, None, (), ()) for light in LIGHTS]
              for at in (np.zeros(3), places)]  # fmt: skip
    said = contradiction(one, lights[0], two, lights[1], camera)
    assert (said is not None) == contradicts


def test_only_the_wanted_kind_is_searched(table):
    assert [ball.kind for ball in searched(table, ("matte",))] == ["matte"]


def test_nothing_is_found_among_things_that_look_like_balls():
    assert searched(photographs(Scene(spheres=(BOWL,), discs=(DISC,), texture=0.3), LIGHTS)) == []


def test_a_ball_beside_a_subject_of_stronger_edges_is_found():
    rng = np.random.default_rng(0)
    places = [(x, y) for x in np.arange(-2.2, 0.4, 0.25) for y in np.arange(-1.6, 1.7, 0.25)]
    subject = tuple((x, y, *rng.uniform((0.04, 0.2), (0.12, 0.9))) for x, y in places)
    sphere = Sphere("mirror", place(EMPTY, 1.4, 0.4, 0.35), 0.35, 0.5)
    (ball,) = searched(photographs(Scene(spheres=(sphere,), discs=subject, albedo=0.06), LIGHTS[:4]))
    middle, radius = circle_of(sphere)
    assert np.hypot(*(ball.centre - middle)) < 0.03 * radius and abs(ball.radius / radius - 1) < 0.03


@pytest.fixture(scope="module")
def near_table():
    """Photographs of a mirror ball and a matte ball under lamps 20 radii away, and the lamps' places."""
    lamps = np.asarray(BALLS[0].centre) + 20 * BALLS[0].radius * LIGHTS
    return photographs(Scene(spheres=BALLS, texture=0.3, near=True), lamps), lamps


def test_a_mirror_ball_under_near_lamps_is_as_large_as_its_outline_not_as_its_shadow(near_table):
    images, lamps = near_table
    (ball,) = searched(images, ("mirror",))
    middle, radius = circle_of(BALLS[0])
    assert np.hypot(*(ball.centre - middle)) < 0.01 * radius and abs(ball.radius / radius - 1) < 0.01
    assert ball.inverse[0] == pytest.approx(1 / 20, rel=0.1) and ball.inverse[1] < 0.005
    placed = as_ball(ball, EMPTY.camera, "ball", None)
    request = Request("mirror", inverse=ball.inverse[0] / placed.radius)
    result = run_steps(calibration_steps([lambda i=i: i for i in images], [placed], request))
    off = degrees([light.light.vector for light in result.lights], lamps - BALLS[0].centre)
    assert off.mean() < 0.7 and off.max() < 1.5


@pytest.mark.parametrize("near", [False, True])
def test_the_fall_off_of_light_over_the_table_shows_the_lamps_distance(table, near_table, near):
    images, lamps = near_table if near else (table, None)
    stack = np.stack([image[..., :3].mean(axis=-1) for image in images])
    clipped = np.stack([image[..., 3] == 0 for image in images])
    centre = np.asarray(BALLS[1].centre)
    ball = Ball("b", EMPTY.camera, centre, BALLS[1].radius, circle_of(BALLS[1])[1], (0.0, 0.0))
    below = shadow.Table(np.array([0.0, 0.0, 1.0]), 1.0)
    away = lamps - centre if near else np.full((len(LIGHTS), 1), np.inf)
    distances = np.linalg.norm(away, axis=-1)
    inverse, error = falloff.inverse_distance(stack, clipped, ball, unit(away) if near else LIGHTS, below)
    assert inverse == pytest.approx(np.mean(BALLS[1].radius / distances), rel=0.1, abs=0.002) and error < 0.005


@pytest.mark.parametrize(
    ("inverse", "error", "near", "warned"),
    [(0.03, 0.001, False, True), (0.03, 0.001, True, False), (0.03, 0.02, False, False), (0.01, 1e-4, False, False)],
)
def test_a_warning_says_that_lamps_are_near_where_they_count_as_distant(inverse, error, near, warned):
    ball = FoundBall("mirror", np.zeros((3, 2)), 30.0, 1.0, 0.9, inverse=(inverse, error))
    warnings = near_lamps([ball], SimpleNamespace(near=near), EMPTY.camera, None, None)
    assert bool(warnings) == warned and all("about 33 ball radii" in warning for warning in warnings)


@pytest.mark.parametrize(
    ("radius", "distance", "warned"),
    [
        (20, 700, None),
        (40, 700, "not 18: the radius is half"),
        (20, 1400, "not 70: the two have different units"),
        (20, None, None),
    ],
)
def test_a_diameter_for_the_radius_is_noticed_by_the_lights_fall_off(radius, distance, warned):
    ball = FoundBall("mirror", np.zeros((3, 2)), 30.0, 1.0, 0.9, inverse=(0.03, 0.001))
    warnings = near_lamps([ball], SimpleNamespace(near=True), EMPTY.camera, radius, distance)
    assert len(warnings) == bool(warned) and all(f"about 33 ball radii away, {warned}" in one for one in warnings)


def test_a_warning_says_by_how_much_an_unknown_lens_may_turn_lights():
    flat, lens = (Camera(400, 300, (100.0, 100.0), (200.0, 150.0), perspective=p) for p in (False, True))
    unstated, stated = (SimpleNamespace(lens=known) for known in (False, True))
    aside, middle = (Ball("b", flat, np.array([x, 0.0, 0.0]), 0.2, 20.0, (0.0, 0.0)) for x in (1.5, 0.02))
    (warning,) = unknown_lens(unstated, flat, [middle, aside])
    # A phone's 65°: at 150 of 200 pixels off the axis rays are slanted by atan(0.75 tan 32.5°).
    assert f"about {np.degrees(np.arctan(0.75 * np.tan(np.radians(32.5)))):.0f}°: give --fov" in warning
    assert not unknown_lens(unstated, flat, [middle]) and not unknown_lens(stated, flat, [aside])
    assert not unknown_lens(unstated, lens, [aside])


@pytest.mark.parametrize("kind", KINDS)
def test_a_ball_on_black_cloth_is_found_by_a_shadow_below_the_noise(kind):
    sphere = Sphere(kind, place(EMPTY, 1.4, 0.4, 0.35), 0.35, 0.6)
    scene = Scene(spheres=(sphere,), discs=((-1.0, 0.0, 0.9, 0.8),), albedo=0.006)
    (ball,) = searched(photographs(scene, LIGHTS, noise=0.006), (kind,))
    middle, radius = circle_of(sphere)
    assert np.hypot(*(ball.centre - middle)) < 0.03 * radius and abs(ball.radius / radius - 1) < 0.03
    assert ball.shadow > 0.85


def test_two_photographs_are_too_few(table):
    with pytest.raises(InputError, match="needs 3 photographs"):
        searched(table[:2])


def test_only_the_true_lights_agree_with_the_shadow(table):
    stack = np.stack([image[..., :3].mean(axis=-1) for image in table])
    ball = Ball("b", EMPTY.camera, np.asarray(BALLS[1].centre), BALLS[1].radius, circle_of(BALLS[1])[1], (0.0, 0.0))
    correlation, below = shadow.agreement(stack, ball, LIGHTS)
    assert correlation > 0.85 and degrees(below.up, [0, 0, 1]) < 11
    assert shadow.agreement(stack, ball, LIGHTS * (-1, -1, 1))[0] < 0.2  # those of a bowl
    assert shadow.agreement(stack, ball, np.roll(LIGHTS, 1, axis=0))[0] < 0.4
    assert shadow.agreement(np.full_like(stack, 0.5), ball, LIGHTS)[0] == 0
    assert shadow.agreement(np.full_like(stack, 0.0005), ball, LIGHTS) is None


def test_a_shadow_under_lamps_a_few_radii_away_agrees_as_well():
    lamps = np.asarray(BALLS[1].centre) + 7 * BALLS[1].radius * LIGHTS
    stack = np.stack([i[..., :3].mean(axis=-1) for i in photographs(Scene(spheres=BALLS[1:], near=True), lamps)])
    ball = Ball("b", EMPTY.camera, np.asarray(BALLS[1].centre), BALLS[1].radius, circle_of(BALLS[1])[1], (0.0, 0.0))
    assert shadow.agreement(stack, ball, LIGHTS, inverse=1 / 7)[0] > 0.95  # with one scale a photograph 0.87


def test_a_faint_outline_in_all_photographs_outweighs_a_strong_edge_in_one():
    y, x = np.mgrid[:80, :80] + 0.5
    disc = 0.5 + 0.05 * (np.hypot(x - 40.3, y - 39.6) < 20)
    edges = Edges((80, 80), -1.0, 1.0)
    for number in range(6):
        edges.add(np.where((number == 0) & (x < 40), 0.05, blurred(disc, 0.6)), 1.0)
    outline = fitted(edges, 41.5, 38.5, 21.0)
    assert np.hypot(outline.x - 40.3, outline.y - 39.6) < 0.4 and abs(outline.radius - 20) < 0.4
    assert outline.support > 0.9


def test_filters_keep_a_plane():
    y, x = np.mgrid[:30, :40] + 0.5
    plane = 2 * x - 3 * y
    np.testing.assert_allclose(blurred(plane, 1.5)[6:-6, 6:-6], plane[6:-6, 6:-6])
    places = np.array([[3.2, 7.9], [20.0, 11.5], [38.1, 2.4]])
    np.testing.assert_allclose(sampled(plane, places), places @ (2, -3))


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1)])
def test_an_image_one_pixel_wide_or_high_is_sampled_along_the_other_side(shape):
    image = 1.0 + np.arange(shape[0] * shape[1]).reshape(shape)
    places = np.array([[0.5, 0.5], [-3.0, 0.9], [2.25, 0.5], [0.5, 2.25], [9.0, 9.0]])
    along = places[:, 0] if shape[1] > 1 else places[:, 1]
    expected = 1 + np.clip(along - 0.5, 0, image.size - 1)
    np.testing.assert_allclose(sampled(image, places), expected, atol=2e-3)


def test_balls_of_the_surest_ones_kind_and_size_are_used():
    def ball(kind, radius):
        return FoundBall(kind, np.zeros((3, 2)), radius, 1.0, 0.9)

    found = [ball("matte", 30), ball("mirror", 50), ball("mirror", 20), ball("mirror", 47)]
    assert [b.radius for b in usable_balls(found)] == [50, 47]
    small = FoundBall("mirror", np.zeros((3, 2)), 12, 1.0, 0.9, exact=False)
    assert [b.kind for b in usable_balls([small, found[0]])] == ["matte"] and usable_balls([small]) == []


def test_a_ball_whose_outline_hardly_shows_is_warned_of():
    clear, dim = (FoundBall("mirror", np.zeros((3, 2)), 30.0, support, 0.9) for support in (0.8, 0.2))
    (warning,) = ball_warnings([clear, dim])
    assert "20% of its outline" in warning and "balls.png" in warning


@pytest.mark.parametrize("size", [(2, 1), (1, 3)])
def test_photographs_a_pixel_wide_or_high_show_no_ball(size):
    image = np.ones((size[1], size[0], 4), np.float32)
    assert run_steps(search_steps([lambda: image] * 4, Camera.from_fov(*size, 35.0), KINDS)) == []


def test_equal_lights_have_no_spread_whatever_their_mean_rounds_to():
    lights = unit(np.random.default_rng(0).normal(size=(200, 3)))
    spreads = [evidence._spread(np.repeat(light[None], 12, axis=0)) for light in lights]
    assert all(isinstance(spread, float) for spread in spreads) and max(spreads) < 1e-7


@pytest.mark.parametrize("size", [(12, 16), (24, 24), (40, 40)])
def test_small_photographs_of_noise_show_no_ball(size):
    readers = [lambda k=k: np.random.default_rng(k).uniform(0, 0.6, (*size, 4)).astype(np.float32) for k in range(6)]
    camera = Camera.from_fov(size[1], size[0], 40.0)
    assert run_steps(search_steps(readers, camera, ("mirror", "matte"))) == []
