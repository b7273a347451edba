"""``calibrate --ball none`` with ``--blend`` or ``--flat``: lights over a known shape, through the public command."""

import json

import bpy
import numpy as np
import pytest

from irpso_addon.capture.read import read_capture
from tests.builders.command_line import run_cli
from tests.builders.known_shape import write_sphere
from tests.builders.near_card import DISTANCE, write_unlit_card
from tests.builders.sphere import LAMPS


def _capture(folder, near, moved=0.0):
    """Write mesh and photographs of two cameras; return the places of the lamps and their strengths."""
    found = write_sphere(folder, near, moved)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"), check_existing=False)
    return found


def _calibrate(folder, *options):
    mesh = "--blend", folder / "scene.blend", "--object", "Sphere"
    return run_cli("calibrate", folder / "capture", "--ball", "none", *mesh, "-o", folder / "out", *options)


@pytest.mark.parametrize("near", [False, True])
def test_lights_over_a_known_mesh_are_found(tmp_path, near):
    places, strengths = _capture(tmp_path, near)
    code, answer, err = _calibrate(tmp_path, "--json")
    assert (code, err) == (0, ""), err
    said = json.loads(answer.splitlines()[-1])
    assert (said["lights"], said["near"], said["warnings"]) == (LAMPS, near, [])
    found = read_capture(tmp_path / "out").lights
    vectors = np.array([light.vector for light in found])
    if near:
        assert np.linalg.norm(vectors - places, axis=-1).max() < 0.03 * 3.2
    else:
        unit = places / np.linalg.norm(places, axis=-1, keepdims=True)
        assert np.degrees(np.arccos((vectors * unit).sum(axis=-1))).max() < 1.0
    power = np.array([light.intensity[0] for light in found]) / strengths
    assert np.std(np.log(power)) < 0.03


def test_a_mesh_that_is_elsewhere_is_refused(tmp_path):
    _capture(tmp_path, near=False, moved=0.8)
    code, _, err = _calibrate(tmp_path, "--quiet")
    assert (code, err.count("\n")) == (2, 1)
    assert "of its outline is off" in err
    assert not (tmp_path / "out").exists()


def test_near_lights_of_a_flat_card_are_found(tmp_path):
    capture = write_unlit_card(tmp_path / "capture")
    code, _, err = run_cli(
        "calibrate", tmp_path / "capture", "--ball", "none", "--flat", "-o", tmp_path / "out", "--quiet"
    )
    assert (code, err.count("\n")) == (0, 1)
    assert "all of each photograph counts as the flat card" in err  # which is right here
    found = read_capture(tmp_path / "out")
    # Nothing tells the unit: it is the width of the picture.
    unit = DISTANCE / found.card_distance
    assert 2 * np.tan(np.radians(15)) * found.card_distance == pytest.approx(1)
    for light, shot in zip(found.lights, capture.observations, strict=True):
        assert np.linalg.norm(unit * np.array(light.vector) - shot.light.vector) < 0.02 * 260
    power = [light.light.intensity[0] for light in found.observations]
    assert np.std(np.log(power)) < 0.03


def test_options_of_meshes_need_a_mesh(tmp_path):
    for options, said in (
        (("--ball", "none", "--object", "Sphere"), "--object: is for meshes"),
        (("--blend", "x.blend"), "--blend: needs --ball none"),
        (("--flat",), "--flat: needs --ball none"),
        (("--ball", "none", "--flat", "--blend", "x.blend"), "--flat and --blend"),
        (("--ball", "none", "--flat", "--lights", "distant"), "--lights distant: matt shading of a flat card"),
        (("--ball", "none", "--blend", "x.blend", "--inside-out"), "--inside-out: a mesh"),
    ):
        code, _, err = run_cli("calibrate", tmp_path, *options, "-o", tmp_path / "out")
        assert (code, err.count("\n")) == (2, 1)
        assert said in err
