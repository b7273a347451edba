"""Meshes and cameras of Blender scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...capture.camera import Camera
from ...capture.distortion import NAMES
from ...capture.errors import CaptureError
from ...capture.poses import upright_camera
from ...core.errors import InputError
from ..operators import quiet_operator

# Custom properties of camera objects: lens distortion, which Blender's cameras do not have; pixel aspect (x, y), which
# Blender has only per scene; the image's size (width, height); of an imported camera, its image's name in the file.
DISTORTION, ASPECT, RESOLUTION = "irpso_distortion", "irpso_pixel_aspect", "irpso_resolution"
FILE_IMAGE = "irpso_camera_image"
_OTHERS = {".obj", ".ply", ".stl", ".fbx", ".glb", ".gltf", ".usd", ".usda", ".usdc", ".usdz", ".abc", ".dae", ".3ds"}


def open_blend(path: str | Path) -> None:
    """Open a .blend file in place of the current one. Raises InputError where it is missing or Blender refuses it."""
    import bpy

    path = Path(path)
    if not path.is_file():
        raise InputError(f"there is no Blender file '{path}'; check the path given to --blend")
    if path.suffix.lower() in _OTHERS:
        raise InputError(f"'{path}' is no .blend file; import it in Blender, save the scene, and give that file")
    try:
        with quiet_operator():
            bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False)
    except RuntimeError as error:
        raise InputError(f"Blender cannot open '{path}': {' '.join(str(error).split())}") from error


def empty_blend() -> None:
    """Open an empty file in place of the current one, without Blender's default cube, lamp and camera."""
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True, load_ui=False)


def mesh_object(name: str | None = None) -> Any:
    """Return the mesh object of that name, or the scene's only one. Raises InputError that lists the candidates."""
    import bpy

    if name is not None:
        found = bpy.context.scene.objects.get(name)
        if found is None:
            raise InputError(f"there is no object '{name}' in scene '{bpy.context.scene.name}'; {_choice()}")
        if found.type != "MESH":
            raise InputError(f"object '{name}' is of type {found.type}, not a mesh; {_choice()}")
        return found
    meshes = _meshes()
    if len(meshes) == 1:
        return meshes[0]
    if not meshes:
        raise InputError(f"scene '{bpy.context.scene.name}' has no mesh objects; open a file that has one")
    raise InputError(f"the scene has {len(meshes)} mesh objects; choose one with --object: {_names()}")


def _meshes() -> list[Any]:
    import bpy

    return [obj for obj in bpy.context.scene.objects if obj.type == "MESH"]


def _names() -> str:
    return ", ".join(f"'{obj.name}'" for obj in _meshes())


def _choice() -> str:
    return f"its mesh objects are {_names()}" if _meshes() else "it has no mesh objects"


def camera_from_object(obj: Any, width: int, height: int, pixel_aspect: tuple[float, float] = (1.0, 1.0)) -> Camera:
    """Return the camera of a Blender camera object at width × height pixels: lens, sensor fit, shift, and scale.

    pixel_aspect: the render settings' pixel aspect x and y. Clip distances and depth of field are ignored; distortion
    comes from the custom property irpso_distortion.
    Raises InputError where the object is not a camera or its projection is neither perspective nor orthographic.
    """
    if obj.type != "CAMERA":
        raise InputError(f"object '{obj.name}' is of type {obj.type}, not a camera; name a camera object")
    data, matrix = obj.data, world_matrix(obj)
    matrix[:3, :3] /= np.linalg.norm(matrix[:3, :3], axis=0)
    if data.type not in ("PERSP", "ORTHO"):
        raise InputError(f"camera '{obj.name}' is panoramic; make it perspective or orthographic")
    fit = data.sensor_fit
    if fit == "AUTO":
        fit = "HORIZONTAL" if width * pixel_aspect[0] >= height * pixel_aspect[1] else "VERTICAL"
    # The unit of Blender's view plane is the width of a pixel; a pixel is `tall` units high.
    tall = pixel_aspect[1] / pixel_aspect[0]
    side = width if fit == "HORIZONTAL" else height * tall
    if data.type == "PERSP":
        sensor = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
        scale = data.lens / sensor * side
    else:
        scale = side / data.ortho_scale
    camera = Camera(
        width=width,
        height=height,
        scale=(scale, scale / tall),
        centre=(width / 2 - data.shift_x * side, height / 2 - data.shift_y * side / tall),
        matrix=matrix,
        perspective=data.type == "PERSP",
    )
    return _distorting(camera, obj)


