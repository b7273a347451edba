"""Makes scene objects of a capture's cameras, lights and photographs, and switches on one light at a time."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy.props import BoolProperty, CollectionProperty, IntProperty, StringProperty
from mathutils import Matrix, Vector

from ...blender.images import decode
from ...blender.materials import material
from ...blender.objects import originals
from ...blender.scenes.file_images import FileImages
from ...blender.scenes.scene import ASPECT, RESOLUTION
from ...blender.scenes.scene_capture import CAPTURE, lights_in_order, photographed_lights
from ...blender.scenes.scene_lights import LIGHT_TYPES
from ...blender.scenes.scene_objects import set_background, set_camera, set_light
from ...capture.camera import Camera
from ...capture.card import card_depth, card_middle, card_size
from ...capture.framing import framed
from ...capture.images.image import ImageRef, ImageStore
from ...capture.inspect.damage import with_skip_remedy
from ...capture.spec import CaptureSpec, build_capture
from ...capture.types import Capture
from ...core.errors import InputError
from ...core.files import natural
from ...core.steps import run_steps
from ..common import failures
from ..common.file_paths import absolute
from ..common.polls import NO_CAPTURE, usable
from ..common.words import rpt
from ..properties.scene_settings import UPDATE_CALLBACKS
from ..session import session
from ..session.card_place import is_automatic, show_card
from ..session.scene_capture import spec_steps
from ..session.scene_job import check_local, subject_object

_ROLE = "irpso_role"  # custom property of the objects made here: "view 0", "light 12", by its number in the list
_FILES = "irpso_capture_files"  # custom property beside CAPTURE: the capture's source, as its name may be another's
_DOME = 2.0  # the dome's radius over the subject's
_SMALL = 0.3  # the cameras' display size over the dome's radius


@dataclass(frozen=True)
class _Dome:
    """Sphere on which distant lights are displayed: centre (3,) and radius in world units."""

    centre: np.ndarray
    radius: float


def create_scene(scene, spec: CaptureSpec, capture: Capture) -> list:
    """Make or update the objects of the capture's cameras and lights; return the lights.

    spec: of the same capture. The user's objects do not change. A scene without a camera gets one and its resolution.
    ``scene_capture.capture_from_scene`` then returns the same capture, in float32 precision.
    """
    existing = _by_role(_of_capture(_created(scene), capture))
    made: list = []
    collection = _collection(scene, capture)
    images = FileImages()
    dome = _dome(scene, capture)
    views = []
    for index, (view, camera, mask) in enumerate(zip(spec.views, capture.cameras, capture.masks, strict=True)):
        obj = _object(existing, made, f"view {index}", f"View {index:03d} {view.name}", "CAMERA", collection, capture)
        set_camera(obj, camera)
        obj.data.clip_end = max(obj.data.clip_end, 10 * float(np.linalg.norm(camera.position - dome.centre)))
        obj.data.display_size = _SMALL * dome.radius
        obj.irpso.image = None if view.mask is None or mask.all() else images.of(view.mask, mask=True)
        views.append(obj)
    lights = []
    for index, listed, observation in zip(capture.listed_numbers, spec.observations, capture.observations, strict=True):
        name = f"Light {index:03d} {observation.name}"
        obj = _object(existing, made, f"light {index}", name, "SUN", collection, capture)
        set_light(obj, observation.light, dome.centre, dome.radius)
        obj.irpso.image, obj.irpso.camera = images.of(listed.image), views[observation.camera]
        lights.append(obj)
    _remove(set(existing.values()) - set(made))
    if scene.camera is None:
        scene.camera = views[0]
    scene[CAPTURE], scene[_FILES] = capture.name, str(capture.source)
    show_observation(scene, scene.irpso.view.observation)
    return lights


def observation_count(scene) -> int:
    """Return the number of listed observations: of the recovery, else up to the capture's last light in the scene."""
    running = session.current()
    return 1 + max(numbered_lights(scene), default=-1) if running is None else running.job.capture.listed


