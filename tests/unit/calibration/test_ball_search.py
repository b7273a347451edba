"""Balls found without being pointed at, in scenes ray traced in numpy."""

import numpy as np
import pytest

from irpso_addon.calibration.balls.ball import Ball
from irpso_addon.calibration.balls.detect import shadow
from irpso_addon.calibration.balls.detect.edges import Edges
from irpso_addon.calibration.balls.detect.outline import fitted
from irpso_addon.calibration.balls.detect.search import FoundBall, as_ball, of_one_kind, search_steps
from irpso_addon.calibration.balls.lights import Request, calibration_steps
from irpso_addon.calibration.filters import blurred, sampled
from irpso_addon.core.errors import InputError
from irpso_addon.core.steps import run_steps
from tests.builders.ball_scenes import Scene, Sphere, photographs, place
from tests.builders.balls import cap, degrees

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
    assert shadow.agreement(np.full_like(stack, 0.005), ball, LIGHTS) is None


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


def test_balls_of_the_surest_ones_kind_and_size_are_used():
    def ball(kind, radius):
        return FoundBall(kind, np.zeros((3, 2)), radius, 1.0, 0.9)

    found = [ball("matte", 30), ball("mirror", 50), ball("mirror", 20), ball("mirror", 47)]
    assert [b.radius for b in of_one_kind(found)] == [50, 47]
    small = FoundBall("mirror", np.zeros((3, 2)), 12, 1.0, 0.9, exact=False)
    assert [b.kind for b in of_one_kind([small, found[0]])] == ["matte"] and of_one_kind([small]) == []
