"""Rasterization of triangles on the GPU: the surface at each pixel's centre."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import context, textures
from .compiler import compile_shader
from .library import read_source
from .textures import Texture

SURFACE = ("position", "normal", "tangent", "uv", "face")
MAX_TRIANGLES = (1 << 24) - 1  # shaders write triangle numbers, from 1, as float32, which holds no larger integers
_TRIANGLES_A_ROW = 1024  # 3072 texels: below every device's limit, and 16 million triangles fit 16384 rows


def rasterize(
    places: np.ndarray, corners: dict[str, np.ndarray], width: int, height: int, nearest: bool
) -> dict[str, np.ndarray]:
    """Draw T triangles; return the surface at every pixel's centre as (height, width, 4) float32 arrays.

    places: (T, 3, 4) float64 x·w, y·w in pixels from the picture's lower left corner, depth·w with depth in −1…1 (near
    to far), w. Parts with w ≤ 0 or a depth outside are clipped. corners: positions (T, 3, 3), normals (T, 3, 3),
    tangents (T, 3, 4) with the sign, uvs (T, 3, 2). nearest: keep the nearest triangle, else the last.

    position: xyz, coverage 0 or 1. normal: xyz unit. tangent: xyz unit, perpendicular to the normal, sign. uv: u, v.
    face: xyz unit normal of the flat triangle, on the normal's side; triangle number, from 1.
    """
    context.ensure()
    middle = places[..., :2] - places[..., 3:] * np.array([width / 2, height / 2])
    samplers = {
        "u_place": np.concatenate([middle, places[..., 3:]], axis=-1),
        "u_position": np.concatenate([corners["positions"], corners["uvs"][..., :1]], axis=-1),
        "u_normal": np.concatenate([corners["normals"], corners["uvs"][..., 1:]], axis=-1),
        "u_tangent": corners["tangents"],
    }
    outputs = [f"out_{name}" for name in SURFACE]
    shader = _shader("bake/surface.glsl", [(name, "VEC4") for name in outputs], list(samplers))
    batch = _batch(_clip(places, width, height), np.arange(3 * len(places), dtype=np.int32))
    bound = {name: textures.upload(_rows(array)) for name, array in samplers.items()}
    targets = [textures.empty(width, height) for _ in outputs]
    _draw(shader, batch, targets, nearest, bound)
    return {name: textures.download(target) for name, target in zip(SURFACE, targets, strict=True)}


def triangle_numbers(places: np.ndarray, width: int, height: int, first: bool) -> np.ndarray:
    """Return (height, width) int32: the first or the last triangle over each pixel's centre, from 1; 0 for none."""
    return _numbers(places, width, height, first, nearest=False)


def nearest_triangles(places: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return (height, width) int32: the nearest triangle over each pixel's centre, from 1; 0 for none."""
    return _numbers(places, width, height, first=False, nearest=True)


def _numbers(places: np.ndarray, width: int, height: int, first: bool, nearest: bool) -> np.ndarray:
    context.ensure()
    order = np.arange(3 * len(places), dtype=np.int32)
    clip = _clip(places, width, height)
    if first:
        order, clip = order[::-1].copy(), clip.reshape(-1, 4)[::-1]
    target = textures.empty(width, height, "R32F")
    shader = _shader("bake/triangle.glsl", [("out_triangle", "FLOAT")], [])
    _draw(shader, _batch(clip, order), [target], nearest, {})
    return textures.download(target)[..., 0].astype(np.int32)


def _clip(places: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return (T, 3, 4) float32 clip coordinates."""
    clip = np.array(places, np.float64)
    clip[..., :2] = 2 * clip[..., :2] / np.array([width, height]) - clip[..., 3:]
    return clip.astype(np.float32)


def _rows(array: np.ndarray) -> np.ndarray:
    """Return (T, 3, C) as a picture (rows, columns, C) within every texture limit."""
    count = len(array)
    columns = min(count, _TRIANGLES_A_ROW)
    rows = -(-count // columns)
    padded = np.zeros((rows * columns, *array.shape[1:]), np.float32)
    padded[:count] = array
    return padded.reshape(rows, columns * 3, -1)


def _batch(clip: np.ndarray, order: np.ndarray) -> Any:
    import gpu

    layout = gpu.types.GPUVertFormat()
    layout.attr_add(id="place", comp_type="F32", len=4, fetch_mode="FLOAT")
    layout.attr_add(id="corner", comp_type="I32", len=1, fetch_mode="INT")
    vertices = gpu.types.GPUVertBuf(layout, len(order))
    vertices.attr_fill("place", np.ascontiguousarray(clip.reshape(-1, 4)))
    vertices.attr_fill("corner", order)
    return gpu.types.GPUBatch(type="TRIS", buf=vertices)


def _shader(source: str, outputs: list[tuple[str, str]], samplers: list[str]) -> Any:
    import gpu

    def info() -> Any:
        create_info = gpu.types.GPUShaderCreateInfo()
        create_info.vertex_in(0, "VEC4", "place")
        create_info.vertex_in(1, "INT", "corner")
        between = gpu.types.GPUStageInterfaceInfo("bake")
        between.flat("INT", "v_triangle")
        create_info.vertex_out(between)
        for slot, name in enumerate(samplers):
            create_info.sampler(slot, "FLOAT_2D", name)
        if samplers:
            create_info.push_constant("VEC2", "u_size")
        for slot, (name, kind) in enumerate(outputs):
            create_info.fragment_out(slot, kind, name)
        return create_info

    sources = {"vertex": read_source("bake/vertex.glsl"), "fragment": read_source(source)}
    return compile_shader(source, info, sources)


def _draw(shader: Any, batch: Any, targets: list[Texture], nearest: bool, bound: dict[str, Texture]) -> None:
    """Draw the batch into cleared targets, without culling, and restore Blender's drawing state."""
    import gpu

    size = (targets[0].width, targets[0].height)
    depth = gpu.types.GPUTexture(size, format="DEPTH_COMPONENT32F")
    framebuffer = gpu.types.GPUFrameBuffer(depth_slot=depth, color_slots=targets)
    state = (gpu.state.depth_test_get(), gpu.state.depth_mask_get(), gpu.state.blend_get())
    try:
        with framebuffer.bind():
            gpu.state.viewport_set(0, 0, *size)
            gpu.state.depth_test_set("LESS" if nearest else "NONE")
            gpu.state.depth_mask_set(nearest)
            gpu.state.blend_set("NONE")
            gpu.state.face_culling_set("NONE")
            framebuffer.clear(color=(0.0, 0.0, 0.0, 0.0), depth=1.0)
            shader.bind()
            for name, texture in bound.items():
                shader.uniform_sampler(name, texture)
            if bound:
                shader.uniform_float("u_size", size)
            batch.draw(shader)
    finally:
        gpu.shader.unbind()
        gpu.state.depth_test_set(state[0])
        gpu.state.depth_mask_set(state[1])
        gpu.state.blend_set(state[2])
