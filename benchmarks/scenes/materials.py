"""Materials of the subjects: Blender's Principled BSDF, with outputs for the true maps."""

from __future__ import annotations

from dataclasses import dataclass, field

from irpso_addon.blender.scenes.true_surface import blank_material, wire_truths


@dataclass(frozen=True)
class Finish:
    """The material of a subject.

    colours: two linear colours that noise mixes. roughness: likewise two values. scale: frequency of the noise.
    attributes: colour, roughness and metallic are those of the mesh (subjects.set_surface), dimmed by the noise.
    extra: further sockets of the node by name (coat, sheen, subsurface). plain: the four maps are the whole material,
    so that roughness can be compared.
    """

    colours: tuple[tuple[float, float, float], tuple[float, float, float]]
    roughness: tuple[float, float]
    metallic: float = 0.0
    specular: float = 0.5
    scale: float = 4.0
    attributes: bool = False
    extra: dict[str, float | tuple] = field(default_factory=dict)
    plain: bool = True


def build(finish: Finish):
    """Return a new Blender material of this finish."""
    material, nodes = blank_material("subject")
    shader = nodes["Principled BSDF"]
    shader.distribution = "GGX"
    shader.inputs["Specular IOR Level"].default_value = finish.specular
    for name, value in finish.extra.items():
        shader.inputs[name].default_value = value
    place = nodes.new("ShaderNodeTexCoord").outputs["Object"]
    blotch = _noise(material, place, finish.scale)
    if finish.attributes:
        low = _attribute(nodes, "tint").outputs["Color"]
        dim = _mix(material, "RGBA", blotch, (0.5, 0.5, 0.5, 1), (1, 1, 1, 1))
        colour = _product(material, low, dim)
        roughness = _attribute(nodes, "rough").outputs["Fac"]
        metallic = _attribute(nodes, "metal").outputs["Fac"]
    else:
        colour = _mix(material, "RGBA", blotch, *((*c, 1) for c in finish.colours))
        roughness = _mix(material, "FLOAT", _noise(material, place, 0.7 * finish.scale, 3.0), *finish.roughness)
        value = nodes.new("ShaderNodeValue")
        value.outputs[0].default_value = finish.metallic
        metallic = value.outputs[0]
    wire_truths(material, colour, roughness, metallic)
    return material


def _noise(material, place, scale: float, seed: float = 0.0):
    nodes = material.node_tree.nodes
    texture, steep = nodes.new("ShaderNodeTexNoise"), nodes.new("ShaderNodeMapRange")
    texture.noise_dimensions = "4D"
    texture.inputs["W"].default_value = seed
    texture.inputs["Scale"].default_value = scale
    steep.inputs["From Min"].default_value, steep.inputs["From Max"].default_value = 0.4, 0.6
    material.node_tree.links.new(place, texture.inputs["Vector"])
    material.node_tree.links.new(texture.outputs[0], steep.inputs["Value"])
    return steep.outputs["Result"]


def _mix(material, kind: str, factor, a, b):
    node = material.node_tree.nodes.new("ShaderNodeMix")
    node.data_type = kind
    sockets = [s for s in node.inputs if s.enabled]
    material.node_tree.links.new(factor, sockets[0])
    sockets[-2].default_value, sockets[-1].default_value = a, b
    return next(s for s in node.outputs if s.enabled)


def _product(material, a, b):
    node = material.node_tree.nodes.new("ShaderNodeMix")
    node.data_type, node.blend_type = "RGBA", "MULTIPLY"
    sockets = [s for s in node.inputs if s.enabled]
    sockets[0].default_value = 1.0
    material.node_tree.links.new(a, sockets[-2])
    material.node_tree.links.new(b, sockets[-1])
    return next(s for s in node.outputs if s.enabled)


def _attribute(nodes, name: str):
    node = nodes.new("ShaderNodeAttribute")
    node.attribute_name = name
    return node
