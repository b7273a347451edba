"""The extension inside Blender: registered, taken away, and registered again without leaving anything behind."""

import sys

import bpy
import pytest

import irpso_addon
from irpso_addon.ui import registration

pytestmark = pytest.mark.bpy_only


def registered_names() -> set[str]:
    """Return the classes, property groups and handlers that extensions leave behind when they forget to clean up."""
    kinds = (bpy.types.Operator, bpy.types.Panel, bpy.types.PropertyGroup, bpy.types.AddonPreferences, bpy.types.UIList,
             bpy.types.FileHandler)  # fmt: skip
    # A class goes on existing in Python once its module has been imported.
    found = [(kind, cls) for kind in kinds for cls in kind.__subclasses__() if getattr(cls, "is_registered", False)]
    classes = {f"{kind.__name__}.{cls.__name__}" for kind, cls in found}
    handlers = [(name, getattr(bpy.app.handlers, name)) for name in dir(bpy.app.handlers)]
    hooks = {f"{name}.{hook.__name__}" for name, hooks in handlers if isinstance(hooks, list) for hook in hooks}
    owners = (bpy.types.Scene, bpy.types.Object, bpy.types.Material, bpy.types.WindowManager)
    properties = {f"{owner.__name__}.{name}" for owner in owners for name in owner.bl_rna.properties}
    return classes | hooks | properties


def test_registering_twice_leaves_nothing_behind():
    before = registered_names()
    for _ in range(2):
        irpso_addon.register()
        assert len(registration._commands) == 1
        irpso_addon.unregister()
        assert registration._commands == []
    assert registered_names() - before == set()


def test_the_command_reaches_the_command_line(monkeypatch):
    seen = []
    fake = type(sys)("irpso_addon.cli")
    fake.main = lambda argv: seen.append(argv) or 7
    monkeypatch.setitem(sys.modules, "irpso_addon.cli", fake)
    monkeypatch.setattr(irpso_addon, "cli", fake, raising=False)
    commands = {}
    monkeypatch.setattr(bpy.utils, "register_cli_command", lambda name, run: commands.setdefault(name, run))
    monkeypatch.setattr(bpy.utils, "unregister_cli_command", lambda handle: None)
    irpso_addon.register()
    irpso_addon.unregister()
    assert commands["irpso"](["doctor"]) == 7
    assert seen == [["doctor"]]
