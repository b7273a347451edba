"""Sphinx's configuration of the guide, and the order of its pages.

Sources are the Markdown pages in place, so that links work in a checkout too. Sphinx needs "toctree" directives for the
order, which other readers of Markdown would show as text: ``add_navigation`` adds them during the build.
"""

import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

# Pages relative to docs/, in the order in which a user needs them.
NAVIGATION = {
    "Start": ["install", "first_recovery", "worked_example"],
    "Photograph": ["shooting", "calibration", "rigs", "developing"],
    "Use the result": ["reading_maps", "meshes", "exports"],
    "Many and large": ["batch", "cluster", "times"],
    "When something goes wrong": ["troubleshooting", "reporting"],
    "Reference": [
        "command_line",
        "presets",
        "capture_format",
        "scripting",
        "api",
        "writing_a_model",
        "../shaders/README",
        "architecture",
        "releasing",
        "benchmarks/README",
    ],
    "About": ["glossary", "../CHANGELOG"],
}
HOME = "docs/README"

project = "IRPSO"
version = release = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))["version"]
copyright = "2026, the IRPSO authors. GPL-3.0-or-later"

extensions = ["myst_parser"]
root_doc = HOME
include_patterns = ["docs/**.md", "shaders/README.md", "CHANGELOG.md"]
exclude_patterns = [".*", "out", "dist", "build", "tests", "irpso_addon", "presets", "scripts", "benchmarks"]
source_suffix = {".md": "markdown"}
myst_heading_anchors = 4
html_theme = "furo"
html_title = f"IRPSO {version}"
html_copy_source = False
html_show_sphinx = False
html_static_path = ["static"]
html_css_files = ["guide.css"]
html_extra_path = ["root"]
# JavaScript would read the captions of search results from the pages, which browsers forbid for local files.
html_show_search_summary = False
# Pygments' styles with enough contrast; furo brings its own for dark pages.
pygments_style, pygments_dark_style = "a11y-high-contrast-light", "a11y-high-contrast-dark"


def add_navigation(app, name, source):
    """Append the order of pages to the home page, and the list of measured pages to theirs."""
    if name == HOME:
        blocks = list(NAVIGATION.items())
    elif name == "docs/benchmarks/README":
        pages = sorted(path.stem for path in (ROOT / "docs" / "benchmarks").glob("*.md") if path.stem != "README")
        blocks = [("Measured", pages)]
    else:
        return
    for caption, pages in blocks:
        source[0] += "\n".join(["", "```{toctree}", ":hidden:", f":caption: {caption}", "", *pages, "```", ""])


def setup(app):
    """Register the hook."""
    app.connect("source-read", add_navigation)
