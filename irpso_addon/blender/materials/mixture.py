"""Two kept materials mixed by a mask in a third one.

Their parameters are mixed, not their shaders. Two captures of one surface are two estimates of one lobe, and their mean
is one lobe; a mix of shaders would be two lobes over each other. Normals are mixed as vectors and normalized.
Roughness is mixed as its square, α, the width of the lobe.
"""

from __future__ import annotations

from typing import Any

from ...core.errors import InputError
from . import two_lobe_nodes as two_lobe
from .look import FACTOR, ROUGHNESS, STRENGTH
from .material import TAG, new_material
from .node_copies import Copies, source_of

_NORMALS = ("Normal", "Coat Normal")
_KINDS = {"RGBA": "NodeSocketColor", "VALUE": "NodeSocketFloat", "VECTOR": "NodeSocketVector"}
_WIDTHS = {*ROUGHNESS, "Coat Roughness"}
_GRAIN = "Tangent"  # driven in materials with a grain


def mix_materials(first: Any, second: Any, mask: Any = None, factor: float = 0.5, scale: float = 1.0) -> Any:
    """Return a new material: ``first`` where the mask is black, ``second`` where it is white.

    mask: an image in the active UV map, None for ``factor`` everywhere. scale: how many times the second's maps repeat
    along the UV square; at 1 they stay as they are. Displacement is left out. Raises InputError for materials that
    IRPSO has not made, of different shaders, with a grain, or with nodes that ``Copies`` refuses.
    """
    import bpy

    pair = (first, second)
    surfaces = [_surface(material) for material in pair]
    if _kind(surfaces[0]) != _kind(surfaces[1]):
        raise InputError(
            f"'{first.name}' and '{second.name}' have different shaders; recover both with models of one shader"
        )
    mixed = [s.name for s, t in zip(surfaces[0].inputs, surfaces[1].inputs, strict=True) if _differ(s, t)]
    if _GRAIN in mixed:
        raise InputError(f"'{first.name}' or '{second.name}' has a grain, whose angles cannot be mixed; choose others")
    made = new_material(f"IRPSO {first.get(TAG)} + {second.get(TAG)}")
    groups: list[Any] = []
    try:
        for material, surface in zip(pair, surfaces, strict=True):
            groups.append(bpy.data.node_groups.new(f"IRPSO {material[TAG]}", "ShaderNodeTree"))
            _fill_parameters(groups[-1], surface, mixed)
    except InputError:
        bpy.data.materials.remove(made)
        for group in groups:
            bpy.data.node_groups.remove(group)
        raise
    groups.append(_mixing(surfaces[0], mixed))
    _fill(made.node_tree, surfaces[0], mixed, groups)
    nodes = made.node_tree.nodes
    nodes["Second"].inputs["Scale"].default_value = scale
    if scale != 1:
        for node in groups[1].nodes:
            if node.type == "TEX_IMAGE":
                node.extension = "REPEAT"
    nodes["Mix"].inputs["Factor"].default_value = factor
    if mask is not None:
        texture = nodes.new("ShaderNodeTexImage")
        texture.name, texture.label, texture.location = "Mask", "Mask", (-760, 420)
        texture.image, texture.extension = mask, "EXTEND"
        made.node_tree.links.new(texture.outputs["Color"], nodes["Mix"].inputs["Factor"])
    return made


def _surface(material: Any) -> Any:
    """Return the node that a recovered material ends in. Raises InputError for other materials."""
    output = material.node_tree.get_output_node("ALL") if TAG in material else None
    source = None if output is None else source_of(output.inputs["Surface"])
    while source is not None and source.node.type == "REROUTE":
        source = source_of(source.node.inputs[0])
    if source is None:
        raise InputError(f"material '{material.name}' is not a recovered one; choose one that Keep made")
    if source.name != "BSDF" or any(socket.type == "SHADER" for socket in source.node.inputs):
        raise InputError(
            f"material '{material.name}': node '{source.node.name}' stands behind the recovered surface; mix first, and"
            " put it behind the mix"
        )
    return source.node


def _kind(surface: Any) -> tuple[str, ...]:
    if surface.bl_idname == "ShaderNodeGroup":
        return surface.bl_idname, surface.node_tree.get(two_lobe.TAG, surface.node_tree.name)
    return (surface.bl_idname,)


def _differ(first: Any, second: Any) -> bool:
    """Return whether two sockets of one name are driven, or have different values."""
    if source_of(first) is not None or source_of(second) is not None:
        return True
    return _value(first) != _value(second)


def _value(socket: Any) -> Any:
    value = getattr(socket, "default_value", None)
    return tuple(value) if hasattr(value, "__len__") else value


def _fill_parameters(group: Any, surface: Any, names: list[str]) -> None:
    """Make a material's surface values the outputs of a node group, and its look and UV scale inputs."""
    copies = Copies(group)
    driving = {name: source_of(surface.inputs[name]) for name in names}
    sources = {name: copies.of(source) for name, source in driving.items() if source is not None}
    for name in names:
        _socket(group, name, surface.inputs[name], "OUTPUT")
    group_input, group_output = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    group_input.location, group_output.location = (-1500, 0), (400, 0)
    for name in names:
        if name in sources:
            group.links.new(sources[name], group_output.inputs[name])
        elif name in _NORMALS:
            group.links.new(group.nodes.new("ShaderNodeNewGeometry").outputs["Normal"], group_output.inputs[name])
        else:
            group_output.inputs[name].default_value = surface.inputs[name].default_value
    look = next((node for node in copies.made.values() if FACTOR in node.inputs), None)
    for name in (FACTOR, STRENGTH) if look is not None else ():
        if not look.inputs[name].is_linked:
            _exposed(group, group_input, look, name)
    _scaled(group, group_input)


