"""Surfaces of known material: grid meshes, and Principled materials that write their true maps to AOVs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..mesh import mesh_of_faces

PRINCIPLED = "ShaderNodeBsdfPrincipled"
TRUTHS = ("base_color", "roughness", "metallic")  # AOVs that every true material writes


@dataclass(frozen=True)
class TrueMaps:
    """True maps. base_color, normal: (N, N, 3), linear and unit in Blender's tangent frame. roughness: (N, N).

    normal: None for the mesh's own normals. metallic, specular (Specular IOR Level): (N, N), None for
    Blender's defaults, 0 and 0.5. Row 0 is at the bottom, at v = 0.
    """

    base_color: np.ndarray
    normal: np.ndarray | None
    roughness: np.ndarray
    metallic: np.ndarray | None = None
    specular: np.ndarray | None = None


def true_material(truth: TrueMaps, flat: bool = False) -> Any:
    """Return a Blender material with these maps: Principled, GGX.

    flat: for a plane whose texels are the picture's pixels: no interpolation, and no correction of bump maps by
    Cycles, which darkens normals that face away from the plane and so departs from the maps' own model.
    """
    material, nodes = blank_material("truth")
    link, shader = material.node_tree.links.new, node_of(nodes, PRINCIPLED)
    shader.distribution = "GGX"
    material.cycles.use_bump_map_correction = not flat
    named = {name: getattr(truth, name) for name in ("base_color", "roughness", "metallic", "specular")}
    named["normal"] = None if truth.normal is None else truth.normal / 2 + 0.5
    sockets = {
        name: texture_node(nodes, name, values, "Closest" if flat else "Linear").outputs["Color"]
        for name, values in named.items()
        if values is not None
    }
    wire_truths(material, sockets["base_color"], sockets["roughness"], sockets.get("metallic"))
    if "specular" in sockets:
        link(sockets["specular"], shader.inputs["Specular IOR Level"])
    if "normal" in sockets:
        turned = nodes.new("ShaderNodeNormalMap")
        link(sockets["normal"], turned.inputs["Color"])
        link(turned.outputs["Normal"], shader.inputs["Normal"])
    return material


def blank_material(name: str) -> tuple[Any, Any]:
    """Return a new material with a Principled node, and its nodes."""
    import bpy

    material = bpy.data.materials.new(name)
    material.use_nodes = True
    return material, material.node_tree.nodes


def node_of(nodes: Any, kind: str) -> Any:
    """Return the first node of a kind (``bl_idname``). Blender may translate the names of new nodes."""
    return next(node for node in nodes if node.bl_idname == kind)


def wire_truths(material: Any, colour: Any, roughness: Any, metallic: Any = None) -> None:
    """Link sockets to the Principled node and to the AOVs that hold the truth."""
    shader = node_of(material.node_tree.nodes, PRINCIPLED)
    sockets = zip(TRUTHS, ("Base Color", "Roughness", "Metallic"), (colour, roughness, metallic), strict=True)
    for truth, name, socket in sockets:
        if socket is None:
            continue
        material.node_tree.links.new(socket, shader.inputs[name])
        write_aov(material, truth, socket)


def write_aov(material: Any, name: str, socket: Any) -> None:
    """Let a material write a socket to the AOV ``name``."""
    output = material.node_tree.nodes.new("ShaderNodeOutputAOV")
    output.aov_name = name
    material.node_tree.links.new(socket, output.inputs["Color" if name == "base_color" else "Value"])


def texture_node(nodes: Any, name: str, values: np.ndarray, interpolation: str = "Linear") -> Any:
    """Return a texture node of linear values (H, W) or (H, W, 3), row 0 at the bottom."""
    import bpy

    height, width = values.shape[:2]
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = values if values.ndim == 3 else values[..., None]
    image = bpy.data.images.new(name, width, height, alpha=True, float_buffer=True, is_data=True)
    image.pixels.foreach_set(rgba.ravel())
    image.update()
    node = nodes.new("ShaderNodeTexImage")
    node.image, node.interpolation = image, interpolation
    return node


def grid_quads(rows: int, columns: int) -> np.ndarray:
    """Return ((rows − 1)·(columns − 1), 4) vertex numbers of a grid's quads; vertices count row by row."""
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    return corner[:, None] + np.array([0, 1, columns + 1, columns])


def smooth_mesh(scene: Any, name: str, vertices: np.ndarray, quads: np.ndarray, uv: np.ndarray) -> Any:
    """Return a new smooth object in ``scene`` of vertices (N, 3), quads (M, 4), texture coordinates (N, 2)."""
    import bpy

    mesh = mesh_of_faces(name, vertices, quads)
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", uv[quads.ravel()].astype(np.float32).ravel())
    mesh.shade_smooth()
    made = bpy.data.objects.new(name, mesh)
    scene.collection.objects.link(made)
    return made
