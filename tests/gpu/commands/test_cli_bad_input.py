"""Bad input through the public command: exit code 2, one clear line, and nothing written."""

import functools
import json
import os
import re
import shutil
import subprocess
import sys
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.capture.images.exr import write_exr
from irpso_addon.commands.calibrate import _photographs
from tests.builders import command_line as cli_maker
from tests.builders.bad_input import CASES, GROUPS, LIGHTS, OUT, SHAPE
from tests.builders.command_line import add_camera, add_mesh, listing, run_cli, save_scene
from tests.builders.exif import exif, jpeg

SQUARE = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
UNIT = [(0, 0), (1, 0), (1, 1), (0, 1)]


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    """A sound capture of a card, the same in the DiLiGenT layout, and a .blend file with every kind of object."""
    folder = tmp_path_factory.mktemp("originals")
    images = cli_maker.render_oracle("lambert", cli_maker.smooth_maps(SHAPE, {}), LIGHTS)
    cli_maker.write_card(folder / "card", images, LIGHTS)
    lists = folder / "lists"
    lists.mkdir()
    for k, image in enumerate(images):
        write_exr(lists / f"{k}.exr", {"": {c: image[..., i].astype(np.float32) for i, c in enumerate("RGB")}})
    (lists / "filenames.txt").write_text("".join(f"{k}.exr\n" for k in range(len(images))))
    np.savetxt(lists / "light_directions.txt", LIGHTS, fmt="%.8f")
    save_scene(folder / "scene.blend", meshes)
    save_scene(folder / "empty.blend", lambda bpy: None)
    library = save_scene(folder / "library.blend", lambda bpy: add_mesh(bpy, "square", SQUARE, [(0, 1, 2, 3)], UNIT))
    save_scene(folder / "linked.blend", functools.partial(link, library))
    for size in (SHAPE, (3, 4)):
        values = np.zeros((*size, 3), np.float32)
        write_exr(folder / f"normal_{size[1]}.exr", {"": {c: values[..., i] for i, c in enumerate("RGB")}})
    return folder


def meshes(bpy):
    add_mesh(bpy, "square", SQUARE, [(0, 1, 2, 3)], UNIT)
    add_mesh(bpy, "no uv", SQUARE, [(0, 1, 2, 3)])
    add_mesh(bpy, "twice", [*SQUARE, *(np.array(SQUARE) + (0, 0, 1))], [(0, 1, 2, 3), (4, 5, 6, 7)], UNIT * 2)
    add_mesh(bpy, "outside", SQUARE, [(0, 1, 2, 3)], np.array(UNIT) * 1.5)
    add_mesh(bpy, "collapsed", SQUARE, [(0, 1, 2, 3)], np.zeros((4, 2)))
    add_mesh(bpy, "points", SQUARE, [])
    add_mesh(bpy, "line", np.array(SQUARE) * (1, 0, 0), [(0, 1, 2, 3)], UNIT)
    add_mesh(bpy, "not numbers", np.array(SQUARE) * (1, np.nan, 1), [(0, 1, 2, 3)], UNIT)
    add_mesh(bpy, "flat", SQUARE, [(0, 1, 2, 3)], UNIT).scale = (1, 1, 0)
    add_mesh(bpy, "hidden", SQUARE, [(0, 1, 2, 3)], UNIT).hide_viewport = True
    add_mesh(bpy, "far", np.array(SQUARE) + (9, 9, 0), [(0, 1, 2, 3)], UNIT)
    add_camera(bpy, "panorama", type="PANO")
    add_camera(bpy, "camera")


def link(library, bpy):
    with bpy.data.libraries.load(str(library), link=True) as (found, wanted):
        wanted.objects = found.objects
    bpy.context.scene.collection.objects.link(wanted.objects[0])


