"""Photographs behind the cameras of a capture, as Blender draws them."""

import numpy as np
import pytest

from irpso_addon.capture.images.exif import upright
from tests.builders.captures import chunk, write_png
from tests.builders.exif import exif

# Of the upright photograph, 40 wide and 60 high: upper left, upper right, lower left, lower right.
COLORS = np.array([[(230, 20, 20), (20, 230, 20)], [(20, 20, 230), (230, 230, 20)]])
INVERSE = {1: 1, 2: 2, 3: 3, 4: 4, 5: 5, 6: 8, 7: 7, 8: 6}  # the orientation that undoes each


def corners_on_screen(window):
    """Return (4, 2) pixels of the screen: the camera frame's corners, clockwise from the upper right one."""
    found = window.run(
        "from bpy_extras.view3d_utils import location_3d_to_region_2d\nscene = bpy.context.scene\n"
        "frame = [scene.camera.matrix_world @ v for v in scene.camera.data.view_frame(scene=scene)]\n"
        "[tuple(location_3d_to_region_2d(bpy.context.region, bpy.context.space_data.region_3d, v)) for v in frame]"
    )
    box = window.region()
    return np.array([(box.x + x, box.y + box.height - 1 - y) for x, y in found])


@pytest.mark.parametrize("orientation", INVERSE)
def test_a_photograph_stands_upright_behind_its_camera(window, tmp_path, orientation):
    picture = np.repeat(np.repeat(COLORS, 30, axis=0), 20, axis=1)
    stored = upright(picture[::-1], INVERSE[orientation])[::-1]
    for k in range(3):
        write_png(tmp_path / f"{k}.png", stored, extra=chunk(b"eXIf", exif(orientation=orientation)))
    (tmp_path / "lights.lp").write_text("3\n0.png 0 0.6 0.8\n1.png 0.6 0 0.8\n2.png -0.6 0 0.8\n")
    window.run(
        "bpy.data.batch_remove(list(bpy.data.objects))\n"
        f"bpy.ops.irpso.import_capture(filepath={str(tmp_path / 'lights.lp')!r})\nbpy.ops.irpso.create_scene()\n"
        "scene = bpy.context.scene\nbackground = scene.camera.data.background_images[0]\n"
        "background.alpha, background.display_depth = 1.0, 'FRONT'\n"
        "if bpy.context.space_data.region_3d.view_perspective != 'CAMERA':\n    bpy.ops.view3d.view_camera()\n"
        "bpy.context.space_data.region_3d.view_camera_zoom = -15\n"
    )
    window.settle()
    right_up, right_down, left_down, left_up = corners_on_screen(window)
    size = np.array([right_up[0] - left_up[0], left_down[1] - left_up[1]])
    assert size[1] / size[0] == pytest.approx(1.5, abs=0.05) and size.min() > 100
    pixels = window.pixels().astype(int)
    for row, column in np.ndindex(2, 2):
        for reach in (0.1, 0.5, 0.9):  # of the quarter: the whole frame is filled
            at = left_up + size * (np.array([column, row]) + reach) / 2
            x, y = np.round(at).astype(int)
            assert np.abs(pixels[y, x] - COLORS[row, column]).max() < 60, (row, column, reach)
