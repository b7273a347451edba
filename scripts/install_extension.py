"""Installs and enables the extension in a real Blender, in a profile of its own, and says what became of it.

Usage: python scripts/install_extension.py ZIP [--json] [--wheel]
BLENDER=/path/to/blender names the Blender. Without it, Debian's serves where the tests in a window have brought it;
without that, the bpy wheel with nothing else on its path. Nobody's own settings are read or changed: whoever wants the
extension runs the command that this prints.
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
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import extension

HERE = Path(__file__).resolve().parent
# Packages that the bpy wheel needs: itself and numpy, which every Blender has.
BARE = ("bpy", "numpy", "numpy.libs")
# The modules of the optional libraries. All have wheels for the Pythons and systems that the tests run on.
OPTIONAL = ("rawpy", "pillow_heif", "cv2")
TIMEOUT = 300  # seconds; an installation takes ten


@dataclass(frozen=True)
class Place:
    """A Blender to install into. name: for messages. run: runs it with arguments and returns the finished process.

    commands: whether it has a command line, unlike the wheel.
    """

    name: str
    run: Callable[..., subprocess.CompletedProcess]
    commands: bool = True


def find_place(variables: dict[str, str], scratch: Path, wheel_only: bool) -> Place:
    """Return the Blender to install into. variables: added to its environment."""
    named = os.environ.get("BLENDER")
    if wheel_only:
        return wheel(variables, scratch / "bare")
    if named:
        if not shutil.which(named):
            raise SystemExit(f"BLENDER={named} is no program that can be run; name Blender's executable")
        return Place(named, partial(_start, [named], variables))
    return debians(variables) or wheel(variables, scratch / "bare")


def debians(variables: dict[str, str]) -> Place | None:
    """Return Debian's Blender, if the tests in a window have brought one here."""
    suite = os.environ.get("BLENDER_SUITE") or "trixie"
    folder = extension.ROOT / ".cache" / f"blender-{suite}"
    if not folder.is_dir() or not hasattr(os, "geteuid") or os.geteuid():
        return None
    from blender_window import blenders, debian

    if not (folder / debian.STAMP).is_file():  # the build is running, or has failed
        return None
    blender = blenders.Blender(suite, "blender", folder, (Path(tempfile.gettempdir()).resolve(), extension.ROOT))
    name = f"Debian's, in {folder.relative_to(extension.ROOT)}"
    return Place(name, lambda *words: blender.run("blender", *map(str, words), variables=variables, timeout=TIMEOUT))


def wheel(variables: dict[str, str], folder: Path) -> Place:
    """Return the bpy wheel as a Blender without other packages: its modules are linked into a folder."""
    spec = importlib.util.find_spec("bpy")
    if spec is None:
        raise SystemExit("No Blender to install into: name one with BLENDER=/path/to/blender")
    packages = Path(spec.submodule_search_locations[0]).parent
    folder.mkdir()
    for name in BARE:
        if (packages / name).exists():
            (folder / name).symlink_to(packages / name)
    # Without -S Python would add its site-packages, whose OpenEXR and Pillow hide what the zip brings or lacks.
    command = [sys.executable, "-S", "-s"]
    return Place("the bpy wheel", partial(_start, command, variables | {"PYTHONPATH": str(folder)}), commands=False)


def _start(command: list[str], variables: dict[str, str], *words: str | Path) -> subprocess.CompletedProcess:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | variables
    return subprocess.run([*command, *words], env=environment, capture_output=True, text=True, timeout=TIMEOUT)


