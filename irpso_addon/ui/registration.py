"""Adding the user interface to Blender and taking it out again, whole."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from types import ModuleType
from typing import Any

# In this order; each may have CLASSES, register() and unregister(). What a module's classes refer to comes before it.
MODULES = (
    "common.failures",
    "properties.preferences",
    "properties.schedule_settings",
    "properties.scene_settings",
    "operators.capture_import",
    "operators.ball_lights",
    "operators.camera_import",
    "operators.scene_setup",
    "operators.presets",
    "properties.upkeep",
    "session.session",
    "operators.restore",
    "operators.recover",
    "session.keep",
    "panels.sidebar",
    "panels.capture",
    "panels.recovery",
    "operators.export",
    "panels.view",
    "panels.image_editor",
    "overlay.handlers",
    "overlay.probes",
)


_commands: list[Any] = []  # handles of commands of Blender's command line; empty while unregistered


def register(command: Callable[[list[str]], int]) -> None:
    """Register every module's classes, then call its own register(). Where one fails, what was added is taken out.

    command: of the command line, ``irpso``: takes words, returns the exit code.
    """
    import bpy

    done: list[ModuleType] = []
    try:
        for name in MODULES:
            module = import_module(f".{name}", __package__)
            try:
                for cls in getattr(module, "CLASSES", ()):
                    bpy.utils.register_class(cls)
                getattr(module, "register", _nothing)()
            except Exception:
                _unregister_classes(module)  # its own register() did not come to its end, so there is no undoing it
                raise
            done.append(module)
        _commands.append(bpy.utils.register_cli_command("irpso", command))
    except Exception:
        _unregister(done)
        raise


def unregister() -> None:
    """Take out what ``register`` added, in the opposite order."""
    import bpy

    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
    _unregister([import_module(f".{name}", __package__) for name in MODULES])


def _unregister(modules: list[ModuleType]) -> None:
    for module in reversed(modules):
        getattr(module, "unregister", _nothing)()
        _unregister_classes(module)


def _unregister_classes(module: ModuleType) -> None:
    import bpy

    for cls in reversed(getattr(module, "CLASSES", ())):
        if getattr(cls, "is_registered", False):
            bpy.utils.unregister_class(cls)


def _nothing() -> None:
    """Stand in for what a module does not have."""
