"""Versions of IRPSO and its libraries."""

from __future__ import annotations

import platform
import tomllib
from functools import cache

import numpy as np

from ..core.paths import ROOT


@cache
def versions() -> dict[str, str]:
    """Return name → version; Blender's is absent outside Blender."""
    import OpenEXR

    with open(ROOT / "blender_manifest.toml", "rb") as file:
        own = tomllib.load(file)["version"]
    table = {"irpso": own, "python": platform.python_version(), "numpy": np.__version__, "openexr": OpenEXR.__version__}
    try:
        import bpy
    except ImportError:
        return table
    return table | {"blender": bpy.app.version_string}