def _observation_changed(view) -> None:
    if 0 < (count := observation_count(view.id_data)) < view.observation:
        view.observation = count  # calls this function again
        return
    show_observation(view.id_data, view.observation)


def show_observation(scene, number: int) -> None:
    """Switch on only one observation's light, and show its photograph as its camera's background.

    number: of the observation in the capture's list, from 1; one without a light counts as the next. Lights without a
    photograph do not change, nor do cameras that ``create_scene`` did not make. The scene's camera changes only if
    ``create_scene`` made it.
    """
    bpy.context.view_layer.update()  # for objects that were added or removed just now
    lights = numbered_lights(scene)
    if not lights:
        return
    shown = of_number(lights, number)
    for obj in {*lights.values(), *_created_lights(scene)}:
        # Written only on change: each write makes Blender rebuild its dependency graph.
        if obj.hide_render != (obj != shown):
            obj.hide_render = obj != shown
        if obj.hide_viewport != (obj != shown):
            obj.hide_viewport = obj != shown
    camera = shown.irpso.camera
    if camera is None or CAPTURE not in camera:
        return
    set_background(camera, shown.irpso.image)
    if scene.camera is not None and CAPTURE in scene.camera:
        scene.camera = camera
        _set_resolution(scene, camera)


def of_number(lights: dict[int, Any], number: int) -> Any:
    """Return the light of a number from 1; without one the next light, or the last. lights: ``numbered_lights``."""
    return lights[min((n for n in lights if n >= number - 1), default=max(lights))]


def numbered_lights(scene) -> dict[int, Any]:
    """Return the scene's lights of the observations by their number in the capture's list, from 0, in its order.

    For a capture of files these are the lights that ``create_scene`` made, for This Scene all lights with a
    photograph.
    """
    if scene.irpso.source == "SCENE":
        return dict(enumerate(photographed_lights(scene)))
    lights = _created_lights(scene)
    wanted = scene.get(CAPTURE), scene.get(_FILES)
    current = _by_role([obj for obj in lights if (obj[CAPTURE], obj.get(_FILES)) == wanted])
    return {int(role.split()[1]): current[role] for role in sorted(current, key=natural)}


def place_card(card, camera: Camera, distance: float) -> None:
    """Place a card object (``material.card_object``) at a distance, where it fills the camera's image exactly."""
    width, height = card_size(camera, distance)
    # The card's sides are in units of its width, and so is its relief.
    size = Matrix.Diagonal((width, height * camera.width / camera.height, width, 1.0))
    place = Matrix.Translation(card_middle(camera, distance).tolist())
    card.matrix_world = Matrix(camera.matrix.tolist()) @ place @ size


def _created(scene) -> list:
    return [obj for obj in scene.objects if CAPTURE in obj and _ROLE in obj and obj.library is None]


def _by_role(objects: Iterable) -> dict[str, Any]:
    """Return role → object, without duplicates."""

    def has_own_name(obj) -> bool:
        kind, index = obj[_ROLE].split()
        return obj.name.startswith(f"{kind.title()} {int(index):03d}")

    return originals(objects, lambda obj: obj[_ROLE], has_own_name)


def _created_lights(scene) -> list:
    return [obj for obj in _created(scene) if obj.type == "LIGHT"]


def _of_capture(items: Iterable, capture: Capture) -> list:
    """Return the objects or collections made of a capture; if none, those of one of its name whose files are gone."""
    source, named = str(capture.source), [item for item in items if item.get(CAPTURE) == capture.name]
    own = [item for item in named if item.get(_FILES, source) == source]
    return own or [item for item in named if not Path(item[_FILES]).exists()]


def _object(existing: dict, made: list, role: str, name: str, kind: str, collection, capture: Capture):
    """Return the capture's object of this role, created and tagged if there is none. kind: CAMERA or a light's."""
    obj = existing.get(role)
    if obj is None:
        data = bpy.data.cameras.new(name) if kind == "CAMERA" else bpy.data.lights.new(name, kind)
        obj = bpy.data.objects.new(name, data)
        obj[CAPTURE], obj[_ROLE] = capture.name, role
        collection.objects.link(obj)
    obj[_FILES] = str(capture.source)
    made.append(obj)
    return obj


