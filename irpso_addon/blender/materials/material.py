"""The recovered maps as a Blender material."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import InputError
from ...geometry.relief.height import Height
from ...reflectance.model import ReflectanceModel
from ...results.map_tables import MapTable, map_tables
from ...results.maps import Maps
from ..objects import in_a_scene
from . import two_lobe_nodes as two_lobe
from .anisotropy_nodes import connect_grain
from .displacement import METHOD, displacement, divide
from .look import ROUGHNESS, look_node
from .nodes import OwnNodes, set_input
from .textures import check_images, check_saved, map_images, material_images, own_blocks, own_images, written_pictures

TAG = "irpso_subject"
ORIGIN = "irpso_origin"  # source of a material
STAMP = "irpso_kept"  # the recovery and state that a material holds
_TRIAL = "trial, removed at once"

# Principled without a specular layer is Lambert; its roughness has no effect then.
_MATTE = {"Roughness": 1.0, "Specular IOR Level": 0.0}
_CHANNELS = ("Red", "Green", "Blue")


def build_material(
    maps: Maps,
    subject: str,
    images_folder: str | Path | None = None,
    uv_map: str = "",
    height: Height | None = None,
    obj: Any = None,
) -> Any:
    """Return the bpy material of a subject, created or updated, with its maps as images.

    images_folder: of the image files; one that begins with // lies beside the open file, and so do the images' paths.
    None packs them. uv_map: the mesh's UV map; "" is the active one. height: displaces a fine enough mesh.
    obj: the subject's object. Of several materials of the subject the one that it shows is updated, else the one with
    the original name; the others are the user's copies and stay, with their images.
    The model's [material] chooses the ``shader``: "two_lobe", or "principled": image nodes drive the sockets of a
    Principled BSDF that the parameters name. Nodes of the user stay unchanged.
    Raises InputError where the material or an image is linked from a library, an image has unsaved changes, or the
    folder cannot be written; then a former material stays as it is.
    """
    import bpy

    tables = map_tables(maps.model)
    shown = [] if obj is None else [slot.material for slot in obj.material_slots]
    materials = own_blocks("material", TAG, subject)
    former = min(materials, key=lambda one: (one not in shown, _renamed(one, subject)), default=None)
    material = former or new_material(f"IRPSO {subject}")
    material[TAG] = subject
    build = _two_lobe if maps.model.material.get("shader") == "two_lobe" else _principled
    folder = None if images_folder is None else Path(bpy.path.abspath(str(images_folder))).absolute()
    try:
        check_images(maps.model, subject)
        known = own_images(subject, material, [one for one in materials if one != material])
        check_saved(known.values())
        # All files first: where one cannot be written, the former material and its images stay as they are.
        heights = None if height is None else height.values
        with written_pictures(maps, subject, folder, heights) as pictures, OwnNodes(material.node_tree) as nodes:
            surface, sockets = build(nodes, maps.model, uv_map)
            images = material_images(pictures, subject, folder is None, known)
            sources = _map_nodes(nodes, tables, images, uv_map, maps.wrapped)
            _connect(nodes, maps.model, sources, sockets)
            output = nodes.node("output", "ShaderNodeOutputMaterial", (620, 0))
            nodes.link(surface, output.inputs["Surface"])
            if height is not None:
                relief = displacement(nodes, height, images["height"], uv_map)
                nodes.link(relief, output.inputs["Displacement"])
                material.displacement_method = METHOD
            if str(images_folder).startswith("//"):
                for image in map_images(subject):
                    if Path(image.filepath).parent == folder:
                        image.filepath = bpy.path.relpath(image.filepath)
    except BaseException:
        if former is None:
            bpy.data.materials.remove(material)
        raise
    return material


def _renamed(block: Any, subject: str) -> tuple[bool, int]:
    """Return the least value for a material or card that has the name it was made with. Blender cuts long names."""
    return not f"IRPSO {subject}".startswith(block.name), -len(block.name)


def subject_name(name: str, origin: str, obj=None) -> str:
    """Return a subject name for a recovery from ``origin``: ``name``, numbered where another recovery uses it.

    Two captures may lie in folders of one name, and a mesh may have that name too: none may take another's maps. obj:
    the mesh object. A name is also taken where only other objects show its material: one may have been renamed.
    """
    import bpy

    def is_free(name: str) -> bool:
        made = [material for material in bpy.data.materials if material.get(TAG) == name]
        users = [one for one in bpy.data.objects if any(slot.material in made for slot in one.material_slots)]
        return all(material.get(ORIGIN, origin) == origin for material in made) and (
            obj is None or not users or obj in users
        )

    numbered = (name if number == 0 else f"{name}.{number:03d}" for number in itertools.count())
    return next(free for free in numbered if is_free(free))


def slots_subject(obj, slots: Sequence[int]) -> str:
    """Return the subject name for some slots of an object: the object's name and those of their materials.

    A material that IRPSO made under such a name gives its original name.
    """
    names = []
    for slot in slots:
        material = obj.material_slots[slot].material
        tag = "" if material is None else material.get(TAG, "")
        if tag.startswith(f"{obj.name} "):
            names.append(tag.removeprefix(f"{obj.name} "))
        else:
            names.append(f"slot {slot}" if material is None or tag else material.name)
    return f"{obj.name} {', '.join(dict.fromkeys(names))}"


def check_material(model: ReflectanceModel, subject: str) -> None:
    """Raise InputError where ``build_material`` would; the open file stays unchanged."""
    import bpy

    own_blocks("material", TAG, subject)
    check_images(model, subject)
    groups = set(bpy.data.node_groups)
    texel = {p.name: np.float32(p.default).reshape(1, 1, -1) for p in model.parameters}
    made = build_material(Maps(model, texel, np.ones((1, 1), bool)), _TRIAL)
    bpy.data.materials.remove(made)
    for image in map_images(_TRIAL):
        bpy.data.images.remove(image)
    for group in set(bpy.data.node_groups) - groups:
        bpy.data.node_groups.remove(group)


def check_object(obj) -> None:
    """Raise InputError where the object is linked from a library, or cannot have materials.

    A local object with linked data needs slots: it then holds its own materials in them.
    """
    if obj.library is not None:
        raise InputError(
            f"object '{obj.name}' is linked from {obj.library.filepath}; make it local before giving it a material"
        )
    if not hasattr(obj.data, "materials"):
        raise InputError(f"object '{obj.name}' is a {obj.type.lower()}, which has no material; choose a mesh")
    if obj.data.library is not None and not obj.material_slots:
        raise InputError(
            f"the mesh of object '{obj.name}' is linked from {obj.data.library.filepath} and has no material slot; add"
            " one in that file, or make the mesh local"
        )


def other_uv_map(obj, name: str) -> str:
    """Return the name of the maps' UV map, "" where image nodes use it by default.

    Image nodes use the UV map with the camera mark; maps are made in the highlighted one.
    """
    marked = next((layer.name for layer in obj.data.uv_layers if layer.active_render), "")
    return "" if name == marked else name


def apply_material(obj, material, slots: Sequence[int] = ()) -> None:
    """Put the material into slots of an object; faces keep their slots, other slots their materials.

    Without ``slots``: into the active slot, unless a slot has it; an object without slots gets one.
    Raises InputError like ``check_object``.
    """
    check_object(obj)
    if slots and obj.material_slots:
        if (last := max(slots)) >= len(obj.material_slots):
            raise InputError(f"object '{obj.name}' has no material slot {last} any more; add its slots again")
        for slot in slots:
            _fill_slot(obj, slot, material)
        return
    if material.name in obj.material_slots and obj.material_slots[material.name].material == material:
        return
    if obj.material_slots:
        _fill_slot(obj, obj.active_material_index, material)
    else:
        obj.data.materials.append(material)


def _fill_slot(obj, index: int, material) -> None:
    slot = obj.material_slots[index]
    former = None if slot.material is None else slot.material.get(TAG)
    # The object holds the material if data are linked, or if a linked duplicate would lose its recovered one.
    if obj.data.library is not None or (obj.data.users > 1 and former not in (None, material.get(TAG))):
        slot.link = "OBJECT"
    slot.material = material


def find_card(subject: str):
    """Return the object that ``card_object`` made for this subject, or None. Duplicates have another name."""
    import bpy

    found = [obj for obj in bpy.data.objects if obj.get(TAG) == subject and obj.library is None]
    return min(found, key=lambda obj: _renamed(obj, subject), default=None)


def subject_object(uid: int | None, subject: str):
    """Return the mesh object of a session number, or the card of a subject for None; None where no scene has it."""
    import bpy

    if uid is None:
        return find_card(subject)
    return next((obj for obj in bpy.data.objects if obj.session_uid == uid and in_a_scene(obj)), None)


def card_object(subject: str, height: int, width: int, displaced: bool | None = False):
    """Return a flat mesh object for maps of a card, 1 unit wide, facing +Z, its UV square the image.

    A tag identifies it later. It takes the maps' proportions unless the user has edited its mesh; a new one is linked
    into the scene's collection. displaced: subdivide it to show a relief; None keeps the former subdivision.
    """
    import bpy

    x, y = 0.5, 0.5 * height / width
    if (found := find_card(subject)) is not None:
        _give_height(found.data, x, y)
        if displaced is not None:
            divide(found, max(height, width) if displaced else 0)
        return found
    mesh = bpy.data.meshes.new(f"IRPSO {subject}")
    mesh.from_pydata([(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)], [], [(0, 1, 2, 3)])
    layer = mesh.uv_layers.new(name="UVMap")
    layer.data.foreach_set("uv", (0, 0, 1, 0, 1, 1, 0, 1))
    obj = bpy.data.objects.new(f"IRPSO {subject}", mesh)
    obj[TAG] = subject
    bpy.context.scene.collection.objects.link(obj)
    divide(obj, max(height, width) if displaced else 0)
    return obj


def _give_height(mesh, x: float, y: float) -> None:
    """Put the corners of a card's mesh at ±y, unless the user has edited them."""
    import bmesh

    edited = bmesh.from_edit_mesh(mesh) if mesh.is_editmode else None  # which replaces the mesh when Edit Mode ends
    corners = [vertex.co for vertex in (mesh.vertices if edited is None else edited.verts)]
    made = len(corners) == 4 and all(abs(c.x) == x and c.z == 0 and abs(c.y) == abs(corners[0].y) for c in corners)
    if made and abs(corners[0].y) != np.float32(y):
        for corner in corners:
            corner.y = math.copysign(y, corner.y)
        if edited is None:
            mesh.update()
        else:
            bmesh.update_edit_mesh(mesh)


