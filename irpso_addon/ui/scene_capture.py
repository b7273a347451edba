"""The capture that a scene's settings name: from files, or from the open file's own cameras, lights and images."""

from __future__ import annotations

import re
from collections.abc import Generator
from pathlib import Path

import bpy
import numpy as np

from ..capture.camera import Camera
from ..capture.draft import build_steps
from ..capture.images import ImageStore
from ..capture.read import read_draft
from ..capture.steps import run_steps
from ..capture.types import Capture, Light, Observation
from ..errors import InputError
from ..geometry.scene import camera_from_object, world_matrix
from ..maps.blender_images import decode
from ..maps.lights import point_intensity, sun_intensity
from .scene_images import Photograph, open_photograph

# Custom properties of objects that "Create Cameras and Lights" made: their capture's name, and what Blender has no
# place for: a camera's own pixel aspect (x, y).
CAPTURE, ASPECT = "irpso_capture", "irpso_pixel_aspect"
LIGHT_TYPES = ("SUN", "POINT")


def capture_of(scene) -> Capture:
    """Return the capture that a scene's settings name; images are read when they are asked for. Raises InputError."""
    return run_steps(capture_steps(scene))


def capture_steps(scene) -> Generator[None, None, Capture]:
    """Yield before each image's header is looked at, and return what ``capture_of`` does."""
    settings = scene.irpso
    if settings.source == "SCENE":
        return (yield from _scene_steps(scene))
    draft = read_draft(capture_path(settings), settings.colour_space)
    return (yield from build_steps(draft, decode))


def capture_path(settings) -> Path:
    """Return the path of the capture's files. Raises InputError where none is chosen."""
    if not settings.capture_path:
        raise InputError("Capture: none is chosen; import a folder, an .lp list or a capture.toml")
    return Path(bpy.path.abspath(settings.capture_path))


def capture_from_scene(scene) -> Capture:
    """Return the capture that a scene itself is: its Sun and Point lights that have an image, in the order of names.

    Each light is seen by its own camera or the scene's; a camera's own image is its mask. Raises InputError naming the
    object and the remedy.
    """
    return run_steps(_scene_steps(scene))


def photographed_lights(scene) -> list:
    """Return the light objects that have an image, in the order of their names; numbers in them count as numbers."""
    return [obj for obj in in_order(scene) if obj.type == "LIGHT" and obj.irpso.image is not None]


def in_order(scene) -> list:
    """Return a scene's objects in the order of names; those of excluded collections only of another scene."""
    context = bpy.context
    objects = context.view_layer.objects if context.scene == scene else scene.objects
    return sorted(objects, key=lambda obj: natural(obj.name))


def natural(name: str) -> list:
    """Return a key that sorts "light 2" before "light 10"."""
    return [int(word) if word.isdecimal() else word.lower() for word in re.split(r"(\d+)", name)]


def _scene_steps(scene) -> Generator[None, None, Capture]:
    bpy.context.view_layer.update()  # else what a script has just added is not in it
    lights = photographed_lights(scene)
    if not lights:
        raise InputError("no light of this scene has a photograph; assign images to its lights, or import a capture")
    colour_space, store = scene.irpso.colour_space, ImageStore(decode)
    seen_by: dict[str, list[tuple[object, Photograph]]] = {}
    vectors = {}
    for obj in lights:
        yield
        vectors[obj.name] = light_of(obj)
        photograph = open_photograph(obj.irpso.image, f"light '{obj.name}'", store, colour_space)
        seen_by.setdefault(_camera_object(obj, scene).name, []).append((obj, photograph))
    names = sorted(seen_by, key=natural)
    cameras, masks = [], []
    for name in names:
        yield
        camera = bpy.data.objects[name]
        width, height = _common_size(seen_by[name], name)
        aspect = camera.get(ASPECT, (scene.render.pixel_aspect_x, scene.render.pixel_aspect_y))
        cameras.append(camera_from_object(camera, width, height, tuple(aspect)))
        masks.append(_mask(camera, cameras[-1], store))
    photographs = {obj.name: (names.index(name), p) for name, pairs in seen_by.items() for obj, p in pairs}
    observations = tuple(
        Observation(name, _reader(photographs[name][1]), light, photographs[name][0]) for name, light in vectors.items()
    )
    return Capture(_name(scene, lights), observations, tuple(cameras), tuple(masks))


