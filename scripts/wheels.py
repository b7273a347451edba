"""The wheels of what Blender has not: for every system and every Python inside a supported Blender."""

import itertools
import shutil
import subprocess
import sys
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path

from own_symbols import make_symbolic

LIBRARIES = ("OpenEXR", "Pillow")
# 3.11 is in Blender up to 5.0 and 3.13 in those after it; Debian builds its Blender with its own Python, 3.14 next.
PYTHONS = ("3.11", "3.13", "3.14")
# Blender's name of a system, and the tags of the wheels that run on the oldest release of it that Blender 4.2 runs on
# (glibc 2.28, macOS 11.2), the oldest first because pip takes the first that there is.
PLATFORMS = {
    "linux-x64": ("manylinux_2_17_x86_64", "manylinux_2_27_x86_64", "manylinux_2_28_x86_64"),
    "windows-x64": ("win_amd64",),
    "macos-arm64": ("macosx_11_0_arm64",),
    "macos-x64": tuple(f"macosx_{version}_x86_64" for version in ("10_9", "10_10", "10_13", "10_15", "11_0")),
}
# What pip says both where there is no such wheel and where it could not look; the second has these words before it.
NO_WHEEL, NO_NETWORK = "No matching distribution found", "Retrying ("


def requirement(library: str) -> str:
    """Return a library as pip is asked for it: the version that the program is tested with here."""
    return f"{library}=={version(library)}"


def download(library: str, platform: str, python: str, cache: Path) -> Path | None:
    """Return the wheel for a system and a Python from ``cache``, downloaded first if need be; None if there is none.

    Leaves with pip's words where it could not look.
    """
    wanted = requirement(library)
    folder = cache / wanted / f"{platform}-{python}"
    kept = sorted(folder.glob("*.whl"))
    if kept:
        return kept[0]
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:", "--dest", folder]
    tags = [word for tag in PLATFORMS[platform] for word in ("--platform", tag)]
    command += [wanted, "--implementation", "cp", "--python-version", python, *tags]
    result = subprocess.run(command, capture_output=True, text=True)
    if result.returncode == 0:
        return next(folder.glob("*.whl"))
    if NO_WHEEL in result.stderr and NO_NETWORK not in result.stderr:
        return None
    raise SystemExit(f"{result.stdout}{result.stderr}".strip())


def collect(folder: Path, cache: Path, platforms: Iterable[str]) -> dict[str, list[str]]:
    """Fill a folder with the wheels of some systems; return the Pythons that each system has all wheels for.

    OpenEXR's for Linux are changed on the way: see own_symbols.py.
    """
    folder.mkdir(parents=True, exist_ok=True)
    served: dict[str, list[str]] = {platform: [] for platform in platforms}
    for platform, python in itertools.product(served, PYTHONS):
        wheels = {library: download(library, platform, python, cache) for library in LIBRARIES}
        if not all(wheels.values()):
            continue
        served[platform].append(python)
        for library, wheel in wheels.items():
            copy = Path(shutil.copy(wheel, folder))
            if platform.startswith("linux") and library == "OpenEXR":
                make_symbolic(copy)
    return served