def _exposed(group: Any, group_input: Any, look: Any, name: str) -> None:
    """Make an input of the group for one of a node in it, with the same limits, text and value."""
    own = next(item for item in look.node_tree.interface.items_tree if item.name == name and item.in_out == "INPUT")
    item = group.interface.new_socket(name, description=own.description, in_out="INPUT", socket_type=own.socket_type)
    item.min_value, item.max_value = own.min_value, own.max_value
    item.default_value = look.inputs[name].default_value
    group.links.new(group_input.outputs[name], look.inputs[name])


def _scaled(group: Any, group_input: Any) -> None:
    """Make an input of the group that scales the UV map of its images, unless the user has mapped them."""
    item = group.interface.new_socket(
        "Scale", in_out="INPUT", socket_type="NodeSocketFloat",
        description="How many times the maps repeat along the UV square; their images must be set to Repeat",
    )  # fmt: skip
    item.min_value, item.max_value, item.default_value = 0.001, 1000.0, 1.0
    scaled: dict[str, Any] = {}
    for texture in [node for node in group.nodes if node.type == "TEX_IMAGE"]:
        links = texture.inputs["Vector"].links
        if links and links[0].from_node.type != "UVMAP":
            continue
        name = links[0].from_node.uv_map if links else ""
        if name not in scaled:
            uv, mapping = group.nodes.new("ShaderNodeUVMap"), group.nodes.new("ShaderNodeMapping")
            uv.uv_map, uv.location, mapping.location = name, (-1300, -200), (-1100, 0)
            group.links.new(uv.outputs["UV"], mapping.inputs["Vector"])
            group.links.new(group_input.outputs["Scale"], mapping.inputs["Scale"])
            scaled[name] = mapping.outputs["Vector"]
        group.links.new(scaled[name], texture.inputs["Vector"])


def _socket(group: Any, name: str, like: Any, direction: str) -> None:
    item = group.interface.new_socket(name, in_out=direction, socket_type=_KINDS[like.type])
    if name in _NORMALS and direction == "INPUT":
        item.hide_value = True


def _mixing(surface: Any, names: list[str]) -> Any:
    """Return a node group that mixes two sets of values."""
    import bpy

    group = bpy.data.node_groups.new("IRPSO Mix", "ShaderNodeTree")
    item = group.interface.new_socket(
        "Factor", description="0 is the first material, 1 the second", in_out="INPUT", socket_type="NodeSocketFloat"
    )
    item.min_value, item.max_value, item.default_value = 0.0, 1.0, 0.5
    for name in names:
        for of in ("First", "Second"):
            _socket(group, f"{of} {name}", surface.inputs[name], "INPUT")
        _socket(group, name, surface.inputs[name], "OUTPUT")
    group_input, group_output = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    group_input.location, group_output.location = (-600, 0), (600, 0)
    squared = _WIDTHS if not two_lobe.is_of_widths(surface) else set()
    for row, name in enumerate(names):
        ends = [group_input.outputs[f"{of} {name}"] for of in ("First", "Second")]
        value = _mix(group, group_input.outputs["Factor"], ends, surface.inputs[name].type, name in squared, -220 * row)
        if name in _NORMALS:
            unit = group.nodes.new("ShaderNodeVectorMath")
            unit.operation, unit.location = "NORMALIZE", (300, -220 * row)
            group.links.new(value, unit.inputs[0])
            value = unit.outputs["Vector"]
        group.links.new(value, group_output.inputs[name])
    return group


def _mix(group: Any, factor: Any, ends: list[Any], kind: str, squared: bool, y: float) -> Any:
    """Return the socket with the mean of two, by ``factor``."""
    node = group.nodes.new("ShaderNodeMix")
    node.data_type, node.location = {"VALUE": "FLOAT", "VECTOR": "VECTOR", "RGBA": "RGBA"}[kind], (0, y)
    shown = [socket for socket in node.inputs if socket.enabled]
    group.links.new(factor, shown[0])
    for k, end in enumerate(ends):
        group.links.new(_power(group, end, 2.0, (-300, y - 90 * k)) if squared else end, shown[1 + k])
    value = next(socket for socket in node.outputs if socket.enabled)
    return _power(group, value, 0.5, (300, y)) if squared else value


def _power(group: Any, socket: Any, exponent: float, place: tuple[float, float]) -> Any:
    node = group.nodes.new("ShaderNodeMath")
    node.operation, node.location = "POWER", place
    node.inputs[1].default_value = exponent
    group.links.new(socket, node.inputs[0])
    return node.outputs[0]


def _fill(tree: Any, surface: Any, names: list[str], groups: list[Any]) -> None:
    """Make the tree: two groups of parameters, their mix, a surface like ``surface``, and the output."""
    made = {}
    for title, group, place in zip(
        ("First", "Second", "Mix"), groups, ((-760, 120), (-760, -240), (-380, 0)), strict=True
    ):
        node = made[title] = tree.nodes.new("ShaderNodeGroup")
        node.name, node.node_tree, node.location, node.width = title, group, place, 240
        node.label = title if title == "Mix" else group.name.removeprefix("IRPSO ")
    end = Copies(tree, driven=False).node(surface)
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    end.location, output.location = (0, 0), (360, 0)
    for name in names:
        for of in ("First", "Second"):
            tree.links.new(made[of].outputs[name], made["Mix"].inputs[f"{of} {name}"])
        tree.links.new(made["Mix"].outputs[name], end.inputs[name])
    tree.links.new(end.outputs["BSDF"], output.inputs["Surface"])
