"""Where a card stands that has no object yet, and turning a viewport to it."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix, Quaternion, Vector

_MARGIN = 0.25  # of a card's width, beside what stands at the origin already
_DISTANCE = 2.2  # of a viewport from a card, in the longer of its sides: a lens of 50 mm then shows all of it
_PUT = "irpso_put"  # the place that a card was given
_HAVE_BODIES = {"MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME", "GPENCIL", "GREASEPENCIL"}


def free_place(context, height: float) -> np.ndarray:
    """Return (4, 4) the place of a card 1 wide and ``height`` high: the origin, or beside what stands there already."""
    boxes = np.array([_bounds(obj) for obj in context.visible_objects if obj.type in _HAVE_BODIES]).reshape(-1, 2, 3)
    place = np.eye(4)
    half = np.array([0.5, 0.5 * height, 0.0]) + _MARGIN
    if ((boxes[:, 0] <= half) & (boxes[:, 1] >= -half)).all(axis=1).any():
        place[0, 3] = boxes[:, 1, 0].max() + 0.5 + _MARGIN
    return place


def put_card(card: bpy.types.Object, place: np.ndarray) -> None:
    """Put a card's object at a (4, 4) place that nobody chose: ``is_free`` knows it until somebody moves it."""
    card.matrix_world = Matrix(place.tolist())
    card[_PUT] = [float(value) for row in card.matrix_basis for value in row]


def is_free(card: bpy.types.Object) -> bool:
    """Return whether a card stands where it was put by itself, or was never put anywhere."""
    now = np.array(card.matrix_basis).ravel()
    return np.allclose(now, np.array(card.get(_PUT, np.eye(4).ravel()))) or np.allclose(now, np.eye(4).ravel())


def look_at_card(context, place: np.ndarray, height: float) -> None:
    """Turn the viewport of a context to a card, from straight above; no other kind of area is changed."""
    space = context.space_data
    if space is None or space.type != "VIEW_3D":
        return
    view = space.region_3d
    view.view_perspective = "PERSP" if view.view_perspective == "CAMERA" else view.view_perspective
    view.view_location = Vector(place[:3, 3])
    view.view_rotation = Quaternion()
    view.view_distance = _DISTANCE * max(1.0, height)


def _bounds(obj: bpy.types.Object) -> np.ndarray:
    """Return (2, 3) the lowest and the highest corner of an object's box in the world."""
    corners = np.array([obj.matrix_world @ Vector(corner) for corner in obj.bound_box])
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


CLASSES = ()
