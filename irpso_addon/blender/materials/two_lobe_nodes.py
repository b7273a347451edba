"""The two-lobe Cook–Torrance material as a node group: diffuse plus two glossy lobes under one Fresnel."""

from __future__ import annotations

from dataclasses import dataclass

from ...core.errors import InputError
from ...reflectance.model import ReflectanceModel
from .nodes import OwnNodes, set_input, tagged_group

TAG = "irpso_group"
_ROLES = {"Base Color": "base_color", "Roughness 1": "r1", "Roughness 2": "r2", "Weight": "w", "Normal": "normal"}
_KINDS = {"Base Color": "NodeSocketColor", "Normal": "NodeSocketVector"}
_F0 = 0.028  # the paper's: skin, IOR 1.402


@dataclass(frozen=True)
class Settings:
    """[material] settings of the two lobes. f0: reflectance at normal incidence, 0…1."""

    distribution: str
    f0: float
    fresnel: str
    roughness: str


def has_metallic() -> bool:
    """Whether Blender has the Metallic BSDF (since 4.3), with Fresnel at the half vector."""
    import bpy

    return hasattr(bpy.types, "ShaderNodeBsdfMetallic")


def has_exact_conductor() -> bool:
    """Whether the Metallic BSDF without extinction is a dielectric (since 5.0).

    Before, its Fresnel is an approximation for metals: at 60° on skin, 77 % too bright.
    """
    import bpy

    return bpy.app.version >= (5, 0, 0)


def surface(nodes: OwnNodes, model: ReflectanceModel) -> tuple[object, dict[str, object]]:
    """Make the group node; return its output and parameter name → driven socket.

    [material] may hold ``distribution`` ("BECKMANN" or "GGX"), ``f0``, ``fresnel`` ("schlick" or "dielectric"), and
    ``roughness``: "alpha" where r1 and r2 are the distribution's own width (m), "perceptual" where they are its square
    root. A parameter drives the socket it names (Base Color, Roughness 1, Roughness 2, Weight, Normal), or by its own
    name (base_color, r1, r2, w, normal).
    """
    settings = settings_of(model)
    node = nodes.node("surface", "ShaderNodeGroup", (280, 0), "Two lobes", width=220)
    node.node_tree = _group(settings)
    sockets = {}
    for socket, name in _ROLES.items():
        driving = [p.name for p in model.parameters if p.socket == socket or (not p.socket and p.name == name)]
        if not driving:
            raise InputError(f'model {model.name}: shader two_lobe needs a parameter with socket = "{socket}"')
        sockets[driving[0]] = node.inputs[socket]
    return node.outputs["BSDF"], sockets


def has_widths(model: ReflectanceModel) -> bool:
    """Return whether a model's two roughnesses are the distribution's own widths, the squares of perceptual ones."""
    return model.material.get("shader") == "two_lobe" and settings_of(model).roughness == "alpha"


def is_of_widths(node) -> bool:
    """Return whether a node is the two lobes' group, for roughnesses as in ``has_widths``."""
    return node.bl_idname == "ShaderNodeGroup" and str(node.node_tree.get(TAG, "")).endswith(" alpha")


def settings_of(model: ReflectanceModel) -> Settings:
    """Return the settings of a model with the shader "two_lobe". Raises InputError for a value that is not allowed."""
    table = model.material
    distribution = table.get("distribution", "BECKMANN")
    width = "alpha" if distribution == "BECKMANN" else "perceptual"
    f0 = table.get("f0", _F0)
    if not isinstance(f0, int | float) or not 0 <= f0 < 1:
        raise InputError(f"model {model.name}: [material] f0 must be a number from 0 to below 1, not {f0!r}")
    settings = Settings(distribution, float(f0), table.get("fresnel", "schlick"), table.get("roughness", width))
    allowed = {
        "distribution": ("BECKMANN", "GGX"),
        "fresnel": ("schlick", "dielectric"),
        "roughness": ("alpha", "perceptual"),
    }
    for name, words in allowed.items():
        if getattr(settings, name) not in words:
            raise InputError(f"model {model.name}: [material] {name} must be one of {', '.join(words)}")
    return settings


def _group(settings: Settings):
    """Return the node group of these settings, by its tag or new."""
    key = f"two_lobe {_kind(settings)} {settings.distribution} {settings.f0:g} {settings.fresnel} {settings.roughness}"
    group, fresh = tagged_group(TAG, key, "IRPSO Two Lobes")
    if not fresh:
        return group
    for socket in _ROLES:
        item = group.interface.new_socket(socket, in_out="INPUT", socket_type=_KINDS.get(socket, "NodeSocketFloat"))
        if socket == "Normal":
            item.hide_value = True
        elif socket != "Base Color":
            item.min_value, item.max_value, item.default_value = 0.0, 1.0, 0.5
    group.interface.new_socket("BSDF", in_out="OUTPUT", socket_type="NodeSocketShader")
    with OwnNodes(group) as nodes:
        _fill(nodes, settings)
    return group


