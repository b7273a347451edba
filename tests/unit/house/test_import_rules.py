"""The rules of the house: who may import whom, where GLSL lives, and what must not be in the repository."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import irpso_addon

ROOT = Path(__file__).resolve().parents[3]
PACKAGE = ROOT / "irpso_addon"
sys.path.insert(0, str(ROOT / "scripts"))

import docs_architecture  # noqa: E402
from docs_architecture import FLOORS, imports_of, modules, room_of  # noqa: E402

ROOMS_ABOVE = (("cli",), ("__main__", "__init__"))
ALLOWED = {
    room: {below for floor in (*FLOORS, *ROOMS_ABOVE)[:number] for below in floor}
    for number, rooms in enumerate((*FLOORS, *ROOMS_ABOVE))
    for room in rooms
}
MAX_FILES = 16  # files of a room
BLENDER = {
    "bpy",
    "bmesh",
    "mathutils",
    "gpu",
    "gpu_extras",
    "bl_ui",
    "bl_operators",
    "bl_math",
    "aud",
    "blf",
    "idprop",
    "imbuf",
}
THIRD_PARTY = {"numpy", "OpenEXR", "PIL"}
# An extra that the program works without: the one module that may import it, and only when it is asked for.
OPTIONAL = {
    "rawpy": "capture/images/raw.py",
    "pillow_heif": "capture/images/heif.py",
    "mpi4py": "cluster/transport.py",
    "cv2": "core/opencv.py",
}
WITH_BLENDER = ("blender", "ui", "gpu")
WITHOUT_BLENDER = {"core", "reflectance", "capture", "calibration"}
GLSL = re.compile(r"\bvoid\s+main\s*\(|\bgl_[A-Z]\w+|\btexelFetch\s*\(|\bimage(Store|Load)\s*\(|^\s*#version", re.M)


def broken_rules(source: str, path: Path) -> list[str]:
    """Return one line for each rule that the source of a module at ``path`` breaks."""
    part, package = room_of(path), path.relative_to(PACKAGE).parent.parts
    if part not in ALLOWED:
        return [f"{path.relative_to(ROOT)}: say in ALLOWED what {part} may import"]
    broken = []
    for item in imports_of(source, package):
        top_name = item.module.split(".")[0]
        where = f"{path.relative_to(ROOT)}:{item.line}: "
        if item.module.startswith(".") or top_name == PACKAGE.name:
            target = item.module.removeprefix(PACKAGE.name).split(".")[1]
            if target != part and target not in ALLOWED[part]:
                broken.append(where + f"{part} must not import {target}")
            if part == "__init__" and item.top:
                broken.append(where + "the package imports its parts only when asked for them")
        elif top_name in BLENDER:
            if top_name in ("gpu", "gpu_extras") and part != "gpu":
                broken.append(where + "only irpso_addon/gpu may import Blender's gpu module")
            elif part not in WITH_BLENDER:
                broken.append(where + f"{part} must leave {top_name} to {', '.join(WITH_BLENDER)}")
            elif item.top and part != "ui" and (part != "gpu" or top_name == "bpy"):
                broken.append(where + f"import {top_name} where it is used; at module level only ui may")
        elif top_name in OPTIONAL:
            if path.relative_to(PACKAGE).as_posix() != OPTIONAL[top_name] or item.top:
                broken.append(where + f"{top_name} is an extra: import it in {OPTIONAL[top_name]}, where it is used")
        elif top_name not in sys.stdlib_module_names | THIRD_PARTY:
            broken.append(where + f"{top_name} is not a dependency of the program")
    return broken


def glsl_in(source: str) -> list[str]:
    """Return the string constants of a Python source, docstrings left out, that hold GLSL statements."""
    tree = ast.parse(source)
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    texts = [node for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)]
    return [text.value for text in texts if id(text) not in docstrings and GLSL.search(text.value)]


def tracked() -> list[Path]:
    """Return the files under version control; outside a checkout there are none to speak of."""
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if listing.returncode:
        pytest.skip("this is not a git checkout: which files are tracked is unknown")
    return [ROOT / name for name in listing.stdout.split("\0") if name and (ROOT / name).is_file()]


def lines_matching(pattern: str) -> list[str]:
    """Return "file:line: text" for every line of a tracked text file in which the pattern is found."""
    found = []
    for path in tracked():
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        for number, line in enumerate(text.splitlines(), 1):
            if re.search(pattern, line):
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()}")
    return found


def test_imports_go_down_only():
    assert [line for path in modules() for line in broken_rules(path.read_text(encoding="utf-8"), path)] == []


def module_imports() -> dict[str, set[str]]:
    """Return for each module of the program, by its name below irpso_addon, the modules that it imports."""
    names = {".".join(path.relative_to(PACKAGE).with_suffix("").parts): path for path in modules()}
    found = {}
    for name, path in names.items():
        found[name] = set()
        for item in imports_of(path.read_text(encoding="utf-8"), path.relative_to(PACKAGE).parent.parts):
            if item.module.startswith("."):
                module = item.module[1:]
                found[name] |= {module, *(f"{module}.{part}" for part in item.names)} & set(names)
    return found


def circles(imports: dict[str, set[str]]) -> set[frozenset[str]]:
    """Return the sets of modules that import one another in a circle, directly or by others."""

    def reached(start: str) -> set[str]:
        seen, waiting = set(), [start]
        while waiting:
            for other in imports[waiting.pop()] - seen:
                seen.add(other)
                waiting.append(other)
        return seen

    below = {name: reached(name) for name in imports}
    return {frozenset(o for o in below[name] if name in below[o]) for name in imports if name in below[name]}


def test_modules_import_one_another_in_no_circle():
    assert circles(module_imports()) == set()
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == {frozenset({"b", "c"})}


def test_folders_of_the_solver_import_only_folders_that_its_docstring_names_before_them():
    source = (PACKAGE / "solver" / "__init__.py").read_text(encoding="utf-8")
    order = re.findall(r"\w+", source.split("\n")[0].split(":")[1])
    assert sorted(order) == sorted(path.parent.name for path in (PACKAGE / "solver").glob("*/__init__.py"))
    floor = {folder: number for number, folder in enumerate([*order, "factory"])}
    upwards = [
        (name, other)
        for name, imported in module_imports().items()
        for other in imported
        if name.startswith("solver.") and other.startswith("solver.")
        if floor[other.split(".")[1]] > floor[name.split(".")[1]]
    ]
    assert upwards == []


def test_no_two_test_modules_have_one_name():
    names = [path.stem for path in (ROOT / "tests").rglob("test_*.py")]
    assert {name for name in names if names.count(name) > 1} == set()  # pytest could not collect both


def test_rooms_stay_small():
    folders = {path.parent for path in modules() if path.parent != PACKAGE}
    full = {}
    for folder in folders:
        room, files = folder.relative_to(PACKAGE).as_posix(), len(list(folder.glob("*.py"))) - 1
        if files > MAX_FILES:
            full[room] = files
    assert full == {}


def test_the_architecture_page_and_picture_are_up_to_date():
    page = docs_architecture.PAGE.read_text(encoding="utf-8")
    assert page == docs_architecture.page_with_table(page), "run scripts/docs_architecture.py"
    drawn = docs_architecture.PICTURE.read_text(encoding="utf-8")
    assert drawn == docs_architecture.picture(), "run scripts/docs_architecture.py"


@pytest.mark.parametrize(
    ("file", "source"),
    [
        ("capture/a.py", "def f():\n    import bpy"),
        ("capture/a.py", "from ..gpu.context import x"),
        ("capture/deep/a.py", "from ...solver import x"),
        ("reflectance/a.py", "from .. import capture"),
        ("results/a.py", "def f():\n    import bpy"),
        ("pipeline/a.py", "def f():\n    from mathutils import Vector"),
        ("__init__.py", "def f():\n    import bpy"),
        ("blender/a.py", "import bpy"),
        ("results/a.py", "class A:\n    import bpy"),
        ("results/a.py", "from ..solver.engine.recovery import Recovery"),
        ("solver/a.py", "def f():\n    import gpu"),
        ("ui/a.py", "import gpu.types"),
        ("gpu/a.py", "import bpy"),
        ("gpu/a.py", "from ..capture.types import Light"),
        ("solver/a.py", "from irpso_addon.ui import panel"),
        ("geometry/a.py", "import scipy.ndimage"),
        ("results/a.py", "def f():\n    import rawpy"),
        ("capture/images/raw.py", "import rawpy"),
        ("cluster/a.py", "def f():\n    import mpi4py"),
        ("cluster/transport.py", "from mpi4py import MPI"),
        ("__init__.py", "from .cli import main"),
    ],
)
def test_a_forbidden_import_is_found(file, source):
    assert len(broken_rules(source, PACKAGE / file)) == 1


@pytest.mark.parametrize(
    ("file", "source"),
    [
        ("capture/deep/a.py", "from ...core.errors import InputError\nfrom ..types import Light\nimport numpy.linalg"),
        ("gpu/a.py", "import gpu\ndef f():\n    import bpy"),
        ("capture/images/raw.py", "def f():\n    import rawpy"),
        ("cluster/transport.py", "def f():\n    from mpi4py import MPI"),
        ("ui/a.py", "import bpy\nfrom ..solver import recovery"),
        ("solver/a.py", "from __future__ import annotations\nfrom ..gpu import context\nimport math"),
        ("blender/a.py", "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import bpy"),
        ("__init__.py", "def f():\n    from . import cli"),
    ],
)
def test_a_downward_import_is_allowed(file, source):
    assert broken_rules(source, PACKAGE / file) == []


def test_importing_the_package_imports_neither_blender_nor_numpy():
    probe = "import sys, irpso_addon; print(sorted({'bpy', 'gpu', 'numpy', 'OpenEXR'} & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", probe], cwd=ROOT, capture_output=True, text=True)
    assert (result.stdout.strip(), result.stderr) == ("[]", "")


def test_the_rooms_without_blender_import_without_it():
    names = [
        "irpso_addon." + ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__")
        for path in modules()
        if room_of(path) in WITHOUT_BLENDER
    ]
    probe = f"import importlib, sys; [importlib.import_module(n) for n in {names}]; print('bpy' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", probe], cwd=ROOT, capture_output=True, text=True)
    assert (result.stdout.strip(), result.stderr) == ("False", "")


def test_shaders_are_files_and_not_strings_in_python():
    assert {path.name: glsl_in(path.read_text(encoding="utf-8")) for path in modules()} == {
        p.name: [] for p in modules()
    }


def test_a_shader_in_a_string_is_found_and_one_named_in_a_docstring_is_not():
    assert glsl_in("s = 'void main() {}'") == ["void main() {}"]
    assert glsl_in("def f():\n    'Writes the body of void main().'\n    return 1") == []


def test_no_tracked_file_names_a_local_path():
    places = "|".join(["home", "root", "work", "tmp", "Users"])
    assert lines_matching(rf"(?<![\w./$}}~-])/({places})\b(?!\s*/\s*\d)") == []


def test_no_tracked_file_names_a_package_registry():
    assert lines_matching("|".join(["py" + r"pi\.", "python" + "hosted", "index" + "-url", "find" + "-links"])) == []


def test_a_fresh_clone_stays_small():
    files = sum(path.stat().st_size for path in tracked())
    names = subprocess.run(
        ["git", "rev-list", "--objects", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    # As a clone gets it: one pack of deltas between files of like names, not taken over from the packs of this clone.
    pack = ["git", "pack-objects", "--stdout", "-q", "--delta-base-offset", "--no-reuse-delta"]
    history = len(subprocess.run(pack, cwd=ROOT, input=names.stdout.encode(), capture_output=True, check=True).stdout)
    # Sources, translations (0.4 MB), tests, benchmarks, and the pages, plots and pictures of docs/; no data.
    assert files < 9_000_000
    assert history < 9_000_000  # some 50 kB more an issue; rewriting all pages and docstrings took 300 kB


@pytest.mark.parametrize("name", [name for name in irpso_addon.__all__ if name not in ("register", "unregister")])
def test_every_public_name_can_be_imported_without_blender(name):
    probe = f"import sys; from irpso_addon import {name}; print({name}.__name__, 'bpy' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", probe], cwd=ROOT, capture_output=True, text=True)
    assert (result.stdout.strip(), result.stderr) == (f"{name} False", "")
