"""Imports the cameras of a photogrammetry program as camera objects, to match the mesh from the same program."""

from __future__ import annotations

import math

import bpy
import numpy as np
from bpy.props import EnumProperty, StringProperty

from ...blender.objects import originals
from ...blender.scenes.scene import FILE_IMAGE
from ...blender.scenes.scene_objects import set_camera
from ...capture.poses import PoseFile, read_poses
from ...core.errors import InputError
from ..common.file_paths import absolute
from ..common.words import rpt

_SOURCE = "irpso_cameras"  # custom property of the collection, its empty and its cameras: the source file
_EXTENSIONS = ".xml;.sfm;.json;.txt"
_SMALL = 0.1  # display size over the cameras' largest distance from their mean position
_FAR = 10.0  # clip end over the same distance
_AXES = (
    ("AUTO", "Automatic", "As in the File for COLMAP, whose meshes are PLY; For an OBJ for the other programs"),
    ("OBJ", "For an OBJ", "Rotated by 90° about X, like OBJ files that Blender imports"),
    ("FILE", "As in the File", "Not rotated, like PLY and STL files, and OBJ files imported with Y Forward and Z Up"),
)


def create_cameras(scene, poses: PoseFile, axes: str = "AUTO") -> list:
    """Make a camera object for each camera of a file, in a collection, with an empty as parent; return the objects.

    Objects of an earlier import of the same file are updated, while their empty stays where the user has moved it.
    axes: of ``_AXES``. The objects store pixels, lens, sensor, shift and distortion.
    """
    source, title = str(poses.path.resolve()), f"Cameras {poses.path.stem}"
    collection = next((c for c in scene.collection.children_recursive if c.get(_SOURCE) == source), None)
    if collection is None:
        collection = bpy.data.collections.new(title)
        collection[_SOURCE] = source
        scene.collection.children.link(collection)
    empty = next((obj for obj in collection.objects if obj.type == "EMPTY" and _SOURCE in obj), None)
    if empty is None:
        empty = bpy.data.objects.new(title, None)
        empty[_SOURCE] = source
        empty.empty_display_type = "ARROWS"
        rotated = axes == "OBJ" or (axes == "AUTO" and poses.program != "COLMAP")
        empty.rotation_euler = (math.pi / 2 if rotated else 0.0, 0.0, 0.0)
        collection.objects.link(empty)
    places = np.array([camera.position for camera in poses.cameras.values()])
    size = float(np.linalg.norm(places - places.mean(axis=0), axis=1).max()) or 1.0
    empty.empty_display_size = _SMALL * size
    made = [obj for obj in collection.objects if FILE_IMAGE in obj]
    objects = originals(made, lambda obj: obj[FILE_IMAGE], lambda obj: obj.name == _file_name(obj[FILE_IMAGE]))
    for image, camera in poses.cameras.items():
        obj = objects.get(image)
        if obj is None:
            name = _file_name(image)
            obj = objects[image] = bpy.data.objects.new(name, bpy.data.cameras.new(name))
            obj[_SOURCE], obj[FILE_IMAGE] = source, image
            collection.objects.link(obj)
        obj.parent = None  # set_camera sets world coordinates, which the parent then transforms
        set_camera(obj, camera)
        obj.parent = empty
        obj.data.display_size, obj.data.clip_end = _SMALL * size, max(obj.data.clip_end, _FAR * size)
    return [objects[image] for image in poses.cameras]


def _file_name(image: str) -> str:
    return image.replace("\\", "/").rpartition("/")[2]


class ImportCameras(bpy.types.Operator):
    """Make camera objects from a file of COLMAP (text), Agisoft Metashape (.xml) or Meshroom (.sfm). If you have moved
    the mesh, move the cameras' empty in the same way. Then choose a camera for each light"""

    bl_idname = "irpso.import_cameras"
    bl_label = "Import Cameras"
    bl_options = {"REGISTER", "UNDO"}

    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    directory: StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE"})
    filter_glob: StringProperty(default=_EXTENSIONS.replace(".", "*."), options={"HIDDEN"})
    axes: EnumProperty(name="Axes", description="Orientation of the imported mesh", items=_AXES, default="AUTO")

    def invoke(self, context, event):
        """Open the file browser for a file, or for COLMAP's folder."""
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context):
        """Make the cameras, and report those of the file that cannot be used."""
        chosen = self.filepath or self.directory
        try:
            if not chosen:
                raise InputError("no file was chosen; choose COLMAP's cameras.txt, Metashape's .xml or Meshroom's .sfm")
            poses = read_poses(absolute(chosen, "Cameras"))
        except InputError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        objects = create_cameras(context.scene, poses, self.axes)
        cameras = rpt("1 camera") if len(objects) == 1 else rpt("{count} cameras", count=len(objects))
        text = rpt("{cameras} of {program}", cameras=cameras, program=poses.program)
        if poses.unusable:
            name, why = next(iter(poses.unusable.items()))
            text += rpt("; {count} left out: '{name}' {why}", count=len(poses.unusable), name=name, why=why)
        self.report({"WARNING"} if poses.unusable else {"INFO"}, text)
        return {"FINISHED"}


def _menu(self, context) -> None:
    self.layout.operator(ImportCameras.bl_idname, text="IRPSO Cameras (COLMAP, Metashape, Meshroom)")


CLASSES = (ImportCameras,)


def register() -> None:
    """Add the entry to File > Import."""
    bpy.types.TOPBAR_MT_file_import.append(_menu)


def unregister() -> None:
    """Remove the entry."""
    bpy.types.TOPBAR_MT_file_import.remove(_menu)
