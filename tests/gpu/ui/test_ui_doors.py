"""One engine behind every door: the operator in background and the command line write the same maps, bit for bit."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.capture.images.exr import read_exr, write_exr
from tests.builders import command_line as cli_maker

ROOT = Path(__file__).resolve().parents[3]
SEED = 7
CHANNELS = {"base_color": "RGB", "normal": "RGB", "roughness": "Y", "specular": "Y"}
TOWARD_THE_CAMERA = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # +Z to −Y: where the camera stands

pytestmark = pytest.mark.bpy_only

OPERATOR = f"""
import json, os, sys
import bpy
import irpso_addon

capture, blend, name, resolution, out = sys.argv[1:6]
if blend:
    bpy.ops.wm.open_mainfile(filepath=blend)
else:
    bpy.ops.wm.read_homefile(use_empty=True)
irpso_addon.register()
from irpso_addon.ui import session

settings = bpy.context.scene.irpso
bpy.ops.irpso.import_capture(filepath=capture)
settings.subject = "MESH" if blend else "CARD"
settings.resolution, settings.seed = int(resolution), {SEED}
if blend:
    settings.object = bpy.data.objects[name]
done = [bpy.ops.irpso.recover()]
done.append(bpy.ops.irpso.export(filepath=out))
irpso_addon.unregister()
print("TOLD", json.dumps([sorted(step) for step in done]), flush=True)
os._exit(0)
"""


def by_operator(capture, out, blend="", name="", resolution=64):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, "-c", OPERATOR, capture, blend, name, str(resolution), out]
    result = subprocess.run(
        [str(part) for part in command], env=environment, capture_output=True, text=True, timeout=600
    )
    lines = [line for line in result.stdout.splitlines() if line.startswith("TOLD ")]
    assert lines, result.stdout + result.stderr
    assert json.loads(lines[0].removeprefix("TOLD ")) == [["FINISHED"], ["FINISHED"]], result.stdout + result.stderr
    assert "Traceback" not in result.stderr
    return read_exr(Path(out) / "maps.exr")


def by_command(capture, out, *options):
    code, _, said = cli_maker.run_cli("recover", capture, "-o", out, "--seed", SEED, "--quiet", *options)
    assert code == 0, said
    return read_exr(Path(out) / "maps.exr")


def assert_same(first, second):
    assert first.keys() == second.keys()
    for part, channels in first.items():
        for channel, values in channels.items():
            np.testing.assert_array_equal(values, second[part][channel], err_msg=f"{part}.{channel}")


@pytest.fixture(scope="module")
def card(tmp_path_factory):
    lights = cli_maker.dome_lights(12)
    values = cli_maker.smooth_maps((20, 18), {"roughness": (0.25, 0.6), "specular": (0.2, 0.8)})
    images = cli_maker.render_oracle("principled", values, lights)
    return cli_maker.write_card(tmp_path_factory.mktemp("card"), images, lights)


def test_a_card_recovered_by_the_operator_is_the_command_lines_bit_for_bit(card, tmp_path):
    assert_same(by_operator(card, tmp_path / "operator"), by_command(card, tmp_path / "command"))


def ball_and_camera(bpy):
    bpy.ops.mesh.primitive_uv_sphere_add(segments=32, ring_count=20)
    ball = bpy.context.object
    ball.name = "Ball"
    ball.scale = (1.0, 1.2, 0.9)
    for polygon in ball.data.polygons:
        polygon.use_smooth = True
    cli_maker.add_camera(bpy, "front", (0.3, -4.0, 1.0), lens=70)


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    """A ball's .blend file, and a capture of it rendered from maps."""
    folder = tmp_path_factory.mktemp("ball")
    blend = cli_maker.save_scene(folder / "ball.blend", ball_and_camera)
    values = cli_maker.smooth_maps((32, 32), {"roughness": (0.3, 0.6), "specular": (0.3, 0.8)})
    write_exr(folder / "maps.exr", {
        name: {channel: np.float32(np.atleast_3d(value)[..., i]) for i, channel in enumerate(CHANNELS[name])}
        for name, value in values.items()
    })  # fmt: skip
    np.savetxt(folder / "lights.txt", cli_maker.dome_lights(12, 60) @ TOWARD_THE_CAMERA.T)
    made = cli_maker.run_cli(
        "render", folder / "maps.exr", "-o", folder / "capture", "--blend", blend, "--object", "Ball",
        "--size", "48x48", "--lights", folder / "lights.txt",
    )  # fmt: skip
    assert made[0] == 0, made
    return folder / "capture", blend


def test_a_mesh_recovered_by_the_operator_is_the_command_lines_bit_for_bit(ball, tmp_path):
    capture, blend = ball
    operator = by_operator(capture, tmp_path / "operator", blend, "Ball", resolution=24)
    assert_same(
        operator, by_command(capture, tmp_path / "command", "--blend", blend, "--object", "Ball", "--resolution", 24)
    )
