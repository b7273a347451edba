"""Shader nodes: IRPSO's nodes are tagged and updated; all others stay unchanged."""

from __future__ import annotations

from typing import Any

TAG = "irpso_role"
_LABEL = "irpso_label"  # the label that the program gave a node


def tagged_group(tag: str, key: str, name: str) -> tuple[Any, bool]:
    """Return the open file's own node group whose tag has a value, or else a new one, and whether it is new."""
    import bpy

    for group in bpy.data.node_groups:
        if group.get(tag) == key and group.library is None:
            return group, False
    group = bpy.data.node_groups.new(name, "ShaderNodeTree")
    group[tag] = key
    return group, True


def images_of(tree: Any) -> set[Any]:
    """Return the images of a node tree and of the groups in it; none for None."""
    if tree is None:
        return set()
    images = {node.image for node in tree.nodes if node.type == "TEX_IMAGE" and node.image is not None}
    return images.union(*(images_of(node.node_tree) for node in tree.nodes if node.type == "GROUP"))


class OwnNodes:
    """IRPSO's nodes of a tree, each identified by its role.

    A context manager: leaving it removes the IRPSO nodes whose role was not requested. A socket that the user has
    connected to another node keeps that connection, also from the first output of a node that is replaced by one of
    another kind.
    """

    def __init__(self, tree):
        self._tree = tree
        self._found: dict[str, Any] = {}
        self._used: set[str] = set()
        self._behind: list[tuple[str, Any]] = []  # role of a replaced node, socket of the user's that it fed
        tagged = [node for node in tree.nodes if TAG in node]
        for node in sorted(tagged, key=lambda node: node.name != f"IRPSO {node[TAG]}"):
            if self._found.setdefault(node[TAG], node) != node:  # the user's copy of a node copies its tag
                del node[TAG]

    def __enter__(self) -> OwnNodes:
        return self

    def __exit__(self, failure, *details) -> None:
        if failure is not None:
            return
        for role, node in list(self._found.items()):
            if role not in self._used:
                self._tree.nodes.remove(node)
        for role, socket in self._behind:
            self._tree.links.new(self._found[role].outputs[0], socket)

    def node(self, role: str, kind: str, place: tuple[float, float], label: str = "", **properties: Any):
        """Return the node of this role; a new one is placed at ``place``. A label of the user's stays."""
        node = self._found.get(role)
        if node is not None and node.bl_idname != kind:
            fed = [link.to_socket for link in node.outputs[0].links if TAG not in link.to_node]
            self._behind += [(role, socket) for socket in fed]
            self._tree.nodes.remove(node)
            node = None
        if node is None:
            node = self._tree.nodes.new(kind)
            node.name = f"IRPSO {role}"
            node.location = place
            node[TAG] = role
            node.label = node[_LABEL] = label
            self._found[role] = node
        elif node.label == node.get(_LABEL):
            node.label = node[_LABEL] = label
        self._used.add(role)
        for name, value in properties.items():
            setattr(node, name, value)
        return node

    def link(self, source, target) -> None:
        """Connect two sockets, unless the user has connected the target to a node of their own."""
        for link in target.links:
            if TAG not in link.from_node or link.from_socket == source:
                return
        self._tree.links.new(source, target)


def set_input(node, name: str, value: Any) -> None:
    """Set the value of a socket by name; numbers become opaque grey where it is a colour."""
    # Lookup by name finds only sockets that the current settings enable.
    socket = next(socket for socket in node.inputs if socket.name == name)
    if hasattr(socket.default_value, "__len__") and not hasattr(value, "__len__"):
        value = (value, value, value, 1.0)[: len(socket.default_value)]
    socket.default_value = value
