"""A recovered material in a Blender asset library: a file of its own, with a preview and what is known of it."""

from __future__ import annotations

import contextlib
import io
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...capture.images.exr import read_exr
from ...core.encode import srgb_from_linear
from ...core.errors import InputError
from ...core.files import replacing_file
from ...gpu.output import caught_output
from ..scenes import cycles, table_top
from .material import TAG

_SIDE, _SAMPLES = 256, 32  # pixels of a preview, as Blender's own have; samples of each
_CARD, _MESH = (0.0, -0.4, 1.0), (0.6, -1.0, 0.5)  # from the subject to the preview's camera
_LAMP = (-0.45, 0.25, 1.0)  # in the camera's axes
_SUN, _SKY = 0.06, 0.6  # half of the lamp's angle in radians; radiance of the zenith
_RIM = 1.04  # of the subject's extent
_EXPOSURE = 0.85


@dataclass(frozen=True)
class About:
    """What Blender's asset browser shows of an asset. tags: words that the browser's search finds."""

    author: str = ""
    license: str = ""
    description: str = ""
    tags: tuple[str, ...] = ()


def recovered_slot(obj: Any) -> Any:
    """Return the first recovered material of an object. Raises InputError where it has none."""
    made = (slot.material for slot in obj.material_slots)
    found = next((material for material in made if material is not None and TAG in material), None)
    if found is None:
        raise InputError(f"object '{obj.name}' has no recovered material")
    return found


def write_asset(path: Path, obj: Any, name: str, about: About, catalog: str) -> None:
    """Write the recovered material of an object into a .blend, as an asset with its maps packed; whole or not at all.

    The open file stays as it is. catalog: UUID, "" for none. Raises InputError where ``path`` cannot be written.
    """
    import bpy

    material = recovered_slot(obj)
    picture = preview_picture(obj)
    with _copy_named(material, name) as copy, _packed(_images(copy.node_tree)):
        copy.asset_mark()
        known = copy.asset_data
        known.author, known.license, known.description = about.author, about.license, about.description
        for tag in about.tags:
            known.tags.new(tag, skip_if_exists=True)
        if catalog:
            known.catalog_id = catalog
        shown = copy.preview_ensure()
        shown.image_size = (_SIDE, _SIDE)
        shown.image_pixels_float.foreach_set(picture.astype(np.float32).ravel())
        try:
            with replacing_file(path, durable=True) as partial, contextlib.redirect_stdout(io.StringIO()):
                bpy.data.libraries.write(str(partial), {copy}, fake_user=True, compress=True)
        except RuntimeError as error:
            raise InputError(f"{path}: cannot be saved ({str(error).strip()}); choose another library") from error


@contextlib.contextmanager
def _copy_named(material: Any, name: str) -> Iterator[Any]:
    """Yield a copy of a material that has this very name, even if the material itself has it."""
    import bpy

    taken = bpy.data.materials.get(name)
    if taken is not None:
        taken.name = f"{name} "
    copy = material.copy()
    copy.name = name
    try:
        yield copy
    finally:
        bpy.data.materials.remove(copy)
        if taken is not None:
            taken.name = name


@contextlib.contextmanager
def _packed(images: Iterable[Any]) -> Iterator[None]:
    """Pack images that are files; they are files again afterwards."""
    files = [image for image in images if image.packed_file is None and image.source in ("FILE", "TILED")]
    try:
        for image in files:
            image.pack()
        yield
    finally:
        for image in files:
            if image.packed_file is not None or image.packed_files:
                image.unpack(method="REMOVE")


def _images(tree: Any) -> set[Any]:
    """Return the images of a node tree and of the groups in it."""
    found = {node.image for node in tree.nodes if node.type == "TEX_IMAGE" and node.image is not None}
    for node in tree.nodes:
        if node.type == "GROUP" and node.node_tree is not None:
            found |= _images(node.node_tree)
    return found


