"""Makes the libraries in a Linux wheel bind to their own functions before those of the loading process.

Blender has its own OpenEXR, of another version, among the libraries of its process. The wheel of OpenEXR exports the
functions of its C core under the same names and calls them by name, so inside Blender it would reach Blender's and
crash (seen with the libraries of 4.2, 4.3, 4.5 and 5.0; the bpy wheel keeps its libraries to itself). DF_SYMBOLIC
in a library's dynamic section, what `ld -Bsymbolic` sets, has the loader look into the library first. RTLD_DEEPBIND
would do so too, but also for malloc, which Blender replaces: that crashes as well.

Debian's Blender also has libheif and libraw among its libraries, by OpenImageIO. The wheels of pillow-heif and rawpy
call theirs from another library, where DF_SYMBOLIC does not help (seen with libheif 1.15 and 1.18: crash; with libraw
0.21: an error). So the names are changed in the wheel, to names of the same length and GNU hash (h = 33 h + c, so that
one more in a letter makes up for 33 less in the next), which leaves the tables of symbols as they are.
"""

import base64
import csv
import hashlib
import io
import struct
import zipfile
from pathlib import Path

# Names and layout: System V ABI, ELF-64 object files; <elf.h>.
PT_DYNAMIC, DT_NULL, DT_FLAGS, DF_SYMBOLIC = 2, 0, 30, 2
HEADER_OFFSETS, PROGRAM_HEADER, ENTRY = (32, 54), struct.Struct("<IIQQQQQQ"), struct.Struct("<QQ")
SECTIONS_OFFSETS, SECTION, SYMBOL, SHT_DYNSYM = (40, 58), struct.Struct("<IIQQQQIIQQ"), struct.Struct("<IBBHQQ"), 11
# Parts of the names of a wheel's symbols, by the library on the package index.
PREFIXES = {"OpenEXR": (), "pillow-heif": (b"heif_", b"de265_"), "rawpy": (b"LibRaw", b"libraw_")}


def symbolic(library: bytes) -> bytes:
    """Return a little-endian ELF-64 library with DF_SYMBOLIC set. Raises ValueError if there is no room for it."""
    if library[:6] != b"\x7fELF\x02\x01":
        raise ValueError("no little-endian ELF-64 library")
    (table,) = struct.unpack_from("<Q", library, HEADER_OFFSETS[0])
    size, count = struct.unpack_from("<HH", library, HEADER_OFFSETS[1])
    headers = [PROGRAM_HEADER.unpack_from(library, table + i * size) for i in range(count)]
    start, length = next((header[2], header[5]) for header in headers if header[0] == PT_DYNAMIC)
    entries = [ENTRY.unpack_from(library, start + at) for at in range(0, length, ENTRY.size)]
    tags = [tag for tag, _ in entries]
    end = tags.index(DT_NULL)
    flags = 0
    if DT_FLAGS in tags[:end]:
        place = tags.index(DT_FLAGS)
        flags = entries[place][1]
    elif end + 1 < len(entries):  # linkers leave spare entries behind the last; one has to stay, as the end
        place = end
    else:
        raise ValueError("the dynamic section has no spare entry")
    changed = bytearray(library)
    ENTRY.pack_into(changed, start + place * ENTRY.size, DT_FLAGS, flags | DF_SYMBOLIC)
    return bytes(changed)


def renamed(library: bytes, prefixes: tuple[bytes, ...]) -> bytes:
    """Return an ELF-64 library with other names for the dynamic symbols that contain one of ``prefixes``."""
    (table,) = struct.unpack_from("<Q", library, SECTIONS_OFFSETS[0])
    size, count = struct.unpack_from("<HH", library, SECTIONS_OFFSETS[1])
    sections = [SECTION.unpack_from(library, table + i * size) for i in range(count)]
    symbols = next(section for section in sections if section[1] == SHT_DYNSYM)
    names = sections[symbols[6]][4]
    changed = bytearray(library)
    for at in range(symbols[4], symbols[4] + symbols[5], SYMBOL.size):
        start = names + SYMBOL.unpack_from(library, at)[0]
        name = library[start : library.index(b"\0", start)]
        for prefix in prefixes:
            name = name.replace(prefix, bytes((prefix[0] + 1, prefix[1] - 33)) + prefix[2:])
        changed[start : start + len(name)] = name
    return bytes(changed)


def isolate(wheel: Path, library: str) -> None:
    """Rewrite a wheel of ``library`` in place: isolate its shared libraries, and update their hashes in RECORD."""
    with zipfile.ZipFile(wheel) as archive:
        files = {item: archive.read(item) for item in archive.infolist()}
    libraries = {item.filename: data for item, data in files.items() if data.startswith(b"\x7fELF")}
    changed = {name: symbolic(renamed(data, PREFIXES[library])) for name, data in libraries.items()}
    if not changed:
        raise ValueError(f"{wheel.name} holds no shared library")
    with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED) as archive:
        for item, data in files.items():
            if item.filename.endswith(".dist-info/RECORD"):
                data = _record(data, changed)
            archive.writestr(item, changed.get(item.filename, data))


def _record(record: bytes, changed: dict[str, bytes]) -> bytes:
    """Return a wheel's RECORD with the hashes of the changed files (PyPA, binary distribution format)."""
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    for name, digest, size in csv.reader(io.StringIO(record.decode())):
        if name in changed:
            sha = base64.urlsafe_b64encode(hashlib.sha256(changed[name]).digest()).rstrip(b"=").decode()
            digest, size = f"sha256={sha}", str(len(changed[name]))
        lines.writerow((name, digest, size))
    return text.getvalue().encode()
