"""Command lines of child processes that run Python code with Blender."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from ..core.paths import ROOT


def child_command(code: str, arguments: Sequence[str] = ()) -> list[str]:
    """Return the command that runs Python code in a child process with this program and its libraries in its path.

    The code gets the arguments as the end of ``sys.argv``. The process has the user's Blender with factory settings, or
    this Python with the bpy wheel.
    """
    # Last in the path: an extension's libraries are there, but also Blender's own modules, which hide the wheel's bpy.
    script = f"import sys; sys.path.insert(0, {str(ROOT)!r}); sys.path += {sys.path!r}; {code}"
    if not inside_blender():
        return [sys.executable, "-c", script, *arguments]
    import bpy

    options = ["--background", "--factory-startup", "--python-exit-code", "1", "--python-expr", script]
    return [bpy.app.binary_path, *options, "--", *arguments]


def inside_blender() -> bool:
    """Return whether Python runs inside the Blender program, not Blender inside Python (the bpy wheel)."""
    try:
        import bpy
    except ImportError:
        return False
    # bpy.app.module is newer than 4.2; the wheel has no binary, unless a script has set one.
    return not getattr(bpy.app, "module", not bpy.app.binary_path)
