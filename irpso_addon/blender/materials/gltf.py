"""glTF 2.0 by Blender's own exporter: an object as triangles, with pictures that the exporter writes unchanged.

Blender's exporter writes a texture at Specular IOR Level unchanged as the specular factor, which is twice the level.
The textures here hold the factor, and a node halves it. Specular Tint is the specular colour.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import InputError
from ...core.files import replacing_file
from ...core.png import encode_png
from ...core.udim import tile_place
from ...geometry.spaces import unit
from ..colour_spaces import Use, use_space
from ..mesh import check_matrix, mesh_with_normals, new_evaluated_mesh, shading_normals
from ..operators import quiet_operator, removed_afterwards
from .displacement import DIVISION
from .material import TAG

_SETTINGS = {
    "export_format": "GLB", "use_selection": True, "export_tangents": True, "export_apply": False,
    "export_animations": False, "export_extras": False, "export_yup": True, "export_cameras": False,
    "export_lights": False, "export_image_format": "AUTO", "will_save_settings": False,
}  # fmt: skip
_UNEQUAL = 1e-3  # relative
_SHEARED = 1e-5  # beyond the rounding of a matrix
_OUTPUT = "glTF Material Output"


@dataclass(frozen=True)
class Surface:
    """A material as glTF has it. base_color, orm, normal: (H, W, 3) pixels in 0…1, colours sRGB-encoded.

    occluded: red of orm is an occlusion. specular: grey of the specular colour (linear), and the factor, for all; or
    (H, W, 4) pixels with the colour and, in alpha, the factor. ior: index of refraction.
    """

    name: str
    base_color: np.ndarray
    orm: np.ndarray
    normal: np.ndarray
    specular: np.ndarray | tuple[float, float]
    ior: float
    occluded: bool = False


def write_glb(
    path: Path,
    obj: Any,
    name: str,
    surfaces: Mapping[int, Surface],
    slots: Sequence[int] | None = None,
    uv_map: str | None = None,
    wrapped: bool = False,
) -> list[str]:
    """Write an object of the open file as .glb, and return warnings. surfaces: by UDIM tile.

    slots: those that get these surfaces, None for all; others keep their materials. uv_map: of the surfaces, None for
    the active one. wrapped: whether a card's surfaces repeat. Pictures have 8 bits. The open file stays unchanged.
    Raises InputError.
    """
    import bpy

    properties = bpy.ops.export_scene.gltf.get_rna_type().properties if _has_exporter() else None
    if properties is None:
        raise InputError("Blender's glTF exporter is switched off; enable the add-on 'glTF 2.0 format'")
    with _kept_selection(), removed_afterwards() as made, tempfile.TemporaryDirectory(prefix="irpso-") as temporary:
        # A card that does not repeat has nothing past its borders; a mesh's UV map may continue at the opposite border.
        extension = "EXTEND" if TAG in obj and not wrapped else "REPEAT"
        materials = {n: _material(made, one, Path(temporary), extension) for n, one in surfaces.items()}
        with _undivided(obj):
            copy = _triangles(made, obj, name, materials, slots, uv_map)
        for other in bpy.context.view_layer.objects:
            other.select_set(other == copy)
        bpy.context.view_layer.objects.active = copy
        with replacing_file(path) as partial, quiet_operator():
            accepted = {name: value for name, value in _SETTINGS.items() if name in properties}
            try:
                bpy.ops.export_scene.gltf(filepath=str(partial), **accepted)
            except RuntimeError as error:
                raise InputError(f"{path}: Blender's glTF exporter says: {str(error).strip()}") from error
    return _scale_warnings(obj)


def _scale_warnings(obj: Any) -> list[str]:
    scale = np.linalg.svd(np.array(obj.matrix_world)[:3, :3], compute_uv=False)  # that of a shear, too
    if np.ptp(scale) <= _UNEQUAL * scale.max():
        return []
    return [
        f"object '{obj.name}' has an unequal scale, which bends normals otherwise in glTF than in Blender; apply it and"
        " recover again"
    ]


def result_object(name: str | None) -> Any:
    """Return the object of the open file that has a recovered material: the one of this name, or the only one there is.

    Raises InputError where there is none, or several and no name.
    """
    import bpy

    if name is not None:
        obj = bpy.data.objects.get(name)
        if obj is None or obj.type != "MESH":
            meshes = ", ".join(f"'{o.name}'" for o in bpy.data.objects if o.type == "MESH")
            raise InputError(f"--object {name}: the result's .blend has no such mesh; it has {meshes or 'none'}")
        return obj
    found = [o for o in bpy.data.objects if o.type == "MESH" and any(_recovered(slot) for slot in o.material_slots)]
    if len(found) != 1:
        names = ", ".join(f"'{o.name}'" for o in found)
        what = f"{len(found)} objects have recovered materials ({names}); name one with --object"
        raise InputError(
            what if found else "no object of the result's .blend has the recovered material; recover again"
        )
    return found[0]


def recovered_slots(obj: Any) -> tuple[int, ...]:
    """Return the slots of an object that have a recovered material."""
    return tuple(index for index, slot in enumerate(obj.material_slots) if _recovered(slot))


def _recovered(slot: Any) -> bool:
    return slot.material is not None and TAG in slot.material


def _has_exporter() -> bool:
    import bpy

    return hasattr(bpy.types, "EXPORT_SCENE_OT_gltf")


@contextlib.contextmanager
def _kept_selection() -> Iterator[None]:
    """Restore selection and active object afterwards."""
    import bpy

    layer = bpy.context.view_layer
    selected, active = [obj for obj in layer.objects if obj.select_get()], layer.objects.active
    try:
        yield
    finally:
        layer.update()  # else it still lists removed objects
        for obj in layer.objects:
            obj.select_set(obj in selected)
        layer.objects.active = active


@contextlib.contextmanager
def _undivided(obj: Any) -> Iterator[None]:
    """Switch a card's subdivision off meanwhile: it serves displacement, which glTF lacks."""
    modifier = obj.modifiers.get(DIVISION)
    shown = modifier is not None and modifier.show_viewport
    if shown:
        modifier.show_viewport = False
    try:
        yield
    finally:
        if shown:
            modifier.show_viewport = True