@pytest.mark.parametrize("case", CASES)
def test_bad_input_gives_one_line_exit_code_2_and_no_file(case, originals, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(originals, tmp_path, dirs_exist_ok=True)
    prepare, words = CASES[case]
    arguments = prepare(tmp_path)
    before = listing(tmp_path)
    code, out, err = run_cli(*arguments)
    assert (code, out) == (2, "")
    assert err.endswith("\n") and err.count("\n") == 1 and err.startswith("irpso: ")
    assert re.search(words, err)
    assert len(err) < 400
    assert listing(tmp_path) == before


def test_there_are_more_than_thirty_kinds_of_bad_input():
    assert len(CASES) == sum(map(len, GROUPS)) > 100


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="there is no folder in which root may not write")
@pytest.mark.parametrize("words", [
    ["recover", "card"], ["calibrate", "card", "--ball", "auto"], ["handheld", "card"], ["develop", "card"],
    ["render", "maps", "--blend", "scene.blend"], ["frames", "card"], ["sample"],
])  # fmt: skip
def test_an_output_that_cannot_be_written_is_refused_before_any_work(originals, words, monkeypatch):
    monkeypatch.chdir(originals)
    code, _, err = run_cli(*words, "-o", "/proc/irpso/out")
    assert code == 2 and re.fullmatch(r"irpso: /proc/irpso/out: cannot be written \(.*\); choose another folder\n", err)


def test_a_broken_capture_that_can_be_opened_is_described_on_standard_output_with_exit_code_2(originals, tmp_path):
    shutil.copytree(originals / "lists", tmp_path / "lists")
    (tmp_path / "lists" / "2.exr").unlink()
    code, out, err = run_cli("inspect", tmp_path / "lists")
    assert (code, err) == (2, "")
    assert re.search(r"^error: .*2.exr", out, re.M)
    code, out, err = run_cli("inspect", tmp_path / "nowhere")
    assert (code, out) == (2, "") and re.fullmatch(r"irpso: .*nowhere: is not there.*\n", err)


def test_a_failure_is_one_line_of_json_too(originals, tmp_path):
    for arguments in (["recover", originals / "card", "-o", tmp_path / OUT, "--model", "skin"], ["recover"]):
        code, out, err = run_cli(*arguments, "--json")
        answer = json.loads(out)
        assert code == 2 and answer["exit_code"] == 2 and err == f"irpso: {answer['error']}\n"


def test_the_process_ends_with_the_commands_exit_code(originals, tmp_path):
    def start(*arguments):
        command = [sys.executable, "-m", "irpso_addon", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=originals.parents[0], env=ENV)

    refused = start("recover", originals / "card", "-o", tmp_path / OUT, "--model", "skin", "--json")
    assert refused.returncode == 2
    assert json.loads(refused.stdout.splitlines()[-1])["exit_code"] == 2
    assert refused.stderr.startswith("irpso: model 'skin'") and refused.stderr.count("\n") == 1
    done = start("recover", originals / "card", "-o", tmp_path / OUT, "--model", "lambert", "--iterations", 5, "--json")
    assert done.returncode == 0
    assert json.loads(done.stdout.splitlines()[-1])["texels"] == SHAPE[0] * SHAPE[1]
    assert (tmp_path / OUT / "normal.exr").is_file()


ENV = {
    **os.environ,
    "PYTHONPATH": os.pathsep.join([str(Path(__file__).resolve().parents[3]), os.environ.get("PYTHONPATH", "")]),
}


@pytest.mark.parametrize(("degrees", "warned"), [(40, True), (68.8, False)])
def test_a_field_of_view_unlike_that_of_exif_is_warned_of(tmp_path, capsys, degrees, warned):
    """26 mm of full frame's diagonal: 67.3° over the width of 4 : 3."""
    for number in range(3):
        (tmp_path / f"{number}.jpg").write_bytes(jpeg(4000, 3000, exif(focal_35mm=26)))
    options = Namespace(capture=tmp_path, output=tmp_path / "out", camera=None, colour_space="auto", frames=())
    spec, keys = _photographs(options, {"fov_degrees": degrees}, [])
    assert keys == {"fov_degrees": degrees} and spec.views[0].lens
    assert ("40.0° over the width, but the photographs' EXIF says 67.3°" in capsys.readouterr().err) == warned