def new_material(name: str):
    """Return a new material without nodes, which shades like the recovery."""
    import bpy

    material = bpy.data.materials.new(name)
    if material.node_tree is None:  # since Blender 5.0 every material has one
        material.use_nodes = True
    material.node_tree.nodes.clear()
    # Cycles darkens surfaces by the angle between shading and geometric normal (1 % where the light is at 50°, more
    # beyond). The recovery has no such term, so the material must not have it.
    if hasattr(material, "cycles"):  # the Cycles add-on can be switched off
        material.cycles.use_bump_map_correction = False
    return material


def _map_nodes(nodes: OwnNodes, tables: list[MapTable], images: dict, uv_map: str, wrapped: bool) -> dict[str, object]:
    """Make the image nodes; return parameter name → the socket with its value (or the shading normal)."""
    sources = {}
    # With repetition the outer half of a card's border texels would mix with the opposite border.
    extension = "REPEAT" if wrapped else "EXTEND"
    uv = nodes.node("uv", "ShaderNodeUVMap", (-1080, 0), uv_map=uv_map) if uv_map else None
    for row, table in enumerate(tables):
        y = 300 - 320 * row
        # Blender's names of the sockets that the map drives; a parameter without a socket keeps its own name.
        label = ", ".join(p.socket or p.name.replace("_", " ").title() for p in table.parameters)
        texture = nodes.node(
            f"map {table.name}", "ShaderNodeTexImage", (-860, y), label, image=images[table.name], extension=extension
        )  # fmt: skip
        if uv is not None:
            nodes.link(uv.outputs["UV"], texture.inputs["Vector"])
        color = texture.outputs["Color"]
        if table.is_normal:
            bump = nodes.node(f"normal {table.name}", "ShaderNodeNormalMap", (60, 140), space="TANGENT", uv_map=uv_map)
            nodes.link(color, bump.inputs["Color"])
            sources[table.parameters[0].name] = bump.outputs["Normal"]
        elif len(table.parameters) == 1:
            sources[table.parameters[0].name] = color
        else:
            sources |= _separated(nodes, table, texture, y)
    return sources


