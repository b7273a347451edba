"""Builds the zips that Blender installs, one for each system, with Blender's own tool, under plain Python.

Usage: python scripts/extension.py FOLDER [--without-wheels | --this-system]
With the wheels of what Blender has not, a zip works in every supported Blender of its system on its own.
The same sources give the same bytes.
"""

import argparse
import importlib.util
import platform
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Iterable
from pathlib import Path

import wheels

ROOT = Path(__file__).resolve().parent.parent
CACHE = ROOT / ".cache" / "wheels"
# Blender's names of this system and its processor, where Python's differ from them.
SYSTEMS = {"darwin": "macos"}
MACHINES = {"x86_64": "x64", "amd64": "x64", "aarch64": "arm64"}
# The date of every file in a zip: the format's earliest.
DATE = (1980, 1, 1, 0, 0, 0)


def this_platform() -> str:
    """Return Blender's name of this system, such as ``linux-x64``."""
    system, machine = platform.system().lower(), platform.machine().lower()
    return f"{SYSTEMS.get(system, system)}-{MACHINES.get(machine, machine)}"


def git(*words: str, root: Path = ROOT) -> str:
    """Return what a command of git says in a checkout. Raises SystemExit where there is no checkout, or no git."""
    if shutil.which("git") is None:
        raise SystemExit("git is not installed here, or not on PATH; install it and run this again")
    said = subprocess.run(["git", *words], cwd=root, capture_output=True, text=True)
    if said.returncode:
        raise SystemExit(f"{root}: is no git checkout ({said.stderr.strip()}); clone the repository and run this there")
    return said.stdout


def manifest() -> dict:
    """Return the extension's manifest."""
    return tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))


def zip_path(folder: Path, system: str = "") -> Path:
    """Return the path at which Blender's tool writes the zip for a system, or the one for all."""
    table = manifest()
    parts = [table["id"], table["version"], system.replace("-", "_")]
    return folder / f"{'-'.join(filter(None, parts))}.zip"


def builder() -> Path:
    """Return the path of Blender's command line tool for extensions, which is in the bpy wheel."""
    spec = importlib.util.find_spec("bpy")
    folders = spec.submodule_search_locations if spec else None
    tools = [
        tool for folder in folders or [] for tool in Path(folder).glob("*/scripts/addons_core/bl_pkg/cli/*_ext.py")
    ]
    if not tools:
        raise SystemExit("Blender's wheel (bpy) is not installed here; run this through `make extension`")
    return tools[0]


def blender_extension(*arguments: str | Path) -> None:
    """Run Blender's tool. Raises SystemExit with its output if it fails."""
    result = subprocess.run([sys.executable, builder(), *arguments], capture_output=True, text=True)
    if result.returncode:
        raise SystemExit(f"{result.stdout}{result.stderr}".strip())


def same_bytes(package: Path) -> None:
    """Rewrite a zip in place with its files ordered by name and with the date ``DATE``."""
    with zipfile.ZipFile(package) as archive:
        files = {item.filename: (item, archive.read(item)) for item in archive.infolist() if not item.is_dir()}
    with zipfile.ZipFile(package, "w") as archive:
        for name, (before, data) in sorted(files.items()):
            item = zipfile.ZipInfo(name, DATE)
            item.compress_type, item.external_attr = before.compress_type, 0o644 << 16
            archive.writestr(item, data, compresslevel=9)


def finish(packages: list[Path]) -> None:
    """Make zips reproducible, then validate them with Blender's tool."""
    for package in packages:
        same_bytes(package)
        blender_extension("validate", package)


def build_plain(folder: Path) -> Path:
    """Build and validate the extension without wheels, for every system; return the zip in ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    blender_extension("build", "--source-dir", ROOT, "--output-dir", folder)
    package = zip_path(folder)
    finish([package])
    return package


def build_all(folder: Path, systems: Iterable[str] = wheels.PLATFORMS) -> dict[str, tuple[Path, list[str]]]:
    """Build and validate a zip for each system; return, for each, the zip and the Pythons it has wheels for."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        # Only the manifest lists the zip's files: so pack, unpack, add the wheels, pack again.
        source = Path(scratch) / "package"
        with zipfile.ZipFile(build_plain(Path(scratch))) as archive:
            archive.extractall(source)
        served = wheels.collect(source / "wheels", CACHE, systems)
        systems = [system for system, pythons in served.items() if pythons]
        names = [f"./wheels/{wheel.name}" for wheel in sorted((source / "wheels").iterdir())]
        text = (source / "blender_manifest.toml").read_text(encoding="utf-8")
        # A list of strings has the same syntax in Python and in TOML.
        added = f"platforms = {systems}\nwheels = {names}\n"
        (source / "blender_manifest.toml").write_text(added + text, encoding="utf-8")
        blender_extension("build", "--split-platforms", "--source-dir", source, "--output-dir", folder)
    built = {system: (zip_path(folder, system), served[system]) for system in systems}
    finish([package for package, _ in built.values()])
    return built


def optional_lines(package: Path, system: str, pythons: list[str]) -> list[str]:
    """Return a line for each optional library: those of ``pythons`` for which the zip has it."""
    with zipfile.ZipFile(package) as archive:
        packed = {tuple(Path(name).name.split("-")[:4]) for name in archive.namelist() if name.endswith(".whl")}
    lines = []
    for library in wheels.OPTIONAL:
        found = [tags for tags in packed if tags[0] == library.replace("-", "_")]
        served = [p for p in pythons if any(t[3] == wheels.STABLE or t[2] == f"cp{p.replace('.', '')}" for t in found)]
        lines.append(f"{wheels.requirement(library, system)}, Python {', '.join(served) or 'none'}")
    return lines


def main() -> None:
    """Build into the folder of the command line; print the zips, and the systems and Pythons without wheels."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--without-wheels", action="store_true", help="leave the wheels out: small, needs no network")
    parser.add_argument("--this-system", action="store_true", help="build the zip of this system alone")
    options = parser.parse_args()
    if options.without_wheels:
        print(build_plain(options.folder))
        return
    systems = [this_platform()] if options.this_system else list(wheels.PLATFORMS)
    built = build_all(options.folder, systems)
    libraries = ", ".join(map(wheels.requirement, wheels.LIBRARIES))
    for system, (package, pythons) in built.items():
        print(f"{package}  {package.stat().st_size / 1e6:.1f} MB, {libraries}, Python {', '.join(pythons)}")
        for line in optional_lines(package, system, pythons):
            print(f"  {line}")
    for system in systems:
        for python in wheels.PYTHONS:
            if python not in built.get(system, (None, []))[1]:
                print(f"no wheels of {libraries} exist for {system} with Python {python}")


if __name__ == "__main__":
    main()
