"""Calibration of near lights: distance of the card under the balls, and units of length."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.calibration import write
from irpso_addon.calibration.ball_calibration import (
    BallRequest,
    ball_of_text,
    calibrate_steps,
    find_ball,
    written_table,
)
from irpso_addon.calibration.ball_report import report_of
from irpso_addon.calibration.balls.lights import Request
from irpso_addon.calibration.photographs import read_photographs, with_camera
from irpso_addon.capture.framing import Framing
from irpso_addon.capture.images.exr import write_exr
from irpso_addon.capture.images.image import ImageStore
from irpso_addon.capture.read import read_spec
from irpso_addon.core.errors import InputError
from irpso_addon.core.steps import run_steps
from tests.builders.near_balls import FOV, write_near_balls
from tests.builders.near_card import DISTANCE


@pytest.fixture(scope="module")
def balls(tmp_path_factory):
    """A folder of photographs of two matte balls under near lamps, and the numbers that say where the balls are."""
    folder = tmp_path_factory.mktemp("balls") / "photographs"
    return folder, [ball_of_text(place) for place in write_near_balls(folder)]


def calibrated(balls, spec, radius=None, **options):
    return run_steps(calibrate_steps(spec, balls[1], Request("matte", "near", **options), radius=radius))


def test_files_of_macos_and_of_calibrations_beside_photographs_are_none(tmp_path):
    for name in ("a.png", "b.png", "._a.png", "dome.toml", "dome_balls.png"):
        (tmp_path / name).touch()
    assert [shot.name for shot in read_photographs(tmp_path).observations] == ["a.png", "b.png"]


def test_calibration_reports_the_distance_of_the_card_under_the_balls(balls):
    spec = with_camera(read_photographs(balls[0]), {"fov_degrees": FOV}, "--fov")
    found = calibrated(balls, spec, radius=10.0)
    assert found.card_distance == pytest.approx(DISTANCE, rel=0.01)
    assert report_of(found)["card_distance"] == pytest.approx(found.card_distance)


def test_the_table_gets_the_cards_distance_unless_it_states_one_or_a_width(balls, tmp_path):
    spec = with_camera(read_photographs(balls[0]), {"fov_degrees": FOV}, "--fov")
    table = tmp_path / "capture.toml"
    found = calibrated(balls, spec, radius=10.0)
    table.write_text(written_table(found, tmp_path, {"fov_degrees": FOV}))
    assert read_spec(table).card_distance == found.new_distance == pytest.approx(found.card_distance, rel=1e-5)
    others = {"card_distance": 400.0}, {"framing": Framing(card_width=80.0)}, {"views": spec.views * 2}
    for changes in others:
        assert replace(found, spec=replace(spec, **changes)).new_distance is None


def test_intensities_of_one_of_several_cameras_are_warned_of_unless_an_albedo_is_given(balls):
    """They are relative to the first light of this camera, and the others' rows stay."""
    spec = with_camera(read_photographs(balls[0]), {"fov_degrees": FOV}, "--fov")
    other = replace(spec.views[0], name="other")
    shown = tuple(replace(observation, name=f"other {observation.name}", camera=1) for observation in spec.observations)
    both = replace(spec, views=(*spec.views, other), observations=(*spec.observations, *shown))

    def warned(spec, **options):
        request = Request("matte", **options)
        warnings = run_steps(calibrate_steps(spec, balls[1], request, radius=10.0, view="camera")).warnings
        return [text for text in warnings if "relative to the first light of 'camera'" in text]

    assert len(warned(both)) == 1 and "--albedo" in warned(both)[0]
    assert warned(both, albedo=(0.5, 0.5, 0.5)) == warned(spec) == []


def test_a_distance_to_the_lamps_without_a_unit_is_refused(balls):
    seen = with_camera(read_photographs(balls[0]), {"fov_degrees": FOV}, "--fov")
    with pytest.raises(InputError, match="--lamp-distance: needs --radius"):
        calibrated(balls, seen, distance=160.0)
    with pytest.raises(InputError, match="has no unit; give --fov and --radius"):
        calibrated(balls, read_photographs(balls[0]), distance=160.0)


def test_a_mask_that_is_white_around_a_black_ball_is_refused(balls, tmp_path):
    camera = (
        read_photographs(balls[0]).views[0].make(*ImageStore().size(read_photographs(balls[0]).observations[0].image))
    )
    y, x = np.mgrid[: camera.height, : camera.width]
    ball = np.hypot(x - camera.width / 2, y - camera.height / 2) < camera.height / 5
    write_exr(tmp_path / "ball.exr", {"": {"Y": 1.0 - ball.astype(np.float32)}})
    with pytest.raises(InputError, match="ball.exr: is white up to its borders, .*; paint the ball white"):
        find_ball(BallRequest(tmp_path / "ball.exr"), camera, ImageStore(), 1, None)


def test_lists_for_other_programs_name_files(balls):
    spec = read_photographs(balls[0])
    files = [observation.image.path.name for observation in spec.observations]
    renamed = [replace(observation, name=f"lamp {n}") for n, observation in enumerate(spec.observations)]
    lists = write._lists(calibrated(balls, replace(spec, observations=tuple(renamed))))
    assert lists["filenames.txt"] == files


