"""A Blender scene as a capture: its cameras, its lights, and the photographs assigned to them."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from typing import Any

import numpy as np

from ...capture.camera import Camera
from ...capture.errors import CaptureError
from ...capture.images.image import ImageStore
from ...capture.inspect.damage import DAMAGE, check_numbers
from ...capture.types import Capture, LeftOut, Light, Observation
from ...core.errors import InputError
from ...core.files import natural
from ...core.steps import run_steps
from ..images import decode
from .scene import camera_of_photographs, middle_of
from .scene_images import Photograph, open_photograph
from .scene_lights import light_of, too_wide

CAPTURE = "irpso_capture"  # custom property of imported objects: the capture's name
_SETTINGS = "irpso"  # the user interface's property group with an object's image and camera

_Seen = tuple[Any, list[tuple[Any, Photograph]]]  # a camera, and its lights with their photographs


def scene_steps(scene: Any, colour_space: str = "auto", skip_damaged: bool = False) -> Generator[None, None, Capture]:
    """Yield before each piece of work; return the capture of a scene: its lights with an image, sorted by name.

    A light's camera is its own or the scene's; a camera's image is its mask. colour_space, skip_damaged: as for
    read_capture. Raises InputError with the object's name and the remedy.
    """
    import bpy

    bpy.context.view_layer.update()  # else the scene lacks objects that a script has just added
    lights = photographed_lights(scene)
    if not lights:
        raise InputError("no light of this scene has a photograph; assign images to its lights, or import a capture")
    store = ImageStore(decode)
    seen_by, vectors, why = yield from _photograph_steps(lights, scene, store, colour_space, skip_damaged)
    photographs = {
        obj.session_uid: (index, photograph) for index, (_, pairs) in enumerate(seen_by) for obj, photograph in pairs
    }
    if not photographs:
        raise InputError(f"{next(iter(why.values()))} (the photographs of all lights are unusable)")
    left_out = tuple(
        LeftOut(n, obj.name, why[obj.session_uid]) for n, obj in enumerate(lights) if obj.session_uid in why
    )
    cameras, masks = [], []
    for camera, pairs in seen_by:
        yield
        size, turned_by = _common_size(pairs, camera.name), _common_turn(pairs, camera.name)
        cameras.append(camera_of_photographs(camera, *size, scene, turned_by))
        masks.append(_mask(camera, cameras[-1], store))
    observations = tuple(
        Observation(obj.name, lambda p=photograph: p.read().bounds, vectors[obj.session_uid], camera, photograph.coarse)
        for obj in lights
        if obj.session_uid in photographs
        for camera, photograph in (photographs[obj.session_uid],)
    )
    return Capture(_name(scene, lights), observations, tuple(cameras), tuple(masks), left_out=left_out)


def _photograph_steps(
    lights: Sequence[Any], scene: Any, store: ImageStore, colour_space: str, skip_damaged: bool
) -> Generator[None, None, tuple[list[_Seen], dict[int, Light], dict[int, str]]]:
    """Yield before each photograph; return (camera, its lights with photographs) pairs sorted by the camera's name.

    Also returns, by the light's session number, the lights and why others were left out: linked objects may have the
    names of local ones.
    """
    by_camera: dict[int, _Seen] = {}
    vectors: dict[int, Light] = {}
    why: dict[int, str] = {}
    for obj in lights:
        yield
        try:
            photograph = open_photograph(setting(obj, "image"), f"light '{obj.name}'", store, colour_space)
            if skip_damaged:
                check_numbers(photograph.where, photograph.read())
        except CaptureError as error:
            if not skip_damaged or error.code not in DAMAGE:
                raise
            why[obj.session_uid] = error.message
            continue
        vectors[obj.session_uid] = light_of(obj)
        camera = _camera_object(obj, scene)
        by_camera.setdefault(camera.session_uid, (camera, []))[1].append((obj, photograph))
    seen_by = sorted(by_camera.values(), key=lambda one: natural(one[0].name))
    if skip_damaged:
        for camera, pairs in seen_by:
            odd = {obj.session_uid: error.message for obj, error in _odd_sizes(pairs, camera.name)}
            pairs[:] = [pair for pair in pairs if pair[0].session_uid not in odd]
            why |= odd
    return seen_by, vectors, why


def capture_of_open_file(colour_space: str = "auto", skip_damaged: bool = False) -> Capture:
    """Return the open file's scene as a capture. Raises InputError like ``scene_steps``."""
    import bpy

    return run_steps(scene_steps(bpy.context.scene, colour_space, skip_damaged))


