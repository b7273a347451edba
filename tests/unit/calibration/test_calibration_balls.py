"""Lights from balls, against balls ray traced in numpy: outline, mirror, matte, near lights, errors."""

import numpy as np
import pytest

from irpso_addon.calibration.balls import mirror
from irpso_addon.calibration.balls.ball import Ball, fit_ball, outline_of_circle, outline_of_mask
from irpso_addon.calibration.balls.lights import Request, calibration_steps
from irpso_addon.calibration.balls.near import meet
from irpso_addon.capture.camera import Camera
from irpso_addon.core.errors import InputError
from irpso_addon.core.steps import run_steps
from tests.builders.balls import CAMERAS, cap, degrees, matte_image, mirror_image, photographed, trace, unit

PLACES = {"perspective": ((1.2, -0.8, -7.0), 0.8), "orthographic": ((0.8, -0.5, 0.0), 0.75)}
SHOTS = {"clean": {"blur": 0.6}, "blurred and noisy": {"blur": 1.2, "noise": 0.01}}
CLIPPED = {"clean": None, "blurred and noisy": 1.0}  # of mirror balls
TWO = [((-1.4, -0.4, -8.0), 0.8), ((1.4, 0.5, -8.0), 0.8)]
LARGE = Camera.from_fov(240, 160, 40.0)


def ball_of(camera, centre, radius, name="ball"):
    known = radius if camera.perspective else None
    return fit_ball(outline_of_mask(trace(camera, centre, radius)[3]), camera, name, known)


def calibrated(images, balls, kind="mirror", **asked):
    return run_steps(calibration_steps([lambda i=i: i for i in images], balls, Request(kind, **asked)))


def directions(found):
    return np.array([light.light.vector for light in found.lights])


@pytest.mark.parametrize(("fov", "centre"), [(20.0, (2.0, -1.2, -20.0)), (70.0, (2.6, -1.7, -6.0))])
def test_a_sphere_off_the_axis_is_found_in_its_oblong_outline(fov, centre):
    camera, centre = Camera.from_fov(300, 220, fov), np.array(centre)
    found = ball_of(camera, centre, 0.9)
    assert degrees(found.centre, centre) < 0.02
    assert abs(np.linalg.norm(found.centre) / np.linalg.norm(centre) - 1) < 0.005
    if fov > 30:  # there the outline is no circle
        rim = outline_of_mask(trace(camera, centre, 0.9)[3])
        assert np.ptp(np.linalg.norm(rim - rim.mean(axis=0), axis=-1)) > 2


def test_the_reported_errors_of_an_outline_match_the_true_errors():
    rng, camera, ratios = np.random.default_rng(3), CAMERAS["orthographic"], []
    for _ in range(40):
        centre, radius = np.array([*rng.uniform(-0.5, 0.5, 2), 0.0]), rng.uniform(0.4, 0.9)
        found = ball_of(camera, centre, radius)
        off = (found.centre - centre)[:2] * camera.scale[0]
        ratios.append([np.sqrt((off**2).mean()) / found.error_px[0],
                       abs(found.radius - radius) * camera.scale[0] / found.error_px[1]])  # fmt: skip
    assert (np.sqrt(np.mean(np.square(ratios), axis=0)) < 1.5).all()


def test_dents_and_holes_of_a_mask_hardly_count():
    camera = CAMERAS["perspective"]
    mask = trace(camera, (0.3, 0.2, -7.0), 1.0)[3]
    dented = mask.copy()
    dented[90:96, 60:90] = False
    dented[75:85, 100:112] = False
    whole, found = (fit_ball(outline_of_mask(m), camera, radius=1.0) for m in (mask, dented))
    assert np.linalg.norm(found.centre[:2] - whole.centre[:2]) < 0.01


def test_a_ball_that_is_cut_by_the_frame_is_found():
    camera = CAMERAS["orthographic"]
    centre = np.array([1.6, 0.3, 0.0])
    found = ball_of(camera, centre, 0.75)
    assert np.linalg.norm(found.centre - centre) < 0.01 and abs(found.radius - 0.75) < 0.01


