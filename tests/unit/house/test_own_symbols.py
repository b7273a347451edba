"""The wheels of OpenEXR, libheif and libraw inside the extension's zip, made safe beside those of Blender's."""

import base64
import hashlib
import importlib.util
import os
import struct
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
    own_symbols.isolate(wheel, "OpenEXR")
    with zipfile.ZipFile(wheel) as archive:
        library, record = archive.read("a.so"), archive.read("a-1.dist-info/RECORD").decode()
    assert library == own_symbols.symbolic(MODULE.read_bytes())
    digest = base64.urlsafe_b64encode(hashlib.sha256(library).digest()).decode().rstrip("=")
    assert record == f"a.so,sha256={digest},{len(library)}\nb.py,sha256=kept,6\na-1.dist-info/RECORD,,\n"


HEIF = """
import io, sys
import pillow_heif
file = io.BytesIO()
pillow_heif.from_bytes("RGB", (64, 64), bytes([90]) * 64 * 64 * 3).save(file)
print(pillow_heif.__file__, len(pillow_heif.read_heif(file).data))
"""


def _copied(tmp_path: Path, change) -> tuple[Path, Path]:
    """Return a folder with pillow-heif, its libraries changed, and the path of its libheif."""
    found = importlib.util.find_spec("_pillow_heif")
    if found is None:
        pytest.skip("pillow-heif is absent")
    source = Path(found.origin).parent
    for path in [
        *source.glob("_pillow_heif*.so"),
        *source.glob("pillow_heif.libs/*"),
        *source.glob("pillow_heif/*.py"),
    ]:
        copy = tmp_path / path.relative_to(source)
        copy.parent.mkdir(parents=True, exist_ok=True)
        data = path.read_bytes()
        copy.write_bytes(change(data) if data.startswith(b"\x7fELF") else data)
    return tmp_path, next(tmp_path.glob("pillow_heif.libs/libheif*"))


def test_the_wheel_reads_heic_beside_another_libheif(tmp_path):
    # Blender's is played by a copy whose functions do nothing but crash: their first byte is an undefined instruction.
    # It shares the decoder's library, of which the loader takes one.
    _, foreign = _copied(tmp_path / "foreign", lambda data: own_symbols.renamed(data, (b"de265_",)))
    data = bytearray(foreign.read_bytes())
    for at, name in symbols_of(bytes(data)):
        if name.startswith(b"heif_") and at:
            data[at : at + 2] = b"\x0f\x0b"
    foreign.write_bytes(data.replace(b"libheif-", b"another-"))
    folder, _ = _copied(tmp_path / "own", lambda data: own_symbols.symbolic(
        own_symbols.renamed(data, own_symbols.PREFIXES["pillow-heif"])))  # fmt: skip
    environment = os.environ | {"LD_PRELOAD": str(foreign), "PYTHONPATH": str(folder)}
    result = subprocess.run([sys.executable, "-c", HEIF], env=environment, capture_output=True, text=True)
    assert (result.returncode, result.stdout.split()[1:]) == (0, [str(64 * 64 * 3)]), result.stderr
    assert result.stdout.startswith(str(folder))


def symbols_of(library: bytes) -> list[tuple[int, bytes]]:
    """Return (offset in the file, name) of an ELF-64 library's functions; offset 0 of those it only calls."""
    (table,) = struct.unpack_from("<Q", library, 40)
    size, count = struct.unpack_from("<HH", library, 58)
    sections = [struct.unpack_from("<IIQQQQIIQQ", library, table + i * size) for i in range(count)]
    symbols = next(section for section in sections if section[1] == 11)
    text = {number: section for number, section in enumerate(sections) if section[1] == 1}
    found = []
    for at in range(symbols[4], symbols[4] + symbols[5], 24):
        name, _, _, section, value, _ = struct.unpack_from("<IBBHQQ", library, at)
        start = sections[symbols[6]][4] + name
        place = value - text[section][3] + text[section][4] if section in text else 0
        found.append((place, library[start : library.index(b"\0", start)]))
    return found


def test_the_new_names_have_the_hashes_of_the_old_ones():
    def gnu_hash(name):
        value = 5381
        for letter in name:
            value = (33 * value + letter) % 2**32
        return value

    library = Path(importlib.util.find_spec("_pillow_heif").origin).read_bytes()
    after = own_symbols.renamed(library, (b"heif_",))
    pairs = list(zip(symbols_of(library), symbols_of(after), strict=True))
    changed = [(old, new) for (_, old), (_, new) in pairs if old != new]
    assert len(changed) > 50 and not any(b"heif_" in new for _, (_, new) in pairs if new != b"PyInit__pillow_heif")
    assert all(gnu_hash(old) == gnu_hash(new) for old, new in changed)
