"""A camera and a light of a capture as Blender's objects; ``scene_capture`` reads them back."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ...capture.camera import Camera
from ...capture.images.exif import upright_axes
from ...capture.types import Light
from ..colour_spaces import from_rec_709
from .light_units import area_power, point_power, spot_power, sun_strength
from .scene import ASPECT, DISTORTION, RESOLUTION
from .scene_images import stored_orientation
from .scene_lights import EMISSION, WIDEST_SPOT

_SENSOR = 36.0  # mm, Blender's own default
_AREA_SIZE = 1e-3  # of an area light, world units: a capture knows its centre alone
_POWER = {"SUN": sun_strength, "POINT": point_power, "SPOT": spot_power, "AREA": area_power}


def set_camera(obj, camera: Camera) -> None:
    """Give a camera object the projection and place of a camera, the inverse of ``scene.camera_from_object``."""
    from mathutils import Matrix

    data, (width, height) = obj.data, (camera.width, camera.height)
    tall = camera.scale[0] / camera.scale[1]  # of a pixel, over its width
    data.type = "PERSP" if camera.perspective else "ORTHO"
    data.sensor_fit = "HORIZONTAL"
    if camera.perspective:
        data.sensor_width = max(_SENSOR, width / camera.scale[0])  # a lens is 1 mm or longer
        data.lens = data.sensor_width * camera.scale[0] / width
    else:
        data.ortho_scale = width / camera.scale[0]
    data.shift_x = (width / 2 - camera.centre[0]) / width
    data.shift_y = (height / 2 - camera.centre[1]) * tall / width
    obj[RESOLUTION] = width, height
    obj[ASPECT] = (max(1.0, 1 / tall), max(1.0, tall))
    _store(obj, DISTORTION, camera.distortion)
    obj.rotation_mode = "QUATERNION"  # Euler angles lose half of the digits near a quarter turn
    obj.matrix_world = Matrix(camera.matrix.tolist())


def set_background(obj, image) -> None:
    """Show a photograph behind a camera of ``set_camera``, upright: Blender does not apply the EXIF orientation."""
    data = obj.data
    data.show_background_images = True
    background = data.background_images[0] if data.background_images else data.background_images.new()
    background.image = image
    orientation = 1 if image is None else stored_orientation(image)
    turn = upright_axes(orientation)[:2, :2]
    # Blender flips the stored picture, turns it clockwise, and lays it around the frame's centre.
    background.use_flip_x, background.use_flip_y = bool(np.linalg.det(turn) < 0), False
    turn = turn @ np.diag([-1.0 if background.use_flip_x else 1.0, 1.0])
    background.rotation = math.atan2(turn[0, 1], turn[0, 0])
    background.frame_method, background.scale = "STRETCH", 1.0  # to the frame, which is the photograph's own
    if orientation >= 5:  # before a quarter turn the picture fits across the frame
        background.frame_method, background.scale = "FIT", max(obj[RESOLUTION]) / min(obj[RESOLUTION])


def set_light(obj, light: Light, centre=(0.0, 0.0, 0.0), radius: float = 1.0) -> None:
    """Set a light object to a light, the inverse of ``scene_lights.light_of``. A distant one is put on a dome.

    centre, radius: of the dome, world units. A light with an axis that differs with no direction becomes a Point.
    """
    from mathutils import Vector

    colour = from_rec_709(np.array(light.intensity))
    strongest = float(colour.max())
    obj.data.type = _type_of(light)
    data = obj.data  # its class has changed with its type
    data.color = (colour / strongest).tolist()
    for name, value in (("exposure", 0.0), ("normalize", True), ("use_temperature", False)):
        if hasattr(data, name):  # since Blender 4.5
            setattr(data, name, value)
    data.energy = _POWER[data.type](strongest)
    _set_shape(data, light)
    # Emission that no Blender lamp has: a cone with a cosine, another power of it, a very wide cone.
    unlike = (light.cosine and light.cone is not None) or light.cosine not in (0, 1) or (light.cone or 0) > WIDEST_SPOT
    _store(obj, EMISSION, (light.cone or 0.0, light.cosine) if unlike else ())
    vector = Vector(light.vector)
    backward = vector if light.distant else -Vector(light.axis or (0, 0, -1))
    obj.rotation_mode = "QUATERNION"
    obj.rotation_quaternion = backward.to_track_quat("Z", "Y")
    obj.location = Vector(centre) + radius * vector if light.distant else vector


def _type_of(light: Light) -> str:
    if light.distant:
        return "SUN"
    return "AREA" if light.cosine else "POINT" if light.cone is None else "SPOT"


def _set_shape(data, light: Light) -> None:
    if data.type == "SUN":
        data.angle = 0.0
    elif data.type == "AREA":
        data.shape, data.size, data.spread = "SQUARE", _AREA_SIZE, math.pi
    else:
        data.shadow_soft_size = 0.0
    if data.type == "SPOT":
        data.spot_size, data.spot_blend, data.use_square = 2 * math.radians(min(light.cone, WIDEST_SPOT)), 0.0, False


def _store(obj, name: str, values: Sequence[float]) -> None:
    """Set an object's custom property, or remove it if there are no values."""
    if values:
        obj[name] = [float(value) for value in values]
    elif name in obj:
        del obj[name]