def test_three_clicked_points_make_a_ball():
    camera = CAMERAS["orthographic"]
    points = outline_of_circle(90, 70, 25)[[3, 60, 130]]
    found = fit_ball(points, camera, measured=False)
    np.testing.assert_allclose(found.centre[:2] * camera.scale + camera.centre, (90, 70), atol=1e-6)
    assert found.radius_px == pytest.approx(25)


def test_a_square_and_a_short_arc_are_refused_and_a_small_ball_gets_a_warning():
    camera = CAMERAS["orthographic"]
    square = np.zeros((160, 200), bool)
    square[40:100, 50:150] = True
    with pytest.raises(InputError, match="not round"):
        fit_ball(outline_of_mask(square), camera)
    with pytest.raises(InputError, match="only (17|21)% of its outline .* at least 25% is needed"):
        fit_ball(outline_of_circle(90, 70, 25)[:30], camera)
    small = ball_of(camera, np.array([0.2, 0.1, 0.0]), 0.24)
    assert any("pixels; 15 or more" in w for w in small.warnings)
    with pytest.raises(InputError, match="radius is 4"):
        ball_of(camera, np.zeros(3), 0.08)


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("shot", SHOTS)
def test_a_mirror_ball_gives_directions_within_a_degree(camera, shot):
    rng, lights = np.random.default_rng(1), cap(14, 100)
    centre, radius = PLACES[camera]
    view = CAMERAS[camera]
    images = [
        photographed(mirror_image(view, [(centre, radius)], lamp), rng, clip=CLIPPED[shot], **SHOTS[shot])
        for lamp in lights
    ]
    found = calibrated(images, [ball_of(view, np.array(centre), radius)])
    off = degrees(directions(found), lights)
    assert not found.near and off.mean() < 0.4 and off.max() < 1.0
    # Half of the angle (the normal), y upside down and an axis for every pixel's own view are all far from that.
    said = np.array([light.error for light in found.lights])
    assert 0.2 < np.sqrt(np.mean((off / said) ** 2)) < 1.5


def test_the_reflection_is_the_light_and_the_normal_halves_the_angle():
    camera, ball = CAMERAS["orthographic"], Ball("b", CAMERAS["orthographic"], np.zeros(3), 1.0, 50.0, (0.1, 0.1))
    pixel = np.array(camera.centre) + 50 * np.sin(np.radians(30)) * np.array([0.6, 0.8])
    light = mirror.reflected(ball, pixel)[1]
    np.testing.assert_allclose(light, [0.6 * np.sin(np.pi / 3), 0.8 * np.sin(np.pi / 3), 0.5], atol=1e-12)


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("shot", SHOTS)
def test_a_matte_ball_gives_colours_and_directions_within_two_degrees(camera, shot):
    rng, lights = np.random.default_rng(1), cap(12, 80)
    centre, radius = PLACES[camera]
    view, strengths = CAMERAS[camera], np.random.default_rng(5).uniform(0.5, 1.5, (12, 3))
    strengths[0] = 1
    images = [
        photographed(matte_image(view, [(centre, radius)], lamp, albedo=0.5 * s), rng, **SHOTS[shot])
        for lamp, s in zip(lights, strengths, strict=True)
    ]
    found = calibrated(images, [ball_of(view, np.array(centre), radius)], "matte")
    off = degrees(directions(found), lights)
    assert off.mean() < 0.6 and off.max() < 2.0
    found_strengths = np.array([light.light.intensity for light in found.lights])
    np.testing.assert_allclose(found_strengths, strengths, rtol=0.03)
    white = calibrated(images, [ball_of(view, np.array(centre), radius)], "matte", albedo=(0.5, 0.5, 0.5))
    np.testing.assert_allclose([light.light.intensity for light in white.lights], strengths, rtol=0.03)


