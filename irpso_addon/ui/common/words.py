"""Translated words. Blender translates constant labels and tooltips itself; these functions do the rest.

``translations`` finds the words in the calls: their first argument must be a constant. Values are named, as in
``iface("{count} lights", count=3)``, because languages differ in their order.
"""

from __future__ import annotations

from typing import Any

from bpy.app import translations


def iface(text: str, **values: Any) -> str:
    """Return a label in the user's language, with the values put in."""
    return _with(translations.pgettext_iface(text), values)


def rpt(text: str, **values: Any) -> str:
    """Return what an operator reports, in the user's language, with the values put in."""
    return _with(translations.pgettext_rpt(text), values)


def tip(text: str, **values: Any) -> str:
    """Return a tooltip in the user's language, with the values put in."""
    return _with(translations.pgettext_tip(text), values)


def n_(text: str) -> str:
    """Return a text as it is: it is translated where it is shown."""
    return text


def _with(text: str, values: dict[str, Any]) -> str:
    return text.format(**values) if values else text
