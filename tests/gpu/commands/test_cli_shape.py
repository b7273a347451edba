"""``calibrate --ball none`` with ``--blend`` or ``--flat``: lights over a known shape, through the public command."""

import json
from dataclasses import replace

import bpy
import numpy as np
import pytest

from irpso_addon.blender.scenes.scene import camera_from_object, empty_blend
from irpso_addon.capture.read import read_capture
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.capture.write import write_capture
from tests.builders.command_line import dome_lights, run_cli, smooth_maps
from tests.builders.near_card import DISTANCE, near_card

LAMPS, SIDE = 8, 72
STRENGTHS = np.exp(0.3 * np.random.default_rng(3).standard_normal(LAMPS))


def _photographs(camera, places, near):
    """Return radiance (K, H, W, 3) and mask of a matt sphere of radius 1 at the origin; computed from its equation."""
    across = camera.points(1.0) - camera.position
    ray = across / np.linalg.norm(across, axis=-1, keepdims=True)
    b = ray @ camera.position
    inside = b**2 - camera.position @ camera.position + 1
    mask = inside > 0.02
    normal = camera.position + ray * (-b - np.sqrt(np.maximum(inside, 0)))[..., None]
    albedo = 0.45 + 0.25 * np.sin(9 * normal)
    pictures = []
    for place, strength in zip(places, STRENGTHS, strict=True):
        toward = place - normal if near else np.broadcast_to(place / np.linalg.norm(place), normal.shape)
        far = np.linalg.norm(toward, axis=-1)
        shading = np.maximum((toward * normal).sum(axis=-1), 0) / far**3
        scale = strength * (place @ place if near else 1)
        pictures.append((albedo * shading[..., None] * scale).astype(np.float32) * mask[..., None])
    return pictures, mask


def _capture(folder, near, moved=0.0):
    """Write mesh and photographs of two cameras; return the places of the lamps."""
    empty_blend()
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, location=(moved, 0, 0))
    bpy.context.object.name = "Sphere"
    bpy.ops.object.shade_smooth()
    shots, cameras, masks = [], [], []
    places = 3.2 * dome_lights(LAMPS, widest=55.0)
    for number, turn in enumerate((0.0, 0.9)):
        bpy.ops.object.camera_add(location=(5 * np.sin(turn), 0, 5 * np.cos(turn)), rotation=(0, turn, 0))
        bpy.context.object.data.angle = np.radians(30)
        bpy.context.view_layer.update()
        cameras.append(camera_from_object(bpy.context.object, SIDE, SIDE))
        pictures, mask = _photographs(cameras[-1], places, near)
        masks.append(mask)
        for k in range(number, LAMPS, 2):
            image = np.concatenate([pictures[k], np.ones((SIDE, SIDE, 1), np.float32)], axis=-1)
            shots.append(Observation(f"{number}-{k}", lambda i=image: i, Light((0.0, 0.0, 1.0)), number))
    write_capture(Capture("sphere", tuple(shots), tuple(cameras), tuple(masks)), folder / "capture")
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"), check_existing=False)
    order = [*range(0, LAMPS, 2), *range(1, LAMPS, 2)]
    return places[order], STRENGTHS[order]


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
    found = [shot.light for shot in read_capture(tmp_path / "out").observations]
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
    shape = 40, 60
    values = smooth_maps(shape, {}, seed=3) | {"normal": np.broadcast_to((0.0, 0.0, 1.0), (*shape, 3))}
    capture, _ = near_card(values=values)
    unlit = tuple(replace(shot, light=Light((0.0, 0.0, 1.0))) for shot in capture.observations)
    write_capture(replace(capture, observations=unlit, card_distance=None), tmp_path / "capture")
    code, _, err = run_cli(
        "calibrate", tmp_path / "capture", "--ball", "none", "--flat", "-o", tmp_path / "out", "--quiet"
    )
    assert (code, err) == (0, "")
    found = read_capture(tmp_path / "out")
    # Nothing tells the unit: it is the width of the picture.
    unit = DISTANCE / found.card_distance
    assert 2 * np.tan(np.radians(15)) * found.card_distance == pytest.approx(1)
    for light, shot in zip((o.light for o in found.observations), capture.observations, strict=True):
        assert np.linalg.norm(unit * np.array(light.vector) - shot.light.vector) < 0.02 * 260
    power = [light.light.intensity[0] for light in found.observations]
    assert np.std(np.log(power)) < 0.03


def test_options_of_meshes_need_a_mesh(tmp_path):
    for options, said in (
        (("--ball", "none", "--object", "Sphere"), "--object: is for meshes"),
        (("--blend", "x.blend"), "--blend: goes with --ball none"),
        (("--flat",), "--flat: goes with --ball none"),
        (("--ball", "none", "--flat", "--blend", "x.blend"), "--flat and --blend"),
        (("--ball", "none", "--flat", "--lights", "distant"), "--lights distant: matt shading of a flat card"),
        (("--ball", "none", "--blend", "x.blend", "--inside-out"), "--inside-out: a mesh"),
    ):
        code, _, err = run_cli("calibrate", tmp_path, *options, "-o", tmp_path / "out")
        assert (code, err.count("\n")) == (2, 1)
        assert said in err
