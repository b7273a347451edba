"""The extension platform's published rules against the manifest, the zip without wheels, and the program's imports.

Each rule carries the page that states it; docs/releasing.md lists the pages. What Blender's own validator checks too
stands here again, because the validator of the oldest supported Blender is not the one that runs here.
"""

import ast
import re
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
MANIFEST = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
SOURCES = sorted((ROOT / "irpso_addon").rglob("*.py"))

# Schema 1.0.0: the fields, required and optional, and the permissions. "build" is for the tool alone.
REQUIRED = {
    "schema_version",
    "id",
    "version",
    "name",
    "tagline",
    "maintainer",
    "type",
    "blender_version_min",
    "license",
}
OPTIONAL = {"blender_version_max", "website", "copyright", "tags", "platforms", "wheels", "permissions", "build"}
PERMISSIONS = {"files", "network", "clipboard", "camera", "microphone"}
# Manual, Extensions Tags: of add-ons, as of Blender 5.1.
TAGS = """3D View, Add Curve, Add Mesh, Animation, Bake, Camera, Compositing, Development, Game Engine, Geometry Nodes,
Grease Pencil, Import-Export, Lighting, Material, Modeling, Mesh, Node, Object, Paint, Pipeline, Physics, Render,
Rigging, Scene, Sculpt, Sequencer, System, Text Editor, Tracking, User Interface, UV"""
TAGS = set(TAGS.replace("\n", " ").split(", "))
VERSION = re.compile(r"\d+\.\d+\.\d+")
LONGEST = 64  # characters of a tagline, and of a permission's reason
# Modules that reach a network: the permission "network" is not asked for.
NETWORK = {"asyncio", "ftplib", "http", "imaplib", "requests", "smtplib", "socket", "ssl", "urllib", "xmlrpc"}
# What a Python file may import besides itself and the standard library: Blender's modules, and the wheels.
KNOWN = {
    "OpenEXR",
    "PIL",
    "bl_operators",
    "bmesh",
    "blf",
    "bpy",
    "bpy_extras",
    "cv2",
    "gpu",
    "gpu_extras",
    "mathutils",
    "mpi4py",
}
KNOWN |= {"numpy", "pillow_heif", "rawpy"}


def terse(text: str) -> bool:
    """Schema 1.0.0: one short line that does not end with punctuation."""
    return (
        text == text.strip()
        and text.isprintable()
        and 0 < len(text) <= LONGEST
        and (text[-1].isalnum() or text[-1] in ")]}")
    )


RULES = {
    "schema: a required field is missing": lambda m: set(m) >= REQUIRED,
    "schema: an unknown field": lambda m: set(m) <= REQUIRED | OPTIONAL,
    "schema: the id is one Python identifier with single separators": lambda m: (
        m["id"].isidentifier() and "__" not in m["id"] and m["id"].strip("_") == m["id"]
    ),
    "schema: the version is semantic": lambda m: re.fullmatch(
        VERSION.pattern + r"(-[\w.-]+)?(\+[\w.-]+)?", m["version"]
    ),
    "schema: the tagline is at most 64 characters and ends without punctuation": lambda m: terse(m["tagline"]),
    "schema: Blender 4.2.0 or later, as three numbers": lambda m: (
        VERSION.fullmatch(m["blender_version_min"]) and [*map(int, m["blender_version_min"].split("."))] >= [4, 2, 0]
    ),
    "schema: a permission that there is": lambda m: set(m["permissions"]) <= PERMISSIONS,
    "schema: a permission's reason is at most 64 characters and ends without punctuation": lambda m: all(
        map(terse, m["permissions"].values())
    ),
    "schema: copyright lines begin with a year or two": lambda m: (
        m["copyright"] and all(re.fullmatch(r"\d{4}(-\d{4})? \S.*", line) for line in m["copyright"])
    ),
    "schema: an optional field has a value or is left out": lambda m: all(m.values()),
    "tags: of the platform's list": lambda m: m["tags"] and set(m["tags"]) <= TAGS,
    "licenses: add-ons are GPL 3.0 or later": lambda m: m["license"] == ["SPDX:GPL-3.0-or-later"],
    "terms 2.1: no Blender in the name": lambda m: "blender" not in m["name"].lower(),
    "guidelines: files, for what reads and writes files": lambda m: "files" in m["permissions"],
}
BROKEN = [
    ("schema: a required field is missing", {"maintainer": None}),
    ("schema: an unknown field", {"author": "Somebody"}),
    ("schema: the id", {"id": "ir__pso"}),
    ("schema: the version", {"version": "0.1"}),
    ("schema: the tagline", {"tagline": "Recovers maps."}),
    ("schema: the tagline", {"tagline": "m" * 65}),
    ("schema: Blender 4.2.0", {"blender_version_min": "4.1.0"}),
    ("schema: Blender 4.2.0", {"blender_version_min": "4.2"}),
    ("schema: a permission that", {"permissions": {"files": "Read", "gpu": "Compute"}}),
    ("schema: a permission's reason", {"permissions": {"files": "Read captures!"}}),
    ("schema: copyright", {"copyright": ["The IRPSO authors"]}),
    ("schema: an optional field", {"website": ""}),
    ("tags", {"tags": ["Material", "Photogrammetry"]}),
    ("licenses", {"license": ["SPDX:MIT"]}),
    ("terms 2.1", {"name": "IRPSO for Blender"}),
    ("guidelines: files", {"permissions": {"clipboard": "Copy the report"}}),
]


