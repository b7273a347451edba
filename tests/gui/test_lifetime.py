"""The extension comes and goes in a living window, and files come and go under it, without a trace left."""

import pytest

MODULE = "bl_ext.user_default.irpso"

# What an extension can leave behind. Blender does not list its draw handlers: they are counted as they come and go.
SNAPSHOT = """
import sys
if "drawers" not in globals():
    drawers = []
    spaces = [kind for kind in bpy.types.Space.__subclasses__() if hasattr(kind, "draw_handler_add")]
    for space in spaces:
        def count(space=space, add=space.draw_handler_add, remove=space.draw_handler_remove):
            def come(*arguments):
                handle = add(*arguments)
                drawers.append(handle)
                return handle
            def go(handle, region):
                remove(handle, region)
                drawers.remove(handle)
            space.draw_handler_add, space.draw_handler_remove = come, go
        count()

def snapshot():
    hooks = {name: getattr(bpy.app.handlers, name) for name in dir(bpy.app.handlers)}
    modules = [module for name, module in sys.modules.items() if ".irpso." in name]
    functions = [value for module in modules for value in vars(module).values() if hasattr(value, "__code__")]
    keyconfigs = bpy.context.window_manager.keyconfigs
    kinds = [getattr(bpy.types, name) for name in dir(bpy.types)]
    owners = [bpy.types.ID, *bpy.types.ID.__subclasses__()]
    drawn = [f for kind in kinds for f in getattr(getattr(kind, "draw", None), "_draw_funcs", ())]
    return {
        "types": dir(bpy.types),
        "properties": [f"{owner.__name__}.{name}" for owner in owners for name in owner.bl_rna.properties.keys()],
        "handlers": {name: len(each) for name, each in hooks.items() if isinstance(each, list)},
        "timers": [f.__qualname__ for f in functions if bpy.app.timers.is_registered(f)],
        "keymaps": {c.name: {m.name: len(m.keymap_items) for m in c.keymaps if len(m.keymap_items)}
                    for c in (keyconfigs.addon, keyconfigs.user)},
        "drawn into Blender's menus": [f.__qualname__ for f in drawn if "irpso" in f.__module__],
        "draw handlers": len(drawers),
        "data": {name: len(getattr(bpy.data, name)) for name in ("images", "materials", "node_groups", "texts")},
    }
"""


def switch(window, state: str) -> dict:
    """Enable or disable the extension as the preferences do, let the window draw, and return what there is then."""
    window.run(f"bpy.ops.preferences.addon_{state}(module={MODULE!r})")
    window.run("redrawn()", area="")
    return window.run("snapshot()")


@pytest.fixture(scope="module")
def counted(window):
    """The window, able to tell what there is; the extension enabled."""
    window.run(SNAPSHOT)
    switch(window, "disable")
    switch(window, "enable")
    return window


def test_enabling_and_disabling_ten_times_leaves_nothing_behind(counted):
    enabled, disabled = [], []
    for _ in range(10):
        disabled.append(switch(counted, "disable"))
        enabled.append(switch(counted, "enable"))
    assert disabled == [disabled[0]] * 10
    assert enabled == [enabled[0]] * 10
    assert disabled[0] != enabled[0]


def test_disabled_nothing_in_blender_bears_the_name_of_the_extension(counted):
    told = switch(counted, "disable")
    switch(counted, "enable")
    names = [*told["types"], *told["properties"], *told["timers"], *told["drawn into Blender's menus"]]
    assert [name for name in names if "irpso" in name.lower()] == []
    assert told["draw handlers"] == 0


def test_another_file_can_be_loaded_and_the_extension_is_there_in_it(counted, tmp_path):
    path = tmp_path / "other.blend"
    counted.run(f"bpy.data.objects['Cube'].name = 'Other'\nbpy.ops.wm.save_as_mainfile(filepath={str(path)!r})")
    counted.run("bpy.ops.wm.read_homefile()", area="")
    before = counted.run("snapshot()")
    assert counted.run("'Other' not in bpy.data.objects")
    counted.run(f"bpy.ops.wm.open_mainfile(filepath={str(path)!r})", area="")
    counted.run("redrawn()", area="")
    assert counted.run("'Other' in bpy.data.objects")
    after = counted.run("snapshot()")
    assert {**after, "data": None} == {**before, "data": None}
