"""Lights of Blender scenes as lights of a capture."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ...capture.types import Light
from ...core.errors import InputError
from ..colour_spaces import to_rec_709
from .light_units import area_intensity, point_intensity, spot_cone, spot_intensity, sun_intensity
from .scene import world_matrix

LIGHT_TYPES = ("SUN", "POINT", "SPOT", "AREA")
# Custom property of a light: its cone in degrees (0 for none), and the power of the cosine with which it falls (0 for
# none). No Blender light has both. It counts as long as the light's own settings are those of ``set_light``.
EMISSION = "irpso_emission"
WIDEST_SPOT = 90.0  # degrees from the axis: the widest cone that Blender's spots have
# A light wider than this fraction of its distance is no point: a disk gives 1 % less than a point at its centre
# (1 / (1 + tan² of its half-angle)) and spans 11°, which blurs highlights.
WIDEST = 0.2
_INTENSITY = {"SUN": sun_intensity, "POINT": point_intensity, "SPOT": spot_intensity, "AREA": area_intensity}
_EVEN = 1e-4  # largest difference of a spot's scales, which stretch its cone
_SAME = 1e-3  # degrees: tolerance of a cone, for float32


def light_of(obj: Any) -> Light:
    """Return a Blender light object as a light: a spot inside its cone, an area light as a point at its centre.

    Raises InputError, with the object's name, where it gives no light or its emission pattern is not supported.
    """
    # The matrix first: it brings the data of a light that is disabled in viewports to the current frame.
    matrix, data, where = world_matrix(obj), obj.data, f"light '{obj.name}'"
    if not getattr(data, "normalize", True):
        raise InputError(f"{where} is not normalized, so its size changes its strength; turn Normalize on")
    power = data.energy * 2.0 ** getattr(data, "exposure", 0.0)
    colour = np.array(data.color, np.float64) * _node_gain(data, where)
    if getattr(data, "use_temperature", False):
        colour *= np.array(data.temperature_color, np.float64)
    distant = data.type == "SUN"
    intensity = to_rec_709(colour) * _INTENSITY[data.type](power)
    if (intensity < 0).any() or not intensity.any():
        raise InputError(f"{where} gives {'negative' if intensity.any() else 'no'} light; set its strength and colour")
    vector = matrix[:3, 2] / np.linalg.norm(matrix[:3, 2]) if distant else matrix[:3, 3]
    light = Light(tuple(map(float, vector)), tuple(map(float, intensity)), distant)
    return _directed(light, obj, matrix[:3, :3], where) if data.type in ("SPOT", "AREA") else light


def too_wide(obj: Any, place: np.ndarray) -> str:
    """Return a warning about a light too wide to act as a point, as seen from ``place`` (3,), else ""."""
    data, matrix = obj.data, world_matrix(obj)
    if data.type == "SUN":
        most = 2 * math.atan(WIDEST / 2)
        if data.angle <= most:
            return ""
        return (
            f"light '{obj.name}' spans {math.degrees(data.angle):.3g}°, and is used as one direction; set its Angle to"
            f" at most {math.degrees(most):.3g}° for sharp highlights"
        )
    if data.type == "AREA":
        sides = (data.size, data.size_y if data.shape in ("RECTANGLE", "ELLIPSE") else data.size)
        width = float(max(side * np.linalg.norm(matrix[:3, axis]) for axis, side in enumerate(sides)))
    else:
        width = 2 * data.shadow_soft_size  # a sphere's radius, which the object's scale does not change
    distance = float(np.linalg.norm(matrix[:3, 3] - place))
    if width <= WIDEST * distance:
        return ""
    return (
        f"light '{obj.name}' is {width:.3g} wide, {distance:.3g} from the subject, and is used as a point; make it"
        f" at most {WIDEST * distance:.3g} wide, or move it away, for sharp highlights"
    )


def _directed(light: Light, obj: Any, axes: np.ndarray, where: str) -> Light:
    """Return the light of a spot or an area light, which point along −z."""
    data = obj.data
    axis = tuple(map(float, -axes[:, 2] / np.linalg.norm(axes[:, 2])))
    own_cone, cosine = map(float, obj.get(EMISSION, (0.0, 0.0)))
    if data.type == "AREA":
        if data.spread < math.pi - _EVEN:
            raise InputError(
                f"{where} has a Spread of {math.degrees(data.spread):.0f}°, which is not supported; set it to 180°"
            )
        if not cosine:  # that of a former spot
            return replace(light, axis=axis, cosine=1.0)
        return replace(light, axis=axis, cone=own_cone or None, cosine=cosine)
    scales = np.linalg.norm(axes, axis=0)
    if data.use_square or np.ptp(scales) > _EVEN * scales.max():
        raise InputError(f"{where} has a cone that is not round; turn Square off, and scale it evenly")
    cone = spot_cone(data.spot_size, data.spot_blend)
    if cone <= 0:
        raise InputError(f"{where} reaches full strength nowhere; lower Blend")
    if not cosine and cone > WIDEST_SPOT - _SAME:
        cone = max(cone, own_cone)
    return replace(light, axis=axis, cone=cone)


def _node_gain(data: Any, where: str) -> np.ndarray:
    """Return (3,) the gain of a light's nodes: strength times colour of a plain Emission."""
    if not data.use_nodes or data.node_tree is None:
        return np.ones(3)
    output = data.node_tree.get_output_node("ALL")
    links = output.inputs["Surface"].links if output else ()
    node = links[0].from_node if links else None
    if node is None or node.bl_idname != "ShaderNodeEmission" or any(socket.is_linked for socket in node.inputs):
        raise InputError(f"{where} has nodes other than a plain Emission; remove them, or turn Use Nodes off")
    return np.array(node.inputs["Color"].default_value[:3]) * node.inputs["Strength"].default_value