def _collection(scene, capture: Capture):
    own = _of_capture(scene.collection.children_recursive, capture)
    collection = own[0] if own else bpy.data.collections.new(f"IRPSO {capture.name}")
    if not own:
        scene.collection.children.link(collection)
    collection[CAPTURE], collection[_FILES] = capture.name, str(capture.source)
    return collection


def _remove(objects: set) -> None:
    """Delete objects, and their data if nothing else uses it."""
    data = {obj.data for obj in objects}
    bpy.data.batch_remove(list(objects))
    bpy.data.batch_remove([item for item in data if item.users == 0])


def _dome(scene, capture: Capture) -> _Dome:
    """Return the dome around the subject: the mesh, else the card of a single camera, else the world's origin."""
    settings = scene.irpso
    obj = subject_object(bpy.context) if settings.subject == "MESH" else None
    if obj is not None:
        corners = np.array([obj.matrix_world @ Vector(corner) for corner in obj.bound_box])
    elif len(capture.cameras) == 1:
        # Without distortion, because a lens may show nothing in its corners.
        undistorted = replace(capture.cameras[0], distortion=())
        corners = undistorted.points(capture.card_distance or 1.0)[[0, 0, -1, -1], [0, -1, 0, -1]]
    else:
        nearest = min(float(np.linalg.norm(camera.position)) for camera in capture.cameras) or 1.0
        corners = np.array([(-nearest / 4,) * 3, (nearest / 4,) * 3])
    centre = (corners.min(axis=0) + corners.max(axis=0)) / 2
    radius = float(np.linalg.norm(corners - centre, axis=1).max()) or 1.0
    return _Dome(centre, settings.view.dome_radius or _DOME * radius)


def _set_resolution(scene, camera) -> None:
    """Set the scene's resolution and pixel aspect to those of a camera's photographs."""
    render = scene.render
    render.resolution_x, render.resolution_y = camera[RESOLUTION]
    render.resolution_percentage = 100
    render.pixel_aspect_x, render.pixel_aspect_y = camera[ASPECT]


class CreateScene(bpy.types.Operator):
    """Make objects of the capture's cameras and of its lights with their photographs. Only the light of the chosen
    photograph is switched on. Pressed again, it updates these objects and changes nothing else"""

    bl_idname = "irpso.create_scene"
    bl_label = "Create Cameras and Lights"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there is a capture of files."""
        there = context.scene.irpso.capture_path
        return usable(cls, there, NO_CAPTURE)

    def execute(self, context):
        """Make cameras and lights, and for a card also the card, which fills the camera's image."""
        scene = context.scene
        settings = scene.irpso
        try:
            check_local(scene)
            spec = run_steps(spec_steps(settings))
            with with_skip_remedy(settings.skip_damaged):
                capture = build_capture(spec, decode)
            on_card = settings.subject == "CARD" and len(capture.cameras) == 1
            part = framed(capture, spec.framing)
            depth = card_depth(part) if on_card else None
        except InputError as error:
            return failures.report_and_cancel(self, error)
        lights = create_scene(scene, spec, capture)
        if on_card:
            settings.card_distance = capture.card_distance or 0.0  # so that This Scene gives the same capture
            rows, columns = part.masks[0].shape
            subject = material.subject_name(capture.name, str(capture.source))  # as a recovery of this capture
            card = material.card_object(subject, rows, columns, displaced=None)
            if is_automatic(card):  # the user has not moved it
                place_card(card, part.cameras[0], depth)
            if context.window is not None:
                show_card(context, card, np.array(card.matrix_world), rows / columns)
        cameras = len(capture.cameras)
        counted = rpt("1 camera") if cameras == 1 else rpt("{count} cameras", count=cameras)
        text = rpt("{cameras} and {lights} lights of {name}", cameras=counted, lights=len(lights), name=capture.name)
        if any(obj.type == "LIGHT" and not obj.hide_render and obj not in lights for obj in scene.objects):
            text += rpt("; other lights are also on: hide them, and darken the world, to compare with the photographs")
        self.report({"INFO"}, text)
        return {"FINISHED"}


