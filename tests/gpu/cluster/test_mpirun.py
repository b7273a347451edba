"""``mpirun … recover``: any number of ranks gives the files of one process, and what stops one rank stops all."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from irpso_addon.core.encode import srgb_from_linear
from irpso_addon.core.png import encode_png
from tests.builders import command_line as cli_maker
from tests.builders import mpi as mpi_maker
from tests.builders.command_line import run_cli

pytestmark = mpi_maker.needs_mpi()

SHAPE = (23, 31)  # primes: no cut is even
LIGHTS = cli_maker.dome_lights(10, widest=70)
UNLIKE = ("report.json", "material.blend")  # which hold times and names
WIDE = ["--model", "lambert", "--preset", "swarm", "--iterations", 12, "--set", "neighbourhood=9", "--set",
        "neighbour_interval=4", "--set", "c3_fade=0"]  # fmt: skip
STANDARD = ["--model", "principled", "--preset", "standard", "--iterations", 3, "--hold-out", "3"]

THOROUGH = [*STANDARD, *(part for name, value in {"rounds": 2, "resolution": 24, "rays": 16}.items()
            for part in ("--set", f"interreflection_{name}={value}"))]  # fmt: skip

# Python runs it at its start: rank 1 fails when the swarms have been placed and moved once.
FAILING = """
import os
from irpso_addon.solver.phases.sequential_swarm import SequentialSwarmPhase
advance = SequentialSwarmPhase.advance
def failing(self, *arguments):
    if os.environ.get("OMPI_COMM_WORLD_RANK") == "1" and self.iteration == 1:
        raise RuntimeError("a driver's own words")
    return advance(self, *arguments)
SequentialSwarmPhase.advance = failing
"""
FULL = """
from irpso_addon.commands import recover
def full(*arguments, **options):
    raise MemoryError("no room")
recover.write_maps = full
"""
LATE = """
import time
from irpso_addon.cluster.transport import Ranks
close = Ranks.close
def late(self):
    close(self)
    if self.leads:
        time.sleep(5)
Ranks.close = late
"""


@pytest.fixture(scope="module")
def card(tmp_path_factory):
    """A card with a hole in it and one that the border cuts."""
    values = cli_maker.smooth_maps(SHAPE, {}, seed=3)
    images = cli_maker.render_oracle("lambert", values, LIGHTS)
    mask = np.ones(SHAPE, bool)
    mask[:6, :4] = mask[10:14, 12:15] = False
    return cli_maker.write_card(tmp_path_factory.mktemp("card") / "card", images, LIGHTS, mask)


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    """A ball whose UV map has seams, and photographs of it: the options of ``recover``."""
    folder = tmp_path_factory.mktemp("ball")

    def build(bpy):
        bpy.ops.mesh.primitive_uv_sphere_add(segments=12, ring_count=8)
        cli_maker.add_camera(bpy, "Camera", (0, -0.5, 5), lens=70)

    cli_maker.save_scene(folder / "ball.blend", build)
    y, x = np.mgrid[:48, :48]
    grey = np.stack([0.2 + 0.3 * np.abs(np.sin(0.2 * x + k) * np.cos(0.15 * y)) for k in range(10)])
    cli_maker.write_card(folder / "ball", grey[..., None] * np.array([1, 0.8, 0.6]), LIGHTS)
    return [folder / "ball", "--blend", folder / "ball.blend", "--resolution", 21]


@pytest.fixture(scope="module")
def bowl(tmp_path_factory):
    """A bowl seen from above, unwrapped in parts, under a pattern of light: the options of ``recover``."""
    folder = tmp_path_factory.mktemp("bowl")

    def build(bpy):
        bpy.ops.mesh.primitive_uv_sphere_add(segments=16, ring_count=12)
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.ops.mesh.select_all(action="SELECT")
        bpy.ops.mesh.bisect(plane_co=(0, 0, 0), plane_no=(0, 0, 1), clear_outer=True)
        bpy.ops.mesh.select_all(action="SELECT")
        bpy.ops.mesh.flip_normals()
        bpy.ops.uv.smart_project(island_margin=0.02)
        bpy.ops.object.mode_set(mode="OBJECT")
        cli_maker.add_camera(bpy, "Camera", (0, 0, 5), lens=70)

    cli_maker.save_scene(folder / "bowl.blend", build)
    y, x = np.mgrid[:48, :48]
    grey = np.stack([0.4 + 0.1 * np.sin(0.1 * x + k) * np.cos(0.15 * y) for k in range(10)])
    cli_maker.write_card(folder / "bowl", grey[..., None] * np.array([1, 0.8, 0.6]), LIGHTS)
    return [folder / "bowl", "--blend", folder / "bowl.blend", "--resolution", 21]


def options_of(subject, settings, folder, *more):
    return ["recover", *subject, *settings, "--entry", "fragment", "--json", "-o", folder, *more]


def files_of(folder):
    """Return the bytes of a result's files by name, but for those that hold times."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name not in UNLIKE}


