"""The converging map on the subject in the viewport: the chosen picture, and the card's or mesh's triangles."""

from __future__ import annotations

import math
import time

import bpy
import numpy as np

from ...gpu.viewport import Surface
from ...reflectance.model import ReflectanceModel
from ...results.maps import UNKNOWN
from ...results.scales import PERCENT, round_up, steady_limit
from ...solver.interreflection.rounds import MAX_INDIRECT
from ...solver.views.display import Shown
from ..common.words import iface
from ..session.recovery import Session
from .place import Placement, card_corners, card_frame, placement_of

_BLINKS = 2.0  # pictures per second
_MEAN_TO_RED = 4.0  # error drawn red over the mean error: about the spread of errors
_RED_SHARE = 0.1  # deviation drawn red over the parameter's range
_RED_ANGLE = math.radians(10)
_PAIRS = {"SPLIT", "BLINK"}
_CARD_UVS = np.float32([(0, 0), (1, 0), (1, 1), (0, 1)])
_TWO_TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])


def wanted(view, running: Session, former_limit: float) -> tuple[Shown, ...]:
    """Return the picture chosen in a scene's ViewSettings, or two to show together: render and photograph.

    former_limit: the last error drawn red, 0 at first. An automatic limit keeps it while it is close enough.
    """
    model = running.job.model
    names = [parameter.name for parameter in model.parameters]
    parameter = view.parameter if view.parameter in names else names[0]
    observation = running.observation(view)
    if view.shown == "PARAMETER":
        return (Shown("parameter", parameter, unknown=_unknown_from(view, running, parameter)),)
    if view.shown == "ERROR":
        limit = view.red_error / PERCENT or steady_limit(_MEAN_TO_RED * (running.error or 0.0), former_limit)
        return (Shown("error", limit=limit),)
    if view.shown == "CONFIDENCE":
        return (Shown("confidence", parameter, limit=_deviation_limit(view, model, parameter)),)
    if view.shown == "INDIRECT":
        return (Shown("indirect", limit=MAX_INDIRECT),)
    exposure = 2.0**view.exposure
    render = Shown("render", observation=observation, exposure=exposure)
    reference = Shown("reference", observation=observation, exposure=exposure)
    if view.shown in _PAIRS:
        return render, reference
    return (render,) if view.shown == "RENDER" else (reference,)


def blink_index() -> int:
    """Return the index of the picture to show now, 0 or 1."""
    return int(time.perf_counter() * _BLINKS) % 2


def make_surface(running: Session) -> Surface:
    """Upload the subject's triangles that have texels, in the domain's frame."""
    positions, uvs = triangles_of(running)
    if running.mesh is not None and running.mesh.solved is not None:
        positions, uvs = positions[running.mesh.solved], uvs[running.mesh.solved]
    return Surface(positions, uvs)


def triangles_of(running: Session) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (T, 3, 3) in the domain's frame and texture coordinates (T, 3, 2), 0…1."""
    if running.mesh is not None:
        return running.mesh.positions, running.mesh.uvs
    corners = card_corners(running.domain.bake.position)
    return corners[_TWO_TRIANGLES].astype(np.float32), _CARD_UVS[_TWO_TRIANGLES]


def is_solved(running: Session, triangle: int) -> bool:
    """Return whether a triangle's material slot is recovered."""
    return running.mesh is None or running.mesh.solved is None or bool(running.mesh.solved[triangle])


def placement(running: Session, subject, corners: np.ndarray) -> Placement:
    """Return the subject's current placement. subject: its object, None for a card without an object.

    corners: (N, 3) points in the domain's frame that bound the subject.
    """
    world = running.job.place if subject is None else np.array(subject.matrix_world, np.float64)
    frame = card_frame(running.domain.bake.position) if running.mesh is None else np.linalg.inv(running.mesh.matrix)
    return placement_of(world @ frame, corners)


def bounding_corners(running: Session) -> np.ndarray:
    """Return the corners (8, 3) of the subject's bounding box in the domain's frame."""
    positions, _ = triangles_of(running)
    low, high = positions.reshape(-1, 3).min(axis=0), positions.reshape(-1, 3).max(axis=0)
    return np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])


def why_unseen(context, running: Session, subject, home_scene: int) -> str:
    """Return a sentence on why the context's viewport draws no maps on the subject, "" if it draws them.

    home_scene: session_uid of the scene for a card that has no object yet.
    """
    space, name = context.space_data, running.job.name
    if not space.overlay.show_overlays:
        return iface("Viewport overlays are off: switch them on in this viewport's header")
    if subject is None and running.mesh is not None:
        return iface("'{name}' has been deleted: undo that", name=name)
    if subject is None:
        return "" if context.scene.session_uid == home_scene else iface("The card is in another scene")
    if subject.mode != "OBJECT":  # the map would cover the user's editing or painting
        return iface(
            "'{name}' is not in Object Mode: press Tab, or choose Object Mode in the header", name=subject.name
        )
    if not subject.visible_get(view_layer=context.view_layer, viewport=space):
        return iface(
            "'{name}' is hidden in this viewport: show it in the Outliner, or leave local view", name=subject.name
        )
    return ""


def is_in_scene(scene: bpy.types.Scene, running: Session, subject, home_scene: int) -> bool:
    """Return whether a scene contains the subject, or is to contain the card once it is kept."""
    if subject is None:
        return running.mesh is None and scene.session_uid == home_scene
    return subject.name in scene.objects and scene.objects[subject.name] == subject


def shows_itself(context, running: Session) -> bool:
    """Return whether the viewport renders the kept material."""
    return running.kept and not running.active and context.space_data.shading.type in ("MATERIAL", "RENDERED")


def _unknown_from(view, running: Session, name: str) -> float:
    """Return the deviation above which a map's values are marked as unknown; 0 (no marks) during the search."""
    p = running.job.model.parameter(name)
    if not view.mark_unknown or running.active or not p.has_unknown or name in running.job.fixed:
        return 0.0
    return UNKNOWN * p.width


def _deviation_limit(view, model: ReflectanceModel, name: str) -> float:
    parameter = model.parameter(name)
    if parameter.is_normal:
        return view.red_angle or _RED_ANGLE
    return view.red_deviation or round_up(_RED_SHARE * parameter.width)
