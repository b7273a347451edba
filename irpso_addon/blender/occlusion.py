"""Ambient occlusion of a mesh: the share of an even sky that each texel sees, baked by Cycles.

Cycles takes the recovered normals: rays spread by the cosine to them, and those below the face count as hidden. On a
hollow half sphere of 9120 triangles it traces 0.7 million rays a second on each core, mathutils' BVHTree 0.3 on one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..core.encode import FLAT_NORMAL, MARGIN_TEXELS, encode_normal, fill_margin
from ..core.errors import InputError
from ..geometry.spaces import unit
from ..geometry.surface.mesh import MeshData
from ..results.maps import Maps
from .materials.material import new_material
from .mesh import mesh_of_faces
from .operators import cycles_operator, removed_afterwards

RAYS = 128
_NAME = "IRPSO occlusion"
_BEHIND = 1e-4  # of the extent of mesh and occluders: distance of a copy of the mesh behind it
_REACH = 10.0  # length of rays, of the same extent: nothing lies farther away than 1
_MIN_COVERED = 0.98  # share of the maps' texels that the mesh must cover; edges differ by rounding


def mesh_open_sky(mesh: MeshData, maps: Maps, rays: int = RAYS) -> np.ndarray:
    """Return (H, W) float32 in 0…1: the share of the light of an even sky that reaches each texel, weighted by cosine.

    maps: of the mesh, normals as in Blender's normal maps. The mesh and its occluders hide the sky, at any distance and
    from both sides. Texels past an island's border have the values across its seam. rays: of a texel. The open file
    stays as it is. Raises InputError where maps and mesh do not belong together.
    """
    if mesh.tiles != maps.tiles:
        raise _other_mesh(mesh)
    baked, share = _baked(mesh, _normals(maps), maps.solved.shape, rays)
    written = share > 0
    if (written & maps.solved).sum() < _MIN_COVERED * maps.solved.sum():
        raise _other_mesh(mesh)
    sky = np.divide(baked, share, out=baked, where=written)
    return np.clip(fill_margin(sky[..., None], written)[..., 0], 0, 1)


def _other_mesh(mesh: MeshData) -> InputError:
    return InputError(
        f"UV map '{mesh.uv_map}' of '{mesh.name}' does not cover the texels of the maps; name the object that they were"
        " recovered on, and make its UV map the active one"
    )


def _normals(maps: Maps) -> np.ndarray | None:
    """Return (H, W, 3) the recovered normals, None where the model has none."""
    name = next((parameter.name for parameter in maps.model.parameters if parameter.is_normal), None)
    if name is None or name not in maps.values:
        return None
    normals = np.broadcast_to(np.asarray(maps.values[name], np.float32), (*maps.solved.shape, 3))
    return fill_margin(normals, maps.solved, far=FLAT_NORMAL, keep=maps.margin)


def _baked(
    mesh: MeshData, normals: np.ndarray | None, shape: tuple[int, int], rays: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return (H, W) float32 the occlusion that Cycles bakes, and the share of each texel that it has written.

    In the margin Cycles blends texels with neighbours that it has not written. They are 0 in colour and alpha, so that
    a texel's alpha is the share of what is baked in its colour.
    """
    import bpy

    with removed_afterwards() as made:
        extent = float(np.linalg.norm(np.ptp(mesh.opaque.reshape(-1, 3), axis=0)))
        scene = _scene(made, rays, _REACH * extent)
        target = _image(made, np.zeros((*shape, 4), np.float32))
        subject = _subject(made, scene, mesh)
        subject.data.materials.append(_material(made, target, normals))
        # Cycles lets rays below the face begin beyond it: behind a sheet they would see the sky.
        beside = [] if mesh.solved is None else [mesh.positions[~mesh.solved]]
        behind = mesh.positions - _BEHIND * extent * mesh.normals
        others = np.concatenate([*beside, mesh.occluders, behind]).reshape(-1, 3)
        _object(made, scene, mesh_of_faces(_NAME, others, np.arange(len(others)).reshape(-1, 3)))
        layer = scene.view_layers[0]
        layer.update()
        subject.select_set(True, view_layer=layer)
        layer.objects.active = subject
        chosen = {"active_object": subject, "object": subject, "selected_objects": [subject]}
        with bpy.context.temp_override(scene=scene, view_layer=layer, **chosen), cycles_operator():
            bpy.ops.object.bake(
                type="AO", margin=MARGIN_TEXELS, margin_type="ADJACENT_FACES", use_clear=False,
                use_selected_to_active=False, target="IMAGE_TEXTURES",
            )  # fmt: skip
        baked = np.empty(4 * shape[0] * shape[1], np.float32)
        target.pixels.foreach_get(baked)
    pixels = baked.reshape(*shape, 4)
    return pixels[..., 0], pixels[..., 3]