def _material(made: list[Any], surface: Surface, folder: Path, extension: str) -> Any:
    """Make the material that the exporter understands. extension: of image nodes, which becomes the wrap mode."""
    import bpy

    material = bpy.data.materials.new(surface.name)
    made.append(material)
    if material.node_tree is None:  # since Blender 5.0 every material has one
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    shader, output = tree.nodes.new("ShaderNodeBsdfPrincipled"), tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader.outputs["BSDF"], output.inputs["Surface"])
    shader.inputs["IOR"].default_value = surface.ior

    def texture(suffix: str, image: np.ndarray, use: Use = "data") -> Any:
        file = folder / f"{surface.name}{suffix}.png"
        encode_png(file, image, bits=8)
        made.append(loaded := bpy.data.images.load(str(file)))
        use_space(loaded, use)
        loaded.alpha_mode = "CHANNEL_PACKED"
        loaded.pack()
        node = tree.nodes.new("ShaderNodeTexImage")
        node.image, node.extension = loaded, extension
        return node.outputs["Color"]

    tree.links.new(texture("_BaseColor", surface.base_color, "srgb"), shader.inputs["Base Color"])
    split = tree.nodes.new("ShaderNodeSeparateColor")
    tree.links.new(texture("_ORM", surface.orm), split.inputs["Color"])
    tree.links.new(split.outputs["Green"], shader.inputs["Roughness"])
    tree.links.new(split.outputs["Blue"], shader.inputs["Metallic"])
    if surface.occluded:
        occlusion = tree.nodes.new("ShaderNodeGroup")
        occlusion.node_tree = _occlusion_group(made)
        tree.links.new(split.outputs["Red"], occlusion.inputs["Occlusion"])
    bend = tree.nodes.new("ShaderNodeNormalMap")
    tree.links.new(texture("_Normal", surface.normal), bend.inputs["Color"])
    tree.links.new(bend.outputs["Normal"], shader.inputs["Normal"])
    level, tint = shader.inputs["Specular IOR Level"], shader.inputs["Specular Tint"]
    if isinstance(surface.specular, tuple):
        grey, factor = surface.specular
        level.default_value, tint.default_value = 0.5 * factor, (grey, grey, grey, 1)
        return material
    half = tree.nodes.new("ShaderNodeMath")
    half.operation = "MULTIPLY"
    half.inputs[1].default_value = 0.5
    # glTF has the factor in alpha; the exporter writes the picture unchanged.
    color = texture("_Specular", surface.specular, "srgb")
    tree.links.new(color, tint)
    tree.links.new(color.node.outputs["Alpha"], half.inputs[0])
    tree.links.new(half.outputs[0], level)
    return material


