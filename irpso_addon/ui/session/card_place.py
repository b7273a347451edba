"""Where a card stands that has no object yet, and turning a viewport to it."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix, Vector

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


def show_card(context, card: bpy.types.Object | None, place: np.ndarray, height: float) -> None:
    """Turn a viewport to a card, from straight above it, unless the card's object is in sight there already.

    The viewport is the context's own, else the window's largest. card: its object, None where there is none yet:
    ``place`` (4, 4) then says where it is going to stand, 1 wide and ``height`` high.
    """
    areas = [area for area in context.window.screen.areas if area.type == "VIEW_3D"]
    if not areas:
        return
    area = context.area if context.area in areas else max(areas, key=lambda area: area.width * area.height)
    view = area.spaces.active.region_3d
    world = Matrix(place.tolist()) if card is None else card.matrix_world
    corners = [world @ Vector((x, y * height, 0.0)) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    if card is not None and all(_in_sight(view.perspective_matrix, corner) for corner in corners):
        return
    view.view_perspective = "PERSP" if view.view_perspective == "CAMERA" else view.view_perspective
    view.view_location = sum(corners, Vector()) / 4
    view.view_rotation = world.to_quaternion()
    view.view_distance = _DISTANCE * max((corners[2] - corners[0]).length, (corners[1] - corners[0]).length)


def _in_sight(perspective: Matrix, point: Vector) -> bool:
    x, y, _, w = perspective @ point.to_4d()
    return w > 0 and abs(x) <= w and abs(y) <= w


def _bounds(obj: bpy.types.Object) -> np.ndarray:
    """Return (2, 3) the lowest and the highest corner of an object's box in the world."""
    corners = np.array([obj.matrix_world @ Vector(corner) for corner in obj.bound_box])
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


CLASSES = ()
