"""The recovered relief as displacement of a material.

Measured in Cycles 4.2 to 5.2 on a card of 128 × 128 faces: the method "Displacement and Bump" gives the relief's shape
within a few thousandths of its height and does not count the connected normal map twice. "Displacement Only" does, by
20°, up to 4.5.
"""

from __future__ import annotations

import math
from typing import Any

from ...geometry.relief.height import Height
from .nodes import OwnNodes

METHOD = "BOTH"
DIVISION = "IRPSO Relief"  # the modifier of a card
_FINEST, _SHOWN = 8, 6  # most halvings of a card's side: in renders, in the viewport
_PLACES = {"uv": (-1080, -1300), "map height": (-860, -1300), "displacement": (280, -620)}


def displacement(nodes: OwnNodes, height: Height, image: Any, uv_map: str) -> Any:
    """Make the nodes of a relief's image; return the Displacement node's output. A card is 1 unit wide at any size."""
    # With repetition the border of a card would take half of its height from the opposite side.
    texture = nodes.node(
        "map height", "ShaderNodeTexImage", _PLACES["map height"], "Height", image=image, extension="EXTEND"
    )
    if uv_map:
        uv = nodes.node("uv", "ShaderNodeUVMap", _PLACES["uv"], uv_map=uv_map)
        nodes.link(uv.outputs["UV"], texture.inputs["Vector"])
    # In world space an object's unequal scale does not bend the relief. A card's relief scales with the card.
    space = "OBJECT" if height.unit == "texels" else "WORLD"
    node = nodes.node("displacement", "ShaderNodeDisplacement", _PLACES["displacement"], space=space)
    node.inputs["Midlevel"].default_value = 0.0
    node.inputs["Scale"].default_value = 1 / height.values.shape[1] if height.unit == "texels" else 1.0
    nodes.link(texture.outputs["Color"], node.inputs["Height"])
    return node.outputs["Displacement"]


def divide(card, texels: int) -> None:
    """Subdivide a one-face card to about ``texels`` faces along its longer side; 0 removes the subdivision."""
    modifier = card.modifiers.get(DIVISION)
    if not texels:
        if modifier is not None:
            card.modifiers.remove(modifier)
        return
    modifier = modifier or card.modifiers.new(DIVISION, "SUBSURF")
    modifier.subdivision_type = "SIMPLE"
    modifier.render_levels = min(math.ceil(math.log2(max(texels, 2))), _FINEST)
    modifier.levels = min(modifier.render_levels, _SHOWN)
    card.data.polygons.foreach_set("use_smooth", [True] * len(card.data.polygons))
