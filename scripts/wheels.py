"""Downloads the wheels that Blender lacks, for every system and every Python of a supported Blender."""

import itertools
import shutil
import subprocess
import sys
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path

from own_symbols import PREFIXES, isolate

LIBRARIES = ("OpenEXR", "Pillow")
# Packed if there is a wheel; without one the program refuses the features that need it, in one line.
OPTIONAL = ("rawpy", "pillow-heif", "opencv-python-headless")
# 3.11 is in Blender up to 5.0 and 3.13 in those after it; Debian builds its Blender with its own Python, 3.14 next.
PYTHONS = ("3.11", "3.13", "3.14")
# Blender's name of a system → tags of the wheels that run on the oldest release that Blender 4.2 supports (glibc 2.28,
# macOS 11.2), the oldest first because pip takes the first available.
PLATFORMS = {
    "linux-x64": ("manylinux_2_17_x86_64", "manylinux_2_27_x86_64", "manylinux_2_28_x86_64"),
    "windows-x64": ("win_amd64",),
    "macos-arm64": ("macosx_11_0_arm64",),
    "macos-x64": tuple(f"macosx_{version}_x86_64" for version in ("10_9", "10_10", "10_13", "10_15", "11_0")),
}
# Further tags of optional libraries. Blender installs a wheel whatever its macOS (bl_pkg ignores the version); on an
# older one the import fails, as if the library were absent.
NEWER = {"macos-x64": ("macosx_12_0_x86_64",)}
# The last version with wheels for a system, where the one that is tested here has none.
VERSIONS = {("rawpy", "macos-x64"): "0.25.1"}
# A wheel of the stable ABI serves this Python and all later ones. Some Blenders accept a wheel by its Python alone, so
# the packed name has the first of PYTHONS.
STABLE = "abi3"
# pip's messages: NO_WHEEL if there is no such wheel, with NO_NETWORK before it if it could not look.
NO_WHEEL, NO_NETWORK = "No matching distribution found", "Retrying ("


def requirement(library: str, platform: str = "") -> str:
    """Return pip's requirement of a library: the version in VERSIONS, else the installed, tested one."""
    return f"{library}=={VERSIONS.get((library, platform)) or version(library)}"


def download(library: str, platform: str, python: str, cache: Path) -> Path | None:
    """Return the wheel for a system and a Python, downloaded into ``cache`` if missing; None if there is none.

    Raises SystemExit with pip's output if the download fails.
    """
    wanted = requirement(library, platform)
    folder = cache / wanted / f"{platform}-{python}"
    cached = sorted([*folder.glob("*.whl"), *(cache / wanted).glob(f"{platform}-*/*-{STABLE}-*.whl")])
    if cached:
        return cached[0]
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:", "--dest", folder]
    newer = NEWER.get(platform, ()) if library in OPTIONAL else ()
    tags = [word for tag in (*PLATFORMS[platform], *newer) for word in ("--platform", tag)]
    command += [wanted, "--implementation", "cp", "--python-version", python, *tags]
    result = subprocess.run(command, capture_output=True, text=True)
    if result.returncode == 0:
        return next(folder.glob("*.whl"))
    if NO_WHEEL in result.stderr and NO_NETWORK not in result.stderr:
        return None
    raise SystemExit(f"{result.stdout}{result.stderr}".strip())


def collect(folder: Path, cache: Path, platforms: Iterable[str]) -> dict[str, list[str]]:
    """Fill a folder with the wheels of some systems; return system → Pythons with all needed wheels.

    Some wheels for Linux are modified: see own_symbols.py.
    """
    folder.mkdir(parents=True, exist_ok=True)
    served: dict[str, list[str]] = {platform: [] for platform in platforms}
    for platform, python in itertools.product(served, PYTHONS):
        wheels = {library: download(library, platform, python, cache) for library in LIBRARIES}
        if not all(wheels.values()):
            continue
        served[platform].append(python)
        wheels |= {library: download(library, platform, python, cache) for library in OPTIONAL}
        for library, wheel in wheels.items():
            if wheel is None:
                continue
            copy = folder / packed_name(wheel)
            if copy.exists():
                continue
            shutil.copy(wheel, copy)
            if platform.startswith("linux") and library in PREFIXES:
                isolate(copy, library)
    return served


def packed_name(wheel: Path) -> str:
    """Return the name of a wheel in the zip."""
    name, python, abi, platform = wheel.name.rsplit("-", 3)
    return "-".join((name, f"cp{PYTHONS[0].replace('.', '')}" if abi == STABLE else python, abi, platform))
