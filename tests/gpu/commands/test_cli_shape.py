"""``calibrate --ball none`` with ``--blend`` or ``--flat``: lights over a known shape, through the public command."""

import json

import bpy
import numpy as np
import pytest

from irpso_addon.capture.camera import Camera
from irpso_addon.capture.read import read_capture, read_spec
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.capture.write import write_capture
from tests.builders.command_line import dome_lights, run_cli
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


def test_the_distance_of_a_tilted_card_is_written_along_the_lens(tmp_path):
    camera, tilt = Camera.from_fov(120, 90, 30.0), np.radians(30)
    axes = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    middle = np.array([0.0, 0.0, -DISTANCE])
    rays = camera.points(1.0)
    points = rays * ((axes[:, 2] @ middle) / (rays @ axes[:, 2]))[..., None]
    lamps = middle + 260.0 * dome_lights(16, widest=60.0) @ axes.T
    shots = []
    for number, lamp in enumerate(lamps):
        toward = lamp - points
        radiance = 3e4 * (toward @ axes[:, 2]) / np.linalg.norm(toward, axis=-1) ** 3
        image = np.stack([*[radiance] * 3, np.ones_like(radiance)], axis=-1).astype(np.float32)
        shots.append(Observation(f"{number}", lambda image=image: image, Light((0.0, 0.0, 1.0))))
    write_capture(Capture("card", tuple(shots), (camera,), (np.ones((90, 120), bool),)), tmp_path / "capture")
    sides = [(-70, 50), (70, 50), (70, -50), (-70, -50)]
    pixels = camera.project(middle + np.array(sides) @ axes[:, :2].T)[0]
    table = tmp_path / "capture" / "capture.toml"
    table.write_text(f"corners = {[[float(x), float(90 - y)] for x, y in pixels]}\n" + table.read_text())
    out = tmp_path / "out"
    assert run_cli("calibrate", table, "--ball", "none", "--flat", "-o", out, "--quiet")[0] == 0
    found = read_capture(out)
    unit = DISTANCE * axes[2, 2] / found.card_distance
    assert unit * read_spec(out).card_distance == pytest.approx(DISTANCE, rel=1e-4)
    assert json.loads((out / "report.json").read_text())["card_distance"] == read_spec(out).card_distance
    errors = unit * np.array([light.vector for light in found.lights]) - lamps
    assert np.linalg.norm(errors, axis=-1).max() < 0.03 * 260


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
