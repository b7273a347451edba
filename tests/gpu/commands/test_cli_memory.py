"""``recover --memory`` and ``--dry-run``: plans that are printed, tiles that change no file of the result."""

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.solver.engine.tiled import TiledRecovery
from tests.builders import command_line as cli_maker
from tests.builders.command_line import run_cli

ROOT = Path(__file__).resolve().parents[3]
SHAPE = (40, 44)
LIGHTS = cli_maker.dome_lights(30, widest=75)
TURNS = "device=1M,host=1G"  # five tiles, which take turns
SCRATCH = "device=1M,host=513.5M"  # and no room for 40 × 44 × 30 samples beside what every recovery needs
SAME = ("base_color.exr", "normal.exr", "residual.exr", "confidence.exr", "maps.exr", "convergence.png", "relit.png")


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """A capture of a flat card of 40 × 44 texels under 30 lights."""
    values = cli_maker.smooth_maps(SHAPE, {}, seed=3)
    folder = tmp_path_factory.mktemp("card") / "card"
    return cli_maker.write_card(folder, cli_maker.render_oracle("lambert", values, LIGHTS), LIGHTS)


@pytest.fixture(scope="module")
def whole(capture, tmp_path_factory):
    """The bytes of the files of a result that was solved at once, by name."""
    folder = tmp_path_factory.mktemp("whole")
    recover(capture, folder)
    return {name: (folder / name).read_bytes() for name in SAME}


def options_of(capture, folder, *more):
    return ["recover", capture, "--model", "lambert", "--preset", "swarm", "--iterations", 40, "--hold-out", "3,7",
            "--entry", "fragment", "-o", folder, "--json", *more]  # fmt: skip


def recover(capture, folder, *more):
    code, out, err = run_cli(*options_of(capture, folder, *more))
    assert (code, err) == (0, "")
    return json.loads(out.splitlines()[-1])


def test_a_dry_run_prints_the_plan_and_writes_nothing(capture, tmp_path):
    plan = recover(capture, tmp_path / "out", "--memory", TURNS, "--dry-run")["plan"]
    assert (plan["shape"], plan["texels"], plan["observations"]) == ([40, 44], 1760, 28)
    assert len(plan["tiles"]) > 3 and plan["halo"] == 1 and not plan["resident"]
    assert plan["evaluations"] == 1760 * (16 + 40)
    assert plan["device"] <= 1 << 20 and plan["host"] <= 1 << 30
    # 40 iterations: the neighbour term lasts 12, neighbours are tried at the 20th, 30th and 40th.
    assert plan["passes"] == 1 + 12 + 3
    options = [o for o in options_of(capture, tmp_path / "out", "--memory", TURNS, "--dry-run") if o != "--json"]
    code, out, err = run_cli(*options)
    assert (code, err) == (0, "")
    for word in (
        "domain        44 × 40, 1760 texels covered, 28 observations",
        "tiles ",
        "halo ",
        "1.0 MiB (--memory)",
        "search        less than a minute",
    ):
        assert word in out
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("memory", ["device=12M,host=1G", TURNS, SCRATCH])
def test_no_file_of_the_result_depends_on_the_memory(capture, whole, memory, tmp_path):
    plan = recover(capture, tmp_path / "out", "--memory", memory, "--dry-run")["plan"]
    report = recover(capture, tmp_path / "out", "--memory", memory)
    assert (len(plan["tiles"]) > 1) == (memory != "device=12M,host=1G")
    assert plan["stack_on"] == ("scratch" if memory == SCRATCH else "memory")
    assert {name: (tmp_path / "out" / name).read_bytes() for name in SAME} == whole
    settings = json.loads((tmp_path / "out" / "report.json").read_text())["settings"]
    assert settings["tiles"] == len(plan["tiles"]) and report["evaluations"] == plan["evaluations"]
    assert os.listdir(tmp_path) == ["out"]


def test_a_stack_on_a_disk_keeps_the_lights_of_the_report_in_the_order_of_the_files(capture, tmp_path):
    found = []
    for name, memory in (("memory", ()), ("scratch", ("--memory", SCRATCH))):
        recover(capture, tmp_path / name, "--intensities", "estimate", *memory)
        found.append(json.loads((tmp_path / name / "report.json").read_text())["lights"])
    assert found[0] == found[1]


def test_interrupted_tiles_resume_to_the_same_files(capture, whole, tmp_path, monkeypatch):
    options = [*options_of(capture, tmp_path / "out"), "--memory", TURNS]
    step, calls = TiledRecovery.step, []

    def interrupted(self, *arguments):
        calls.append(None)
        if len(calls) == 3:
            signal.raise_signal(signal.SIGINT)
        return step(self, *arguments)

    monkeypatch.setattr(TiledRecovery, "step", interrupted)
    assert run_cli(*options)[0] == 130
    assert os.listdir(tmp_path / "out") == ["checkpoint.npz"]
    monkeypatch.setattr(TiledRecovery, "step", step)
    # With more memory it goes on as a whole.
    assert run_cli(*options_of(capture, tmp_path / "out"), "--resume")[0] == 0
    assert {name: (tmp_path / "out" / name).read_bytes() for name in SAME} == whole


@pytest.mark.parametrize(
    ("memory", "words"),
    [
        ("lots", "--memory lots: write an amount"),
        ("device=1K,host=1G", r"--memory device=1.0 KiB \(--memory\): a tile of .* allow more"),
        ("device=1M,host=10M", r"--memory host=10.0 MiB \(--memory\): the recovery needs .* even"),
    ],
)
def test_insufficient_memory_is_refused_in_one_line(capture, memory, words, tmp_path):
    for more in ([], ["--dry-run"]):
        code, out, err = run_cli(*options_of(capture, tmp_path / "out", "--memory", memory, *more))
        assert code == 2 and re.search(words, json.loads(out)["error"])
        assert err.count("\n") == 1 and not list(tmp_path.iterdir())


def test_a_dry_run_of_4096_texels_squared_and_100_observations_takes_little_memory(tmp_path):
    def ball(bpy):
        bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=32)
        cli_maker.add_camera(bpy, "Camera", (0, -5, 0), lens=70)

    cli_maker.save_scene(tmp_path / "scene.blend", ball)
    cli_maker.write_card(tmp_path / "capture", np.full((100, 16, 16, 3), 0.5), cli_maker.dome_lights(100))
    run = [
        *(sys.executable, "-m", "irpso_addon", "recover", tmp_path / "capture", "--blend", tmp_path / "scene.blend"),
        *("--resolution", 4096, "--memory", "device=8G,host=8G", "-o", tmp_path / "out", "--dry-run", "--json"),
    ]
    with subprocess.Popen([str(a) for a in run], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        out = process.stdout.read()
        _, status, usage = os.wait4(process.pid, 0)
    assert os.waitstatus_to_exitcode(status) == 0
    plan = json.loads(out.splitlines()[-1])["plan"]  # Blender itself says what file it has read
    assert plan["shape"] == [4096, 4096] and plan["observations"] == 100
    assert 0.9 * 4096**2 < plan["texels"] <= 4096**2
    assert plan["stack_on"] == "scratch" and plan["scratch"] >= 4096**2 * 100 * 16
    assert plan["device"] <= 8 << 30 and plan["host"] <= 8 << 30
    assert sum(tile["texels"] for tile in plan["tiles"]) == plan["texels"]
    print(f"\npeak {usage.ru_maxrss / 1024:.0f} MiB, {len(plan['tiles'])} tiles")
    assert usage.ru_maxrss / 1024 < 1024  # of which Blender itself takes 400