def _name(scene, lights: list) -> str:
    """Return the capture's name: that of the files that the lights were made from, else the scene's."""
    names = {obj.get(CAPTURE) for obj in lights}
    return names.pop() if len(names) == 1 and None not in names else scene.name


def _reader(photograph: Photograph):
    return lambda: photograph.read().rgba


def _camera_object(light, scene):
    camera = light.irpso.camera or scene.camera
    if camera is None:
        raise InputError(f"light '{light.name}' has no camera and the scene has none; set the one that took its image")
    return camera


def _common_size(pairs: list[tuple[object, Photograph]], camera: str) -> tuple[int, int]:
    sizes = [photograph.size for _, photograph in pairs]
    # The size that most have: then the error tells of an odd one.
    expected = max(set(sizes), key=sizes.count)
    for _, photograph in pairs:
        if photograph.size != expected:
            width, height = photograph.size
            raise InputError(
                f"{photograph.where} is {width} × {height}, others of camera '{camera}' are {expected[0]} ×"
                f" {expected[1]}; all images of a camera must be of one size, unscaled and uncropped"
            )
    return expected


def _mask(obj, camera: Camera, store: ImageStore) -> np.ndarray:
    if obj.irpso.image is None:
        return np.ones((camera.height, camera.width), bool)
    photograph = open_photograph(obj.irpso.image, f"camera '{obj.name}'", store, "linear")
    if photograph.size != (camera.width, camera.height):
        raise InputError(
            f"{photograph.where}, its mask, is {photograph.size[0]} × {photograph.size[1]}, its photographs are"
            f" {camera.width} × {camera.height}; save it at their size"
        )
    mask = photograph.mask()
    if not mask.any():
        raise InputError(f"{photograph.where}, its mask, is empty; paint what is to be solved white")
    return mask


def light_of(obj) -> Light:
    """Return a Blender light object as a light. Raises InputError where it is no Sun or Point, or gives no light."""
    data, where = obj.data, f"light '{obj.name}'"
    if data.type not in LIGHT_TYPES:
        raise InputError(f"{where} is of type {data.type}; make it a Sun (far away) or a Point (near)")
    if not getattr(data, "normalize", True):
        raise InputError(f"{where} is not normalized, so its size changes its strength; turn Normalize on")
    power = data.energy * 2.0 ** getattr(data, "exposure", 0.0)
    colour = np.array(data.color, np.float64) * _node_gain(data, where)
    if getattr(data, "use_temperature", False):
        colour *= np.array(data.temperature_color, np.float64)
    distant = data.type == "SUN"
    intensity = colour * (sun_intensity(power) if distant else point_intensity(power))
    if (intensity < 0).any() or not intensity.any():
        raise InputError(f"{where} gives {'negative' if intensity.any() else 'no'} light; set its strength and colour")
    matrix = world_matrix(obj)
    vector = matrix[:3, 2] / np.linalg.norm(matrix[:3, 2]) if distant else matrix[:3, 3]
    return Light(tuple(map(float, vector)), tuple(map(float, intensity)), distant)


def _node_gain(data, where: str) -> np.ndarray:
    """Return (3,) what a light's nodes multiply its colour by: the strength and colour of a plain Emission."""
    if not data.use_nodes or data.node_tree is None:
        return np.ones(3)
    output = data.node_tree.get_output_node("ALL")
    links = output.inputs["Surface"].links if output else ()
    node = links[0].from_node if links else None
    if node is None or node.bl_idname != "ShaderNodeEmission" or any(socket.is_linked for socket in node.inputs):
        raise InputError(f"{where} has nodes other than a plain Emission; remove them, or turn Use Nodes off")
    return np.array(node.inputs["Color"].default_value[:3]) * node.inputs["Strength"].default_value