def preview_picture(obj: Any) -> np.ndarray:
    """Return (256, 256, 4) display values and coverage, row 0 at the bottom: an object by Cycles, as an icon shows it.

    A card is seen from above, a mesh from the side; under one lamp and a sky, so that metal has something to show.
    """
    with table_top.own_scene("IRPSO preview") as scene, tempfile.TemporaryDirectory(prefix="irpso-") as folder:
        scene.collection.objects.link(obj)
        axes = _add_camera(scene, obj)
        _add_sky(scene)
        lamp = cycles.only_lamp(scene, "SUN")
        lamp.data.angle = 2 * _SUN
        cycles.place_lamp(lamp, axes @ np.array(_LAMP) / np.linalg.norm(_LAMP))
        cycles.set_up(scene, cycles.View(_SIDE, _SIDE, samples=_SAMPLES))
        rendered = Path(folder) / "preview.exr"
        with caught_output():  # Blender tells of each file
            cycles.render_radiance(scene, rendered)
        (channels,) = read_exr(rendered).values()
    light = np.stack([channels[c] for c in "RGB"], axis=-1).astype(np.float64)
    alpha = np.clip(channels["A"].astype(np.float64), 0, 1)[..., None]
    shown = srgb_from_linear(np.clip(_EXPOSURE * light / np.maximum(alpha, 1e-3), 0, 1))
    return np.concatenate([shown, alpha], axis=-1)


def _add_camera(scene: Any, obj: Any) -> np.ndarray:
    """Give the scene an orthographic camera that the object fills; return its axes (3, 3) in columns."""
    import bpy
    from mathutils import Matrix, Vector

    matrix = obj.matrix_world
    turn = matrix.to_quaternion().to_matrix() if TAG in obj else Matrix.Identity(3)
    toward = (turn @ Vector(_CARD if TAG in obj else _MESH)).normalized()
    axes = toward.to_track_quat("Z", "Y").to_matrix()
    low, high = _extent(obj, np.array(axes.transposed() @ matrix.to_3x3()))
    middle = np.array(axes.transposed() @ matrix.translation)
    low, high = low + middle, high + middle
    size = max(float((high - low).max()), 1e-6)
    data = bpy.data.cameras.new("Camera")
    data.type, data.ortho_scale = "ORTHO", _RIM * float(max(*(high - low)[:2], 1e-6))
    data.clip_start, data.clip_end = 1e-3 * size, 10 * size
    place = axes @ Vector([*((low + high)[:2] / 2), high[2] + size])
    scene.camera = bpy.data.objects.new("Camera", data)
    scene.camera.matrix_world = Matrix.Translation(place) @ axes.to_4x4()
    scene.collection.objects.link(scene.camera)
    return np.array(axes)


def _extent(obj: Any, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the largest coordinates of an object as it is rendered, in axes of which turn is the map."""
    import bpy

    shown = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = shown.to_mesh()
    places = np.zeros(3 * max(len(mesh.vertices), 1), np.float32)
    mesh.vertices.foreach_get("co", places)
    shown.to_mesh_clear()
    turned = places.reshape(-1, 3) @ turn.T
    return turned.min(axis=0), turned.max(axis=0)


def _add_sky(scene: Any) -> None:
    """Give the scene a sky that is bright above and dark below."""
    import bpy

    world = scene.world = bpy.data.worlds.new("Sky")
    if world.node_tree is None:  # since Blender 5.0 every world has one
        world.use_nodes = True
    tree = world.node_tree
    place, parts = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeSeparateXYZ")
    ramp = tree.nodes.new("ShaderNodeMapRange")
    ramp.inputs["From Min"].default_value, ramp.inputs["From Max"].default_value = -1.0, 1.0
    ramp.inputs["To Min"].default_value, ramp.inputs["To Max"].default_value = 0.0, _SKY
    tree.links.new(place.outputs["Generated"], parts.inputs["Vector"])
    tree.links.new(parts.outputs["Z"], ramp.inputs["Value"])
    tree.links.new(ramp.outputs["Result"], tree.nodes["Background"].inputs["Strength"])
