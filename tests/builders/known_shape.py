"""A scene with the mesh of a matt sphere of radius 1, photographed by two cameras under lamps."""

import bpy
import numpy as np

from irpso_addon.blender.scenes.scene import camera_from_object, empty_blend
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.capture.write import write_capture
from tests.builders.command_line import dome_lights
from tests.builders.sphere import LAMPS, SIDE, STRENGTHS, sphere_photographs


def write_sphere(folder, near, moved=0.0):
    """Put the mesh into the open file and write photographs of two cameras as FOLDER/capture.

    moved: shift of the mesh along x. Return the positions (K, 3) of the lamps and their strengths.
    """
    empty_blend()
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, location=(moved, 0, 0))
    bpy.context.object.name = "Sphere"
    bpy.ops.object.shade_smooth()
    shots, cameras, masks = [], [], []
    places = 3.2 * dome_lights(LAMPS, widest=55.0)
    for number, turn in enumerate((0.0, 0.9)):
        bpy.ops.object.camera_add(location=(5 * np.sin(turn), 0, 5 * np.cos(turn)), rotation=(0, turn, 0))
        bpy.context.object.data.angle = np.radians(30)
        bpy.context.view_layer.update()
        cameras.append(camera_from_object(bpy.context.object, SIDE, SIDE))
        pictures, mask = sphere_photographs(cameras[-1], places, near)
        masks.append(mask)
        for k in range(number, LAMPS, 2):
            image = np.concatenate([pictures[k], np.ones((SIDE, SIDE, 1), np.float32)], axis=-1)
            shots.append(Observation(f"{number}-{k}", lambda i=image: i, Light((0.0, 0.0, 1.0)), number))
    write_capture(Capture("sphere", tuple(shots), tuple(cameras), tuple(masks)), folder / "capture")
    order = [*range(0, LAMPS, 2), *range(1, LAMPS, 2)]
    return places[order], STRENGTHS[order]
