"""The part of the photographs in the window's settings: cropped, smaller, by four corners; and the card's width."""

import itertools
import re

import bpy
import numpy as np
import pytest

from irpso_addon.capture.camera import Camera
from irpso_addon.capture.frame import find
from irpso_addon.capture.frame.board import board_of
from irpso_addon.capture.images import image
from irpso_addon.capture.inspect import damage
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.capture.write import write_capture
from irpso_addon.ui.marks.card_marks import around
from irpso_addon.ui.marks.marking import Marking
from irpso_addon.ui.session import scene_capture, scene_job
from tests.builders.flat_scene import from_upper_left, looking_camera, seen_plane
from tests.builders.handheld import on_board
from tests.builders.near_card import DISTANCE, write_near_card, write_unlit_card

pytestmark = [pytest.mark.bpy_only, pytest.mark.usefixtures("registered")]
MARKS = ((4.0, 3.0), (20.0, 2.6), (19.5, 12.0), (3.6, 12.4))  # of a card, clockwise


@pytest.fixture
def settings(registered, tmp_path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    folder = write_near_card(tmp_path / "card")
    bpy.context.scene.irpso.capture_path = str(folder)
    return bpy.context.scene.irpso


def shape(settings):
    return scene_capture.capture_of(settings.id_data).masks[0].shape


@pytest.mark.parametrize("order", list(itertools.permutations(range(4)))[::5])
def test_marked_corners_go_clockwise_from_the_upper_left(settings, order):
    bpy.ops.irpso.mark_card(corners=np.take(MARKS, order, axis=0).ravel())
    np.testing.assert_allclose(np.reshape(settings.corners, (4, 2)), MARKS, atol=1e-6)
    assert (settings.framing, tuple(settings.crop)) == ("CORNERS", (3, 2, 17, 11))


def test_numbers_are_those_that_were_typed_as_on_the_command_line(settings):
    """Blender keeps 0.7 as 0.699999988."""
    settings.framing, settings.corners = "CORNERS", np.ravel(MARKS)
    settings.picture_scale, settings.card_width = 0.04, 0.53
    framing = scene_capture.spec_of(settings).framing
    assert (framing.scale, framing.card_width, framing.corners) == (0.04, 0.53, MARKS)
    settings.card_width, settings.card_distance = 0.0, 0.7
    assert scene_capture.spec_of(settings).card_distance == 0.7


@pytest.mark.parametrize("damaged", [0, 1, 3])
def test_only_the_shown_photographs_are_read_even_where_damaged_ones_are_left_out(settings, monkeypatch, damaged):
    shots = scene_capture.spec_of(settings).observations
    assert len(shots) == 16
    settings.skip_damaged = True
    damage._sizes.clear()  # the check has read them
    shown = [shots[0], shots[8], shots[15]]
    for shot in shown[:damaged]:
        shot.image.path.write_bytes(shot.image.path.read_bytes()[:-200])
    read, load = set(), image.load_exr
    monkeypatch.setattr(image, "load_exr", lambda path: read.add(path) or load(path))
    pictures = list(Marking().radiances(settings, 3))
    assert len(pictures) == (3 if damaged == 3 else 3 - damaged)
    assert all(picture.shape == (16, 24, 3) for picture in pictures)
    intact = [shot for shot in (shots if damaged == 3 else shown) if shot not in shown[:damaged]]
    assert read == {shot.image.path for shot in intact}


def test_corners_of_a_card_that_is_turned_begin_at_the_upper_left():
    square = np.array([(0, 1), (1, 0), (0, -1), (-1, 0)])  # on its tip
    np.testing.assert_array_equal(around(square + (0.1, 0)), np.roll(square + (0.1, 0), 1, axis=0))


def test_what_is_marked_is_what_is_recovered(settings):
    assert shape(settings) == (16, 24)
    settings.framing = "CROP"
    assert "nothing is marked" in scene_job.missing(bpy.context)
    bpy.ops.irpso.mark_card(corners=np.ravel(MARKS))
    assert (settings.framing, shape(settings)) == ("CROP", (11, 17))
    settings.framing = "CORNERS"
    assert scene_job.missing(bpy.context) == ""
    found = scene_capture.capture_of(settings.id_data)
    assert found.masks[0].shape == (9, 16)
    assert not np.allclose(found.cameras[0].matrix, np.eye(4))
    settings.picture_scale = 0.5
    assert shape(settings) == (5, 8)


def test_the_width_of_a_card_gives_its_distance(settings, tmp_path):
    folder = write_near_card(tmp_path / "unknown", card_distance=None)
    settings.capture_path = str(folder)
    scene_capture.capture_of(settings.id_data)  # reads whether the lights are near
    assert "Card Width" in scene_job.missing(bpy.context)
    settings.card_width = 2 * DISTANCE * np.tan(np.radians(15))  # of a picture over 30°
    assert scene_job.missing(bpy.context) == ""
    assert scene_capture.capture_of(settings.id_data).card_distance == pytest.approx(DISTANCE, rel=1e-6)
    settings.card_distance = 3.0
    assert scene_capture.capture_of(settings.id_data).card_distance == 3.0


def test_a_crop_does_not_get_the_width_that_the_file_states_of_the_whole(settings, tmp_path):
    table = write_near_card(tmp_path / "stated", card_distance=None) / "capture.toml"
    table.write_text(f"card_width = {2 * DISTANCE * np.tan(np.radians(15))}\n" + table.read_text())
    settings.capture_path = str(table)
    settings.framing, settings.crop = "CROP", (4, 2, 12, 10)
    assert scene_capture.capture_of(settings.id_data).card_distance == pytest.approx(DISTANCE, rel=1e-6)
    settings.card_width = 50.0
    assert scene_capture.capture_of(settings.id_data).card_distance == pytest.approx(50 / np.tan(np.radians(15)))


def test_the_check_takes_the_width_for_the_part_that_the_window_marks(settings, tmp_path):
    folder = write_near_card(tmp_path / "unknown", card_distance=None)
    settings.capture_path = str(folder)
    settings.framing, settings.crop, settings.card_width = "CROP", (4, 2, 12, 10), DISTANCE * np.tan(np.radians(15))
    bpy.ops.irpso.check_capture()
    assert "card: 420 from its camera, 112.5 × 93.78" in settings.summary
    settings.crop = (0, 0, 0, 0)  # not marked yet
    bpy.ops.irpso.check_capture()
    assert "card: 210 from its camera" in settings.summary
    settings.crop, settings.card_width, settings.card_distance = (4, 2, 12, 10), 0.0, 300.0
    bpy.ops.irpso.check_capture()
    assert "card: 300 from its camera" in settings.summary


def test_another_capture_is_whole_again(settings, tmp_path):
    settings.framing, settings.picture_scale, settings.card_width = "CROP", 0.5, 2.0
    settings.capture_path = str(write_near_card(tmp_path / "other"))
    assert (settings.framing, settings.picture_scale, settings.card_width) == ("FILE", 1.0, 0.0)


def test_a_mesh_is_not_cropped(settings):
    bpy.ops.irpso.mark_card(corners=np.ravel(MARKS))
    settings.subject = "MESH"
    assert shape(settings) == (16, 24)


def test_corners_are_found_by_a_printed_board_with_the_width_of_its_field(settings, tmp_path):
    pytest.importorskip("cv2", reason="OpenCV is not installed")
    camera = looking_camera((400, 320), 430, 480, tilt=20, around=70)
    grey = np.dstack([seen_plane(camera, on_board)] * 3 + [np.ones((320, 400))]).astype(np.float32)
    shots = tuple(Observation(f"{n}", lambda: grey, Light((n, 0.0, 90.0), distant=False)) for n in range(3))
    flat = Camera(400, 320, (430, 430), (200, 160))
    write_capture(Capture("board", shots, (flat,), (np.ones((320, 400), bool),)), tmp_path / "board")
    settings.capture_path = str(tmp_path / "board")
    assert bpy.ops.irpso.find_corners() == {"FINISHED"}
    true = from_upper_left(camera, board_of("A4", 8).field_corners)
    np.testing.assert_allclose(np.reshape(settings.corners, (4, 2)), true, atol=1.0)
    assert (settings.framing, settings.card_width) == ("CORNERS", 130.0)
    damaged = tmp_path / "board" / "001.exr"
    damaged.write_bytes(damaged.read_bytes()[:-50])
    with pytest.raises(RuntimeError, match="cut short"):
        bpy.ops.irpso.find_corners()
    settings.skip_damaged = True
    assert bpy.ops.irpso.find_corners() == {"FINISHED"}


def test_photographs_without_a_card_are_refused_where_corners_are_looked_for(settings):
    pytest.importorskip("cv2", reason="OpenCV is not installed")
    before = settings.framing
    with pytest.raises(RuntimeError, match="corners auto"):
        bpy.ops.irpso.find_corners()
    assert settings.framing == before


def test_corners_that_the_check_has_found_are_not_searched_again_by_recover(settings, tmp_path, monkeypatch):
    pytest.importorskip("cv2", reason="OpenCV is not installed")
    write_unlit_card(tmp_path / "bordered", border=(20, 30))
    table = tmp_path / "bordered" / "capture.toml"
    text = table.read_text().replace('colour_space = "linear"', 'colour_space = "linear"\ncorners = "auto"', 1)
    rows = (f"light_direction = [{0.3 * (k % 4) - 0.45}, {0.1 * k - 0.7}, 1.0]" for k in itertools.count())
    table.write_text(re.sub(r"light_direction = .*", lambda _: next(rows), text))
    assert bpy.ops.irpso.import_capture(filepath=str(table)) == {"FINISHED"}
    true = [(30, 20), (90, 20), (90, 60), (30, 60)]
    np.testing.assert_allclose(np.reshape(settings.corners, (4, 2)), true, atol=0.7)
    assert settings.framing == "CORNERS" and settings.checked_texels == 40 * 60
    monkeypatch.setattr(find, "display_codes", lambda *_: pytest.fail("it is searched again"))
    assert shape(settings) == (40, 60)