def _separated(nodes: OwnNodes, table: MapTable, texture, y: float) -> dict[str, object]:
    """Split a map that parameters share; join the channels of a parameter of several components."""
    split = nodes.node(f"split {table.name}", "ShaderNodeSeparateColor", (-540, y), mode="RGB")
    nodes.link(texture.outputs["Color"], split.inputs["Color"])
    channels = [*(split.outputs[name] for name in _CHANNELS), texture.outputs["Alpha"]]
    sources, at = {}, 0
    for parameter in table.parameters:
        own = channels[at : at + parameter.components]
        at += parameter.components
        sources[parameter.name] = own[0]
        if len(own) > 1:
            join = nodes.node(f"join {parameter.name}", "ShaderNodeCombineColor", (-360, y - 40 * at), mode="RGB")
            for channel, name in zip(own, _CHANNELS, strict=False):
                nodes.link(channel, join.inputs[name])
            sources[parameter.name] = join.outputs["Color"]
    return sources


def _connect(nodes: OwnNodes, model: ReflectanceModel, sources: dict, sockets: list[tuple[str, object]]) -> None:
    """Connect the maps to the surface's sockets, roughness and relief by way of the node with their factors."""
    roughness = tuple(socket.name for _, socket in sockets if socket.name in ROUGHNESS)
    normal = sources[model.normal].node
    look = look_node(nodes, roughness, two_lobe.has_widths(model), normal)
    for name, socket in sockets:
        source = sources[name]
        if socket.name in roughness:
            nodes.link(source, look.inputs[socket.name])
            source = look.outputs[socket.name]
        nodes.link(source, socket)


