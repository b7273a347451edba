"""Colour spaces of Blender's images by what they are for: names differ between OpenColorIO configurations.

Blender's own configuration has "Non-Color", "sRGB" and "Linear Rec.709"; those of ACES have "Raw", "sRGB - Texture" and
"Linear Rec.709 (sRGB)". The role of data is asked from the configuration; Python has no access to the other roles.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

from ..core.errors import InputError

Use = Literal["data", "srgb", "linear"]
_NAMES = {
    "srgb": ("sRGB", "sRGB - Texture", "sRGB Encoded Rec.709 (sRGB)", "Utility - sRGB - Texture", "srgb_texture"),
    "linear": (
        "Linear Rec.709", "Linear Rec.709 (sRGB)", "Utility - Linear - sRGB", "Utility - Linear - Rec.709", "lin_srgb",
        "Linear",
    ),
}  # fmt: skip


def use_space(image: Any, use: Use) -> None:
    """Give an image the colour space of data, of sRGB codes, or of linear Rec. 709.

    Raises InputError where the configuration has none that is known by name.
    """
    settings = image.colorspace_settings
    if use == "data":
        settings.is_data = True  # the role
        return
    name = _first(_NAMES[use], _all(settings))
    if name is None:
        what = {"srgb": "sRGB textures", "linear": "linear Rec. 709"}[use]
        raise InputError(
            f"the OpenColorIO configuration has no colour space for {what} ({_NAMES[use][0]}, {_NAMES[use][1]}); add"
            " one, or unset OCIO"
        )
    settings.name = name


def use_of(image: Any) -> Use | None:
    """Return what the colour space of an image is for; None if it is another."""
    settings = image.colorspace_settings
    if settings.is_data:
        return "data"
    return next((use for use in ("srgb", "linear") if settings.name in _NAMES[use]), None)  # type: ignore[return-value]


def _all(settings: Any) -> set[str]:
    return {item.identifier for item in settings.bl_rna.properties["name"].enum_items}


def _first(names: Iterable[str], known: set[str]) -> str | None:
    return next((name for name in names if name in known), None)
