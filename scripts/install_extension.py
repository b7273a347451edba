"""Installs and enables the extension in a real Blender, in a profile of its own, and says what became of it.

Usage: python scripts/install_extension.py ZIP [--json]
BLENDER=/path/to/blender names the Blender; without it the bpy wheel serves, with nothing else on its path. Nobody's own
settings are read or changed: whoever wants the extension runs the command that this prints.
"""

import argparse
import importlib.util
import json
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import extension

HERE = Path(__file__).resolve().parent
# What the bpy wheel needs beside Python's own modules: itself and numpy, which every Blender brings.
BARE = ("bpy", "numpy", "numpy.libs")


def own_blender() -> list[str]:
    """Return the command that starts the Blender that BLENDER names; empty where it names none."""
    named = os.environ.get("BLENDER")
    if not named:
        return []
    if not shutil.which(named):
        raise SystemExit(f"BLENDER={named} is no program that can be run; name Blender's executable")
    return [named]


def wheel(folder: Path) -> tuple[list[str], dict[str, str]]:
    """Return the command and the variables for the bpy wheel as a Blender that has nothing else."""
    found = importlib.util.find_spec("bpy")
    if found is None:
        raise SystemExit("No Blender to install into: name one with BLENDER=/path/to/blender")
    packages = Path(found.submodule_search_locations[0]).parent
    folder.mkdir()
    for name in BARE:
        if (packages / name).exists():
            (folder / name).symlink_to(packages / name)
    # Without -S Python would add its site-packages, whose OpenEXR hides what the zip brings or lacks.
    return [sys.executable, "-S", "-s"], {"PYTHONPATH": str(folder)}


def run(command: list[str], variables: dict[str, str], cwd: Path) -> subprocess.CompletedProcess:
    """Run a Blender; leave with what it said if it ended badly."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | variables
    result = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=300)
    if result.returncode:
        raise SystemExit(f"{shlex.join(command)} ended with {result.returncode}\n{result.stdout}{result.stderr}")
    return result


def install(package: Path) -> dict:
    """Install a zip; return what scripts/installed.py tells of it, "profile": the folder, now gone, and "command".

    "command" is the one that ran, and "usage" what `blender --command irpso --help` printed, None in the wheel.
    """
    found = own_blender()
    with tempfile.TemporaryDirectory() as scratch:
        profile = Path(scratch) / "profile"
        profile.mkdir()
        variables = {"BLENDER_USER_RESOURCES": str(profile)}
        if found:
            blender = [*found, "--background", "--factory-startup"]
            script = [*blender, "--python", str(HERE / "installed.py")]
        else:
            bare, more = wheel(Path(scratch) / "bare")
            blender, script, variables = bare, [*bare, str(HERE / "installed.py")], variables | more
        result = run([*script, "--", str(package.resolve())], variables, profile)
        lines = [line for line in result.stdout.splitlines() if line.startswith("TOLD ")]
        if not lines:
            raise SystemExit(f"Blender said nothing of the extension\n{result.stdout}{result.stderr}")
        told = json.loads(lines[0].removeprefix("TOLD "))
        usage = None
        if found:
            add = ["extension", "install-file", "-r", "user_default", "--enable", str(package.resolve())]
            run([*blender, "--command", *add], variables, profile)
            usage = run([*found, "--background", "--command", "irpso", "--help"], variables, profile).stdout
        return told | {"profile": str(profile), "command": shlex.join(blender), "usage": usage}


def faults(told: dict, with_wheels: bool) -> list[str]:
    """Return what is not as it should be, one line each."""
    wanted = {
        "Blender did not finish the installation": told["done"] == ["FINISHED"],
        "the command irpso was not registered": told["commands"] == ["irpso"],
        "the command irpso outlived the extension": told["commands after"] == [],
        "the extension has no panel or operator": told["classes"] != [],
        f"classes outlived the extension: {told['classes after']}": told["classes after"] == [],
        f"Blender warns of it: {told['violations']}": told["violations"] == [],
        f"it wrote into its own folder: {told['written']}": told["written"] == [],
        "the program was not run from where it was installed": told["root"].startswith(told["profile"]),
    }
    if with_wheels:
        inside = (told["exr"] or "").startswith(told["profile"])
        wanted[f"OpenEXR is not that of the zip but {told['exr']}"] = inside
        wanted["OpenEXR gave back other numbers than it got"] = told.get("exr same", False)
    if told["usage"] is not None:
        wanted["blender --command irpso --help said nothing of recover"] = "recover" in told["usage"]
    return [line for line, good in wanted.items() if not good]


def main() -> int:
    """Install the zip named on the command line; return 1 where something is not as it should be."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("zip", type=Path, help="a zip, or the folder that extension.py built into")
    parser.add_argument("--json", action="store_true", help="print what was found as one JSON line")
    options = parser.parse_args()
    package = options.zip
    if package.is_dir():
        package = extension.zip_path(package, extension.this_platform())
    if not package.is_file():
        raise SystemExit(f"{package}: no such file; build it with scripts/extension.py")
    told = install(package)
    if options.json:
        print(json.dumps(told))
        return 0
    wrong = faults(told, with_wheels=package.name != extension.zip_path(package.parent).name)
    print(f"installed {package.name} in Blender {told['blender']} (Python {told['python']}: {told['command']})")
    if wrong:
        print(*(f"WRONG: {line}" for line in wrong), sep="\n")
        return 1
    exr = f"OpenEXR {told['exr version']} of the zip" if told["exr"] else "no OpenEXR"
    parts = f"{told['modules']} modules, {len(told['classes'])} classes, command {', '.join(told['commands'])}"
    print(f"  {parts}, {exr}; disabled without a trace")
    print(f"In your own Blender:  blender --command extension install-file -r user_default --enable {package}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
