"""Ctrl-C and SIGTERM while Cycles renders or bakes: the command ends with 130, and leaves nothing."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import bpy
import pytest

from irpso_addon.blender.materials.result_blend import save_blend
from irpso_addon.results.write import write_maps
from tests.builders.exports import on_a_sheet

pytestmark = pytest.mark.bpy_only
ROOT = Path(__file__).resolve().parents[3]
ENTERED = "IRPSO-CYCLES"
# The command line, which says when Cycles begins.
PROGRAM = f"""
import os, sys
from irpso_addon.blender import operators
from irpso_addon.cli import main
from irpso_addon.gpu.context import exit_process
real = operators._ended_by_signals
operators._ended_by_signals = lambda: (os.write(2, b"{ENTERED}\\n"), real())[1]
exit_process(main(sys.argv[1:]))
"""


@pytest.fixture(scope="module")
def leaf(tmp_path_factory):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    folder = tmp_path_factory.mktemp("result") / "leaf"
    result, _ = on_a_sheet("principled", texels=512)
    write_maps(result.maps, folder, {"model": "principled", "settings": {"object": "sheet", "slots": None}})
    save_blend(folder / "material.blend")
    return folder


def interrupted(folder, number, words, delay=0.5):
    """Send a signal to a command, ``delay`` seconds after Cycles begins; return exit code, message and seconds."""
    environment = {**os.environ, "TMPDIR": str(folder)}
    command = [sys.executable, "-c", PROGRAM, *map(str, words), "--quiet"]
    run = subprocess.Popen(command, cwd=ROOT, env=environment, stderr=subprocess.PIPE, text=True)
    try:
        assert any(ENTERED in line for line in run.stderr)
        time.sleep(delay)
        sent = time.monotonic()
        run.send_signal(number)
        said = run.stderr.read()
        return run.wait(), said, time.monotonic() - sent
    finally:
        run.kill()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_a_sample_is_rendered_ends_it_and_leaves_nothing(number, tmp_path):
    """The truth of this size takes two cores half a minute, and Cycles cannot be stopped."""
    (tmp_path / "tmp").mkdir()
    words = ("sample", "-o", tmp_path / "tile", "--photographs", 3, "--size", "1200x900")
    code, said, seconds = interrupted(tmp_path / "tmp", number, words)
    assert code == 130 and said.endswith("irpso: interrupted\n"), said
    assert seconds < 25
    assert list(tmp_path.rglob("*")) == [tmp_path / "tmp"]


def test_a_signal_is_heeded_when_a_short_render_is_done(tmp_path):
    words = ("sample", "-o", tmp_path / "tile", "--photographs", 20, "--size", "160x120")
    code, said, _ = interrupted(tmp_path, signal.SIGINT, words, 0.05)
    assert code == 130 and said.splitlines()[-1] == "irpso: interrupted", said
    assert not list(tmp_path.rglob("*"))


@pytest.mark.parametrize(
    "words", [("--format", "turntable"), ("--format", "textures", "--occlusion", "--rays", 512)], ids=["render", "bake"]
)
def test_a_signal_ends_an_export_that_renders_or_bakes(words, leaf, tmp_path):
    (tmp_path / "tmp").mkdir()
    words = ("export", leaf, *words, "-o", tmp_path / "out")
    code, said, seconds = interrupted(tmp_path / "tmp", signal.SIGTERM, words)
    assert code == 130 and said.endswith("irpso: interrupted\n"), said
    assert seconds < 25
    assert list(tmp_path.rglob("*")) == [tmp_path / "tmp"]
