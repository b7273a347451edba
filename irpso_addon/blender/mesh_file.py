"""Meshes as STL, PLY and OBJ files, by Blender's own exporters."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..core.errors import InputError
from ..core.files import replacing_file
from .mesh import mesh_of_faces
from .operators import quiet_operator

SUFFIXES = (".stl", ".ply", ".obj")


def write_mesh(path: Path, vertices: np.ndarray, quads: np.ndarray, uv: np.ndarray) -> None:
    """Write vertices (V, 3) and quads (Q, 4) into a file of one of SUFFIXES, whole or not at all.

    uv: (V, 2); STL has none. z is up in STL and PLY, y in OBJ, as is usual. The open file stays as it is. Raises
    InputError where the file cannot be written.
    """
    import bpy

    mesh = mesh_of_faces(path.stem, vertices, quads)
    mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", uv[quads.ravel()].astype(np.float32).ravel())
    obj = bpy.data.objects.new(path.stem, mesh)
    scene = bpy.context.scene
    scene.collection.objects.link(obj)
    layer = bpy.context.view_layer
    selected = [other for other in layer.objects if other.select_get()]
    try:
        for other in selected:
            other.select_set(False)
        obj.select_set(True)
        with replacing_file(path) as partial, quiet_operator():
            named = partial.with_suffix(path.suffix)  # exporters take the format from the suffix
            _export(named, path.suffix.lower())
            if named != partial:
                named.replace(partial)
    except RuntimeError as error:
        raise InputError(f"{path}: cannot be written ({str(error).strip()}); choose another place") from error
    finally:
        bpy.data.objects.remove(obj)
        bpy.data.meshes.remove(mesh)
        for other in selected:
            other.select_set(True)


def _export(path: Path, suffix: str) -> None:
    import bpy

    if suffix == ".stl":
        bpy.ops.wm.stl_export(filepath=str(path), export_selected_objects=True)
    elif suffix == ".ply":
        bpy.ops.wm.ply_export(filepath=str(path), export_selected_objects=True, export_colors="NONE")
    else:
        bpy.ops.wm.obj_export(filepath=str(path), export_selected_objects=True, export_materials=False)
