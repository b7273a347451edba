"""Registers all classes and handlers of the user interface with Blender, and unregisters them."""

from __future__ import annotations

import atexit
from collections.abc import Callable
from importlib import import_module
from types import ModuleType
from typing import Any

from ..gpu.child import inside_blender

# In the order of registration: a module stands after those whose classes its own refer to. Each may define CLASSES,
# register() and unregister().
MODULES = (
    "translations.register",
    "common.failures",
    "properties.preferences",
    "properties.schedule_settings",
    "properties.scene_settings",
    "properties.moved_files",
    "operators.capture_import",
    "operators.video",
    "operators.find_lights",
    "operators.sample",
    "operators.develop",
    "operators.rigs",
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
    "operators.asset",
    "operators.mix",
    "panels.view",
    "panels.image_editor",
    "overlay.handlers",
    "overlay.probes",
    "marks.card_marks",
    "marks.ball_marks",
)


_commands: list[Any] = []  # handles of commands in Blender's command line; empty while unregistered


def register(command: Callable[[list[str]], int]) -> None:
    """Register each module's classes, then call its register(). A failure unregisters all modules again.

    command: the command line's ``irpso``, which takes words and returns the exit code.
    """
    import bpy

    done: list[ModuleType] = []
    try:
        for name in MODULES:
            module = import_module(f".{name}", __package__)
            try:
                for cls in getattr(module, "CLASSES", ()):
                    if issubclass(cls, bpy.types.Operator):  # one line, like the keys of the translations
                        cls.bl_description = " ".join(cls.__doc__.split())
                    bpy.utils.register_class(cls)
                getattr(module, "register", _no_op)()
            except Exception:
                _unregister_classes(module)  # not its unregister(): its register() did not finish
                raise
            done.append(module)
        _commands.append(bpy.utils.register_cli_command("irpso", command))
        if not inside_blender():  # the bpy wheel crashes when a session's GPU objects outlive it
            atexit.register(unregister)
    except Exception:
        _unregister(done)
        raise


def unregister() -> None:
    """Undo ``register``, in reverse order."""
    import bpy

    atexit.unregister(unregister)
    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
    _unregister([import_module(f".{name}", __package__) for name in MODULES])


def _unregister(modules: list[ModuleType]) -> None:
    for module in reversed(modules):
        getattr(module, "unregister", _no_op)()
        _unregister_classes(module)


def _unregister_classes(module: ModuleType) -> None:
    import bpy

    for cls in reversed(getattr(module, "CLASSES", ())):
        if getattr(cls, "is_registered", False):
            bpy.utils.unregister_class(cls)


def _no_op() -> None:
    """Stand in for a register() or unregister() that a module does not define."""