def test_a_cast_shadow_and_a_gloss_on_a_matte_ball_hardly_count():
    rng, lights = np.random.default_rng(1), cap(6, 60)
    (centre, radius), view = PLACES["orthographic"], CAMERAS["orthographic"]
    _, normal, ray, hit = trace(view, centre, radius)
    images = []
    for light in lights:
        image = matte_image(view, [(centre, radius)], light)
        half = unit(light - ray)
        image += (0.6 * np.maximum((normal * half).sum(-1), 0) ** 200 * hit)[..., None]
        image[60:90, 120:140] = 0.02
        images.append(photographed(image, rng, 0.8, 0.005))
    found = calibrated(images, [ball_of(view, np.array(centre), radius)], "matte")
    assert degrees(directions(found), lights).max() < 1.0


def test_a_bright_room_and_a_window_are_not_taken_for_the_lamp():
    rng, lights = np.random.default_rng(1), cap(8, 70)
    (centre, radius), view = PLACES["perspective"], CAMERAS["perspective"]
    room = mirror_image(view, [(centre, radius)], unit([-0.5, 0.6, 0.6]), width=25.0, room=0.0)
    images = [
        photographed(mirror_image(view, [(centre, radius)], lamp, room=0.3) + room, rng, 0.8, 0.005, 1.0)
        for lamp in lights
    ]
    found = calibrated(images, [ball_of(view, np.array(centre), radius)])
    off = degrees(directions(found), lights)
    near_window = degrees(lights, [-0.5, 0.6, 0.6]) < 20
    assert off[~near_window].max() < 2.5


@pytest.mark.parametrize(("brightness", "grey"), [(0.08, 0.6), (0.04, 0.25)])
def test_the_grey_of_a_matte_ball_is_not_taken_for_a_lamp_of_a_few_pixels(brightness, grey):
    rng, lights = np.random.default_rng(1), cap(8, 60)
    (centre, radius), view = PLACES["perspective"], CAMERAS["perspective"]
    ball = [(centre, radius)]
    # Another ball is seen at the side in every second photograph, so that it is no part of what is always there.
    other = mirror_image(view, ball, unit([-0.9, 0.3, -0.1]), width=40.0, room=0.0) / 100
    lamps = [brightness * mirror_image(view, ball, light, width=4.0, room=0.0) for light in lights]
    images = [photographed(lamp + grey * (n % 2) * other, rng, 0.8, 0.002, 1.0) for n, lamp in enumerate(lamps)]
    lamp_alone = [photographed(lamp, rng, 0.8) for lamp in lamps]
    clipped = [int((image[..., :3] >= 1).all(axis=-1).sum()) for image in lamp_alone]
    assert all(2 <= count <= 7 for count in clipped) if brightness > 0.05 else not any(clipped)
    # What the lamp sends, clipped as it is, is less than what the grey sends.
    assert max(np.minimum(image[..., 0], 1).sum() for image in lamp_alone) < grey * other[..., 0].sum()
    found = calibrated(images, [ball_of(view, np.array(centre), radius)])
    off, said = degrees(directions(found), lights), np.array([light.error for light in found.lights])
    assert off.max() < 1.0 and (off < 4 * said).all()


def test_a_clipped_thing_that_most_photographs_show_is_not_taken_for_the_lamp():
    rng, lights = np.random.default_rng(1), cap(8, 60)
    (centre, radius), view = PLACES["perspective"], CAMERAS["perspective"]
    thing = 0.05 * mirror_image(view, [(centre, radius)], unit([0.9, 0.1, -0.4]), width=14.0, room=0.0)
    images = [
        photographed(
            mirror_image(view, [(centre, radius)], lamp, width=8.0) + (n % 3 > 0) * thing, rng, 0.8, 0.003, 1.0
        )
        for n, lamp in enumerate(lights)
    ]
    assert degrees(directions(calibrated(images, [ball_of(view, np.array(centre), radius)])), lights).max() < 1.0