def install(package: Path, wheel_only: bool = False) -> dict:
    """Install a zip; return the report of scripts/installed.py, with "place": the Blender, "profile": its folder.

    The folder is deleted on return. "usage": the output of `blender --command irpso --help`, None in the wheel.
    """
    package = package.resolve()
    with tempfile.TemporaryDirectory() as scratch:
        profile = Path(scratch).resolve() / "profile"
        profile.mkdir()
        place = find_place({"BLENDER_USER_RESOURCES": str(profile)}, Path(scratch), wheel_only)

        def run(*words: str | Path) -> str:
            result = place.run(*words)
            if result.returncode:
                text = f"{result.stdout}{result.stderr}"
                raise SystemExit(f"{place.name}: {shlex.join(map(str, words))} ended with {result.returncode}\n{text}")
            return result.stdout

        start = ("--background", "--factory-startup", "--python") if place.commands else ()
        text = run(*start, HERE / "installed.py", "--", package)
        lines = [line for line in text.splitlines() if line.startswith("TOLD ")]
        if not lines:
            raise SystemExit(f"{place.name}: said nothing of the extension\n{text}")
        usage = None
        if place.commands:
            add = ("extension", "install-file", "-r", "user_default", "--enable", package)
            run("--background", "--factory-startup", "--command", *add)
            usage = run("--background", "--command", "irpso", "--help")
        return json.loads(lines[0].removeprefix("TOLD ")) | {
            "profile": str(profile), "place": place.name, "usage": usage,
        }  # fmt: skip


def faults(report: dict, with_wheels: bool) -> list[str]:
    """Return the faults in a report, one line each."""
    wanted = {
        "Blender did not finish the installation": report["done"] == ["FINISHED"],
        "the command irpso was not registered": report["commands"] == ["irpso"],
        "the command irpso outlived the extension": report["commands after"] == [],
        "the extension has no panel or operator": report["classes"] != [],
        f"classes outlived the extension: {report['classes after']}": report["classes after"] == [],
        f"Blender warns of it: {report['violations']}": report["violations"] == [],
        f"it wrote into its own folder: {report['written']}": report["written"] == [],
        "the program was not run from where it was installed": report["root"].startswith(report["profile"]),
    }
    if with_wheels:
        for name, key in (("OpenEXR", "exr"), ("Pillow", "pillow")):
            inside = (report[key] or "").startswith(report["profile"])
            wanted[f"{name} is not that of the zip but {report[key]}"] = inside
        wanted["OpenEXR gave back other numbers than it got"] = report.get("exr same", False)
        wanted["Pillow drew no text"] = report.get("drawn", False)
        for name in OPTIONAL:
            place, _, works = report["optional"].get(name, ("nowhere", "", False))
            wanted[f"{name} is not that of the zip but {place}"] = place.startswith(report["profile"])
            wanted[f"{name} does not work"] = works
    if report["usage"] is not None:
        wanted["blender --command irpso --help said nothing of recover"] = "recover" in report["usage"]
    return [line for line, good in wanted.items() if not good]


def main() -> int:
    """Install the zip of the command line; return 1 if there are faults."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("zip", type=Path, help="a zip, or the folder that extension.py built into")
    parser.add_argument("--json", action="store_true", help="print what was found as one JSON line")
    parser.add_argument("--wheel", action="store_true", help="into the bpy wheel, whatever else there is")
    options = parser.parse_args()
    package = options.zip
    if package.is_dir():
        package = extension.zip_path(package, extension.this_platform())
    if not package.is_file():
        raise SystemExit(f"{package}: no such file; build it with scripts/extension.py")
    report = install(package, options.wheel)
    if options.json:
        print(json.dumps(report))
        return 0
    wrong = faults(report, with_wheels=package.name != extension.zip_path(package.parent).name)
    print(f"installed {package.name} in Blender {report['blender']} (Python {report['python']}: {report['place']})")
    if wrong:
        print(*(f"WRONG: {line}" for line in wrong), sep="\n")
        return 1
    versions = [
        f"{name} {report[f'{key} version']}" for name, key in (("OpenEXR", "exr"), ("Pillow", "pillow")) if report[key]
    ]
    versions += [f"{name} {version}" for name, (_, version, _) in report["optional"].items()]
    parts = f"{report['modules']} modules, {len(report['classes'])} classes, command {', '.join(report['commands'])}"
    print(f"  {parts}, {', '.join(versions) or 'no wheels'}; disabled without a trace")
    print(f"In your own Blender:  blender --command extension install-file -r user_default --enable {package}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
