"""The GPU context: what it leaves behind, what a probe says of it, and how a process that had one ends."""

import json
import stat
import subprocess
import sys
from types import SimpleNamespace

import bpy
import pytest

from irpso_addon.core.errors import GpuUnavailableError
from irpso_addon.core.paths import ROOT
from irpso_addon.gpu import child, context, probe

# What Blender does with --python-expr CODE -- ARGUMENTS, in a file that any Python can run.
STAND_IN = """#!{python}
import sys
exec(sys.argv[sys.argv.index("--python-expr") + 1])
"""


def run(*arguments):
    """Run this Python in the repository; return exit code and output."""
    done = subprocess.run([sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=120)
    return done.returncode, done.stdout


def executable(path, text):
    """Write a file that can be run; return its path."""
    path.write_text(text, encoding="utf-8")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def everything():
    """Return the names of all that a context could leave in a file, and the scene that is active."""
    kinds = (bpy.data.scenes, bpy.data.objects, bpy.data.cameras, bpy.data.images)
    return [sorted(thing.name for thing in kind) for kind in kinds], bpy.context.scene.name


def test_a_context_does_not_change_the_open_file():
    before = everything()
    context.ensure()
    assert context.describe()["max_texture_size"] >= 4096
    assert everything() == before
    assert not [kind for kind in bpy.types.RenderEngine.__subclasses__() if kind.is_registered and "IRPSO" in str(kind)]


def test_the_probe_finds_the_context_of_this_process():
    found = probe.probe()
    ours = context.describe()
    assert {name: found[name] for name in ours} == ours
    assert found["fragment_seconds"] > 0 and found["compute_seconds"] > 0


@pytest.mark.parametrize(
    ("renderer", "entry"), [("llvmpipe (LLVM 19.1.7, 256 bits)", "fragment"), ("NVIDIA H200", "compute")]
)
def test_timing_noise_does_not_choose_between_equal_passes(renderer, entry):
    assert probe.chosen_entry({"renderer": renderer, "fragment_seconds": 3.0, "compute_seconds": 1.0}) == entry
    assert probe.chosen_entry({"renderer": renderer, "fragment_seconds": 1.4, "compute_seconds": 1.0}) == "fragment"


@pytest.mark.parametrize("facts", [{"module": False}, {}], ids=["since 4.3", "4.2"])
def test_a_probe_inside_blender_uses_blender_itself(facts, monkeypatch, tmp_path):
    assert not child.inside_blender()
    ours = context.describe()
    binary = executable(tmp_path / "a renamed Blender", STAND_IN.format(python=sys.executable))
    monkeypatch.setattr(bpy, "app", SimpleNamespace(binary_path=binary, **facts))
    monkeypatch.setattr(sys, "executable", "must not be run")
    assert probe.probe()["renderer"] == ours["renderer"]


def test_a_crashed_probe_is_reported_with_its_last_output(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "executable", executable(tmp_path / "dies", "#!/bin/sh\necho no EGL >&2\nexit 134\n"))
    with pytest.raises(GpuUnavailableError, match=r"exit code 134 \(no EGL\)"):
        probe.probe()


@pytest.mark.parametrize("code", [0, 3, 130])
def test_a_process_with_a_context_exits_with_its_code(code):
    drawn = "from irpso_addon.gpu import context, probe; context.ensure(); probe.check(); print('said', end='')"
    found, out = run("-c", f"{drawn}; context.exit_process({code})")
    assert (found, out.splitlines()[-1]) == (code, "said")


def test_doctor_ends_with_0_and_names_the_renderer():
    code, out = run("-m", "irpso_addon", "doctor", "--json")
    assert code == 0
    assert json.loads(out.splitlines()[-1])["renderer"] == context.describe()["renderer"]


class Driver:
    """An OpenGL that knows the names in ``told`` and what they are."""

    def __init__(self, told):
        self.told, self.error = told, 0

    def glGetIntegerv(self, name, answer):
        self.error = 0 if name in self.told else 0x500
        answer[0] = self.told.get(name, answer[0])

    def glGetError(self):
        error, self.error = self.error, 0
        return error


@pytest.mark.parametrize(
    ("told", "free"),
    [({0x9049: 82943616}, 82943616 << 10), ({0x87FC: 3 << 20}, 3 << 30), ({0x9049: 0}, None), ({}, None)],
)
def test_free_memory_is_what_the_driver_tells(told, free, monkeypatch):
    context.ensure()
    monkeypatch.setattr(context, "is_software", lambda renderer: False)
    monkeypatch.setattr(context.ctypes, "CDLL", lambda name: Driver(told))
    assert context.free_device_memory() == free


def test_of_a_software_renderer_no_free_memory_is_known(monkeypatch):
    if not context.is_software(str(context.describe()["renderer"])):
        pytest.skip("this device is no software renderer")
    assert context.free_device_memory() is None
    monkeypatch.setattr(context, "is_software", lambda renderer: False)
    assert context.free_device_memory() is None  # Mesa's says that it knows no such name