def _kind(settings: Settings) -> str:
    """Return the lobes' nodes: a Metallic BSDF (the name of its Fresnel), Principled BSDFs, or Glossy BSDFs."""
    if has_metallic() and settings.fresnel == "schlick":
        return "F82"
    if has_metallic() and has_exact_conductor():
        return "PHYSICAL_CONDUCTOR"
    if settings.distribution == "GGX":
        return "principled"
    # For a dielectric the nearest is Schlick's Fresnel, 19 % too dark at 60° on skin.
    return "F82" if has_metallic() else "glossy"


def _fill(nodes: OwnNodes, settings: Settings) -> None:
    """Make the group's nodes: Diffuse + mix(lobe 1, lobe 2, 1 − w)."""
    inputs = nodes.node("input", "NodeGroupInput", (-720, 0)).outputs
    diffuse = nodes.node("diffuse", "ShaderNodeBsdfDiffuse", (-120, 260))
    nodes.link(inputs["Base Color"], diffuse.inputs["Color"])
    nodes.link(inputs["Normal"], diffuse.inputs["Normal"])
    mix = nodes.node("mix", "ShaderNodeMixShader", (140, 0))
    nodes.link(inputs["Weight"], mix.inputs[0])
    # Mix Shader shows its second shader where the weight is 1, and w is the weight of the first lobe.
    for lobe, target in ((2, mix.inputs[1]), (1, mix.inputs[2])):
        roughness = inputs[f"Roughness {lobe}"]
        if settings.roughness == "alpha":
            root = nodes.node(f"root {lobe}", "ShaderNodeMath", (-440, 40 - 220 * lobe), operation="SQRT")
            nodes.link(roughness, root.inputs[0])
            roughness = root.outputs[0]
        glossy = _lobe(nodes, lobe, settings, inputs)
        nodes.link(roughness, glossy.inputs["Roughness"])
        nodes.link(inputs["Normal"], glossy.inputs["Normal"])
        nodes.link(glossy.outputs["BSDF"], target)
    add = nodes.node("add", "ShaderNodeAddShader", (340, 160))
    nodes.link(diffuse.outputs["BSDF"], add.inputs[0])
    nodes.link(mix.outputs["Shader"], add.inputs[1])
    nodes.link(add.outputs["Shader"], nodes.node("output", "NodeGroupOutput", (540, 160)).inputs["BSDF"])


def _lobe(nodes: OwnNodes, lobe: int, settings: Settings, group_inputs):
    """Return one glossy lobe whose colour is the Fresnel reflectance.

    Measured against Cook and Torrance in Cycles 5.0: the Metallic BSDF has the Fresnel term within 0.03 % at every
    angle. Glossy times the Fresnel node, which uses n·v instead of v·h, is up to 4.2 times too bright at 75°; it is the
    only choice for Beckmann without the Metallic BSDF.
    """
    place = (-120, 20 - 220 * lobe)
    ior = (1 + settings.f0**0.5) / (1 - settings.f0**0.5)
    kind = _kind(settings)
    if kind in ("F82", "PHYSICAL_CONDUCTOR"):
        metal = nodes.node(
            f"lobe {lobe}", "ShaderNodeBsdfMetallic", place, distribution=settings.distribution, fresnel_type=kind
        )
        # With a white edge tint the F82 model is Schlick's; a conductor without extinction is a dielectric.
        set_input(metal, "Base Color", settings.f0)
        set_input(metal, "Edge Tint", 1.0)
        set_input(metal, "IOR", (ior,) * 3)
        set_input(metal, "Extinction", (0.0,) * 3)
        return metal
    if kind == "principled":
        return _principled_lobe(nodes, lobe, settings, ior, place)
    fresnel = nodes.node("fresnel", "ShaderNodeFresnel", (-440, 260))
    fresnel.inputs["IOR"].default_value = ior
    nodes.link(group_inputs["Normal"], fresnel.inputs["Normal"])
    glossy = nodes.node(f"lobe {lobe}", "ShaderNodeBsdfAnisotropic", place, distribution=settings.distribution)
    nodes.link(fresnel.outputs["Fac"], glossy.inputs["Color"])
    return glossy


def _principled_lobe(nodes: OwnNodes, lobe: int, settings: Settings, ior: float, place: tuple[float, float]):
    """Return one GGX lobe from a Principled BSDF, which has Fresnel at the half vector since 4.2."""
    node = nodes.node(f"lobe {lobe}", "ShaderNodeBsdfPrincipled", place, distribution="GGX")
    schlick = settings.fresnel == "schlick"
    # A metal has Schlick's Fresnel between base colour and tint; a black dielectric has the exact Fresnel term.
    set_input(node, "Metallic", 1.0 if schlick else 0.0)
    set_input(node, "Base Color", settings.f0 if schlick else 0.0)
    set_input(node, "Specular Tint", 1.0)
    set_input(node, "IOR", ior)
    return node
