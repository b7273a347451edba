"""The wheels of OpenEXR inside the extension's zip, made safe beside the OpenEXR that is a part of Blender."""

import base64
import hashlib
import importlib.util
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.capture.images.exr import write_exr

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "scripts"))
own_symbols = pytest.importorskip("own_symbols")

MODULE = Path(importlib.util.find_spec("OpenEXR").origin)

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems bind names to libraries")

READ = "import sys, OpenEXR; print(OpenEXR.__file__, OpenEXR.File(sys.argv[1]).channels()['Y'].pixels.sum())"


def blenders_libraries() -> list[Path]:
    """Return the OpenEXR libraries of the Blender that is installed as a module."""
    found = importlib.util.find_spec("bpy")
    folders = list(found.submodule_search_locations or []) if found else []
    return [path for folder in folders for path in sorted(Path(folder).glob("lib/libOpenEXR*.so*"))]


def test_the_wheel_reads_a_file_beside_blenders_own_library(tmp_path):
    libraries = blenders_libraries()
    if not libraries:
        pytest.skip("the bpy wheel, which brings Blender's OpenEXR, is absent")
    write_exr(tmp_path / "a.exr", {"image": {"Y": np.full((4, 8), 0.5, np.float32)}})
    module = tmp_path / MODULE.name
    module.write_bytes(own_symbols.symbolic(MODULE.read_bytes()))
    environment = os.environ | {
        "LD_PRELOAD": ":".join(map(str, libraries)),
        "LD_LIBRARY_PATH": str(libraries[0].parent),
        "PYTHONPATH": str(tmp_path),
    }
    command = [sys.executable, "-c", READ, tmp_path / "a.exr"]
    result = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert (result.returncode, result.stdout.split()) == (0, [str(module), "16.0"]), result.stderr


def test_a_second_time_changes_nothing():
    once = own_symbols.symbolic(MODULE.read_bytes())
    assert own_symbols.symbolic(once) == once


def test_only_one_entry_of_the_library_changes():
    before = MODULE.read_bytes()
    after = own_symbols.symbolic(before)
    changed = [i for i, (a, b) in enumerate(zip(before, after, strict=True)) if a != b]
    assert changed and changed[-1] - changed[0] < 16


def test_another_file_than_a_library_is_refused():
    with pytest.raises(ValueError, match="no little-endian ELF-64"):
        own_symbols.symbolic(b"MZ" + bytes(100))


def test_the_list_of_a_rewritten_wheel_has_the_hashes_of_what_is_in_it(tmp_path):
    wheel = tmp_path / "a-1-cp311-cp311-manylinux_2_28_x86_64.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("a.so", MODULE.read_bytes())
        archive.writestr("b.py", "b = 1\n")
        archive.writestr("a-1.dist-info/RECORD", "a.so,sha256=old,1\nb.py,sha256=kept,6\na-1.dist-info/RECORD,,\n")
    own_symbols.make_symbolic(wheel)
    with zipfile.ZipFile(wheel) as archive:
        library, record = archive.read("a.so"), archive.read("a-1.dist-info/RECORD").decode()
    assert library == own_symbols.symbolic(MODULE.read_bytes())
    digest = base64.urlsafe_b64encode(hashlib.sha256(library).digest()).decode().rstrip("=")
    assert record == f"a.so,sha256={digest},{len(library)}\nb.py,sha256=kept,6\na-1.dist-info/RECORD,,\n"
