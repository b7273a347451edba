"""Troubleshooting quotes the program; the site has all pages and needs no network; pictures show today's panels."""

import ast
import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
DOCS = ROOT / "docs"


@pytest.fixture
def guide(monkeypatch):
    """Import a module of scripts/guide; neither of them needs Sphinx."""
    monkeypatch.syspath_prepend(ROOT / "scripts" / "guide")
    return importlib.import_module


@pytest.fixture
def panel_words(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    return importlib.import_module("panel_words")


def text_of(node: ast.AST) -> str:
    """Return a string or an f-string, with "…" for its values."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    if isinstance(node, ast.JoinedStr):
        return "".join(text_of(part) if isinstance(part, ast.Constant) else "…" for part in node.values)
    return ""


def said_by_the_program() -> str:
    """Return all strings of the program, one a line."""
    trees = (ast.parse(path.read_text(encoding="utf-8")) for path in (ROOT / "irpso_addon").rglob("*.py"))
    return "\n".join(text.replace("\n", " ") for tree in trees for node in ast.walk(tree) if (text := text_of(node)))


def test_troubleshooting_quotes_the_program():
    page = (DOCS / "troubleshooting.md").read_text(encoding="utf-8")
    cells = [line.split("|")[1].strip() for line in page.splitlines() if line.startswith("| `")]
    said = said_by_the_program()
    quoted = [cell.strip("`") for cell in cells if cell.count("`") == 2]
    assert len(quoted) > 25
    patterns = {quote: ".*?".join(map(re.escape, quote.split("…"))) for quote in quoted}
    assert [quote for quote, pattern in patterns.items() if not re.search(pattern, said)] == []


def test_every_page_has_one_place_in_the_sites_navigation(guide):
    conf = guide("conf")
    pages = [name for names in conf.NAVIGATION.values() for name in names]
    assert len(pages) == len(set(pages))
    wanted = {path.stem for path in DOCS.glob("*.md")} - {"README"}
    assert set(pages) == wanted | {"../shaders/README", "../CHANGELOG", "benchmarks/README"}


def test_the_pictures_show_the_panels_as_they_are(panel_words):
    assert panel_words.changed(panel_words.digests()) == [], 'make docs-images ONLY="panels"'


PANEL = """
class P(Panel):
    "A panel."
    bl_label = "Capture"
    def draw(self, context):
        "Draw it."
        row = self.layout.row(align=True)
        row.prop(settings, "source", expand=True)
        row.operator("irpso.recover", text="Recover", icon="PLAY")
"""


@pytest.mark.parametrize(
    ("old", "new", "differs"),
    [
        ('"Capture"', '"Photographs"', True),
        ('text="Recover"', 'text="Start"', True),
        ('icon="PLAY"', 'icon="X"', True),
        ('"source"', '"subject"', True),
        ("align=True", "align=False", True),
        ('"A panel."', '"The panel."', False),
        ("context", "c", False),
    ],
)
def test_other_words_order_or_icons_of_a_panel_change_its_digest(panel_words, old, new, differs):
    assert (panel_words.drawn(PANEL) != panel_words.drawn(PANEL.replace(old, new))) == differs


def test_the_order_of_a_panels_rows_is_part_of_its_digest(panel_words):
    *head, first, second = PANEL.splitlines()
    assert panel_words.drawn("\n".join([*head, second, first])) != panel_words.drawn(PANEL)


def test_a_propertys_name_is_part_of_its_digest_and_its_tooltip_is_not(panel_words):
    line = 'size: IntProperty(name="Size", description="Of the map")'
    assert panel_words.labels(line) == ["'Size'"] == panel_words.labels(line.replace("map", "picture"))
    assert panel_words.labels(line.replace("Size", "Resolution")) == ["'Resolution'"]


def test_the_name_of_a_button_is_part_of_the_digests_and_that_of_another_operator_is_not(panel_words, tmp_path):
    for name in ("panels", "operators"):
        (tmp_path / name).mkdir()
    (tmp_path / "panels" / "one.py").write_text(PANEL)
    button = 'class R(Operator):\n    bl_idname = "irpso.recover"\n    bl_label = "Recover"\n'
    other = button.replace("recover", "tidy")
    file = tmp_path / "operators" / "all.py"
    file.write_text(button + other)
    before = panel_words.digests(tmp_path)
    file.write_text(button + other.replace("Recover", "Tidy"))
    assert panel_words.digests(tmp_path) == before
    file.write_text(button.replace("Recover", "Start") + other)
    assert panel_words.digests(tmp_path)["operators"] != before["operators"]


def test_a_module_that_came_or_went_since_the_pictures_is_named(panel_words, tmp_path):
    record = tmp_path / "panels.json"
    record.write_text('{"panels/a.py": "1", "panels/gone.py": "2", "panels/same.py": "3"}')
    now = {"panels/a.py": "9", "panels/new.py": "4", "panels/same.py": "3"}
    assert panel_words.changed(now, record) == ["panels/a.py", "panels/gone.py", "panels/new.py"]


def test_a_page_that_loads_something_from_elsewhere_is_found(guide, tmp_path):
    outside = [
        '<script src="https://cdn.example/a.js">',
        '<link rel="stylesheet" href="//fonts.example/b">',
        '<link href="http://fonts.example/c" rel=preconnect>',
        '<img alt="d" src="http://a.example/d.png">',
        "<style>body { background: url(https://a.example/e.png) }</style>",
        '<style>@import "https://a.example/f.css"</style>',
    ]
    inside = ['<a href="https://a.example">', '<img src="a.png">', '<link rel="canonical" href="https://a.example">']
    for number, text in enumerate(outside + inside):
        (tmp_path / f"{number}.html").write_text(text, encoding="utf-8")
    found = guide("build").loads_from_elsewhere(tmp_path)
    assert [line[0] for line in found] == [str(number) for number in range(len(outside))]
