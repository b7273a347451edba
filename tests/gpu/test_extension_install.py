"""The built zip, installed into a Blender that has nothing else, by a process that never saw this repository."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent.parent

pytestmark = pytest.mark.bpy_only

# bpy 4.5 does not exit by itself, hence os._exit; what is printed before it is flushed.
INSTALL = """
import importlib, json, os, sys
import bpy
done = bpy.ops.extensions.package_install_files(filepath=sys.argv[1], repo="user_default", enable_on_install=True)
enabled = [addon.module for addon in bpy.context.preferences.addons if addon.module.endswith("irpso")]
package = importlib.import_module(enabled[0] + ".irpso_addon")
paths = importlib.import_module(package.__name__ + ".paths")
told = {
    "done": list(done), "enabled": enabled, "commands": len(package._commands), "base": paths.BASE_PACKAGE,
    "model": package.load_model("lambert").name, "root": str(paths.ROOT),
}
bpy.ops.preferences.addon_disable(module=enabled[0])
told["commands after"] = len(package._commands)
print("TOLD", json.dumps(told), flush=True)
os._exit(0)
"""


@pytest.fixture(scope="module")
def told(tmp_path_factory) -> dict:
    folder = tmp_path_factory.mktemp("install")
    build = [sys.executable, ROOT / "scripts" / "extension.py", folder, "--without-wheels"]
    package = subprocess.run(build, capture_output=True, text=True, check=True).stdout.strip()
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment["BLENDER_USER_RESOURCES"] = str(folder / "blender")
    command = [sys.executable, "-c", INSTALL, package]
    result = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300)
    lines = [line for line in result.stdout.splitlines() if line.startswith("TOLD ")]
    assert lines, result.stdout + result.stderr
    return json.loads(lines[0].removeprefix("TOLD ")) | {"folder": str(folder)}


def test_blender_installs_and_enables_the_zip(told):
    assert (told["done"], told["enabled"]) == (["FINISHED"], ["bl_ext.user_default.irpso"])


def test_enabling_adds_one_command_and_disabling_takes_it_away(told):
    assert (told["commands"], told["commands after"]) == (1, 0)


def test_the_installed_program_knows_its_own_package(told):
    assert told["base"] == "bl_ext.user_default.irpso"


def test_the_installed_program_finds_its_own_shaders(told):
    assert told["model"] == "lambert"
    assert told["root"].startswith(told["folder"])
