"""A card's relief as a solid mesh file, for 3D printing and study."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..blender.mesh_file import SUFFIXES, write_mesh
from ..core.errors import InputError
from ..geometry.relief.height import TEXELS
from ..geometry.relief.solid import relief_solid
from .place import file_place, file_stem
from .result import Result

_WIDEST = 1e9  # far within a mesh file's float32
WIDTH, BASE = 100.0, 0.02  # card's width in mm, STL's unit in printing programs; base as a fraction of it


def write_relief(result: Result, out: str | Path, width: float = WIDTH, replace: bool = True) -> dict[str, Any]:
    """Write a card's relief as .stl, .ply or .obj; return the entries of the report.

    out: the file, or a folder for NAME.stl. width: of the whole card. replace: an existing file. Raises InputError
    where the result has no height or is a mesh's.
    """
    if result.height is None:
        raise InputError(f"{result.folder}: has no height; recover with --height")
    if result.height.unit != TEXELS:
        raise InputError(f"{result.folder}: its height is the fine detail of a mesh; export the mesh as gltf")
    if not 0 < width <= _WIDEST:
        raise InputError(f"--width {width:g}: give a length above 0 and up to {_WIDEST:g}")
    path = file_place(out, file_stem(result.name), SUFFIXES, replace)
    path.parent.mkdir(parents=True, exist_ok=True)
    vertices, quads = relief_solid(result.height, width, BASE * width)
    rows, columns = result.height.covered.shape
    uv = vertices[:, :2] / (width, width * rows / columns) + 0.5
    write_mesh(path, vertices, quads, uv)
    return {"output": str(path), "width": width, "depth": float(vertices[:, 2].max() - BASE * width)}
