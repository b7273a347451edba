"""Group node of a kept material with factors of roughness and normal strength; 1 and 1 change no value."""

from __future__ import annotations

from .nodes import OwnNodes, tagged_group

FACTOR, STRENGTH = "Roughness Factor", "Normal Strength"
ROUGHNESS = ("Roughness", "Roughness 1", "Roughness 2")  # sockets of surfaces
_TAG = "irpso_look"
_PLACE = (-180, 140)
# Name: most, description. Normal Strength is that of Blender's Normal Map node, with its limit.
_INPUTS = {
    FACTOR: (4.0, "Factor of the recovered roughness. Below 1 is glossier, above 1 is more matt; 1 is as photographed"),
    STRENGTH: (10.0, "Factor of the recovered relief's slopes. 0 is flat, above 1 is deeper; 1 is as photographed"),
}


def look_node(nodes: OwnNodes, roughness: tuple[str, ...], widths: bool, normal):
    """Make the group node, and connect it to the Normal Map node ``normal``; values that the user has set stay.

    roughness: the sockets of ``ROUGHNESS`` that maps drive; each has an input and an output of its name. widths: the
    maps hold widths of the distribution, α = r², to which the factor is applied twice.
    """
    node = nodes.node("look", "ShaderNodeGroup", _PLACE, "Gloss and Normal")
    group, strength = _group(roughness, widths), normal.inputs["Strength"]
    if node.node_tree != group:
        former = {name: node.inputs[name].default_value for name in _INPUTS if name in node.inputs}
        former = former or {STRENGTH: strength.default_value}  # of a material made before this node existed
        node.node_tree = group
        for name, value in former.items():
            node.inputs[name].default_value = value
    nodes.link(node.outputs[STRENGTH], strength)
    return node


def _group(roughness: tuple[str, ...], widths: bool):
    """Return the node group for these sockets, by its tag or new."""
    key = f"{', '.join(roughness)} {'widths' if widths else 'perceptual'}"
    group, fresh = tagged_group(_TAG, key, "IRPSO Gloss and Normal")
    if not fresh:
        return group
    for name in roughness:
        group.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketFloat")
    for name, (most, text) in _INPUTS.items():
        item = group.interface.new_socket(name, description=text, in_out="INPUT", socket_type="NodeSocketFloat")
        item.min_value, item.max_value, item.default_value = 0.0, most, 1.0
    for name in (*roughness, STRENGTH):
        group.interface.new_socket(name, in_out="OUTPUT", socket_type="NodeSocketFloat")
    with OwnNodes(group) as nodes:
        inputs = nodes.node("input", "NodeGroupInput", (-400, 0)).outputs
        result = nodes.node("output", "NodeGroupOutput", (400, 0)).inputs
        nodes.link(inputs[STRENGTH], result[STRENGTH])
        for row, name in enumerate(roughness):
            value = inputs[name]
            for times in range(2 if widths else 1):
                product = nodes.node(
                    f"{name} {times}", "ShaderNodeMath", (-200 + 200 * times, -200 * row), operation="MULTIPLY",
                    use_clamp=True,
                )  # fmt: skip
                nodes.link(value, product.inputs[0])
                nodes.link(inputs[FACTOR], product.inputs[1])
                value = product.outputs[0]
            nodes.link(value, result[name])
    return group
