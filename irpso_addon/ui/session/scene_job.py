"""Builds a job from a scene's settings, and reports missing settings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...blender.colour_spaces import to_rec_709, use_of
from ...blender.materials import material
from ...blender.mesh import extract_mesh
from ...blender.objects import in_a_scene
from ...blender.occluders import can_occlude, with_occluders
from ...blender.tiled_images import tile_images
from ...capture.inspect.sufficiency import MIN_LIGHTS, check_normal, no_normal
from ...capture.read import read_spec
from ...capture.types import Capture
from ...core.encode import linear_from_srgb, srgb_from_linear
from ...core.errors import InputError
from ...core.udim import ONE_SQUARE
from ...geometry.surface.mesh import MeshData
from ...geometry.surface.slots import listed, slot_names, slots_of_text
from ...pipeline.job import Job, LightOptions
from ...reflectance.model import Parameter, ReflectanceModel, digest_of_own_model
from ...results.map_tables import ALPHA, MapTable, table_of
from ...solver.planning.make_plan import scratch_folder
from ...solver.views.held_out import MIN_OBSERVATIONS, held_out_last, spared
from ..common.polls import NO_CAPTURE
from ..common.words import iface
from ..properties import findings, preferences
from ..properties.recipe import recipe_of
from ..properties.scene_settings import model_of, model_source
from ..properties.schedule_settings import schedule_of
from .card_place import free_place
from .scene_capture import capture_of, capture_path, has_capture, is_marked, knows_distance, wants_distance

_ROUNDING = 1e-5  # error of a colour's conversion between colour spaces
_MESH = "mesh"  # origin of a recovery of a mesh
# Formats without values beyond 0…1. Blender loads 16-bit PNG files as floats.
_WHOLE_NUMBERS = {"BMP", "JPEG", "JPEG2000", "PNG", "TARGA", "TARGA_RAW", "WEBP"}


@dataclass(frozen=True, kw_only=True)
class SceneJob(Job):
    """A job from a scene's settings; later changes of these do not affect it.

    origin: "mesh", or the source of a card's capture. scene_uid: Blender's session number of the scene. place: (4, 4)
    matrix of a card without an object. recipe: the settings, from ``recipe_of``. model_source: name of a shipped
    model or path of a user's. model_digest: of the latter.
    """

    origin: str
    scene_uid: int
    place: np.ndarray
    recipe: dict[str, Any]
    model_source: str
    model_digest: str | None


def missing(context) -> str:
    """Return a text on the first missing or wrong setting, with the remedy; "" if there is none. Opens no file."""
    settings = context.scene.irpso
    if not has_capture(settings):
        return iface(NO_CAPTURE)
    if text := findings.obstacle(settings):
        return text
    if settings.source == "SCENE":
        count = sum(obj.type == "LIGHT" and obj.irpso.image is not None for obj in context.scene.objects)
        if not count:
            return iface("No light of this scene has a photograph: assign images to the lights, or import a capture")
        if count < MIN_LIGHTS and findings.wants_normal(settings):
            lights = iface("1 light has a photograph")
            if count > 1:
                lights = iface("{count} lights have photographs", count=count)
            return iface("Only {lights}: a normal needs at least three; add some, or give the normals", lights=lights)
    if wants_distance(context.scene) and not knows_distance(settings):
        return iface(
            "No distance of the card: its lights have positions; set Card Distance or Card Width, in their unit"
        )
    if settings.source == "FILES" and settings.subject == "CARD" and not is_marked(settings):
        return iface("Frame: nothing is marked; mark the card in the photograph, or set Frame to As Imported")
    if settings.subject == "MESH":
        obj = subject_object(context)
        if obj is None and settings.object is not None and settings.object.type == "MESH":
            return iface("'{name}' has been deleted: undo that", name=settings.object.name)
        if obj is None:
            return iface("No mesh: choose the object whose maps are to be recovered, or make it active")
        if not obj.data.uv_layers:
            return iface("'{name}' has no UV map: unwrap it first", name=obj.name)
        if settings.slots == "NAMED" and len(obj.material_slots) > 1 and not settings.slot_list.strip():
            return iface("No slot is chosen: name those to be recovered, of {slots}", slots=listed(slot_names(obj)))
    if settings.parameters and not any(item.recover for item in settings.parameters):
        return iface("Nothing to recover: tick at least one map")
    return ""


def subject_object(context):
    """Return the mesh object of the settings, or the active one; None if neither is a mesh, or it has been deleted."""
    obj = context.scene.irpso.object or context.view_layer.objects.active  # the setting keeps a deleted object
    return obj if obj is not None and obj.type == "MESH" and in_a_scene(obj) else None


def check_local(scene) -> None:
    """Raise InputError for a scene that is linked from a library, which can hold no new objects."""
    if scene.library is not None:
        raise InputError(
            f"scene '{scene.name}' is linked from {scene.library.filepath}; make it local (Object › Relations › Make"
            " Local › All), or work in another scene"
        )


def make_job(context) -> SceneJob:
    """Return the job of the scene's settings. Raises InputError naming the setting and the remedy."""
    if text := missing(context):
        raise InputError(text)
    check_local(context.scene)
    settings, prefs = context.scene.irpso, preferences.current(context)
    model, schedule = model_of(settings), schedule_of(settings.schedule)
    capture = capture_of(context.scene)
    if findings.wants_normal(settings):
        check_normal(f"capture '{capture.name}'", capture.lights)
    held_out = _held_out(settings, capture)
    capture, _ = held_out_last(capture, held_out)
    obj = subject_object(context) if settings.subject == "MESH" else None
    mesh = slots = None
    if obj is not None:
        material.check_object(obj)
        slots = wanted_slots(settings, obj)
        mesh = mesh_of(settings, obj)
    origin = _MESH if obj is not None else str(capture.source or context.scene.name)
    name = capture.name if obj is None else obj.name if slots is None else material.slots_subject(obj, slots)
    name = material.subject_name(name, origin, obj)
    material.check_material(model, name)
    size = capture.masks[0].shape[::-1] if mesh is None else mesh.domain_size(*[settings.resolution] * 2)
    tiles = ONE_SQUARE if mesh is None else mesh.tiles
    return SceneJob(
        capture=capture, name=name, model=model, schedule=schedule, seed=settings.seed, size=size,
        scratch=scratch_folder((prefs.folder() or Path.home()) / "x"), mesh=mesh,
        object_uid=None if obj is None else obj.session_uid, fixed=_fixed(settings, model, size[::-1], tiles),
        held_out=held_out, shadows=settings.shadows, entry=prefs.entry, memory=prefs.memory,
        lights=LightOptions(settings.light_strengths.lower(), round(math.degrees(settings.refine_directions), 4)),
        source=_domain_key(settings, capture, mesh, held_out), origin=origin, scene_uid=context.scene.session_uid,
        place=free_place(context, size[1] / size[0]), recipe=recipe_of(settings, obj, slots),
        model_source=(source := model_source(settings)), model_digest=digest_of_own_model(source),
    )  # fmt: skip


