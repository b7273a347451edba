"""A flat card under near lights and a perspective camera, in any unit of length."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from irpso_addon.capture.camera import Camera
from irpso_addon.capture.images.exr import write_exr
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.capture.write import write_capture
from tests.builders.command_line import dome_lights, smooth_maps
from tests.oracles import reflectance as oracles

SHAPE = (16, 24)  # rows, columns
DISTANCE = 420.0  # millimetres, like the lamps' positions, 260 from the card's centre
LAMPS, _POWER = 260.0 * dome_lights(16, widest=60.0) - (0.0, 0.0, DISTANCE), 1.4 * 260.0**2


def near_card(unit=1.0, camera=None, values=None, **changes):
    """Return the capture of a matt card and its maps. unit: of length, millimetres; changes: of the Capture."""
    values = values or smooth_maps(SHAPE, {}, seed=3)
    height, width = shape = values["normal"].shape[:2]
    camera = camera or Camera.from_fov(width, height, 30.0)
    points = replace(camera, matrix=np.eye(4)).points(DISTANCE / unit)
    view = oracles.unit(-points) if camera.perspective else np.array([0.0, 0.0, 1.0])
    shots = []
    for k, place in enumerate(LAMPS / unit):
        toward = place - points
        strength = _POWER / unit**2 / (toward**2).sum(axis=-1, keepdims=True)
        radiance = oracles.lambert(values, oracles.unit(toward), view) * strength
        image = np.concatenate([radiance, np.ones((*shape, 1))], axis=-1).astype(np.float32)
        light = Light(tuple(map(float, place)), (_POWER / unit**2,) * 3, False)
        shots.append(Observation(f"lamp {k}", lambda image=image: image, light))
    options = {"card_distance": DISTANCE / unit, **changes}
    return Capture("card", tuple(shots), (camera,), (np.ones(shape, bool),), **options), values


def write_near_card(folder, **settings):
    """Write the capture of ``near_card`` and its normals as ``truth.exr``; return the folder."""
    folder = Path(folder)
    capture, values = near_card(**settings)
    write_capture(capture, folder)
    write_exr(folder.parent / "truth.exr", {"normal": {c: values["normal"][..., i] for i, c in enumerate("XYZ")}})
    return folder


def write_unlit_card(folder, border=(0, 0)):
    """Write a flat card of 40 × 60 pixels without lights and distance; return the capture with them.

    border: rows and columns of black table on each side of it.
    """
    rows, columns = border
    shape = 40 + 2 * rows, 60 + 2 * columns
    values = smooth_maps(shape, {}, seed=3) | {"normal": np.broadcast_to((0.0, 0.0, 1.0), (*shape, 3))}
    card = np.zeros((*shape, 1))
    card[rows : rows + 40, columns : columns + 60] = 1
    values["base_color"] = values["base_color"] * card
    capture, _ = near_card(values=values)
    unlit = tuple(replace(shot, light=Light((0.0, 0.0, 1.0))) for shot in capture.observations)
    write_capture(replace(capture, observations=unlit, card_distance=None), folder)
    return capture
