"""Gives Blender the words of all languages, for the one that is chosen in its preferences."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy

from .po import read_po

# Blender looks for de_DE, then for de. Chinese has two scripts and so keeps its own.
LOCALES = ("de", "es", "fr", "ja", "zh_HANS")
FOLDER = Path(__file__).parent
_CONTEXTS = ("*", "Operator")  # of labels and properties; of operators' names, as in buttons and menus


def words() -> dict[str, dict[tuple[str, str], str]]:
    """Return locale → (context, English text) → translation. A file that cannot be read is named, and left out."""
    read: dict[str, dict[str, str]] = {}
    for locale in LOCALES:
        try:
            read[locale] = read_po(FOLDER / f"{locale}.po")
        except (OSError, ValueError, SyntaxError) as error:
            sys.stderr.write(f"irpso: warning: {locale}.po: {error}; its texts are English\n")
    return {
        locale: {(context, text): word for text, word in found.items() for context in _CONTEXTS}
        for locale, found in read.items()
    }


def register() -> None:
    """Register the words under this module's name."""
    bpy.app.translations.register(__name__, words())


def unregister() -> None:
    """Remove them."""
    bpy.app.translations.unregister(__name__)