@pytest.fixture(scope="module")
def alone(card, tmp_path_factory):
    """The files that one process without MPI makes of the card, by name."""
    folder = tmp_path_factory.mktemp("alone") / "out"
    code, _, err = run_cli(*options_of([card], WIDE, folder))
    assert (code, err) == (0, "")
    return files_of(folder)


def test_any_number_of_ranks_gives_the_bits_of_one_process(tmp_path):
    """Prime sizes, empty ranks, near lights, wide windows, seams, indirect light; other ranks after a checkpoint."""
    mpi_maker.start(5, sys.executable, mpi_maker.ROOT / "tests" / "builders" / "mpi_ranks.py", tmp_path)
    found = json.loads((tmp_path / "digests.json").read_text())
    assert len(found) == 8 and sum(len(reply) for reply in found.values()) == 31
    assert {name: set(reply.values()) - {reply["one process"]} for name, reply in found.items()} == dict.fromkeys(
        found, set()
    )
    assert len({reply["one process"] for reply in found.values()}) == 8


def test_a_mesh_with_seams_over_ranks_gives_the_files_of_one_process(ball, tmp_path):
    assert run_cli(*options_of(ball, STANDARD, tmp_path / "one"))[0] == 0
    code, reply, err = mpi_maker.run(3, *options_of(ball, STANDARD, tmp_path / "out"))
    assert code == 0, err
    assert files_of(tmp_path / "out") == files_of(tmp_path / "one")
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    settings = report["settings"]
    assert settings["ranks"] == 3 and reply["texels"] == report["texels"]
    sent = settings["bytes_sent"]  # one rank has the texels that no camera sees
    assert len(settings["messages"]) == len(sent) == 3 and sorted(sent)[1] > 0


def test_rounds_of_interreflection_over_ranks_give_the_files_of_one_process(bowl, tmp_path):
    assert run_cli(*options_of(bowl, THOROUGH, tmp_path / "one"))[0] == 0
    code, reply, err = mpi_maker.run(2, *options_of(bowl, THOROUGH, tmp_path / "out", "--checkpoint-every", 3))
    assert code == 0, err
    assert files_of(tmp_path / "out") == files_of(tmp_path / "one")
    report = json.loads((tmp_path / "one" / "report.json").read_text())
    assert reply["interreflection"] == report["interreflection"]
    assert reply["interreflection"]["rounds"] == 4  # two of them matte
    assert min(reply["interreflection"]["strength"]) > 0


