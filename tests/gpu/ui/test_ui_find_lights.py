"""The button that finds lights: from balls, from a known mesh, a flat card or relief."""

import json
import math
import tempfile
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from irpso_addon.capture.camera import Camera
from irpso_addon.capture.images.exr import write_exr
from irpso_addon.capture.read import read_capture, read_spec
from irpso_addon.ui.marks import ball_marks
from irpso_addon.ui.operators import find_lights
from irpso_addon.ui.operators.find_lights import FindLights, free_table
from tests.builders.ball_scenes import Scene, Sphere, place
from tests.builders.ball_scenes import photographs as photographs_of
from tests.builders.balls import cap, degrees, mirror_image, photographed, trace
from tests.builders.known_shape import write_sphere
from tests.builders.near_card import DISTANCE, write_unlit_card
from tests.builders.relief import write_ball

pytestmark = [pytest.mark.bpy_only, pytest.mark.usefixtures("registered")]

CAMERA, CENTRE, RADIUS = Camera.from_fov(96, 80, 30.0), np.array([0.2, -0.1, -8.0]), 1.4
LIGHTS = cap(6, 50)


@pytest.fixture
def photographs(tmp_path):
    """A folder of mirror balls, and the mask outside of it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    folder, rng = tmp_path / "photographs", np.random.default_rng(1)
    folder.mkdir()
    for number, light in enumerate(LIGHTS):
        image = photographed(mirror_image(CAMERA, [(CENTRE, RADIUS)], light), rng, 0.8)
        write_exr(folder / f"{number}.exr", {"": {c: image[..., i] for i, c in enumerate("RGB")}})
    write_exr(tmp_path / "ball.exr", {"": {"Y": trace(CAMERA, CENTRE, RADIUS)[3].astype(np.float32)}})
    return folder


def press(folder, kind="mirror", **given):
    return bpy.ops.irpso.find_lights(photographs=str(folder), kind=kind, fov=math.radians(30), **given)


def test_with_nothing_but_the_folder_the_ball_is_searched(tmp_path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = Scene(camera=Camera.from_fov(160, 120, 30.0))
    scene = Scene(spheres=(Sphere("matte", place(scene, 0.3, -0.2, 0.6), 0.6),), camera=scene.camera)
    for number, image in enumerate(photographs_of(scene, LIGHTS)):
        write_exr(tmp_path / f"{number}.exr", {"": {c: image[..., i] for i, c in enumerate("RGB")}})
    assert bpy.ops.irpso.find_lights(photographs=str(tmp_path), fov=math.radians(30)) == {"FINISHED"}
    capture = read_capture(bpy.context.scene.irpso.capture_path)
    assert degrees([o.light.vector for o in capture.observations], LIGHTS).max() < 3.0


def test_without_a_ball_the_subjects_shading_shows_the_lights(tmp_path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    directions = write_ball(tmp_path)
    assert bpy.ops.irpso.find_lights(photographs=str(tmp_path), found_by="NONE") == {"FINISHED"}
    settings = bpy.context.scene.irpso
    assert settings.capture_path == str(tmp_path / "capture.toml")
    found = [one.light.vector for one in read_capture(settings.capture_path).observations]
    assert degrees(found, directions).mean() < 1.0
    assert (tmp_path / "capture_report.json").is_file()


@pytest.mark.parametrize("near", [False, True])
def test_a_mesh_of_the_scene_shows_the_lights_and_is_then_the_subject(tmp_path, near):
    places, _ = write_sphere(tmp_path, near)
    bpy.context.view_layer.objects.active = bpy.data.objects["Sphere"]
    given = {"photographs": str(tmp_path / "capture"), "found_by": "MESH"}
    assert bpy.ops.irpso.find_lights(**given, lights="near" if near else "auto") == {"FINISHED"}
    settings = bpy.context.scene.irpso
    assert settings.subject == "MESH"
    found = np.array([one.light.vector for one in read_capture(settings.capture_path).observations])
    if near:
        assert np.linalg.norm(found - places, axis=-1).max() < 0.03 * 3.2
    else:
        assert degrees(found, places / np.linalg.norm(places, axis=-1, keepdims=True)).max() < 1.0


def test_without_a_mesh_there_is_no_known_mesh(tmp_path):
    write_sphere(tmp_path, near=False)
    bpy.data.objects.remove(bpy.data.objects["Sphere"])
    with pytest.raises(RuntimeError, match="Object: is no mesh; choose the mesh that the photographs show"):
        bpy.ops.irpso.find_lights(photographs=str(tmp_path / "capture"), found_by="MESH")


@pytest.mark.parametrize("marked", [False, True])
def test_near_lamps_are_found_over_the_framed_part_of_a_flat_card_of_known_width(tmp_path, marked):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    capture, settings = write_unlit_card(tmp_path / "card"), bpy.context.scene.irpso
    shown = 60
    if marked:
        settings.capture_path, shown = str(tmp_path / "card"), 50
        settings.framing, settings.crop = "CROP", (4, 0, shown, 40)
    width = shown / 60 * 2 * DISTANCE * math.tan(math.radians(15))
    given = {"photographs": str(tmp_path / "card"), "found_by": "FLAT", "card_width": width}
    assert bpy.ops.irpso.find_lights(**given) == {"FINISHED"}
    found = read_capture(settings.capture_path)
    assert found.card_distance == pytest.approx(DISTANCE, rel=1e-5) and found.masks[0].shape == (40, shown)
    table = Path(settings.capture_path)
    warnings = json.loads(table.with_name(f"{table.stem}_report.json").read_text())["warnings"]
    assert any("all of each photograph counts as the flat card" in warning for warning in warnings) != marked
    for light, shot in zip(found.observations, capture.observations, strict=True):
        assert np.linalg.norm(np.array(light.light.vector) - shot.light.vector) < 0.02 * 260


def test_a_flat_card_whose_corners_do_not_show_is_refused_and_nothing_is_written(tmp_path):
    pytest.importorskip("cv2", reason="OpenCV is not installed")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    write_unlit_card(tmp_path)
    with pytest.raises(RuntimeError, match="corners auto: .*; use Mark in Photograph"):
        bpy.ops.irpso.find_lights(photographs=str(tmp_path), found_by="FLAT", card="FIND")
    assert not (tmp_path / "capture_1.toml").exists()


def test_corners_that_are_found_are_the_frame_of_the_new_capture(tmp_path):
    pytest.importorskip("cv2", reason="OpenCV is not installed")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    capture = write_unlit_card(tmp_path, border=(20, 30))
    width = 2 * DISTANCE * math.tan(math.radians(15)) * 60 / 120
    given = {"photographs": str(tmp_path), "found_by": "FLAT", "card": "FIND", "card_width": width}
    assert bpy.ops.irpso.find_lights(**given) == {"FINISHED"}
    found = read_capture(bpy.context.scene.irpso.capture_path)
    assert found.masks[0].shape == (40, 60)
    for light, shot in zip(found.observations, capture.observations, strict=True):
        assert np.linalg.norm(np.array(light.light.vector) - shot.light.vector) < 0.03 * 260


def test_what_is_marked_stays_when_lights_of_the_same_photographs_are_found_again(photographs):
    mask = {"found_by": "MASK", "mask": str(photographs.parent / "ball.exr")}
    press(photographs, **mask)
    settings = bpy.context.scene.irpso
    settings.framing, settings.crop, settings.picture_scale = "CROP", (3, 2, 40, 30), 0.5
    press(settings.capture_path, **mask)
    assert settings.capture_path.endswith("capture_1.toml")
    assert (settings.framing, tuple(settings.crop), settings.picture_scale) == ("CROP", (3, 2, 40, 30), 0.5)


def test_a_ball_of_known_radius_gives_directions_without_a_lamp_distance(photographs):
    assert press(photographs, found_by="MASK", mask=str(photographs.parent / "ball.exr"), radius=RADIUS) == {"FINISHED"}
    assert not bpy.context.scene.irpso.near_lights


def test_a_string_makes_positions_of_one_balls_directions_and_a_correction_keeps_it(photographs):
    mask = {"found_by": "MASK", "mask": str(photographs.parent / "ball.exr")}
    press(photographs, **mask, radius=RADIUS, distance=9.0)
    settings = bpy.context.scene.irpso
    assert settings.near_lights and settings.stated_distance == pytest.approx(RADIUS - CENTRE[2], rel=0.01)
    assert read_spec(settings.capture_path).card_distance == pytest.approx(settings.stated_distance)
    bpy.ops.irpso.mark_balls(moves=[0.0] * 30)
    for light in read_capture(settings.capture_path).observations:
        assert np.linalg.norm(np.array(light.light.vector) - CENTRE) == pytest.approx(9.0, rel=0.01)


def test_messages_have_the_names_of_the_dialogs_entries(photographs):
    with pytest.raises(RuntimeError, match="one ball gives a direction only; add a second ball, or Lamp Distance"):
        press(photographs, found_by="MASK", mask=str(photographs.parent / "ball.exr"), lights="near")


def test_photographs_in_which_no_ball_is_found_are_one_line(tmp_path):
    for number in range(3):
        grey = np.random.default_rng(number).uniform(0.2, 0.3, (60, 80)).astype(np.float32)
        write_exr(tmp_path / f"{number}.exr", {"": dict.fromkeys("RGB", grey)})
    with pytest.raises(RuntimeError, match="no ball was found"):
        bpy.ops.irpso.find_lights(photographs=str(tmp_path))
    assert not (tmp_path / "capture.toml").exists()


def test_importing_photographs_without_lights_leads_to_find_lights(photographs):
    with pytest.raises(RuntimeError, match="holds photographs without a list of their lights; use Find Lights"):
        bpy.ops.irpso.import_capture(directory=str(photographs))


def test_the_dialog_has_the_entries_of_the_chosen_way_alone(photographs):
    def entries(**values):
        given = {"photographs": str(photographs), "radius": 0.0, "kind": "auto", "found_by": "AUTO", **values}
        return FindLights._entries(SimpleNamespace(**given), bpy.context)

    assert entries() == ["kind", "lights", "radius"]
    assert entries(found_by="CIRCLE", radius=20.0) == ["kind", "circle", "lights", "radius", "distance"]
    assert entries(found_by="MASK", kind="matte") == ["kind", "mask", "lights", "radius", "albedo"]
    assert entries(found_by="MESH") == ["lights"] and entries(found_by="FLAT") == ["card", "card_width"]
    assert entries(found_by="NONE") == ["inside_out"]


def test_a_capture_of_several_cameras_asks_for_that_of_the_balls(tmp_path):
    write_sphere(tmp_path, near=False)
    dialog = SimpleNamespace(photographs=str(tmp_path / "capture"), found_by="AUTO", kind="auto", radius=0.0)
    assert FindLights._entries(dialog, bpy.context)[0] == "camera"
    with pytest.raises(RuntimeError, match="has 2 cameras; name the one that saw the ball with Camera"):
        bpy.ops.irpso.find_lights(photographs=str(tmp_path / "capture"))


def test_the_dialog_opens_with_the_scenes_photographs_and_not_with_those_of_last_time():
    assert bpy.ops.irpso.find_lights.get_rna_type().properties["photographs"].is_skip_save


def choose_another_capture():
    bpy.context.scene.irpso.capture_path = "/another"


def open_another_scene():
    bpy.context.window.scene = bpy.data.scenes.new("Other")


@pytest.mark.parametrize("meanwhile", [choose_another_capture, open_another_scene])
def test_lights_found_for_another_capture_are_not_imported(monkeypatch, photographs, meanwhile):
    usual = FindLights._find_steps

    def steps(self, settings):
        found = yield from usual(self, settings)
        meanwhile()
        return found

    monkeypatch.setattr(FindLights, "_find_steps", steps)
    assert press(photographs, found_by="MASK", mask=str(photographs.parent / "ball.exr")) == {"FINISHED"}
    assert (photographs / "capture.toml").is_file()
    assert bpy.context.scene.irpso.capture_path in ("/another", "")


def test_photographs_that_cannot_be_written_beside_are_refused_before_the_work(monkeypatch, photographs):
    def refused(**_):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(tempfile, "TemporaryFile", refused)
    monkeypatch.setattr(find_lights, "calibrate_steps", None)
    with pytest.raises(RuntimeError, match="photographs: cannot be written .*; copy the photographs to a folder"):
        press(photographs, found_by="MASK", mask=str(photographs.parent / "ball.exr"))


def test_a_mask_needs_a_kind(photographs):
    with pytest.raises(RuntimeError, match="choose Mirror or Matte"):
        press(photographs, "auto", found_by="MASK", mask=str(photographs.parent / "ball.exr"))


def test_a_mask_makes_the_folder_a_capture_that_is_imported(photographs):
    assert press(photographs, found_by="MASK", mask=str(photographs.parent / "ball.exr")) == {"FINISHED"}
    settings = bpy.context.scene.irpso
    assert settings.capture_path == str(photographs / "capture.toml") and settings.source == "FILES"
    capture = read_capture(settings.capture_path)
    assert degrees([o.light.vector for o in capture.observations], LIGHTS).max() < 1.0
    assert (photographs / "capture_balls.png").is_file() and (photographs / "capture_report.json").is_file()


def test_a_circle_counts_from_the_upper_left_and_a_table_is_never_overwritten(photographs):
    inside = np.argwhere(trace(CAMERA, CENTRE, RADIUS)[3]) + 0.5
    (y, x), radius = inside.mean(axis=0), np.sqrt(len(inside) / np.pi)
    circle = (x, CAMERA.height - y, radius)
    (photographs / "capture.toml").write_text("format = 1")
    (photographs / "filenames.txt").write_text("".join(f"{n}.exr\n" for n in range(len(LIGHTS))))
    with pytest.raises(RuntimeError, match="has no"):
        press(photographs, found_by="CIRCLE", circle=circle)
    assert (photographs / "capture.toml").read_text() == "format = 1"
    (photographs / "capture.toml").unlink()
    assert press(photographs, found_by="CIRCLE", circle=circle) == {"FINISHED"}
    first = (photographs / "capture.toml").read_text()
    bpy.context.scene.irpso.subject = "MESH"
    assert press(photographs / "capture.toml", found_by="CIRCLE", circle=circle) == {"FINISHED"}
    assert (photographs / "capture.toml").read_text() == first and bpy.context.scene.irpso.subject == "MESH"
    assert free_table(photographs).name == "capture_2.toml"
    capture = read_capture(photographs / "capture_1.toml")
    assert degrees([o.light.vector for o in capture.observations], LIGHTS).max() < 1.5


def test_balls_of_a_calibration_are_moved_and_a_highlight_is_dropped(photographs):
    inside = np.argwhere(trace(CAMERA, CENTRE, RADIUS)[3]) + 0.5
    (y, x), radius = inside.mean(axis=0), np.sqrt(len(inside) / np.pi)
    press(photographs, found_by="CIRCLE", circle=(x + 3, CAMERA.height - y - 2, radius * 0.9))
    wrong = read_capture(photographs / "capture.toml")
    assert degrees([o.light.vector for o in wrong.observations], LIGHTS).max() > 5
    assert bpy.ops.irpso.mark_balls(moves=(-3, 2, 0.1 * radius, *[0] * 27), dropped="2.exr") == {"FINISHED"}
    path = bpy.context.scene.irpso.capture_path
    assert path == str(photographs / "capture_1.toml")
    right, kept = read_capture(path), np.delete(LIGHTS, 2, axis=0)
    assert [o.name for o in right.observations] == ["0.exr", "1.exr", "3.exr", "4.exr", "5.exr"]
    assert degrees([o.light.vector for o in right.observations], kept).max() < 1.5


def test_the_rim_of_a_ball_and_its_highlights_are_where_the_mouse_takes_hold_of_them(photographs):
    press(photographs, found_by="MASK", mask=str(photographs.parent / "ball.exr"))
    report = ball_marks.report_beside(photographs / "capture.toml")
    marks = SimpleNamespace(
        _size=np.array([CAMERA.width, CAMERA.height]), _circles=np.array([b["circle"] for b in report["balls"]]),
        _highlights=[(row["name"], np.array(row["highlights"][0])) for row in report["lights"]], _dropped=set(),
    )  # fmt: skip
    operator = ball_marks.IRPSO_OT_mark_balls
    marks._place_of = lambda x, y: operator._place_of(marks, x, y)
    handles = operator.handles(marks)
    inside = np.argwhere(trace(CAMERA, CENTRE, RADIUS)[3])[:, ::-1] + 0.5
    np.testing.assert_allclose(handles["middle", 0] * marks._size, inside.mean(axis=0), atol=0.5)
    assert handles["rim", 0][0] * CAMERA.width == pytest.approx(inside[:, 0].max() + 0.5, abs=1)
    assert operator.clicked(marks, ("spot", 1), np.zeros(2)) is None and marks._dropped == {"1.exr"}
    operator.clicked(marks, ("spot", 1), np.zeros(2))
    assert marks._dropped == set() and operator.clicked(marks, ("rim", 0), np.zeros(2)) == ("rim", 0)
    operator.moved(marks, ("rim", 0), handles["middle", 0] + (0.1, 0))
    assert marks._circles[0, 2] == pytest.approx(0.1 * CAMERA.width)
    operator.moved(marks, ("middle", 0), np.array([0.25, 0.75]))
    np.testing.assert_allclose(marks._circles[0, :2], (0.25 * CAMERA.width, 0.25 * CAMERA.height))


def test_without_a_calibrations_report_no_ball_can_be_moved(photographs):
    bpy.context.scene.irpso.capture_path = str(photographs)
    with pytest.raises(RuntimeError, match="use Find Lights first"):
        bpy.ops.irpso.mark_balls()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"found_by": "MASK"}, "no file is chosen"),
        ({"found_by": "CIRCLE"}, "Radius: is 0"),
        ({"found_by": "CIRCLE", "circle": (900, 10, 20)}, "outside the image"),
    ],
)
def test_missing_input_is_reported_and_nothing_written(photographs, given, words):
    before = sorted(p.name for p in photographs.iterdir())
    with pytest.raises(RuntimeError, match=words):
        press(photographs, **given)
    assert sorted(p.name for p in photographs.iterdir()) == before
    assert bpy.context.scene.irpso.capture_path == ""