def broken_rules(manifest: dict) -> list[str]:
    """Return the rules that a manifest breaks; those of fields that it has not are left out."""

    def holds(rule) -> bool:
        try:
            return bool(rule(manifest))
        except KeyError:
            return True

    return [name for name, rule in RULES.items() if not holds(rule)]


def test_the_manifest_keeps_the_platforms_rules():
    assert broken_rules(MANIFEST) == []


@pytest.mark.parametrize(("rule", "change"), BROKEN, ids=[f"{rule} {change}"[:70] for rule, change in BROKEN])
def test_a_manifest_that_breaks_a_rule_is_found(rule, change):
    manifest = {name: value for name, value in (MANIFEST | change).items() if value is not None}
    assert [name for name in broken_rules(manifest) if name.startswith(rule)]


def test_the_zip_brings_reviewable_sources_alone(package):
    # Terms 3.5: no obfuscated code or byte code; manual, Add-ons: libraries come as wheels.
    with zipfile.ZipFile(package) as archive:
        names = [name for name in archive.namelist() if not name.endswith("/")]
        texts = {name: archive.read(name) for name in names}
    kinds = {Path(name).suffix for name in names}
    assert kinds <= {"", ".py", ".glsl", ".toml", ".md", ".html", ".css", ".js", ".po"}
    assert [name for name, data in texts.items() if b"\0" in data] == []
    lines = [line for name in names if name.endswith((".py", ".glsl")) for line in texts[name].decode().splitlines()]
    assert [line for line in lines if len(line) > 120 and not line.startswith("#define")] == []
    assert {"__init__.py", "blender_manifest.toml", "LICENSE"} <= set(names)


def imported(tree: ast.AST) -> set[str]:
    """Return the top names of what a module imports from outside its own package."""
    nodes = list(ast.walk(tree))
    plain = {name.name for node in nodes if isinstance(node, ast.Import) for name in node.names}
    taken = {node.module for node in nodes if isinstance(node, ast.ImportFrom) and not node.level and node.module}
    return {name.partition(".")[0] for name in plain | taken}


def path_changes(tree: ast.AST) -> list[int]:
    """Return the lines at which a module changes ``sys.path``."""
    lines = []
    for node in ast.walk(tree):
        targets = [node.func.value] if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) else []
        targets += node.targets if isinstance(node, ast.Assign) else []
        targets += [node.target] if isinstance(node, ast.AugAssign) else []
        lines += [node.lineno for target in targets if ast.unparse(target) == "sys.path"]
    return lines


def test_no_module_reaches_a_network_without_the_permission():
    # Manual, Add-ons: whoever uses a network declares it and asks bpy.app.online_access.
    assert "network" not in MANIFEST["permissions"]
    assert [p.name for p in SOURCES if imported(ast.parse(p.read_text(encoding="utf-8"))) & NETWORK] == []


def test_every_import_is_in_the_zip_or_in_blender():
    # Guidelines 11: an extension is self-contained. mpi4py alone comes from elsewhere: for clusters, without Blender.
    outside = set().union(*(imported(ast.parse(p.read_text(encoding="utf-8"))) for p in SOURCES))
    assert outside - sys.stdlib_module_names <= KNOWN


def test_no_module_changes_the_path_of_imports():
    # Guidelines, violations in code. A child process has its own path, which is text here.
    assert path_changes(ast.parse("import sys\nsys.path += ['x']\nsys.path.insert(0, 'y')")) == [2, 3]
    assert [p.name for p in SOURCES if path_changes(ast.parse(p.read_text(encoding="utf-8")))] == []
