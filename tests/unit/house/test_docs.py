"""The pages agree with the program: links, settings, presets, public names, modules, and examples that need no GPU."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import irpso_addon
from irpso_addon.solver.settings.schedule import GROUPS, SETTINGS, load_schedule, shipped_presets

ROOT = Path(__file__).resolve().parents[3]
DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", ROOT / "shaders" / "README.md", *DOCS.rglob("*.md")])
GUIDE = sorted(DOCS.glob("*.md"))
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def name_of(page):
    return page.relative_to(ROOT).as_posix()


def prose(page):
    return FENCE.sub("", page.read_text(encoding="utf-8"))


def anchors(page):
    """The anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_link_leads_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        assert file.exists(), target
        assert not anchor or anchor in anchors(file), target


def test_every_page_of_the_guide_is_reached_from_its_index():
    index = (DOCS / "README.md").read_text(encoding="utf-8")
    assert [page.name for page in GUIDE if page.name != "README.md" and f"({page.name})" not in index] == []


def test_every_picture_is_shown_and_small():
    shown = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    pictures = sorted(path for path in (DOCS / "images").glob("*") if path.name != "panels.json")
    assert [p.name for p in pictures if f"images/{p.name}" not in shown] == []
    assert max((p.stat().st_size for p in pictures), default=0) < 80_000
    assert sum(p.stat().st_size for p in pictures) < 640_000


def test_the_table_of_settings_is_the_panels_own():
    sys.path.insert(0, str(ROOT / "scripts"))
    import docs_settings

    page = docs_settings.PAGE.read_text(encoding="utf-8")
    assert page == docs_settings.page_with_tables(page), "run scripts/docs_settings.py"


@pytest.mark.parametrize("name", ["first_recovery.md", "install.md"])
def test_every_named_button_exists(name):
    labels = set(re.findall(r"\*\*(.+?)\*\*", (DOCS / name).read_text(encoding="utf-8")))
    sources = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "irpso_addon" / "ui").rglob("*.py"))
    sources += "".join(path.read_text(encoding="utf-8") for path in (ROOT / "shaders" / "models").glob("*.toml"))
    assert [label for label in labels if f'"{label}' not in sources] == []


def test_every_advised_setting_is_in_its_named_panel():
    pages = [(DOCS / name).read_text(encoding="utf-8") for name in ("presets.md", "reading_maps.md")]
    advised = re.findall(r"\b([A-Z]\w+), ([A-Z][A-Za-z ]+) = \w", "\n".join(pages))
    assert len(advised) > 5
    labels = {group: {SETTINGS[name].label for name in names} for group, names in GROUPS.items()}
    assert [(group, label) for group, label in advised if label not in labels[group]] == []


def test_every_shipped_preset_is_described():
    page = (DOCS / "presets.md").read_text(encoding="utf-8")
    titles = [load_schedule(name).title.partition(":")[0] for name in shipped_presets()]
    assert [title for title in titles if f"| **{title}** |" not in page] == []


def test_every_public_name_is_listed():
    page = (DOCS / "api.md").read_text(encoding="utf-8")
    listed = re.findall(r"`(\w+)[(`]", "\n".join(line.split("|")[1] for line in page.splitlines() if line[:2] == "| "))
    assert set(listed) == set(irpso_addon.__all__)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_named_module_exists(page):
    names = re.findall(r"irpso_addon(?:\.\w+)+", page.read_text(encoding="utf-8"))
    assert [name for name in names if not exists(name)] == []


def exists(name):
    """Whether a dotted name is a module of the program, or is defined in one."""
    module, last = (ROOT.joinpath(*parts) for parts in (name.split("."), name.split(".")[:-1]))
    if module.is_dir() or module.with_suffix(".py").is_file():
        return True
    home = last / "__init__.py" if last.is_dir() else last.with_suffix(".py")
    own = name.rpartition(".")[2]
    return home.is_file() and re.search(
        rf"^(?:(?:def|class) {own}\b|{own} =|from .*\b{own}\b)", home.read_text("utf-8"), re.M
    )


def test_every_file_that_the_page_on_architecture_names_exists():
    names = re.findall(r"`((?:[\w]+/)+\w*(?:\.\w+)?)`", (DOCS / "architecture.md").read_text(encoding="utf-8"))
    assert len(names) > 20
    assert [name for name in names if not any((base / name).exists() for base in (ROOT, ROOT / "irpso_addon"))] == []


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_example_in_python_compiles(page):
    for language, code in FENCE.findall(page.read_text(encoding="utf-8")):
        if language == "python":
            compile(code, name_of(page), "exec")


def test_the_script_of_the_guide_finds_the_lamp_from_highlights_on_a_ball(tmp_path):
    script, rows = tmp_path / "lights_from_ball.py", ["ball 2510 1730 96"]
    blocks = FENCE.findall((DOCS / "shooting.md").read_text(encoding="utf-8"))
    script.write_text(next(code for language, code in blocks if language == "python"), encoding="utf-8")
    rng = np.random.default_rng(3)
    lamps = rng.normal(size=(20, 3)) + (0, 0, 1.5)
    lamps /= np.linalg.norm(lamps, axis=1, keepdims=True)
    # A distant camera sees the lamp where the ball's normal bisects the directions to lamp and camera.
    halves = lamps + (0, 0, 1)
    halves /= np.linalg.norm(halves, axis=1, keepdims=True)
    rows += [f"IMG {k}.jpg {2510 + 96 * h[0]:.6f} {1730 - 96 * h[1]:.6f}" for k, h in enumerate(halves)]
    (tmp_path / "highlights.txt").write_text("\n".join(rows) + "\n", encoding="utf-8")
    command = [sys.executable, script, tmp_path / "highlights.txt"]
    first, *lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    directions = np.array([[float(number) for number in line.rsplit(maxsplit=3)[1:]] for line in lines])
    assert int(first) == 20 and lines[3].startswith("IMG 3.jpg ")
    assert np.allclose(directions, lamps, atol=1e-6)