def test_the_highlight_of_a_glossy_table_beside_the_lamp_does_not_pull_it():
    rng, lights = np.random.default_rng(1), unit(np.array([(np.cos(a), np.sin(a), 0.9) for a in range(6)]))
    (centre, radius), view = PLACES["perspective"], CAMERAS["perspective"]
    images = []
    for light in lights:  # the table's highlight touches the lamp's, nearer to the rim, and is as large
        below = unit(light - (0, 0, 1.0))
        both = [mirror_image(view, [(centre, radius)], at, width=24.0, room=0.02) for at in (light, below)]
        images.append(photographed(sum(both), rng, 0.8, 0.003, 1.0))
    off = degrees(directions(calibrated(images, [ball_of(view, np.array(centre), radius)])), lights)
    assert off.max() < 4.0 and off.mean() < 2.0


def test_an_overexposed_matte_ball_gets_a_warning():
    rng, (centre, radius), view = np.random.default_rng(1), PLACES["perspective"], CAMERAS["perspective"]
    lamp = 0.08 * mirror_image(view, [(centre, radius)], unit([0.3, 0.2, 0.9]), room=0.0)
    other = mirror_image(view, [(centre, radius)], unit([-0.9, 0.3, -0.1]), width=40.0, room=0.0) / 100
    images = [photographed(lamp + 1.5 * other, rng, 0.8, 0.002, 1.0), photographed(lamp, rng, 0.8, 0.002, 1.0)]
    white, dark = calibrated(images, [ball_of(view, np.array(centre), radius)]).lights
    assert white.light is None or "expose less" in " ".join(white.warnings)
    assert dark.light is not None and not dark.warnings


@pytest.mark.parametrize("weaker", [0.7, 1.0])
def test_a_photograph_with_two_lamps_gives_no_light_and_a_reason(weaker):
    rng, (first, second) = np.random.default_rng(1), unit(np.array([[0.5, 0.3, 0.8], [-0.5, 0.1, 0.8]]))
    (centre, radius), view = PLACES["perspective"], CAMERAS["perspective"]
    one, two = (mirror_image(view, [(centre, radius)], light) for light in (first, second))
    images = [photographed(image, rng, 0.8, 0.002, 1.0) for image in (one, two, one + weaker * two)]
    found = calibrated(images, [ball_of(view, np.array(centre), radius)]).lights
    assert degrees([light.light.vector for light in found[:2]], [first, second]).max() < 1.0
    assert found[2].light is None and "ambiguous" in found[2].warnings[0]
    apart = float(found[2].warnings[0].split("° apart")[0].split()[-1])
    assert abs(apart - degrees(first, second)) < 1.5


def test_a_photograph_whose_lamp_is_hidden_from_the_ball_gives_no_light():
    rng, lights = np.random.default_rng(1), cap(7, 50)
    (centre, radius), view = PLACES["perspective"], CAMERAS["perspective"]
    images = [mirror_image(view, [(centre, radius)], light) for light in lights]
    # The lamp is behind a screen; what it lights beside the ball is now the brightest.
    images[3] = mirror_image(view, [(centre, radius)], unit([0.9, 0.2, 0.3]), width=14.0) * 0.003 + 0.997 * 0.05
    found = calibrated([photographed(image, rng, 0.8, 0.002, 1.0) for image in images],
                       [ball_of(view, np.array(centre), radius)]).lights  # fmt: skip
    assert found[3].light is None and "the lamp is hidden" in found[3].warnings[0]
    others = [n for n in range(7) if n != 3]
    assert degrees([found[n].light.vector for n in others], lights[others]).max() < 1.0


