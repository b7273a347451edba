"""Objects whose place or origin is not certain: deleted or hidden ones, which settings keep, and duplicates."""

from __future__ import annotations

from collections.abc import Callable, Iterable
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


def originals(
    objects: Iterable[Any], role: Callable[[Any], str], has_own_name: Callable[[Any], bool]
) -> dict[str, Any]:
    """Return role → object. A duplicate has the role of its original, and another or a longer name.

    has_own_name: whether an object's name is, or begins with, the one that it was made with.
    """
    ordered = sorted(objects, key=lambda obj: (not has_own_name(obj), len(obj.name), obj.session_uid), reverse=True)
    return {role(obj): obj for obj in ordered}


def _holds(objects: Any, obj: Any) -> bool:
    """Return whether a collection of objects has this one; a linked one may have the name of a local one."""
    found = objects.get(obj.name)
    return found == obj or (found is not None and obj in objects.values())