def killed(command, variables, folder, victim):
    """Start a job, end one of its ranks with SIGKILL once a checkpoint is there; return exit code and seconds."""
    job = subprocess.Popen(command, cwd=mpi_maker.ROOT, env=variables, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    deadline = time.monotonic() + mpi_maker.SECONDS
    while not (folder / "checkpoint.npz").exists() and job.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    assert job.poll() is None, job.stderr.read().decode()
    os.kill(int((folder.parent / f"pid{victim}").read_text()), signal.SIGKILL)
    started = time.monotonic()
    _, err = job.communicate(timeout=60)
    return job.returncode, time.monotonic() - started, err.decode()


def test_a_killed_job_resumes_on_another_number_of_ranks_with_the_same_files(card, alone, tmp_path):
    options = options_of([card], WIDE, tmp_path / "out")
    noted = f'echo $$ > "{tmp_path}/pid$OMPI_COMM_WORLD_RANK";'
    # So often that one is there long before the end.
    command, variables = mpi_maker.job(3, *options, "--checkpoint-every", 0.01, before=noted)
    code, seconds, _ = killed(command, variables, tmp_path / "out", victim=2)
    assert code != 0 and seconds < 20
    assert "checkpoint.npz" in os.listdir(tmp_path / "out")
    code, _, err = mpi_maker.run(2, *options, "--resume")
    assert code == 0, err
    assert files_of(tmp_path / "out") == alone


def test_a_rank_that_fails_in_the_middle_ends_the_job_and_is_named(card, tmp_path):
    (tmp_path / "sitecustomize.py").write_text(FAILING)
    there = f'export PYTHONPATH="{mpi_maker.ROOT}:{tmp_path}";'
    code, reply, err = mpi_maker.run(2, *options_of([card], WIDE, tmp_path / "out"), before=there)
    assert code == 1 and reply is None
    assert re.search(r"irpso: rank 1 on \S+: RuntimeError: a driver's own words", err) and err.count("irpso: ") == 1
    assert not (tmp_path / "out").exists()


def test_ranks_that_wait_while_rank_0_fails_end_as_it_does(card, tmp_path):
    """130, an interrupt's code, would make a scheduler start the job again and again."""
    (tmp_path / "sitecustomize.py").write_text(FULL)
    noted = (
        f'export PYTHONPATH="{mpi_maker.ROOT}:{tmp_path}"; "$@"; code=$?;'
        f' echo $code > "{tmp_path}/code$OMPI_COMM_WORLD_RANK"; exit $code;'
    )
    code, _, err = mpi_maker.run(2, *options_of([card], WIDE, tmp_path / "out"), before=noted)
    assert code == 2 and "memory is full (no room)" in err
    assert [(tmp_path / f"code{rank}").read_text().strip() for rank in (0, 1)] == ["2", "2"]


def test_ranks_with_unlike_versions_of_the_program_refuse(card, tmp_path):
    other = tmp_path / "other"
    for name in ("irpso_addon", "shaders", "presets"):
        shutil.copytree(mpi_maker.ROOT / name, other / name, ignore=shutil.ignore_patterns("__pycache__"))
    manifest = (mpi_maker.ROOT / "blender_manifest.toml").read_text()
    version = re.search(r'^version = "(.*)"', manifest, re.M)[1]
    (other / "blender_manifest.toml").write_text(manifest.replace(f'version = "{version}"', 'version = "9.9.9"'))
    moved = f'[ $OMPI_COMM_WORLD_RANK = 1 ] && cd "{other}";'
    code, reply, err = mpi_maker.run(2, *options_of([card], WIDE, tmp_path / "out"), before=moved)
    assert code == 2 and not (tmp_path / "out").exists()
    assert re.search(rf"program of rank 1 on \S+ \(version 9.9.9\) and of rank 0 on \S+ \(version {version}\)", err)
    assert reply["exit_code"] == 2 and err.count("irpso: ") == 1


def test_a_rank_without_a_gpu_is_named(card, tmp_path):
    blind = "[ $OMPI_COMM_WORLD_RANK = 1 ] && export __EGL_VENDOR_LIBRARY_FILENAMES=/nowhere.json;"
    code, reply, err = mpi_maker.run(2, *options_of([card], WIDE, tmp_path / "out"), before=blind)
    assert code == 3 and reply["exit_code"] == 3
    assert re.search(r"irpso: rank 1 on \S+: no GPU context", err) and err.count("irpso: ") == 1
    assert not (tmp_path / "out").exists()


def test_unsupported_options_of_ranks_are_refused_once(card, tmp_path):
    code, reply, err = mpi_maker.run(2, *options_of([card], [*WIDE, "--set", "levels=2"], tmp_path / "out"))
    assert code == 2 and "levels" in reply["error"] and err.count("irpso: ") == 1
    code, reply, err = mpi_maker.run(2, *options_of([card, "--preview"], WIDE, tmp_path / "out"))
    assert code == 2 and "--preview" in reply["error"] and err.count("irpso: ") == 1


@pytest.mark.parametrize(
    ("command", "more", "code"),
    [
        ("recover", ["--set", "levels=2", "--model", "lambert"], LATE),
        ("batch", ["--only", "a"], LATE),
        ("recover", WIDE, LATE + FULL.replace("MemoryError", "recover.InputError")),  # at the end, of rank 0 alone
    ],
)
def test_an_error_is_printed_before_another_rank_ends(card, tmp_path, command, more, code):
    """Open MPI ends rank 0 as soon as another one has ended with a code above 0."""
    (tmp_path / "sitecustomize.py").write_text(code)
    there = f'export PYTHONPATH="{mpi_maker.ROOT}:{tmp_path}";'
    code, reply, err = mpi_maker.run(2, command, card, "--json", "-o", tmp_path / "out", *more, before=there)
    assert code == 2 and err.count("irpso: ") == 1 and "Traceback" not in err
    assert reply["exit_code"] == 2 and f"irpso: {reply['error']}\n" in err


def test_an_asset_that_is_there_already_is_refused_before_the_search(card, tmp_path):
    (tmp_path / "library").mkdir()
    (tmp_path / "library" / "card.blend").touch()
    options = options_of([card, "--asset", tmp_path / "library"], WIDE, tmp_path / "out")
    code, reply, err = mpi_maker.run(2, *options)
    assert code == 2 and "the library has this file already" in reply["error"] and err.count("irpso: ") == 1
    assert not (tmp_path / "out").exists()


def test_ranks_refuse_separate_slots_and_batches(ball, card, tmp_path):
    code, reply, _ = mpi_maker.run(2, *options_of([*ball, "--slots", "each"], STANDARD, tmp_path / "out"))
    assert code == 2 and "--slots each" in reply["error"]
    (tmp_path / "list.toml").write_text('[[job]]\ncapture = "a"\n[[job]]\ncapture = "b"\n')
    code, reply, _ = mpi_maker.run(2, "batch", tmp_path / "list.toml", "--json", "-o", tmp_path / "out")
    assert code == 2 and "without mpirun" in reply["error"]
    assert not (tmp_path / "out").exists()


def test_processes_of_an_mpi_job_without_mpi4py_are_refused(card, tmp_path, monkeypatch):
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    monkeypatch.setitem(sys.modules, "mpi4py", None)  # as where it is not installed
    code, out, _ = run_cli(*options_of([card], WIDE, tmp_path / "out"))
    assert code == 2 and "mpi4py" in json.loads(out)["error"]
    assert not (tmp_path / "out").exists()


def test_ranks_share_the_noise_of_8_bit_files(tmp_path):
    (tmp_path / "card").mkdir()
    images = cli_maker.render_oracle("lambert", cli_maker.smooth_maps(SHAPE, {}, seed=5), LIGHTS)
    for number, image in enumerate(images):
        encode_png(tmp_path / "card" / f"{number:02}.png", srgb_from_linear(np.clip(image, 0, 1)), bits=8)
    lines = [f"{number:02}.png {x} {y} {z}" for number, (x, y, z) in enumerate(LIGHTS)]
    (tmp_path / "card" / "dirs.lp").write_text("\n".join([str(len(lines)), *lines]) + "\n")
    options = [[tmp_path / "card"], ["--model", "lambert", "--iterations", 2, "--colour-space", "srgb"]]
    code, _, err = run_cli(*options_of(*options, tmp_path / "alone"))
    assert (code, err) == (0, "")
    code, _, err = mpi_maker.run(2, *options_of(*options, tmp_path / "ranks"))
    assert code == 0, err
    assert files_of(tmp_path / "ranks") == files_of(tmp_path / "alone")
