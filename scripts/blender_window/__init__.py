"""Drives a real Blender in a virtual screen by real events, for the tests of the UI and the guide's pictures.

from blender_window import build_package, find_blender, install, open_window

blender = find_blender()  # BLENDER=/path, or Debian's own, built once (BLENDER_SUITE)
install(blender, build_package(folder), folder / "user")
with open_window(blender, folder / "user", folder / "pictures") as window:
    window.open_sidebar("IRPSO")
    window.click(*window.find_button("irpso.recover"))
    window.screenshot("recovering")
"""

from .blenders import Blender, find_blender
from .layout import Box
from .session import BlenderError, build_package, install, open_window
from .window import BlenderGone, FailedInside, Window

__all__ = [
    "Blender", "BlenderGone", "Box", "BlenderError", "FailedInside", "Window", "build_package", "find_blender",
    "install", "open_window",
]  # fmt: skip
