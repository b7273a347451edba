"""Where a card lies under near lights, and lengths in units that do not go together."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.calibration.photographs import calibrated_table
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.inspect.report import inspect_capture
from irpso_addon.capture.inspect.units import camera_problems, lens_problems
from irpso_addon.capture.read import read_capture, read_spec
from irpso_addon.capture.types import Light
from irpso_addon.capture.write import write_capture
from irpso_addon.cluster.agreement import _digest_of_capture
from irpso_addon.core.errors import CheckpointError, InputError
from irpso_addon.geometry.build import domain_from_card
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state import checkpoint
from irpso_addon.solver.state.prepare import lambert_fit
from tests.builders.command_line import angle
from tests.builders.near_card import DISTANCE, near_card, write_near_card

WIDE = Camera.orthographic(24, 16, 225.0)


def codes(folder, **settings):
    return inspect_capture(folder, goals=(), **settings).codes


@pytest.mark.parametrize("camera", [None, WIDE])
def test_a_card_under_near_lights_without_its_distance_is_refused_with_the_remedy(camera):
    with pytest.raises(InputError, match="card needs its distance .* card_distance in capture.toml, or --distance"):
        domain_from_card(near_card(camera=camera, card_distance=None)[0])


@pytest.mark.parametrize("camera", [None, WIDE])
@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_normals_are_the_same_in_any_unit_of_length(unit, camera):
    if camera is not None:
        camera = Camera.orthographic(24, 16, 225.0 / unit)
    capture, values = near_card(unit, camera)
    assert angle(lambert_fit(domain_from_card(capture))[0], values["normal"]).max() < 0.01
    at_one = replace(capture, card_distance=1.0)  # what was taken before, in silence
    assert angle(lambert_fit(domain_from_card(at_one))[0], values["normal"]).mean() > 15


def test_under_distant_lights_a_card_needs_no_distance_and_one_changes_nothing():
    capture = near_card(card_distance=None)[0]
    light = Light((0.6, 0.0, 0.8))
    capture = replace(capture, observations=tuple(replace(o, light=light) for o in capture.observations))
    plain, far = (domain_from_card(replace(capture, card_distance=d)) for d in (None, DISTANCE))
    np.testing.assert_array_equal(plain.lights, far.lights)
    one, other = (d.bake.position / np.linalg.norm(d.bake.position, axis=-1, keepdims=True) for d in (plain, far))
    np.testing.assert_allclose(one, other, atol=2e-7)  # lines of sight from the camera, the origin


@pytest.mark.parametrize("value", ["0", "-420.0", "nan", "inf", '"far"', "true", "[420]"])
def test_an_invalid_distance_is_refused_in_one_line(tmp_path, value):
    table = write_near_card(tmp_path / "card") / "capture.toml"
    table.write_text(table.read_text().replace("card_distance = 420.0", f"card_distance = {value}"))
    with pytest.raises(InputError, match=r"capture.toml: card_distance must be a number above 0, as in card_d[^\n]*$"):
        read_spec(table)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_a_capture_made_in_python_has_a_distance_above_0_or_none(value):
    with pytest.raises(InputError, match="give a length above 0"):
        near_card(card_distance=value)


def test_the_distance_comes_back_with_a_written_capture_and_stays_in_a_calibrated_table(tmp_path):
    folder = write_near_card(tmp_path / "card")
    assert read_capture(folder).card_distance == DISTANCE
    spec = read_spec(folder)
    (tmp_path / "new.toml").write_text(calibrated_table(spec, {}, {0: Light((0.0, 0.0, 1.0))}, tmp_path))
    assert read_spec(tmp_path / "new.toml").card_distance == DISTANCE


def test_a_calibrated_table_keeps_the_colour_space_that_was_chosen(tmp_path):
    folder = write_near_card(tmp_path / "card")
    spec = read_spec(folder, "srgb")
    (tmp_path / "new.toml").write_text(calibrated_table(spec, {}, {0: Light((0.0, 0.0, 1.0))}, tmp_path))
    assert {shot.image.colour_space for shot in read_spec(tmp_path / "new.toml").observations} == {"srgb"}


def test_an_intensity_at_distance_1_is_not_that_of_a_distant_light(tmp_path):
    folder = write_near_card(tmp_path / "card")
    spec = read_spec(folder)
    near, distant = Light((1.0, 2.0, 400.0), distant=False), Light((0.0, 0.0, 1.0))
    (tmp_path / "new.toml").write_text(calibrated_table(spec, {}, {0: near, 1: distant}, tmp_path))
    first, second, *_ = read_spec(tmp_path / "new.toml").observations
    assert first.intensity == spec.observations[0].intensity != (1.0, 1.0, 1.0) and second.intensity == (1.0, 1.0, 1.0)


def test_measured_intensities_replace_all_former_ones_also_that_of_the_first_light(tmp_path):
    spec = read_spec(write_near_card(tmp_path / "card"))
    measured = [(1.0, 1.0, 1.0), (0.7, 0.8, 0.9)]  # relative to the first light, as matte balls give them
    lights = {n: Light((1.0, 2.0, 400.0), intensity, False) for n, intensity in enumerate(measured)}
    (tmp_path / "new.toml").write_text(calibrated_table(spec, {}, lights, tmp_path))
    assert spec.observations[0].intensity != measured[0]
    assert [shot.intensity for shot in read_spec(tmp_path / "new.toml").observations[:2]] == measured


def test_inspect_reports_the_size_of_a_card_and_a_missing_distance(tmp_path):
    folder = write_near_card(tmp_path / "card")
    report = inspect_capture(folder, goals=())
    assert dict(report.facts)["card"] == "420 from its camera, 225.1 × 150.1" and not report.findings
    unknown = write_near_card(tmp_path / "unknown", card_distance=None)
    assert codes(unknown) == {"card_distance"} and codes(unknown, card_distance=DISTANCE) == set()


def test_inspect_reports_distance_and_lamps_in_different_units(tmp_path):
    folder = write_near_card(tmp_path / "card")
    assert codes(folder, card_distance=0.42) == {"light_behind", "light_far"}
    assert "lights_narrow" in inspect_capture(folder, card_distance=420_000.0).codes


@pytest.mark.parametrize(("turn", "code"), [((1, 1, 1), set()), ((1, -1, 1), {"mirrored"})])
def test_inspect_reports_lamps_with_y_downward(tmp_path, turn, code):
    y, x = np.mgrid[:64, :96] / 8.0
    q, p = np.gradient(3 * np.sin(0.7 * (x + y)) + 2 * np.sin(x - 0.4 * y))
    normal = np.stack([-p, -q, np.ones_like(p)], axis=-1)
    values = {"normal": normal / np.linalg.norm(normal, axis=-1, keepdims=True), "base_color": np.full(3, 0.5)}
    capture, _ = near_card(values=values)
    lights = [replace(o.light, vector=tuple(np.multiply(o.light.vector, turn))) for o in capture.observations]
    shots = tuple(replace(o, light=light) for o, light in zip(capture.observations, lights, strict=True))
    write_capture(replace(capture, observations=shots), tmp_path / "card")
    assert codes(tmp_path / "card") == code


def test_inspect_reports_strengths_not_given_at_distance_1(tmp_path):
    capture, _ = near_card()
    weak = tuple(replace(o, light=replace(o.light, intensity=(1.4,) * 3)) for o in capture.observations)
    write_capture(replace(capture, observations=weak), tmp_path / "card")
    (finding,) = inspect_capture(tmp_path / "card", goals=()).findings
    assert finding.code == "light_strength" and "distance squared" in finding.message


def test_inspect_reports_a_camera_without_a_width_beside_positioned_lamps(tmp_path):
    table = write_near_card(tmp_path / "card", camera=WIDE) / "capture.toml"
    assert "lens" not in codes(tmp_path / "card")
    kept = [line for line in table.read_text().splitlines() if not line.startswith(("orthographic", "world_width"))]
    table.write_text("\n".join(kept))
    (message,) = [f.message for f in inspect_capture(tmp_path / "card", goals=()).findings if f.code == "lens"]
    assert "add fov_degrees, the lens's angle over the width, or world_width" in message


@pytest.mark.parametrize(("focal", "odd"), [(50.0, True), (2000.0, False), (6000 / 36 * 50, False), (8e5, True)])
def test_a_focal_length_in_millimetres_looks_like_no_lens(focal, odd):
    assert [code for code, _ in lens_problems(Camera(6000, 4000, (focal, focal), (3000, 2000)))] == ["lens"] * odd


@pytest.mark.parametrize(("scale", "odd"), [(1.0, False), (1000.0, True), (0.001, True)])
def test_lamps_and_cameras_in_different_units_are_reported(scale, odd):
    capture, _ = near_card()
    aside = np.array([[0, 0, 1, DISTANCE], [0, 1, 0, 0], [-1, 0, 0, -DISTANCE], [0, 0, 0, 1.0]])
    cameras = []
    for matrix in (np.eye(4), aside):  # both look at (0, 0, −420)
        matrix = matrix.copy()
        matrix[:3, 3] *= scale
        cameras.append(replace(capture.cameras[0], matrix=matrix))
    moved = replace(capture, cameras=tuple(cameras))
    assert [code for code, _ in camera_problems(moved)] == ["light_unit"] * odd


def test_ranks_refuse_captures_with_different_distances_or_lenses():
    capture, _ = near_card()
    longer = replace(capture.cameras[0], scale=(99.0, 99.0))
    others = [capture, replace(capture, card_distance=421.0), replace(capture, cameras=(longer,))]
    assert len({_digest_of_capture(one) for one in others}) == 3


def test_a_checkpoint_of_another_distance_is_refused_with_the_reason(tmp_path):
    model, schedule = load_model("lambert"), load_schedule("standard")
    near, far = (
        checkpoint.identity(domain_from_card(near_card(card_distance=d)[0]), model, schedule, 0, "fragment")
        for d in (DISTANCE, 421.0)
    )
    checkpoint.write(tmp_path / "run", near, checkpoint.Checkpoint(0, 0, 0, {}))
    with pytest.raises(CheckpointError, match="geometry differs .*distance of the card.*; start without --resume"):
        checkpoint.read(tmp_path / "run", far)