def setting(obj: Any, name: str) -> Any:
    """Return an object's image or camera, or None; works without the registered user interface."""
    if hasattr(obj, _SETTINGS):
        return getattr(getattr(obj, _SETTINGS), name)
    group = system_properties(obj).get(_SETTINGS)
    return None if group is None else group.get(name)


def system_properties(owner: Any) -> Any:
    """Return the stored values of registered properties, by name: since 5.0 apart from custom properties."""
    get = getattr(owner, "bl_system_properties_get", None)
    return owner if get is None else get(do_create=True)


def wide_lights(scene: Any, place: np.ndarray) -> list[str]:
    """Return warnings about lights too wide to act as points, as seen from ``place`` (3,)."""
    return [text for obj in photographed_lights(scene) if (text := too_wide(obj, place))]


def wide_lights_around(obj: Any) -> list[str]:
    """Return the ``wide_lights`` of the open file's scene for a subject in it."""
    import bpy

    return wide_lights(bpy.context.scene, middle_of(obj))


def photographed_lights(scene: Any) -> list:
    """Return the light objects with an image, in natural order of their names."""
    return [obj for obj in lights_in_order(scene) if setting(obj, "image") is not None]


def lights_in_order(scene: Any) -> list:
    """Return a scene's light objects, sorted by name; the current scene's without its excluded collections."""
    import bpy

    context = bpy.context
    objects = context.view_layer.objects if context.scene == scene else scene.objects
    return sorted((obj for obj in objects if obj.type == "LIGHT"), key=lambda obj: natural(obj.name))


def _name(scene: Any, lights: list) -> str:
    """Return the capture's name: of the files that the lights came from, else the scene's."""
    names = {obj.get(CAPTURE) for obj in lights}
    return names.pop() if len(names) == 1 and None not in names else scene.name


def _camera_object(light: Any, scene: Any) -> Any:
    camera = setting(light, "camera") or scene.camera
    if camera is None:
        raise InputError(f"light '{light.name}' has no camera and the scene has none; set the one that took its image")
    return camera


def _common_size(pairs: list[tuple[Any, Photograph]], camera: str) -> tuple[int, int]:
    for _, error in _odd_sizes(pairs, camera):
        raise error
    return pairs[0][1].size


def _common_turn(pairs: list[tuple[Any, Photograph]], camera: str) -> int:
    """Return the EXIF orientation that turns a camera's photographs upright; a phone that looks down guesses it."""
    turns = [photograph.turned_by for _, photograph in pairs]
    usual = max(turns, key=turns.count)
    for _, photograph in pairs:
        if photograph.turned_by != usual:
            raise CaptureError(
                f"{photograph.where}: its EXIF orientation is {photograph.turned_by} where others of camera '{camera}'"
                f" have {usual}; the camera stands still, so give all of them the same orientation",
                "orientation",
            )
    return usual


def _odd_sizes(pairs: list[tuple[Any, Photograph]], camera: str) -> Iterator[tuple[Any, CaptureError]]:
    """Yield the lights whose photographs differ from the most common size of their camera, with the error."""
    sizes = [photograph.size for _, photograph in pairs]
    expected = max(sizes, key=sizes.count)
    for obj, photograph in pairs:
        if photograph.size != expected:
            width, height = photograph.size
            message = (
                f"{photograph.where} is {width} × {height}, others of camera '{camera}' are {expected[0]} ×"
                f" {expected[1]}; all images of a camera must have one size, unscaled and uncropped"
            )
            yield obj, CaptureError(message, "size")


def _mask(obj: Any, camera: Camera, store: ImageStore) -> np.ndarray:
    image = setting(obj, "image")
    if image is None:
        return np.ones((camera.height, camera.width), bool)
    photograph = open_photograph(image, f"camera '{obj.name}'", store, "linear")
    if photograph.size != (camera.width, camera.height):
        raise InputError(
            f"{photograph.where}, its mask, is {photograph.size[0]} × {photograph.size[1]}, its photographs are"
            f" {camera.width} × {camera.height}; save it at their size"
        )
    mask = photograph.mask()
    if not mask.any():
        raise InputError(f"{photograph.where}, its mask, is empty; paint the subject white")
    return mask
