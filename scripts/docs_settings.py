"""Writes the tables of all settings, and of their former names, into docs/presets.md, from solver/settings/."""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from irpso_addon.solver.settings.renamed import FORMER, FORMER_VALUES  # noqa: E402
from irpso_addon.solver.settings.schedule import GROUPS, SETTINGS  # noqa: E402
from irpso_addon.solver.settings.setting import Setting  # noqa: E402

PAGE = ROOT / "docs" / "presets.md"
BEGIN, END = "<!-- settings: scripts/docs_settings.py writes what follows -->", "<!-- end of settings -->"
_UNITS = {"PIXEL": "texels", "FACTOR": "part", "PERCENTAGE": "%"}


def tables() -> str:
    """Return the tables of all settings, one for each panel, and that of former names."""
    lines = []
    for group, names in GROUPS.items():
        head = "| setting | in files and `--set` | values | default | meaning |"
        lines += [f"**{group}**", "", head, "|---|---|---|---|---|"]
        for name in names:
            one = SETTINGS[name]
            lines.append(f"| {one.label} | `{name}` | {_values(one)} | {_default(one)} | {_meaning(one)} |")
        lines.append("")
    lines += ["## Former names", "", "| table | before | now |", "|---|---|---|"]
    for table, names in FORMER.items():
        place, shape = (f" `[{table}]`", "`{}`") if table else ("", "`[{}]`")
        lines += [f"|{place} | {shape.format(old)} | {shape.format(now)} |" for old, now in names.items()]
    lines += [f'| | `{name} = "{old}"` | `{name} = "{now}"` |' for (name, old), now in FORMER_VALUES.items()]
    lines.append("")
    return "\n".join(lines)


def page_with_tables(page: str) -> str:
    """Return the page with current tables."""
    before, rest = page.split(BEGIN)
    return f"{before}{BEGIN}\n\n{tables()}\n{END}{rest.split(END)[1]}"


def _values(setting: Setting) -> str:
    if setting.choices:
        return ", ".join(f"`{choice}`" for choice in setting.choices)
    if setting.kind is bool:
        return "`true`, `false`"
    low = "above" if setting.exclusive_minimum else "from"
    high = "" if setting.maximum is None else f" to {setting.maximum}"
    kind = "odd, " if setting.odd else "whole, " if setting.kind is int else ""
    return f"{kind}{low} {setting.minimum}{high} {_UNITS.get(setting.subtype, '')}".rstrip()


def _default(setting: Setting) -> str:
    return "in the preset" if setting.default is None else f"`{str(setting.default).lower()}`"


def _meaning(setting: Setting) -> str:
    if not setting.choices:
        return setting.help
    return f"{setting.help}. " + "; ".join(
        f"{label}: {text[0].lower()}{text[1:]}" for label, text in setting.choices.values()
    )


if __name__ == "__main__":
    PAGE.write_text(page_with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
