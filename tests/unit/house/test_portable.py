"""The portable archive: its launcher, and what it packs."""

import importlib
import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def portable(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    return importlib.import_module("portable")


def test_the_launcher_runs_with_what_lies_beside_it_alone_and_hands_its_arguments_on(portable, tmp_path):
    tree = tmp_path / "a folder" / "irpso"
    (tree / "python" / "bin").mkdir(parents=True)
    (tree / "irpso").write_text(portable.LAUNCHER, encoding="utf-8")
    stub = tree / "python" / "bin" / "python3"
    stub.write_text('#!/bin/sh\necho "$PYTHONHOME|$PYTHONPATH|$LD_LIBRARY_PATH|$*"\n', encoding="utf-8")
    for file in (stub, tree / "irpso"):
        file.chmod(0o755)
    link = tmp_path / "link"
    link.symlink_to(tree / "irpso")
    clean = {"PATH": os.environ["PATH"], "LD_LIBRARY_PATH": "/theirs", "PYTHONPATH": "/theirs"}
    shown = subprocess.run([link, "recover", "a b"], env=clean, cwd="/", capture_output=True, text=True, check=True)
    home, packages, paths, arguments = shown.stdout.strip().split("|")
    assert home == f"{tree}/python" and packages == f"{tree}/program:{tree}/site"
    assert paths.startswith(f"{tree}/python/lib:{tree}/lib") and paths.endswith(":/theirs")
    assert arguments == "-m irpso_addon recover a b"


def test_every_runtime_package_is_packed_with_what_it_needs(portable):
    names = {package.metadata["Name"].lower() for package in portable.packages(portable.runtime())}
    assert {"bpy", "numpy", "openexr", "pillow", "rawpy", "requests", "urllib3"} <= names
    assert not names & {"pytest", "scipy", "mypy"}


def test_a_package_that_is_not_installed_is_named(portable):
    with pytest.raises(SystemExit, match="no-such-package is not installed here; run this through `make portable`"):
        portable.packages(["no-such-package"])


def test_the_c_library_and_the_compilers_stay_the_nodes(portable):
    names = [path.name for path in portable.linked([Path(os.path.realpath("/proc/self/exe"))], "")]
    assert "libEGL.so.1" in names
    assert not [name for name in names if name.startswith(("libc.so", "libm.so", "libstdc++", "libgcc_s", "ld-linux"))]


def test_the_program_is_what_the_zips_hold(portable):
    assert {"irpso_addon", "shaders", "presets", "web", "blender_manifest.toml"} <= set(portable.program())
