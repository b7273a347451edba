"""Nodes that convert a grain's two parameters to Anisotropic, Anisotropic Rotation and Tangent of Principled BSDF."""

from __future__ import annotations

import math

from ...core.errors import InputError
from ...reflectance.model import ReflectanceModel
from .nodes import OwnNodes

_TURNS = 1 / (4 * math.pi)  # from twice the grain's angle in radians to full turns


def grain_parameters(model: ReflectanceModel) -> tuple[str, str] | None:
    """Return the names of the two scalars of a grain, a cos 2θ and a sin 2θ; None for a model without.

    The model's [material] names them, ``anisotropy = [x, y]``. Raises InputError where it names other parameters.
    """
    names = model.material.get("anisotropy")
    if names is None:
        return None
    scalars = [p.name for p in model.parameters if p.components == 1]
    if not isinstance(names, list) or len(names) != 2 or not set(names) <= set(scalars) or names[0] == names[1]:
        raise InputError(f"model {model.name}: [material] anisotropy names two scalar parameters, not {names!r}")
    return names[0], names[1]


def connect_grain(nodes: OwnNodes, model: ReflectanceModel, surface, uv_map: str) -> dict[str, object]:
    """Make the nodes that drive a Principled BSDF ``surface``; return parameter name → socket.

    The two parameters are a cos 2θ and a sin 2θ of a grain of strength a at the angle θ from the tangent of ``uv_map``
    ("": the active one). For a model without them no node is made. Raises InputError as ``grain_parameters`` does.
    """
    names = grain_parameters(model)
    if names is None:
        return {}
    # Principled's own default tangent runs around the object's z axis.
    tangent = nodes.node("tangent", "ShaderNodeTangent", (60, -620), direction_type="UV_MAP", uv_map=uv_map)
    nodes.link(tangent.outputs["Tangent"], surface.inputs["Tangent"])
    pair = nodes.node("grain", "ShaderNodeCombineXYZ", (-340, -460))
    strength = nodes.node("grain strength", "ShaderNodeVectorMath", (-120, -380), operation="LENGTH")
    nodes.link(pair.outputs["Vector"], strength.inputs[0])
    nodes.link(strength.outputs["Value"], surface.inputs["Anisotropic"])
    parts = nodes.node("grain parts", "ShaderNodeSeparateXYZ", (-280, -600))
    nodes.link(pair.outputs["Vector"], parts.inputs["Vector"])
    angle = nodes.node("grain angle", "ShaderNodeMath", (-120, -560), operation="ARCTAN2")
    nodes.link(parts.outputs["Y"], angle.inputs[0])
    nodes.link(parts.outputs["X"], angle.inputs[1])
    turns = nodes.node("grain turns", "ShaderNodeMath", (60, -480), operation="MULTIPLY")
    turns.inputs[1].default_value = _TURNS
    nodes.link(angle.outputs["Value"], turns.inputs[0])
    nodes.link(turns.outputs["Value"], surface.inputs["Anisotropic Rotation"])
    return {names[0]: pair.inputs["X"], names[1]: pair.inputs["Y"]}
