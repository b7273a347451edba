"""Reads .po files (GNU gettext): pairs of msgid and msgstr."""

from __future__ import annotations

import ast
import re
from pathlib import Path

_ENTRY = re.compile(r'^msgid((?:\s*"(?:[^"\\]|\\.)*")+)\s*^msgstr((?:\s*"(?:[^"\\]|\\.)*")+)', re.MULTILINE)
_QUOTED = re.compile(r'"(?:[^"\\]|\\.)*"')


def read_po(path: Path) -> dict[str, str]:
    """Return English text → translation. Texts without one and those marked fuzzy are left out.

    Contexts and plurals are not used. A text that stands twice is a ValueError.
    """
    found: dict[str, str] = {}
    for block in path.read_text(encoding="utf-8").split("\n\n"):
        entry = _ENTRY.search(block)
        if entry is None or re.search(r"^#,.*\bfuzzy\b", block, re.MULTILINE):
            continue
        text, translation = (_joined(part) for part in entry.groups())
        if text in found:
            raise ValueError(f"{text!r} stands twice")
        if text and translation:
            found[text] = translation
    return found


def _joined(quoted: str) -> str:
    return "".join(ast.literal_eval(piece) for piece in _QUOTED.findall(quoted))