def test_positions_in_ball_radii_are_refused_for_a_capture_with_lengths(balls):
    spec = with_camera(read_photographs(balls[0]), {"fov_degrees": FOV}, "--fov")
    with pytest.raises(InputError, match="has card_distance; .* give --radius in it, or --lights distant"):
        calibrated(balls, replace(spec, card_distance=DISTANCE))
    calibrated(balls, replace(spec, card_distance=DISTANCE), radius=10.0)


def test_the_width_in_the_lamps_unit_is_written(balls, tmp_path):
    table = tmp_path / "capture.toml"
    table.write_text(written_table(calibrated(balls, read_photographs(balls[0])), tmp_path, {}))
    assert "world_width = 2" in table.read_text() and read_spec(table).views[0].lens


def test_the_principal_point_stays_beside_the_width_in_the_lamps_unit(balls, tmp_path):
    folder, table = tmp_path / "photographs", tmp_path / "capture.toml"
    shutil.copytree(balls[0], folder)
    width, height = ImageStore().size(read_photographs(folder).observations[0].image)
    (folder / "camera.toml").write_text(f"principal_point = [{width / 2 + 9}, {height / 2 - 4}]\n")
    found = calibrated(balls, read_photographs(folder))
    table.write_text(written_table(found, tmp_path, {}))
    again = read_spec(table).views[0].make(width, height)
    used = found.result.views[0].ball.camera
    assert again.centre == used.centre == (width / 2 + 9, height / 2 - 4) and again.scale == used.scale


def test_a_width_alone_leaves_the_principal_point_but_no_distortion(balls):
    spec = with_camera(read_photographs(balls[0]), {"fov_degrees": FOV, "principal_point": [3.0, 5.0]}, "--camera")
    spec = with_camera(spec, {"world_width": 30.0}, "--camera")
    camera = spec.views[0].make(30, 20)
    assert (camera.perspective, camera.scale, camera.centre, camera.distortion) == (False, (1.0, 1.0), (3.0, 5.0), ())


def test_the_distance_of_a_tilted_table_counts_on_the_lenss_axis(balls):
    """Closed form: the plane through the balls' lowest points along the normal, which the corners give."""
    tilt = np.radians(30)
    across, normal = np.array([1.0, 0, 0]), np.array([0, np.sin(tilt), np.cos(tilt)])
    spec = with_camera(read_photographs(balls[0]), {"fov_degrees": FOV}, "--fov")
    found = calibrated(balls, spec, radius=10.0)
    camera = found.result.views[0].ball.camera
    upward, place = np.cross(normal, across), np.array([0.0, 0.0, -400.0])
    corners = []
    for x, y in ((-1, 1), (1, 1), (1, -1), (-1, -1)):
        point = place + 30 * (x * across + y * upward)
        flat = point[:2] / -point[2] * camera.scale + camera.centre
        corners.append((flat[0], camera.height - flat[1]))
    views = [
        replace(view, ball=replace(view.ball, centre=place + side * across + 10 * (normal + upward)))
        for view, side in zip(found.result.views, (-40, 40), strict=True)
    ]
    tilted = replace(
        found, result=replace(found.result, views=tuple(views)), spec=replace(spec, framing=Framing(corners=corners))
    )
    assert tilted.card_distance == pytest.approx(400, rel=1e-6)
    searched = replace(spec, framing=Framing(corners="auto"))
    assert any(
        "faces the camera; corners are searched later" in text for text in calibrated(balls, searched, 10.0).warnings
    )


def test_an_angle_leaves_the_principal_point_and_the_distortion(balls, tmp_path):
    folder = tmp_path / "photographs"
    shutil.copytree(balls[0], folder)
    keys = "focal_length_px = 900.0\nprincipal_point = [{:.1f}, {:.1f}]\ndistortion = [0.01]\n"
    first = read_photographs(folder).observations[0].image
    width, height = ImageStore().size(first)
    (folder / "camera.toml").write_text(keys.format(width / 2 + 3, height / 2 - 2))
    spec = with_camera(read_photographs(folder), {"fov_degrees": FOV}, "--fov")
    seen = spec.views[0].make(width, height)
    angle = 2 * np.degrees(np.arctan(width / 2 / seen.scale[0]))
    assert (angle, seen.distortion) == (pytest.approx(FOV), (0.01,)) and seen.centre == (width / 2 + 3, height / 2 - 2)
    table = tmp_path / "capture.toml"
    table.write_text(written_table(calibrated(balls, spec, radius=10.0), tmp_path, {"fov_degrees": FOV}))
    again = read_spec(table).views[0].make(width, height)
    assert (again.scale, again.centre, again.distortion) == (seen.scale, seen.centre, seen.distortion)
    given = with_camera(read_photographs(folder), {"focal_length_px": 900.0}, "--camera").views[0].make(width, height)
    assert given.distortion == () and given.centre == (width / 2, height / 2)