def _two_lobe(nodes: OwnNodes, model: ReflectanceModel, uv_map: str) -> tuple[object, list[tuple[str, object]]]:
    output, sockets = two_lobe.surface(nodes, model)  # isotropic: it needs no tangent of the UV map
    return output, list(sockets.items())


def _principled(nodes: OwnNodes, model: ReflectanceModel, uv_map: str) -> tuple[object, list[tuple[str, object]]]:
    """Make the Principled BSDF; return its output and pairs of parameter name and driven socket."""
    table = model.material.get("settings", {})
    if not isinstance(table, dict):
        raise InputError(f"model {model.name}: settings is a table, written [material.settings], not {table!r}")
    table = dict(table)
    distribution = table.pop("distribution", "GGX")
    if distribution not in ("GGX", "MULTI_GGX"):
        raise InputError(f"model {model.name}: [material.settings] distribution must be GGX or MULTI_GGX")
    node = nodes.node("surface", "ShaderNodeBsdfPrincipled", (280, 0), distribution=distribution)
    driven = {parameter.socket for parameter in model.parameters}
    if model.material.get("shader") == "principled" and not table and "Roughness" not in driven:
        table = _MATTE
    for name, value in table.items():
        if name not in node.inputs:
            raise InputError(f"model {model.name}: [material.settings] names '{name}', no socket of Principled BSDF")
        try:
            set_input(node, name, value)
        except (TypeError, ValueError) as error:
            raise InputError(f"model {model.name}: [material.settings] '{name}' cannot be {value!r}") from error
    missing = [p for p in model.parameters if p.socket and p.socket not in node.inputs]
    if missing and model.material.get("shader") == "principled":
        raise InputError(
            f"model {model.name}: parameter {missing[0].name} names the socket '{missing[0].socket}', which Principled"
            " BSDF does not have"
        )
    sockets = [(p.name, node.inputs[p.socket]) for p in model.parameters if p.socket and p.socket in node.inputs]
    if "Coat Weight" in driven:  # left alone, a coat has the normal of the mesh
        sockets += [(p.name, node.inputs["Coat Normal"]) for p in model.parameters if p.is_normal]
    return node.outputs["BSDF"], sockets + list(connect_grain(nodes, model, node, uv_map).items())
