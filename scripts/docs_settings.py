"""Writes the table of all settings into docs/presets.md, from the words and limits that the panel goes by."""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from irpso_addon.solver.settings.limits import Limits  # noqa: E402
from irpso_addon.solver.settings.schedule import SETTINGS  # noqa: E402
from irpso_addon.ui.schedule_words import GROUPS, WORDS, Words  # noqa: E402

PAGE = ROOT / "docs" / "presets.md"
BEGIN, END = "<!-- settings: scripts/docs_settings.py writes what follows -->", "<!-- end of settings -->"
_UNITS = {"PIXEL": "texels", "FACTOR": "part", "PERCENTAGE": "%"}


def tables() -> str:
    """Return the tables of all settings, one for each panel."""
    lines = []
    for group, names in GROUPS.items():
        lines += [f"**{group}**", "", "| setting | in files and `--set` | values | meaning |", "|---|---|---|---|"]
        lines += [
            f"| {WORDS[n].label} | `{n}` | {_values(SETTINGS[n], WORDS[n])} | {_meaning(WORDS[n])} |" for n in names
        ]
        lines.append("")
    return "\n".join(lines)


def page_with_tables(page: str) -> str:
    """Return the page with its tables as they ought to be."""
    before, rest = page.split(BEGIN)
    return f"{before}{BEGIN}\n\n{tables()}\n{END}{rest.split(END)[1]}"


def _values(limits: Limits, words: Words) -> str:
    if limits.choices:
        return ", ".join(f"`{choice}`" for choice in limits.choices)
    if limits.kind is bool:
        return "`true`, `false`"
    low = "above" if limits.above else "from"
    high = "" if limits.most is None else f" to {limits.most}"
    kind = "odd, " if limits.odd else "whole, " if limits.kind is int else ""
    return f"{kind}{low} {limits.least}{high} {_UNITS.get(words.subtype, '')}".rstrip()


def _meaning(words: Words) -> str:
    if not words.choices:
        return words.tip
    return f"{words.tip}. " + "; ".join(f"{label}: {tip[0].lower()}{tip[1:]}" for label, tip in words.choices.values())


if __name__ == "__main__":
    PAGE.write_text(page_with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
