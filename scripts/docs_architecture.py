"""Draws the program's packages from its imports, docs/architecture.svg, and writes the table in docs/architecture.md.

Usage: python scripts/docs_architecture.py
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "irpso_addon"
PAGE, PICTURE = ROOT / "docs" / "architecture.md", ROOT / "docs" / "architecture.svg"
BEGIN, END = "<!-- rooms: scripts/docs_architecture.py writes what follows -->", "<!-- end of rooms -->"
# Layers from the bottom up: a package ("room") may import those of the layers ("floors") below it.
FLOORS = (
    ("core",),
    ("capture", "reflectance", "gpu"),
    ("calibration", "geometry"),
    ("results",),
    ("blender", "solver"),
    ("demo", "sample", "exports", "cluster"),
    ("pipeline",),
    ("commands", "ui"),
)
_WIDTH, _BOX, _GAP = 860, 46, 34  # pixels


@dataclass(frozen=True)
class Import:
    """An imported module: absolute ("numpy.linalg") or of the program (".capture.read"). top: at module level.

    names: imported from it, maybe modules.
    """

    module: str
    top: bool
    line: int
    names: tuple[str, ...] = ()


def imports_of(source: str, package: tuple[str, ...]) -> list[Import]:
    """Return the imports of a module whose package below irpso_addon is ``package``, relative ones resolved.

    Imports for type checkers count, but not as imports at module level.
    """
    imports = []

    def visit(node: ast.AST, top: bool) -> None:
        if isinstance(node, ast.Import):
            imports.extend(Import(alias.name, top, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) + 1 - node.level] if node.level else ()
            prefix = "." if node.level else ""
            names = tuple(alias.name for alias in node.names)
            if node.module:
                imports.append(Import(prefix + ".".join((*base, node.module)), top, node.lineno, names))
            else:
                imports.extend(Import(prefix + ".".join((*base, name)), top, node.lineno) for name in names)
        inside = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        typing_only = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for child in ast.iter_child_nodes(node):
            visit(child, top and not inside and not typing_only)

    visit(ast.parse(source), True)
    return imports


def modules() -> list[Path]:
    """Return every Python file of the program."""
    return sorted(PACKAGE.rglob("*.py"))


def room_of(path: Path) -> str:
    """Return the top package of a file below irpso_addon, or its own name if it is in none."""
    relative = path.relative_to(PACKAGE)
    return relative.parts[0] if len(relative.parts) > 1 else path.stem


def room_imports() -> dict[str, set[str]]:
    """Return package → packages that it imports."""
    rooms = {room for floor in FLOORS for room in floor}
    imports: dict[str, set[str]] = {room: set() for room in rooms}
    for path in modules():
        package = path.relative_to(PACKAGE).parent.parts
        for item in imports_of(path.read_text(encoding="utf-8"), package):
            target = item.module[1:].split(".")[0] if item.module.startswith(".") else ""
            if room_of(path) in rooms and target in rooms - {room_of(path)}:
                imports[room_of(path)].add(target)
    return imports


def drawn(imports: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return the imports without those that others imply (the transitive reduction)."""

    def below(room: str) -> set[str]:
        return imports[room].union(*(below(other) for other in imports[room]))

    return {
        room: {other for other in others if not any(other in below(third) for third in others - {other})}
        for room, others in imports.items()
    }


def headline(folder: Path) -> str:
    """Return the first line of a package's docstring."""
    text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))) or ""
    return text.split("\n")[0]


def picture() -> str:
    """Return the SVG: a row a layer, the lowest at the bottom, an arrow from each package to those that it imports."""
    places, height = {}, len(FLOORS) * (_BOX + _GAP) + _GAP
    for floor, rooms in enumerate(FLOORS):
        width = min(190, (_WIDTH - _GAP) / len(rooms) - _GAP)
        left = (_WIDTH - len(rooms) * width - (len(rooms) - 1) * _GAP) / 2
        top = height - (floor + 1) * (_BOX + _GAP)
        for number, room in enumerate(rooms):
            places[room] = (left + number * (width + _GAP), top, width)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height}" font-family="sans-serif">',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0L8 4L0 8z" fill="#888"/></marker></defs>',
        f'<rect width="{_WIDTH}" height="{height}" fill="#fff"/>',
    ]
    for room, others in sorted(drawn(room_imports()).items()):
        for other in sorted(others):
            (x, y, width), (to_x, to_y, to_width) = places[room], places[other]
            lines.append(
                f'<path d="M{x + width / 2:.0f} {y + _BOX}L{to_x + to_width / 2:.0f} {to_y}" stroke="#888" fill="none"'
                ' marker-end="url(#tip)"/>'
            )
    for room, (x, y, width) in places.items():
        files = sum(1 for path in modules() if room_of(path) == room)
        lines += [
            f'<rect x="{x:.0f}" y="{y}" width="{width:.0f}" height="{_BOX}" rx="6" fill="#eef3f8" stroke="#567"/>',
            f'<text x="{x + width / 2:.0f}" y="{y + 20}" text-anchor="middle" font-size="15">{escape(room)}</text>',
            f'<text x="{x + width / 2:.0f}" y="{y + 37}" text-anchor="middle" font-size="11" fill="#567">'
            f"{files} files</text>",
        ]
    return "\n".join([*lines, "</svg>", ""])


def _rows() -> Iterator[str]:
    for room in (room for floor in FLOORS[::-1] for room in sorted(floor)):
        folders = [PACKAGE / room, *sorted(p.parent for p in (PACKAGE / room).rglob("*/__init__.py"))]
        for folder in folders:
            name, files = folder.relative_to(PACKAGE).as_posix(), len(list(folder.glob("*.py"))) - 1
            yield f"| `{name}/` | {files} | {headline(folder)} |"


def page_with_table(page: str) -> str:
    """Return the page with a current table of packages."""
    before, rest = page.split(BEGIN)
    table = "\n".join(["| room | files | what is in it |", "|---|---|---|", *_rows()])
    return f"{before}{BEGIN}\n\n{table}\n\n{END}{rest.split(END)[1]}"


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
    PAGE.write_text(page_with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