def _occlusion_group(made: list[Any]) -> Any:
    """Return the node group by whose name and socket Blender's exporter finds occlusion; the user's if it exists."""
    import bpy

    group = bpy.data.node_groups.get(_OUTPUT)
    if group is None or "Occlusion" not in group.interface.items_tree:
        made.append(group := bpy.data.node_groups.new(_OUTPUT, "ShaderNodeTree"))
        group.interface.new_socket("Occlusion", in_out="INPUT", socket_type="NodeSocketFloat")
    return group


def _triangles(
    made: list[Any], obj: Any, name: str, materials: dict[int, Any], chosen: Sequence[int] | None, uv_map: str | None
) -> Any:
    """Return a copy of an object, in triangles, with the materials of its UDIM tiles in chosen slots; others stay.

    The maps' tangents are those of Blender's triangles; for quads the exporter would compute others.
    """
    import bpy

    made.append(source := new_evaluated_mesh(obj))
    layer = source.uv_layers.active if uv_map is None else source.uv_layers.get(uv_map)
    if layer is None:
        missing = "UV map" if uv_map is None else f"UV map '{uv_map}'"
        raise InputError(f"object '{obj.name}' has no {missing}; the maps cannot be shown on it")
    source.calc_loop_triangles()
    count = len(source.loop_triangles)
    loops, vertices = (_read(source.loop_triangles, name, 3 * count, np.int32) for name in ("loops", "vertices"))
    slots = _read(source.loop_triangles, "material_index", count, np.int32)
    uvs = _read(layer.uv, "vector", 2 * len(source.loops)).reshape(-1, 2)[loops]
    normals, _ = shading_normals(source)
    corners = np.reshape(vertices, (-1, 3))
    check_matrix(obj.name, np.array(obj.matrix_world))
    placed, rest = _placed(obj.matrix_world)
    coordinates = _read(source.vertices, "co", 3 * len(source.vertices)).reshape(-1, 3) @ rest.T
    order = [0, 1, 2] if np.linalg.det(rest) > 0 else [2, 1, 0]  # a mirrored triangle keeps its outer side
    normals = unit(normals @ np.linalg.inv(rest)).astype(np.float32)
    mesh = mesh_with_normals(name, coordinates, corners[:, order], normals[:, order])
    made.append(mesh)
    is_recovered = [chosen is None or index in chosen for index in range(len(obj.material_slots))]
    is_recovered = np.array(is_recovered if any(is_recovered) else [True] * max(len(is_recovered), 1))
    recovered = is_recovered[np.minimum(slots, len(is_recovered) - 1)]
    originals = [slot.material for slot in obj.material_slots]
    number, uvs = _tiles(uvs.reshape(-1, 3, 2), sorted(materials), recovered)
    for material in (*(materials[n] for n in sorted(materials)), *originals):
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", np.where(recovered, number, len(materials) + slots).astype(np.int32))
    mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", uvs[:, order].astype(np.float32).ravel())
    mesh.update()
    copy = bpy.data.objects.new(name, mesh)
    made.append(copy)
    copy.matrix_world = placed
    bpy.context.scene.collection.objects.link(copy)
    bpy.context.view_layer.update()
    return copy


def _placed(matrix: Any) -> tuple[Any, np.ndarray]:
    """Return location, rotation and positive scale as a matrix, and (3, 3) what they leave of an object's matrix.

    The rest holds a shear by parents, and the reflection of a mirrored object: glTF's viewers take the bitangent as
    w n × t in the world, which a reflection of the node would turn over.
    """
    from mathutils import Matrix

    mirror = Matrix.Diagonal((-1 if matrix.determinant() < 0 else 1, 1, 1, 1))
    placed = Matrix.LocRotScale(*(matrix @ mirror).decompose())
    rest, plain = np.array(placed.inverted() @ matrix)[:3, :3], np.array(mirror)[:3, :3]
    return placed, rest if np.abs(rest - plain).max() > _SHEARED else plain


def _tiles(uvs: np.ndarray, numbers: list[int], recovered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return each triangle's index into the tiles, and its texture coordinates inside the tile: glTF has no UDIM."""
    index = np.zeros(len(uvs), int)
    moved = uvs.copy()
    for place, number in enumerate(numbers):
        corner = np.array(tile_place(number))
        centre = uvs.mean(axis=1) - corner
        inside = recovered & ((centre >= 0) & (centre <= 1)).all(axis=1)
        index[inside] = place
        moved[inside] = uvs[inside] - corner
    return index, moved


def _read(collection: Any, attribute: str, size: int, kind: type = np.float32) -> np.ndarray:
    values = np.empty(size, kind)
    collection.foreach_get(attribute, values)
    return values
