"""``render MAPS``: renders a capture from maps, a mesh, cameras and lights with the solver's shaders."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..blender.materials.tangent_frames import maps_from_blender
from ..blender.mesh import extract_mesh
from ..blender.scenes.scene import mesh_object, open_blend, scene_cameras
from ..capture.formats.lists import read_numbers
from ..capture.types import Light
from ..capture.write import write_capture
from ..core.encode import nearest_covered
from ..core.errors import InputError
from ..core.files import check_unused
from ..core.paths import DEFAULT_MODEL
from ..core.progress_bar import ProgressBar
from ..exports.result import model_of_result
from ..geometry.surface.bake import bake_camera
from ..gpu import context, probe
from ..reflectance.model import ReflectanceModel, load_model
from ..results.read import read_coverage, read_maps, unknown_maps
from ..solver.settings.fixed import check_map
from ..solver.views.forward import Renderer, camera_renderer, dome, rendered_capture, sampled, with_unit_normals
from .options.values import silent, size_option, warn


def run(options: Namespace) -> dict:
    """Render every camera under every light and write the capture. Raises InputError."""
    stated = load_model(options.model) if options.model else model_of_result(options.maps)
    model = stated or load_model(DEFAULT_MODEL)
    size = size_option("--size", options.size)
    lights = _lights(options)
    check_unused(Path(options.output), "choose a new folder for the capture")
    probe.probe()
    context.ensure()
    open_blend(options.blend)
    mesh = extract_mesh(mesh_object(options.object))
    values = complete_maps(read_maps(options.maps, model, mesh.tiles), model)
    cameras = scene_cameras(options.camera, size)
    bar = ProgressBar("render", silent(options))
    bakes = [bake_camera(mesh, camera) for camera in cameras]
    renderers: list[Renderer] = []
    recovered = _recovered(options.maps, mesh.tiles)
    shown_count = empty_count = filled_count = 0
    for bake, camera in zip(bakes, cameras, strict=True):
        shown = sampled(values, bake.uv, len(mesh.tiles))
        for name, value in shown.items():
            check_map(model, name, value, bake.coverage, f"{options.maps}: {name}")
        shown_count += np.count_nonzero(bake.coverage)
        empty_count += np.count_nonzero(bake.coverage & ~shown[model.normal].any(axis=-1))
        if recovered is not None:
            near = sampled({"": recovered}, bake.uv, len(mesh.tiles))[""][..., 0] >= 0.5
            filled_count += np.count_nonzero(bake.coverage & ~near)
        turned = maps_from_blender(model, with_unit_normals(model, shown), mesh, bake)
        renderers.append(camera_renderer(bake, model, turned, camera, lights))
    masks = [bake.coverage for bake in bakes]
    capture = rendered_capture(Path(options.output).name, renderers, cameras, masks, lights, bar.show)
    write_capture(capture, options.output)
    bar.close()
    for renderer in renderers:
        renderer.close()
    if stated is None and (names := unknown_maps(options.maps, model, mesh.tiles)):
        warn([f"{options.maps}: {', '.join(names)}: model {model.name} has no such maps; give theirs by --model"])
    if empty_count:
        warn([f"the maps have no normal at {empty_count / shown_count:.1%} of what shows, which is black"])
    if filled_count:
        share = filled_count / shown_count
        warn([f"the maps have no recovered value at {share:.1%} of what shows, which is filled from other texels"])
    if not silent(options):
        sys.stdout.write(f"{len(capture.observations)} photographs written to {options.output}\n")
    return {"output": options.output, "images": len(capture.observations)}


def _recovered(path: str, tiles: Sequence[int]) -> np.ndarray | None:
    """Return (H, W, 1) float32: 1 at solved texels and beside them, where islands end, else 0; None if unknown."""
    covered = read_coverage(path, tiles)
    if covered is None:
        return None
    rows, columns, *_ = nearest_covered(covered, 2)
    covered[rows, columns] = True
    return covered[..., None].astype(np.float32)


def complete_maps(values: dict[str, np.ndarray], model: ReflectanceModel) -> dict[str, np.ndarray]:
    """Return the maps, with the model's defaults for missing ones. Raises InputError if sizes differ."""
    sizes = {value.shape[:2] for value in values.values()}
    if len(sizes) > 1:
        raise InputError(f"the maps differ in size: {', '.join(f'{w} × {h}' for h, w in sorted(sizes))}; resample them")
    height, width = sizes.pop()
    defaults = {p.name: np.broadcast_to(np.float32(p.default), (height, width, p.components)) for p in model.parameters}
    return defaults | values


def _lights(options: Namespace) -> list[Light]:
    if options.lights:
        rows = read_numbers(Path(options.lights), "give a file with one light direction per line: x y z")
        for line, row in rows:
            if len(row) != 3 or not np.isfinite(row).all() or not np.any(row):
                raise InputError(f"{options.lights}: line {line}: write the three numbers of a direction, not all zero")
        directions = np.array([np.divide(row, np.linalg.norm(row)) for _, row in rows])
    else:
        directions = dome(*size_option("--dome", options.dome))
    return [Light(tuple(float(v) for v in direction)) for direction in directions]
