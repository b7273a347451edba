"""Whether scenes and view layers have an object: settings that name one keep it in the file, and evaluated."""

from __future__ import annotations

from typing import Any


def in_a_scene(obj: Any) -> bool:
    """Return whether a scene has an object."""
    import bpy

    return any(_holds(scene.objects, obj) for scene in bpy.data.scenes)


def in_viewports(obj: Any) -> bool:
    """Return whether the active view layer has an object that its viewports may show; H hides it from the eye alone."""
    import bpy

    def shows(layer: Any) -> bool:
        if layer.exclude or layer.collection.hide_viewport:
            return False
        return _holds(layer.collection.objects, obj) or any(map(shows, layer.children))

    return not obj.hide_viewport and shows(bpy.context.view_layer.layer_collection)


def _holds(objects: Any, obj: Any) -> bool:
    """Return whether a collection of objects has this one; a linked one may have the name of a local one."""
    found = objects.get(obj.name)
    return found == obj or (found is not None and obj in objects.values())
