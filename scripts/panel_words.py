"""Digests of the panels' contents, to detect without a window that the guide's pictures of them are outdated.

Usage: python scripts/panel_words.py    prints the modules that have changed since the pictures were made
A digest covers a module's names of panels and properties and its layout calls, in order, and the names of the operators
of its buttons; not tooltips.
"""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
UI = ROOT / "irpso_addon" / "ui"
RECORD = ROOT / "docs" / "images" / "panels.json"
# Layout calls that count, and attributes of classes with a panel's name and position.
DRAWS = {"label", "prop", "operator", "menu", "popover", "progress", "template_ID", "separator", "row", "column", "box",
         "split", "fact", "wrapped"}  # fmt: skip
NAMES = {"bl_label", "bl_parent_id", "bl_options", "bl_order"}


def calls_of(tree: ast.AST) -> Iterator[ast.Call]:
    """Yield the calls of a module in the order of its lines."""
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    yield from sorted(calls, key=lambda call: (call.lineno, call.col_offset))


def drawn(source: str) -> list[str]:
    """Return the layout calls of a panel module with their arguments, and the attributes NAMES of its classes."""
    tree = ast.parse(source)
    lines = [
        f"{node.targets[0].id} = {ast.unparse(node.value)}"
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id in NAMES
    ]
    for call in calls_of(tree):
        name = call.func.attr if isinstance(call.func, ast.Attribute) else ""
        if name in DRAWS:
            words = [ast.unparse(one) for one in call.args] + [f"{k.arg}={ast.unparse(k.value)}" for k in call.keywords]
            lines.append(f"{name}({', '.join(words)})")
    return lines


def labels(source: str) -> list[str]:
    """Return the names of a module's properties, in order."""
    return [
        ast.unparse(keyword.value)
        for call in calls_of(ast.parse(source))
        if ast.unparse(call.func).endswith("Property")
        for keyword in call.keywords
        if keyword.arg == "name"
    ]


def operators(source: str) -> dict[str, str]:
    """Return the names of a module's operators by their ``bl_idname``."""
    names = {}
    for kind in (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ClassDef)):
        attributes = {
            node.targets[0].id: ast.literal_eval(node.value)
            for node in kind.body
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
            if node.targets[0].id in ("bl_idname", "bl_label") and isinstance(node.value, ast.Constant)
        }
        if len(attributes) == 2:
            names[attributes["bl_idname"]] = attributes["bl_label"]
    return names


def digests(ui: Path = UI) -> dict[str, str]:
    """Return path below ``ui`` → digest of the module, and the digest of all operators' names."""
    sources = {path.relative_to(ui).as_posix(): path.read_text(encoding="utf-8") for path in sorted(ui.rglob("*.py"))}
    words = {name: drawn(source) for name, source in sources.items() if name.startswith("panels/")}
    shown = "\n".join(line for lines in words.values() for line in lines)
    words |= {name: labels(source) for name, source in sources.items() if name.startswith("properties/")}
    named = {key: label for source in sources.values() for key, label in operators(source).items()}
    words["operators"] = sorted(f"{key} {label}" for key, label in named.items() if f"'{key}'" in shown)
    return {name: hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16] for name, lines in words.items() if lines}


def changed(now: dict[str, str], record: Path = RECORD) -> list[str]:
    """Return the modules whose digests differ from the record."""
    then = json.loads(record.read_text(encoding="utf-8")) if record.is_file() else {}
    return sorted(name for name in now.keys() | then.keys() if now.get(name) != then.get(name))


def remember(record: Path = RECORD) -> None:
    """Record the current digests as those of the pictures."""
    record.write_text(json.dumps(digests(), indent=1, sort_keys=True) + "\n", encoding="utf-8")


if __name__ == "__main__":
    print("\n".join(changed(digests())) or "the pictures show the panels as they are")