@pytest.mark.parametrize("off", [0, 2])
def test_an_evenly_lit_ball_gives_no_light_and_does_not_scale_the_others(off):
    """Rounding of even values once gave a light of strength 1e-19."""
    camera, ball = CAMERAS["perspective"], [((0.3, -0.2, -8.0), 0.8)]
    lights = cap(4, 60)
    albedos = [(0.0 if number == off else 0.5,) * 3 for number in range(4)]
    images = [matte_image(camera, ball, light, albedo=a) for light, a in zip(lights, albedos, strict=True)]
    photographs = [photographed(image, np.random.default_rng(0)) for image in images]
    found = calibrated(photographs, [ball_of(camera, *ball[0])], "matte")
    assert found.lights[off].light is None and found.lights[off].warnings == ("no shading",)
    others = [light for number, light in enumerate(found.lights) if number != off]
    np.testing.assert_allclose([light.light.intensity for light in others], 1.0, rtol=0.02)


def test_a_matte_ball_far_darker_than_in_other_photographs_gets_a_warning():
    """A hidden lamp leaves the light of a wall."""
    camera, ball = CAMERAS["perspective"], [((0.3, -0.2, -8.0), 0.8)]
    images = [matte_image(camera, ball, light) for light in cap(6, 60)]
    images[2] = matte_image(camera, ball, unit([0.9, 0.2, 0.3]), albedo=(0.01, 0.01, 0.01))
    photographs = [photographed(image, np.random.default_rng(0)) for image in images]
    found = calibrated(photographs, [ball_of(camera, *ball[0])], "matte").lights
    faint = [number for number, light in enumerate(found) if any("the lamp may be hidden" in w for w in light.warnings)]
    assert faint == [2] and "2%" in " ".join(found[2].warnings)


@pytest.mark.parametrize("kind", ["mirror", "matte"])
def test_two_balls_locate_near_lights_and_recognise_distant_ones(kind):
    rng, make = np.random.default_rng(1), {"mirror": mirror_image, "matte": matte_image}[kind]
    balls = [ball_of(LARGE, np.array(c), r, f"ball {n}") for n, (c, r) in enumerate(TWO)]
    middle = np.mean([c for c, _ in TWO], axis=0)
    places = middle + cap(5, 50, seed=2) * np.array([4, 5, 6, 4.5, 5.5])[:, None]
    scale = 25 if kind == "matte" else 1
    extra = {"albedo": (0.5 * scale,) * 3} if kind == "matte" else {}
    images = [photographed(make(LARGE, TWO, p, False, **extra), rng, 0.7, 0.002) for p in places]
    found = calibrated(images, balls, kind)
    assert found.near and "converge" in found.how
    off = np.linalg.norm(directions(found) - places, axis=1) / np.linalg.norm(places - middle, axis=1)
    assert off.mean() < 0.03 and off.max() < 0.06
    if kind == "matte":
        powers = [light.light.intensity for light in found.lights]
        np.testing.assert_allclose(powers, 1, atol=0.08)
    far = [photographed(make(LARGE, TWO, lamp), rng, 0.7, 0.002) for lamp in cap(5, 50, seed=2)]
    found = calibrated(far, balls, kind)
    assert not found.near and degrees(directions(found), cap(5, 50, seed=2)).max() < 1.0


@pytest.mark.parametrize(("kind", "distance"), [("mirror", 5.0), ("matte", 5.0), ("matte", 2.5)])
def test_one_ball_and_a_known_distance_give_positions(kind, distance):
    rng, (centre, radius) = np.random.default_rng(1), TWO[0]
    places = np.array(centre) + distance * cap(6, 70)
    make = {"mirror": mirror_image, "matte": matte_image}[kind]
    white = {} if kind == "mirror" else {"albedo": (0.5 * distance**2,) * 3}
    images = [photographed(make(LARGE, TWO[:1], p, False, **white), rng, 0.7, 0.002) for p in places]
    found = calibrated(images, [ball_of(LARGE, np.array(centre), radius)], kind, distance=distance)
    off = np.linalg.norm(directions(found) - places, axis=1) / distance
    # From the ball's middle the light lies up to 0.8/5 off where it is seen from the surface: 3° to 6°. What is matte
    # would be off by 11°, and its intensities by a third, were it taken to be lit from afar.
    assert found.near and off.max() < np.radians(0.5)
    if kind == "matte":
        np.testing.assert_allclose([light.light.intensity for light in found.lights], 1, atol=0.02)


