"""Colour spaces of Blender's images by their use, and the space in which Blender renders.

Names differ between OpenColorIO configurations. Blender's own has "Non-Color", "sRGB" and "Linear Rec.709"; those of
ACES have "Raw", "sRGB - Texture" and "Linear Rec.709 (sRGB)". The role of data is asked from the configuration; Python
has no access to the other roles, so the role scene_linear is measured on three pixels.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

import numpy as np

from ..core.errors import InputError
from ..core.png import png_bytes

Use = Literal["data", "srgb", "linear"]
_SAME = 1e-4  # of a matrix: the digits of configurations
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
    """Return the use of an image's colour space; None for a space of another use."""
    settings = image.colorspace_settings
    if settings.is_data:
        return "data"
    return next((use for use in ("srgb", "linear") if settings.name in _NAMES[use]), None)  # type: ignore[return-value]


def working_matrix() -> np.ndarray | None:
    """Return the matrix (3, 3) from linear Rec. 709 to the scene-linear space of the file; None if they are equal.

    Colours of lights and sockets, and pixels of float images other than data, are in that space. Since Blender 5.0 a
    file chooses it (Rec. 709, Rec. 2020, ACEScg); ACES configurations have ACEScg. It is measured: Blender converts the
    pixels of 16-bit images to it. Raises InputError where the configuration has no sRGB.
    """
    import bpy

    image = bpy.data.images.new("IRPSO colours", 3, 1)
    try:
        image.source = "FILE"
        use_space(image, "srgb")
        data = png_bytes(np.eye(3)[None], 16)
        image.pack(data=data, data_len=len(data))
        values = np.empty(12, np.float32)
        image.pixels.foreach_get(values)
    finally:
        bpy.data.images.remove(image)
    matrix = values.reshape(3, 4)[:, :3].T.astype(np.float64)
    return None if np.abs(matrix - np.eye(3)).max() < _SAME else matrix


def to_rec_709(values: np.ndarray) -> np.ndarray:
    """Return scene-linear colours (…, 3) of the file as linear Rec. 709."""
    matrix = working_matrix()
    return values if matrix is None else values @ np.linalg.inv(matrix).T


def from_rec_709(values: np.ndarray) -> np.ndarray:
    """Return linear Rec. 709 colours (…, 3) in the scene-linear space of the file."""
    matrix = working_matrix()
    return values if matrix is None else values @ matrix.T


def _all(settings: Any) -> set[str]:
    return {item.identifier for item in settings.bl_rna.properties["name"].enum_items}


def _first(names: Iterable[str], known: set[str]) -> str | None:
    return next((name for name in names if name in known), None)