def scene_cameras(names: Sequence[str], size: tuple[int, int]) -> list[Camera]:
    """Return the cameras of these names in the open scene at (width, height) pixels, the active one for none.

    Raises InputError where there is none.
    """
    import bpy

    scene = bpy.context.scene
    if not names:
        if scene.camera is None:
            raise InputError(f"scene '{scene.name}' has no active camera; name one with --camera")
        return [camera_in_scene(scene.camera, *size, scene)]
    if missing := [name for name in names if name not in scene.objects]:
        raise InputError(f"--camera {missing[0]}: there is no such object in scene '{scene.name}'")
    return [camera_in_scene(scene.objects[name], *size, scene) for name in names]


def camera_in_scene(obj: Any, width: int, height: int, scene: Any) -> Camera:
    """Return the camera of an object, with the pixels of its custom property, else of the scene's render settings."""
    aspect = obj.get(ASPECT, (scene.render.pixel_aspect_x, scene.render.pixel_aspect_y))
    return camera_from_object(obj, width, height, tuple(aspect))


def camera_of_photographs(obj: Any, width: int, height: int, scene: Any, turned_by: int) -> Camera:
    """Return the camera of an object that took upright photographs of width × height pixels.

    An imported camera is that of the stored pictures. turned_by: the EXIF orientation that turns them upright.
    Raises InputError where its photographs have other proportions.
    """
    if FILE_IMAGE not in obj or RESOLUTION not in obj:
        return camera_in_scene(obj, width, height, scene)
    stored = camera_in_scene(obj, *obj[RESOLUTION], scene)
    return upright_camera(stored, width, height, turned_by, f"camera '{obj.name}'")


def _distorting(camera: Camera, obj: Any) -> Camera:
    """Return the camera with the distortion of its object's custom property. Raises InputError."""
    stored = obj.get(DISTORTION, ())
    where = f"camera '{obj.name}': its custom property {DISTORTION}"
    try:
        return replace(camera, distortion=tuple(map(float, stored if hasattr(stored, "__len__") else (stored,))))
    except (TypeError, ValueError) as error:
        raise InputError(f"{where} holds no numbers; they are {', '.join(NAMES)}, or remove it") from error
    except CaptureError as error:
        raise InputError(f"{where} cannot be: {error}") from error


def middle_of(obj: Any) -> np.ndarray:
    """Return (3,) the centre of an object's bounding box, in world space."""
    corners = np.array([tuple(corner) for corner in obj.bound_box])
    matrix = world_matrix(obj)
    return matrix[:3, :3] @ corners.mean(axis=0) + matrix[:3, 3]


def world_matrix(obj: Any) -> np.ndarray:
    """Return (4, 4) float64, an object's world matrix, also where it is disabled in viewports.

    Blender does not evaluate objects that are disabled in viewports: their matrix_world is outdated, or unset in a file
    just opened. For them this multiplies the transforms of the object and its parents. One whose place or data come
    from constraints, animation or drivers is shown meanwhile, which also brings its data to the current frame. Raises
    InputError where it is hidden otherwise.
    """
    import bpy

    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    if evaluated.is_evaluated:
        return np.array(evaluated.matrix_world, np.float64)
    if obj.constraints or (obj.parent is not None and obj.parent_type != "OBJECT") or _is_animated(obj, obj.data):
        return _matrix_shown(obj)
    matrix = np.array(obj.matrix_basis, np.float64)
    if obj.parent is None:
        return matrix
    return world_matrix(obj.parent) @ np.array(obj.matrix_parent_inverse, np.float64) @ matrix


def _is_animated(*owners: Any) -> bool:
    """Return whether a keyframe or a driver may set a value of one of these."""
    found = [owner.animation_data for owner in owners if owner is not None]
    return any(data is not None and (data.action or data.drivers or data.nla_tracks) for data in found)


def _matrix_shown(obj: Any) -> np.ndarray:
    """Return the world matrix that an object disabled in viewports has when it is shown. Raises InputError."""
    import bpy

    disabled = obj.hide_viewport
    obj.hide_viewport = False
    try:
        owner = obj
        while owner is not None:  # Blender does not bring what is shown again to the current frame
            owner.update_tag(refresh={"TIME"})
            owner = owner.parent
        if obj.data is not None:
            obj.data.update_tag(refresh={"TIME"})
        evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
        if not evaluated.is_evaluated:
            raise InputError(
                f"object '{obj.name}' is hidden and has constraints, animation or drivers; show it in the viewport, or"
                " apply them"
            )
        return np.array(evaluated.matrix_world, np.float64)
    finally:
        obj.hide_viewport = disabled
