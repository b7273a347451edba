"""The hollow bodies of the benchmark: unwrapped without overlaps, and seen by the camera."""

import bpy
import numpy as np
import pytest

from benchmarks.scenes import hollows, render
from benchmarks.scenes.textured import NAME
from irpso_addon.blender.mesh import extract_mesh
from irpso_addon.geometry.surface.bake import bake_uv

pytestmark = pytest.mark.bpy_only


@pytest.mark.parametrize("shape", ["bowl, 0.6", "vase", "cloth", "coin, metal paint", "cubes, white"])
def test_a_body_has_one_place_for_every_texel_and_faces_the_camera(shape):
    render.empty_scene(render.View(8, 8))
    hollows.HOLLOWS[shape].build()
    bake = bake_uv(extract_mesh(bpy.data.objects[NAME]), 80, 80)  # refuses overlaps
    assert bake.coverage.mean() > 0.45
    position = bake.position[bake.coverage]
    assert np.abs(position[:, :2]).max() == pytest.approx(1.1, abs=0.03)
    assert (bake.face_normal[bake.coverage][:, 2] > 0.1).mean() > 0.25