def _held_out(settings, capture: Capture) -> tuple[int, ...]:
    """Return the indices of the held-out observations, chosen as by ``--hold-out``. Raises InputError."""
    if settings.hold_out == "OFF":
        return ()
    count = capture.listed
    if not (chosen := spared(capture.listed_cameras)):
        photographs = "1 photograph" if count == 1 else f"{count} photographs"
        raise InputError(
            f"Hold Out: of {photographs} none can be spared; set it to Off, or add some, to {MIN_OBSERVATIONS} or more"
        )
    held_out = tuple(capture.numbers(chosen))
    fitted = [one.light for k, one in enumerate(capture.observations) if k not in held_out]
    if findings.wants_normal(settings) and (problem := no_normal(fitted)):
        raise InputError(f"Hold Out: what is left to fit gives no normal: {problem.message}; or set it to Off")
    return held_out


def wanted_slots(settings, obj) -> tuple[int, ...] | None:
    """Return the material slots to recover, None for all. Raises InputError."""
    if settings.slots == "ALL" or len(obj.material_slots) < 2:
        return None
    if settings.slots == "ACTIVE":
        return (obj.active_material_index,)
    return slots_of_text(settings.slot_list, slot_names(obj))


def mesh_of(settings, obj) -> MeshData:
    """Return the mesh of the settings' slots, with the objects around it. Raises InputError."""
    mesh = extract_mesh(obj, wanted_slots(settings, obj))
    return with_occluders(mesh, _occluders(settings, obj), of_collection=True)


def _occluders(settings, obj) -> list[Any]:
    """Return the objects with a surface or instances in the collection of occluders, without the subject."""
    members = settings.occluders.all_objects if settings.occluders is not None else ()
    return [other for other in members if other != obj and can_occlude(other)]


