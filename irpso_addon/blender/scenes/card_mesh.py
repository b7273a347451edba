"""A flat card as a mesh of its own file, for captures whose cameras differ."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..operators import quiet_operator
from .true_surface import smooth_mesh

CARD = "Card"


def save_card(path: Path, field: tuple[float, float, float, float]) -> None:
    """Write a .blend with one rectangle, x0, y0, x1, y1 in the plane z = 0, which faces +z and fills its UV square.

    The open file stays as it is.
    """
    import bpy

    x0, y0, x1, y1 = field
    places = np.array([(x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0)], float)
    uv = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float)
    scene = bpy.data.scenes.new(CARD)
    made = smooth_mesh(scene, CARD, places, np.arange(4)[None], uv)
    mesh = made.data
    scene.view_layers[0].update()  # Blender 5.2.3 crashes where it writes a scene that was never updated
    try:
        with quiet_operator():
            bpy.data.libraries.write(str(path), {scene}, fake_user=True)
    finally:
        bpy.data.scenes.remove(scene)
        bpy.data.objects.remove(made)
        bpy.data.meshes.remove(mesh)
