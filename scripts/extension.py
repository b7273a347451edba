"""Builds the zip that Blender installs, with Blender's own tool, under plain Python.

Usage: python scripts/extension.py FOLDER [--without-wheels]
With the wheels of OpenEXR, which Blender has not, the zip works in every supported Blender on its own.
"""

import argparse
import importlib.util
import subprocess
import sys
import tempfile
import zipfile
from importlib.metadata import version
from pathlib import Path

from own_symbols import make_symbolic

ROOT = Path(__file__).resolve().parent.parent
# The Pythons inside the supported versions of Blender: 3.11 up to 5.0, 3.13 after it; and the systems they run on.
PYTHONS = ("3.11", "3.13")
PLATFORMS = ("manylinux_2_28_x86_64", "win_amd64", "macosx_11_0_arm64")


def builder() -> Path:
    """Return the path of Blender's command line tool for extensions, which lies inside the bpy wheel."""
    found = importlib.util.find_spec("bpy")
    folders = found.submodule_search_locations if found else None
    tools = [
        tool for folder in folders or [] for tool in Path(folder).glob("*/scripts/addons_core/bl_pkg/cli/*_ext.py")
    ]
    if not tools:
        raise SystemExit("Blender's wheel (bpy) is not installed here; run this through `make extension`")
    return tools[0]


def blender_extension(*arguments: str | Path) -> None:
    """Run Blender's tool; leave with what it said when it refuses."""
    result = subprocess.run([sys.executable, builder(), *arguments], capture_output=True, text=True)
    if result.returncode:
        raise SystemExit(f"{result.stdout}{result.stderr}".strip())


def add_wheels(package: Path) -> None:
    """Download OpenEXR's wheels into a package folder and name them in its manifest."""
    wheels = package / "wheels"
    pip = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:", "--dest", wheels]
    for python in PYTHONS:
        for platform in PLATFORMS:
            wanted = [f"OpenEXR=={version('OpenEXR')}", "--python-version", python, "--platform", platform]
            subprocess.run([*pip, *wanted], check=True)
    for wheel in wheels.glob("*linux*.whl"):
        make_symbolic(wheel)
    names = ", ".join(f'"./wheels/{wheel.name}"' for wheel in sorted(wheels.iterdir()))
    manifest = package / "blender_manifest.toml"
    manifest.write_text(f"wheels = [{names}]\n{manifest.read_text(encoding='utf-8')}", encoding="utf-8")


def build(folder: Path, with_wheels: bool = True) -> Path:
    """Build and validate the extension; return the path of the zip in ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        source = ROOT
        if with_wheels:
            # What belongs in the zip is said once, in the manifest: so pack, unpack, add the wheels, pack again.
            plain = build(Path(scratch) / "plain", with_wheels=False)
            source = Path(scratch) / "package"
            with zipfile.ZipFile(plain) as archive:
                archive.extractall(source)
            add_wheels(source)
        blender_extension("build", "--source-dir", source, "--output-dir", folder)
    newest = max(folder.glob("*.zip"), key=lambda path: path.stat().st_mtime)
    blender_extension("validate", newest)
    return newest


def main() -> None:
    """Build into the folder named on the command line and say where the zip is."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--without-wheels", action="store_true", help="leave OpenEXR out: smaller, needs no network")
    options = parser.parse_args()
    print(build(options.folder, not options.without_wheels))


if __name__ == "__main__":
    main()
