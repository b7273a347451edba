"""A flat card under near lights, from files in millimetres to maps: through the command line and through the window."""

import json
import re
import shutil

import bpy
import numpy as np
import pytest

from irpso_addon.capture.read import read_capture
from irpso_addon.ui.session import scene_capture
from irpso_addon.ui.session.scene_job import make_job, missing
from tests.builders.command_line import angle, listing, read_map, run_cli
from tests.builders.near_card import DISTANCE, SHAPE, near_card, write_near_card

OPTIONS = ("--model", "lambert", "--iterations", 100, "--quiet")

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    """Two captures of the card: one says its distance, the other does not; and the true normals."""
    folder = tmp_path_factory.mktemp("captures")
    stated = write_near_card(folder / "stated")
    return stated, write_near_card(folder / "unstated", card_distance=None), near_card()[1]["normal"]


@pytest.fixture
def settings(registered):
    bpy.ops.wm.read_homefile(use_empty=True)
    return bpy.context.scene.irpso


def test_a_near_lit_card_needs_its_distance(captures, tmp_path):
    stated, unstated, normals = captures
    before = listing(tmp_path)
    code, _, said = run_cli("recover", unstated, *OPTIONS, "-o", tmp_path / "none")
    assert code == 2 and said.count("\n") == 1 and "set card_distance in capture.toml, or --distance" in said
    assert listing(tmp_path) == before
    for name, words in {"stated": [stated], "given": [unstated, "--distance", DISTANCE]}.items():
        code, _, said = run_cli("recover", *words, *OPTIONS, "-o", tmp_path / name)
        assert (code, said) == (0, "")
        assert angle(read_map(tmp_path / name / "normal.exr"), normals).max() < 0.1
    code, _, said = run_cli("recover", stated, *OPTIONS, "--distance", 1, "-o", tmp_path / "other")
    assert code == 0 and angle(read_map(tmp_path / "other" / "normal.exr"), normals).mean() > 30


def test_lamps_behind_the_card_are_warned_of(captures, tmp_path):
    folder = tmp_path / "behind"
    shutil.copytree(captures[0], folder)
    table = folder / "capture.toml"
    numbers = r"light_position = \[([^,]+), ([^,]+), ([^,]+)\]"

    def behind(match):  # the sign of z, from the card, is wrong
        x, y, z = map(float, match.groups())
        return f"light_position = [{x}, {y}, {-2 * DISTANCE - z}]"

    table.write_text(re.sub(numbers, behind, table.read_text(), count=4))
    command = "recover", folder, "-o", tmp_path / "out", "--model", "lambert", "--iterations", 20, "--quiet"
    code, _, said = run_cli(*command)
    (warning,) = [
        line for line in json.loads((tmp_path / "out" / "report.json").read_text())["warnings"] if "behind" in line
    ]
    assert code == 0 and warning in said and warning.startswith("4 of 16 near lights lie behind the card, which is 420")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["--distance", "0"], "--distance 0: give a number above 0"),
        (["--distance", "-420"], "--distance -420: give a number above 0"),
        (["--distance", "nan"], "--distance nan: give a number above 0"),
        (["--distance", "far"], "--distance: invalid float value: 'far'"),
        (["--distance", "1", "--blend", "x.blend"], "--distance applies to a flat card; leave it out with a mesh"),
    ],
)
@pytest.mark.bpy_only
def test_an_invalid_distance_is_refused_in_one_line(captures, tmp_path, given, words):
    code, _, said = run_cli("recover", captures[1], *OPTIONS, *given, "-o", tmp_path / "out")
    assert code == 2 and words in said and said.count("\n") == 1 and not (tmp_path / "out").exists()


@pytest.mark.bpy_only
def test_a_developed_capture_keeps_the_distance(captures, tmp_path):
    code, _, said = run_cli("develop", captures[0], "-o", tmp_path / "out", "--quiet")
    assert (code, said) == (0, "") and read_capture(tmp_path / "out").card_distance == DISTANCE


@pytest.mark.bpy_only
def test_the_window_asks_for_the_distance_of_a_card_until_it_has_one(captures, settings):
    stated, unstated, _ = captures
    bpy.ops.irpso.import_capture(filepath=str(unstated))
    assert settings.subject == "CARD" and "set Card Distance" in missing(bpy.context)
    assert not bpy.ops.irpso.recover.poll()
    settings.card_distance = DISTANCE
    assert missing(bpy.context) == "" and make_job(bpy.context).capture.card_distance == DISTANCE
    bpy.ops.irpso.check_capture()
    assert "card_distance" not in " ".join(item.message for item in settings.findings)
    bpy.ops.irpso.import_capture(filepath=str(unstated))  # the same files again
    assert settings.card_distance == DISTANCE
    bpy.ops.irpso.import_capture(filepath=str(stated))  # others, which say it themselves
    assert settings.card_distance == 0 and missing(bpy.context) == ""
    assert make_job(bpy.context).capture.card_distance == DISTANCE
    settings.subject = "MESH"
    assert not scene_capture.wants_distance(bpy.context.scene)


@pytest.mark.bpy_only
def test_a_path_that_was_typed_is_refused_with_the_settings_name(captures, settings):
    settings.capture_path = str(captures[1])
    with pytest.raises(RuntimeError, match="card needs its distance .* or Card Distance"):
        bpy.ops.irpso.recover()
    assert settings.near_lights and "set Card Distance" in missing(bpy.context)  # from now on the panel shows it


@pytest.mark.bpy_only
def test_the_scene_of_a_capture_has_its_card_at_the_distance_and_is_the_same_capture(captures, settings):
    bpy.ops.irpso.import_capture(filepath=str(captures[0]))
    bpy.ops.irpso.create_scene()
    (card,) = [obj for obj in bpy.context.scene.objects if obj.type == "MESH"]
    width = 2 * DISTANCE * np.tan(np.radians(15))
    np.testing.assert_allclose(card.matrix_world.translation, (0, 0, -DISTANCE), atol=1e-4)
    np.testing.assert_allclose(card.dimensions, (width, width * SHAPE[0] / SHAPE[1], 0), rtol=1e-5)
    settings.source = "SCENE"
    assert scene_capture.wants_distance(bpy.context.scene) and missing(bpy.context) == ""
    assert scene_capture.capture_of(bpy.context.scene).card_distance == DISTANCE
    settings.card_length = 0.0
    assert settings.card_distance == 0 and "set Card Distance" in missing(bpy.context)
    bpy.ops.irpso.check_capture()
    assert "card needs its distance" in settings.findings[0].message


@pytest.mark.bpy_only
def test_no_scene_is_made_of_a_card_at_an_unknown_distance(captures, settings):
    bpy.ops.irpso.import_capture(filepath=str(captures[1]))
    with pytest.raises(RuntimeError, match="card needs its distance"):
        bpy.ops.irpso.create_scene()
    assert not bpy.context.scene.objects
