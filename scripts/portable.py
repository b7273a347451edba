"""Packs Python, Blender's wheel and the program into one archive for a Linux machine without a network, a farm node.

Usage: python scripts/portable.py FOLDER
Run by the environment of `make demo`, whose packages it packs. The node needs a C library at least as new as this
machine's, and its own GPU driver, or Mesa's software renderer: `./irpso doctor` says which is missing.
"""

import argparse
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path

import extension
import libraries

# Blender's data that the program does not use: Cycles' kernels for GPUs, essentials assets, fonts of 15 MB.
LEFT_OUT = (
    "scripts/addons_core/cycles/lib",
    "datafiles/assets",
    "datafiles/fonts/*CJK*",
    "datafiles/studiolights/world",
)
UNUSED = ("site-packages", "dist-packages", "test", "idlelib", "*tkinter*", "ensurepip", "config-*", "__pycache__")
# Libraries of the node's kernel and compiler, which are not packed.
NODES_OWN = re.compile(r"/(ld-linux[^/]*|lib(c|m|dl|pthread|rt|util|gcc_s|stdc\+\+|resolv|anl))\.so")
# Loaders in front of the driver. A node with a driver has them.
LOADERS = re.compile(r"/lib(EGL|GL|GLX|GLdispatch|OpenGL)\.so")
_WITH_SBIN = {**os.environ, "PATH": f"{os.environ.get('PATH', '')}:/sbin:/usr/sbin"}
LAUNCHER = """\
#!/bin/sh
# Runs the program with what lies beside it, from any folder: ./irpso recover CAPTURE -o OUT
root=$(dirname "$(readlink -f "$0")")
export PYTHONHOME="$root/python" PYTHONPATH="$root/program:$root/site" PYTHONNOUSERSITE=1 PYTHONDONTWRITEBYTECODE=1
path="$root/python/lib:$root/lib"
loaders=
# The loaders of a node that has a driver come first; it may have only one of them.
for name in libEGL.so.1 libGL.so.1; do
    PATH="$PATH:/sbin:/usr/sbin" ldconfig -p 2>/dev/null | grep -q "$name" || loaders=":$root/loaders"
done
export LD_LIBRARY_PATH="$path$loaders${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}"
exec "$root/python/bin/python3" -m irpso_addon "$@"
"""


def packages(names: list[str]) -> list[importlib.metadata.Distribution]:
    """Return installed packages and their requirements, each once. Raises SystemExit if one is not installed."""
    distributions: dict[str, importlib.metadata.Distribution] = {}
    while names:
        name = names.pop()
        key = name.lower().replace("_", "-")
        if key in distributions:
            continue
        try:
            distributions[key] = importlib.metadata.distribution(name)
        except importlib.metadata.PackageNotFoundError:
            raise SystemExit(f"{name} is not installed here; run this through `make portable`") from None
        wanted = [text for text in distributions[key].requires or [] if "extra ==" not in text]
        names += [re.split(r"[\s<>=!~;\[(]", text, maxsplit=1)[0] for text in wanted if _applies(text)]
    return list(distributions.values())


def _applies(requirement: str) -> bool:
    """Return whether a requirement applies to this Python; one with a marker does if it is installed."""
    name = re.split(r"[\s<>=!~;\[(]", requirement, maxsplit=1)[0]
    return ";" not in requirement or any(importlib.metadata.distributions(name=name))


def runtime() -> list[str]:
    """Return the names of the packages of the group ``runtime``."""
    groups = tomllib.loads((extension.ROOT / "pyproject.toml").read_text(encoding="utf-8"))["dependency-groups"]
    return list(dict.fromkeys(re.split(r"[<>=!~;]", text)[0].strip() for text in groups["runtime"]))


def program() -> list[str]:
    """Return the program's paths in the repository: those that the manifest puts into the zips, and the manifest."""
    patterns = extension.manifest()["build"]["paths_exclude_pattern"]
    return [pattern[2:] for pattern in patterns if pattern.startswith("!/")] + ["blender_manifest.toml"]


