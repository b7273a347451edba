"""Copies the nodes that drive a socket into another node tree; Blender's own copying needs an editor."""

from __future__ import annotations

from typing import Any

from ...core.errors import InputError

_CURVES = {"mapping", "color_ramp"}  # data of a node that scripts cannot assign


class Copies:
    """Nodes copied into ``tree``, each once. driven: with the nodes that drive them. made: original's name → copy."""

    def __init__(self, tree: Any, driven: bool = True):
        self._tree, self._driven = tree, driven
        self.made: dict[str, Any] = {}

    def of(self, output: Any) -> Any:
        """Return the copy of an output socket, of its node. Raises InputError like ``node``."""
        return self.node(output.node).outputs[list(output.node.outputs).index(output)]

    def node(self, node: Any) -> Any:
        """Return the copy of a node. Raises InputError for curves, ramps and drivers, and in an animated tree."""
        if node.name in self.made:
            return self.made[node.name]
        if any(getattr(node, name, None) is not None for name in _CURVES):
            raise InputError(
                f"node '{node.name}' has curves or a color ramp, which cannot be copied; put it behind the mix instead"
            )
        if _is_animated(node):
            raise InputError(
                f"node '{node.name}' has a driver, or its tree has keyframes, which cannot be copied; delete them"
            )
        copy = self.made[node.name] = self._tree.nodes.new(node.bl_idname)
        copy.name, copy.label, copy.location, copy.mute = node.name, node.label, node.location, node.mute
        for name in _own_properties(node):
            setattr(copy, name, getattr(node, name))
        for socket, target in zip(node.inputs, copy.inputs, strict=True):
            if self._driven and (source := source_of(socket)) is not None:
                self._tree.links.new(self.of(source), target)
            elif hasattr(socket, "default_value"):
                target.default_value = socket.default_value
        for socket, target in zip(node.outputs, copy.outputs, strict=True):
            if hasattr(socket, "default_value"):  # that of the nodes Value and RGB
                target.default_value = socket.default_value
        return copy


def source_of(socket: Any) -> Any:
    """Return the output that drives an input socket; None without a link, or with a muted one."""
    return next((link.from_socket for link in socket.links if not link.is_muted), None)


def _is_animated(node: Any) -> bool:
    """Return whether a node has a driver, or its tree an action."""
    animation = node.id_data.animation_data
    if animation is None:
        return False
    driven = any(driver.data_path.startswith(node.path_from_id()) for driver in animation.drivers)
    return driven or animation.action is not None or len(animation.nla_tracks) > 0


def _own_properties(node: Any) -> list[str]:
    """Return the names of the settings that a kind of node has beyond all nodes'."""
    import bpy

    common = bpy.types.Node.bl_rna.properties
    return [p.identifier for p in node.bl_rna.properties if not p.is_readonly and p.identifier not in common]