def _fixed(settings, model: ReflectanceModel, size: tuple[int, int], tiles: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Return the maps of the fixed parameters."""
    items = {item.name: item for item in settings.parameters}
    return {
        parameter.name: _fixed_map(items[parameter.name], model, parameter, size, tiles)
        for parameter in model.parameters
        if parameter.name in items and not items[parameter.name].recover
    }


def _fixed_map(
    item, model: ReflectanceModel, parameter: Parameter, size: tuple[int, int], tiles: tuple[int, ...]
) -> np.ndarray:
    low, high = np.float32(parameter.range)  # Blender keeps 0.02 as 0.0199999996
    if item.image is not None:
        return image_map(item.image, model, parameter.name, size, tiles)
    if parameter.is_normal:
        return np.float32((0, 0, 1))
    values = item.color if parameter.components == 3 else [item.value] * parameter.components
    if parameter.color_space == "sRGB" and parameter.components == 3:
        values = to_rec_709(np.array(values))
        values = np.where(np.abs(values - np.clip(values, low, high)) < _ROUNDING, np.clip(values, low, high), values)
    values = np.float32(values)
    if values.min() < low or values.max() > high:
        raise InputError(f"{parameter.name}: the given value must lie between {low:g} and {high:g}")
    return values


def image_map(
    image, model: ReflectanceModel, name: str, size: tuple[int, int], tiles: tuple[int, ...] = ONE_SQUARE
) -> np.ndarray:
    """Return (H, W, components) of a model's parameter in a Blender image, in the parameter's own units.

    The image is the parameter's own, or the map that it shares with others. A normal map holds unit vectors, as
    normal.exr does, or n/2 + 1/2; a PNG of a range beyond 0…1 holds a fraction of it, as those of a result.
    Parameters other than colours get the file's own numbers, although Blender marks every PNG as sRGB. size: (H, W) of
    all tiles. tiles: the domain's UDIM tiles, which a tiled image must have. Raises InputError if the image is
    unreadable or does not fit.
    """
    table = table_of(model, name)
    with tile_images(image, tiles) as parts:
        size = size[0], size[1] // len(tiles)
        return np.concatenate([_tile_map(part, table, model.parameter(name), size) for part in parts], axis=1)


def _tile_map(image, table: MapTable, parameter: Parameter, size: tuple[int, int]) -> np.ndarray:
    height, width = size
    if not image.has_data and not image.size[0]:
        raise InputError(f"image '{image.name}' cannot be read; choose another for {parameter.name}")
    if tuple(image.size) != (width, height):
        raise InputError(
            f"image '{image.name}', given for {parameter.name}, is {image.size[0]} × {image.size[1]}, the maps"
            f" {width} × {height}; scale it"
        )
    values = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(values)
    values = values.reshape(height, width, image.channels)
    values = table.channels_of(parameter.name, values, f"image '{image.name}'")
    encoded = use_of(image) == "srgb"  # float pixels are decoded already, by Blender
    if image.is_float and not image.colorspace_settings.is_data and values.shape[-1] == 3:
        values = to_rec_709(values)  # Blender has converted them to the .blend file's working space
    if encoded and image.is_float and parameter.color_space != "sRGB":
        values = srgb_from_linear(values)
    if parameter.is_normal:
        return _normals(values, image.is_float and not encoded)
    if (
        encoded
        and not image.is_float
        and parameter.color_space == "sRGB"
        and table.first_channel(parameter.name) < ALPHA
    ):
        colours = linear_from_srgb(np.maximum(values[..., :ALPHA], 0).astype(np.float64))
        values = np.concatenate([colours, values[..., ALPHA:]], axis=-1)  # no curve applies to alpha
    whole = image.source != "GENERATED" and image.file_format in _WHOLE_NUMBERS
    if whole and parameter.color_space != "sRGB" and not table.fits_unit:
        values = parameter.range[0] + np.float32(parameter.width) * values
    return values.astype(np.float32)


def _normals(values: np.ndarray, may_be_vectors: bool) -> np.ndarray:
    """Return the unit vectors of a normal map: its values, or 2v − 1, whichever have lengths nearer to 1."""
    shifted = 2 * values - 1
    error, shifted_error = (np.median(np.abs(np.linalg.norm(v, axis=-1) - 1)) for v in (values, shifted))
    vectors = values if may_be_vectors and error < shifted_error else shifted
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    # Vectors of length 1 but for rounding stay bit for bit equal to those of the command line.
    return np.where(np.abs(lengths - 1) < 1e-6, vectors, vectors / np.maximum(lengths, 1e-8))


def _domain_key(settings, capture: Capture, mesh: MeshData | None, held_out: tuple[int, ...]) -> tuple[Any, ...] | None:
    """Return a key of the domain of these settings, None for a scene's own capture; equal keys have equal domains.

    Images enter by modification time and size; lights and cameras by value, because a folder's time does not change
    with its lists. held_out: the held-out observations, which are read last.
    """
    if settings.source != "FILES":
        return None
    spec = read_spec(capture_path(settings), settings.colour_space)
    left_out = {one.index for one in capture.left_out}
    images = (
        *(observation.image for k, observation in enumerate(spec.observations) if k not in left_out),
        *(view.mask for view in spec.views if view.mask),
    )
    files = {image.path: image.path.stat() for image in images}
    stamps = tuple((image, files[image.path].st_mtime_ns, files[image.path].st_size) for image in images)
    lights = tuple((observation.light, observation.camera) for observation in capture.observations)
    cameras = (capture.card_distance, *(camera.key for camera in capture.cameras))
    mesh_key = None
    if mesh is not None:
        arrays = (mesh.positions, mesh.normals, mesh.tangents, mesh.uvs, mesh.occluders)
        solved = None if mesh.solved is None else mesh.solved.tobytes()
        bake_settings = (settings.resolution, settings.shadows, mesh.tiles, solved)
        mesh_key = hash((*(array.tobytes() for array in arrays), *bake_settings))
    return stamps, lights, cameras, mesh_key, held_out