class ShowObservation(bpy.types.Operator):
    """Light the scene as in this photograph: only its light is on, and it is the camera's background"""

    bl_idname = "irpso.show_observation"
    bl_label = "Light as in Photograph"
    bl_options = {"REGISTER", "UNDO"}

    number: IntProperty(name="Photograph", description="Number of the photograph, from 1", min=1, default=1)

    @classmethod
    def poll(cls, context) -> bool:
        """Whether the scene has lights of a capture."""
        there = numbered_lights(context.scene)
        return usable(cls, there, "No lights of a capture: press Create Cameras and Lights, or assign images to lights")

    def execute(self, context):
        """Choose the observation, which updates the scene."""
        context.scene.irpso.view.observation = self.number
        return {"FINISHED"}


class AssignImages(bpy.types.Operator):
    """Choose the photographs of the scene's lights: the first image by name belongs to the first light by name, and so
    on. If lights are selected, only these get images"""

    bl_idname = "irpso.assign_images"
    bl_label = "Assign Images to Lights"
    bl_options = {"REGISTER", "UNDO"}

    directory: StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE"})
    files: CollectionProperty(type=bpy.types.OperatorFileListElement, options={"SKIP_SAVE"})
    filter_image: BoolProperty(default=True, options={"HIDDEN"})
    filter_folder: BoolProperty(default=True, options={"HIDDEN"})

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there are lights that can have photographs."""
        return usable(cls, _assignable(context), "The scene has no lights: add one for each photograph")

    def invoke(self, context, event):
        """Open the file browser."""
        if bpy.data.filepath:  # without this the browser proposes the open file itself
            self.directory = f"{Path(bpy.data.filepath).parent}{os.sep}"
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context):
        """Assign the images to the lights in the order of names, and report those that are left over."""
        names = sorted((item.name for item in self.files if item.name), key=natural)
        context.view_layer.update()  # for lights that a script has just added
        lights = _assignable(context)
        if not names:
            self.report({"ERROR"}, "No image was chosen: select the photographs of the lights in the file browser")
            return {"CANCELLED"}
        store, images = ImageStore(decode), FileImages(with_own_spaces=True)
        try:
            references = [ImageRef(absolute(self.directory, "Folder") / name) for name in names]
            for reference in references:
                store.size(reference)  # all headers are read before any light changes
        except InputError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        for light, reference in zip(lights, references, strict=False):
            light.irpso.image = images.of(reference)
        if len(names) == len(lights):
            one, count = rpt("1 image assigned to 1 light"), len(names)
            many = rpt("{count} images assigned to {lights} lights", count=count, lights=count)
            self.report({"INFO"}, one if count == 1 else many)
            return {"FINISHED"}
        count = min(len(names), len(lights))
        longer = len(lights) > count
        left = rpt("light '{name}'", name=lights[count].name) if longer else rpt("image '{name}'", name=names[count])
        more = abs(len(names) - len(lights))
        self.report(
            {"WARNING"},
            rpt(
                "{images} images for {lights} lights: {count} assigned, {more} left over, from {left} on; check the"
                " selection",
                images=len(names),
                lights=len(lights),
                count=count,
                more=more,
                left=left,
            ),
        )
        return {"FINISHED"}


def _assignable(context) -> list:
    lights = [obj for obj in lights_in_order(context.scene) if obj.data.type in LIGHT_TYPES]
    return [obj for obj in lights if obj.select_get()] or lights


CLASSES = (CreateScene, ShowObservation, AssignImages)
UPDATE_CALLBACKS["observation"] = _observation_changed