def test_a_light_seen_by_one_ball_gets_the_distance_of_the_other_lights():
    rng = np.random.default_rng(1)
    balls = [ball_of(LARGE, np.array(c), r, f"ball {n}") for n, (c, r) in enumerate(TWO)]
    middle = np.mean([c for c, _ in TWO], axis=0)
    places = middle + 5 * cap(4, 50, seed=2)
    images = [photographed(mirror_image(LARGE, TWO, p, False), rng, 0.7) for p in places]
    images[0][:, LARGE.width // 2 :, :3] = 0
    found = calibrated(images, balls)
    assert found.near and found.lights[0].sights[1] is None and "distance" in " ".join(found.lights[0].warnings)
    off = np.linalg.norm(directions(found) - places, axis=1) / 5
    assert off.max() < 0.03


def test_rays_meet_where_they_were_sent_from():
    rng, light = np.random.default_rng(2), np.array([1.0, 2.0, 3.0])
    points = rng.normal(size=(4, 3))
    found = meet(points, unit(light - points), [0.01] * 4, points.mean(axis=0), True)
    place = points.mean(axis=0) + found.direction / found.inverse
    np.testing.assert_allclose(place, light, atol=1e-6)


def test_undetermined_lights_get_a_warning():
    rng, (centre, radius), view = np.random.default_rng(1), PLACES["orthographic"], CAMERAS["orthographic"]
    ball = ball_of(view, np.array(centre), radius)
    lamps = [unit([0.3, 0.2, 1]), unit([0.3, -0.2, 1]), unit([-0.4, 0.2, 1]), unit([0.5, 0, -2]), unit([0, 0.4, 1])]
    images = [photographed(mirror_image(view, [(centre, radius)], lamp), rng, 0.8, 0.005, 1.0) for lamp in lamps]
    images.append(photographed(mirror_image(view, [(centre, radius)], lamps[0]) * 0, rng, 0.8, 0.005, 1.0))
    found = calibrated(images, [ball])
    assert "edge" in " ".join(found.lights[3].warnings)
    assert found.lights[5].light is None and "no highlight" in found.lights[5].warnings[0]
    behind = [photographed(matte_image(view, [(centre, radius)], unit([0.3, 0.1, -1])), rng, 0.8)]
    assert "behind" in " ".join(calibrated(behind, [ball], "matte").lights[0].warnings)
    with pytest.raises(InputError, match="second --ball"):
        calibrated(images, [ball], lights="near")


def test_a_matte_ball_whose_parts_show_different_lights_gives_none():
    """Three photographs are right; in a fourth half of the ball is lit from elsewhere."""
    rng, (centre, radius), view = np.random.default_rng(1), PLACES["orthographic"], CAMERAS["orthographic"]
    images = [matte_image(view, [(centre, radius)], light) for light in cap(7, 40)]
    image, ball = images[3].copy(), ball_of(view, np.array(centre), radius)
    middle = ball.outline[:-1].mean(axis=0)
    image[int(middle[1]) :] = images[6][int(middle[1]) :]
    lights = calibrated([photographed(i, rng, 0.8) for i in [*images[:3], image]], [ball], "matte").lights
    assert [light.light is None for light in lights] == [False, False, False, True]
    assert "uncertain by" in lights[3].warnings[-1]


def test_a_highlight_that_floods_the_ball_gets_a_warning():
    rng, (centre, radius), view = np.random.default_rng(1), PLACES["orthographic"], CAMERAS["orthographic"]
    ball = ball_of(view, np.array(centre), radius)
    images = [
        photographed(mirror_image(view, [(centre, radius)], lamp, width=100.0), rng, 0.8, 0.005, 1.0)
        for lamp in cap(3, 50)
    ]
    found = calibrated(images, [ball])
    assert all("expose less" in " ".join(light.warnings) for light in found.lights)