def _scene(made: list[Any], rays: int, reach: float) -> Any:
    """Return an empty scene with the settings of the bake. reach: length of a ray, in the world's unit."""
    import bpy

    made.append(scene := bpy.data.scenes.new(_NAME))
    made.append(world := bpy.data.worlds.new(_NAME))
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_adaptive_sampling = rays, False
    scene.world, world.light_settings.distance = world, reach
    return scene


def _subject(made: list[Any], scene: Any, mesh: MeshData) -> Any:
    """Return the solved triangles as an object, its UV square the maps, all UDIM tiles side by side.

    It has the matrix of the mesh's own object, because Cycles reads a normal map in object space. Corners with one
    place and normal are one vertex, so that smooth faces are neighbours across UV seams; with one place alone, some
    would get the normal of others: Cycles splits vertices at sharp edges only.
    """
    from mathutils import Matrix

    solved = slice(None) if mesh.solved is None else mesh.solved
    inverse = np.linalg.inv(mesh.matrix)
    local = mesh.positions[solved].reshape(-1, 3) @ inverse[:3, :3].T + inverse[:3, 3]
    normals = unit(mesh.normals[solved].reshape(-1, 3) @ mesh.matrix[:3, :3])
    both = np.concatenate([local, normals], axis=-1).astype(np.float32)
    vertices, corners = np.unique(both, axis=0, return_inverse=True)
    corners = corners.reshape(-1, 3)
    # Blender ends (exit 139) where a face with normals of its own has one vertex twice.
    whole = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    data = mesh_of_faces(_NAME, vertices[:, :3], corners[whole])
    data.uv_layers.new(name=_NAME).uv.foreach_set("vector", mesh.uvs[solved][whole].ravel())
    data.normals_split_custom_set(vertices[corners[whole].ravel(), 3:])
    obj = _object(made, scene, data)
    obj.matrix_world = Matrix(mesh.matrix.tolist())
    for settings in (obj, obj.cycles):  # of today's Blender, of earlier ones
        if hasattr(settings, "shadow_terminator_geometry_offset"):
            settings.shadow_terminator_geometry_offset = 0.0  # else rays along the face begin above it
    return obj


def _object(made: list[Any], scene: Any, data: Any) -> Any:
    import bpy

    obj = bpy.data.objects.new(_NAME, data)
    made += [obj, data]
    scene.collection.objects.link(obj)
    return obj


def _image(made: list[Any], pixels: np.ndarray) -> Any:
    """Return a float image of pixels (H, W, 4)."""
    import bpy

    height, width = pixels.shape[:2]
    made.append(image := bpy.data.images.new(_NAME, width, height, alpha=True, float_buffer=True, is_data=True))
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    return image


def _material(made: list[Any], target: Any, normals: np.ndarray | None) -> Any:
    """Return a matt material with a normal map (H, W, 3), whose active image is baked to."""
    made.append(material := new_material(_NAME))
    tree = material.node_tree
    output, shader = tree.nodes.new("ShaderNodeOutputMaterial"), tree.nodes.new("ShaderNodeBsdfDiffuse")
    tree.links.new(shader.outputs["BSDF"], output.inputs["Surface"])
    if normals is not None:
        picture, bend = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNormalMap")
        codes = encode_normal(normals)
        picture.image = _image(made, np.concatenate([codes, np.ones_like(codes[..., :1])], axis=-1))
        tree.links.new(picture.outputs["Color"], bend.inputs["Color"])
        tree.links.new(bend.outputs["Normal"], shader.inputs["Normal"])
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = target
    tree.nodes.active = node
    return material