def linked(files: list[Path], path: str) -> Iterator[Path]:
    """Yield the shared libraries that files link to, except the node's own."""
    environment = {**os.environ, "LD_LIBRARY_PATH": path}
    # Blender loads some by name.
    cached = subprocess.run(["ldconfig", "-p"], env=_WITH_SBIN, capture_output=True, text=True, check=True).stdout
    named = [
        re.findall(rf"^\s{re.escape(name)} \(.*(?:x86-64|AArch64).*=> (/\S+)", cached, re.MULTILINE)[:1]
        for name in libraries.LIBRARIES.values()
    ]
    linked_paths = {path for paths in named for path in paths}
    for file in [*files, *sorted(linked_paths)]:
        shown = subprocess.run(["ldd", file], env=environment, capture_output=True, text=True).stdout
        linked_paths |= set(re.findall(r"=> (/\S+)", shown))
    yield from (Path(line) for line in sorted(linked_paths) if not NODES_OWN.search(line))


def fill(tree: Path) -> None:
    """Write the archive's files into an empty folder."""
    listed = extension.git("ls-files", "-z", *program())
    base, version = Path(sys.base_prefix), f"python{sys.version_info.major}.{sys.version_info.minor}"
    (tree / "python" / "bin").mkdir(parents=True)
    shutil.copy(Path(sys.executable).resolve(), tree / "python" / "bin" / "python3")
    shutil.copytree(
        sysconfig.get_path("stdlib"), tree / "python" / "lib" / version, ignore=shutil.ignore_patterns(*UNUSED)
    )
    for library in base.glob(f"lib/lib{version}*.so*"):
        shutil.copy(library, tree / "python" / "lib")
    for package in packages(runtime()):
        for file in package.files or []:
            source = Path(str(package.locate_file(file)))
            if ".." not in file.parts and "__pycache__" not in file.parts and source.is_file():
                target = tree / "site" / file
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(source, target)
    for data in (tree / "site" / "bpy").glob("[0-9]*.[0-9]*"):
        for name in LEFT_OUT:
            for path in data.glob(name):
                shutil.rmtree(path) if path.is_dir() else path.unlink()
    for name in filter(None, listed.split("\0")):
        target = tree / "program" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(extension.ROOT / name, target)
    files = [
        tree / "site" / "bpy" / "__init__.so",
        *(tree / "python").rglob("*.so"),
        tree / "python" / "bin" / "python3",
    ]
    for library in linked(files, str(tree / "python" / "lib")):
        folder = tree / ("loaders" if LOADERS.search(str(library)) else "lib")
        if tree not in library.parents:
            folder.mkdir(exist_ok=True)
            shutil.copy(library, folder)
    launcher = tree / "irpso"
    launcher.write_text(LAUNCHER, encoding="utf-8")
    launcher.chmod(0o755)


def main() -> None:
    """Write the archive into the folder of the command line, after a test run from another folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder.resolve()
    if not sys.platform.startswith("linux"):
        raise SystemExit("a portable archive is for Linux; elsewhere install the extension's zip (`make extension`)")
    if missing := [name for name in ("ldd", "tar", "xz", "git") if shutil.which(name) is None]:
        raise SystemExit(
            f"Missing: {', '.join(missing)}. Install it; on Debian or Ubuntu: apt-get install xz-utils git"
        )
    name = f"irpso-{extension.manifest()['version']}-{extension.this_platform()}-portable"
    folder.mkdir(parents=True, exist_ok=True)
    archive = folder / f"{name}.tar.xz"
    with tempfile.TemporaryDirectory() as place:
        tree = Path(place) / name
        fill(tree)
        clean = {"PATH": "/usr/bin:/bin", "HOME": place}
        tried = subprocess.run(
            [tree / "irpso", "inspect", "--help"], env=clean, cwd=place, capture_output=True, text=True
        )
        if tried.returncode:
            raise SystemExit(f"the packed program does not start:\n{tried.stderr}")
        partial = archive.with_suffix(".partial")
        subprocess.run(
            ["tar", "-C", place, "--owner=0", "--group=0", "-I", "xz -T0 -2", "-cf", partial, name], check=True
        )
        partial.replace(archive)
    print(
        f"{archive}: {archive.stat().st_size / 1e6:.0f} MB; on the node: tar -xf {archive.name} && {name}/irpso doctor"
    )


if __name__ == "__main__":
    main()
