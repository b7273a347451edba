"""The automatic position of a new card, and a viewport that turns to a card."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix, Vector

_MARGIN = 0.25  # gap to objects at the origin, in widths of the card
_DISTANCE = 2.2  # viewport to card, in lengths of its longer side: a 50 mm lens then shows all of it
_POSITION = "irpso_put"  # custom property: the card's automatic position
_BODY_TYPES = {"MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME", "GPENCIL", "GREASEPENCIL"}


def free_place(context, height: float) -> np.ndarray:
    """Return the (4, 4) matrix of a card 1 wide and ``height`` high: the origin, or beside objects there."""
    bodies = [obj for obj in context.visible_objects if obj.type in _BODY_TYPES]
    corners = np.array([obj.matrix_world @ Vector(corner) for obj in bodies for corner in obj.bound_box])
    low, high = (end(corners.reshape(-1, 8, 3), axis=1) for end in (np.min, np.max))
    place = np.eye(4)
    half = np.array([0.5, 0.5 * height, 0.0]) + _MARGIN
    if ((low <= half) & (high >= -half)).all(axis=1).any():
        place[0, 3] = high[:, 0].max() + 0.5 + _MARGIN
    return place


def put_card(card: bpy.types.Object, place: np.ndarray) -> None:
    """Move a card's object to an automatic (4, 4) position; ``is_automatic`` is true until the user moves it."""
    card.matrix_world = Matrix(place.tolist())
    card[_POSITION] = [float(value) for row in card.matrix_basis for value in row]


def is_automatic(card: bpy.types.Object) -> bool:
    """Return whether a card is at its automatic position or at the origin."""
    now = np.array(card.matrix_basis).ravel()
    return np.allclose(now, np.array(card.get(_POSITION, np.eye(4).ravel()))) or np.allclose(now, np.eye(4).ravel())


def show_card(context, card: bpy.types.Object | None, place: np.ndarray, height: float) -> None:
    """Make a viewport look straight down on a card, unless the card's object is completely in view.

    The viewport is the context's own, else the window's largest. card: its object, or None for a card at
    ``place`` (4, 4), 1 wide and ``height`` high.
    """
    areas = [area for area in context.window.screen.areas if area.type == "VIEW_3D"]
    if not areas:
        return
    area = context.area if context.area in areas else max(areas, key=lambda area: area.width * area.height)
    view = area.spaces.active.region_3d
    world = Matrix(place.tolist()) if card is None else card.matrix_world
    corners = [world @ Vector((x, y * height, 0.0)) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    clip = [view.perspective_matrix @ corner.to_4d() for corner in corners]
    if card is not None and all(w > 0 and abs(x) <= w and abs(y) <= w for x, y, _, w in clip):
        return
    view.view_perspective = "PERSP" if view.view_perspective == "CAMERA" else view.view_perspective
    view.view_location = sum(corners, Vector()) / 4
    view.view_rotation = world.to_quaternion()
    view.view_distance = _DISTANCE * max((corners[2] - corners[0]).length, (corners[1] - corners[0]).length)
