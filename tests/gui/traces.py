"""What the extension could leave behind in a Blender, counted; and switching it off and on."""

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


def changes(before: dict, after: dict) -> dict:
    """Return what differs between two snapshots: kind -> (there before only, there after only)."""
    difference = {}
    for kind in before:
        if before[kind] != after[kind]:
            sides = [each if isinstance(each, list) else [each] for each in (before[kind], after[kind])]
            difference[kind] = tuple([item for item in one if item not in other] for one, other in (sides, sides[::-1]))
    return difference
