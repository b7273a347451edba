"""Translation of texts that Blender does not translate itself, which are all but constant labels and tooltips.

``scripts/translations.py`` collects the first arguments of the calls, which must be constants. Values have names, as in
``iface("{count} lights", count=3)``, because their order differs between languages.
"""

from __future__ import annotations

from typing import Any

from bpy.app import translations


def iface(text: str, **values: Any) -> str:
    """Return a label in the user's language, with the values inserted."""
    return _formatted(translations.pgettext_iface(text), values)


def rpt(text: str, **values: Any) -> str:
    """Return an operator's report in the user's language, with the values inserted."""
    return _formatted(translations.pgettext_rpt(text), values)


def tip(text: str, **values: Any) -> str:
    """Return a tooltip in the user's language, with the values inserted."""
    return _formatted(translations.pgettext_tip(text), values)


def n_(text: str) -> str:
    """Return a text unchanged. Marks it for translation by the code that shows it."""
    return text


def _formatted(text: str, values: dict[str, Any]) -> str:
    return text.format(**values) if values else text
