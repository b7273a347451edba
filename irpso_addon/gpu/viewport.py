"""Drawing in Blender's windows, from draw callbacks: lines, points, triangles and pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from . import context
from .compiler import compile_shader
from .library import read_source
from .textures import Texture

Color = Sequence[float] | np.ndarray  # (4,) or (N, 4) display values and alpha
Size = tuple[float, float]
_PULL = 1e-3  # of the distance to the eye: moves no pixel, and exceeds the rounding of two transformations
_UNSPLIT = 1e9  # a column right of every window
# Two triangles of a line's rectangle: x along it, y across.
_CORNERS = np.array([[0, -1], [1, -1], [1, 1], [0, -1], [1, 1], [0, 1]], np.float32)


class Surface:
    """Textured triangles on the GPU; ``close`` frees them.

    positions: (T, 3, 3). uvs: (T, 3, 2), 0…1 over the picture.
    """

    def __init__(self, positions: np.ndarray, uvs: np.ndarray):
        context.ensure()
        self._shader = _surface_shader()
        columns = {"position": np.reshape(positions, (-1, 3)), "uv": np.reshape(uvs, (-1, 2))}
        self._batch = _batch(columns)

    def draw(
        self,
        picture: Texture,
        view_projection: np.ndarray,
        model: np.ndarray,
        second: Texture | None = None,
        split: float = 0.5,
        region_size: Size | None = None,
        opacity: float = 1.0,
        depth: bool = True,
        stripes: float = 0.0,
    ) -> None:
        """Draw the surface with a picture, in a POST_VIEW callback or with a bound frame buffer.

        picture: a texture of display values; alpha 0 is not drawn. view_projection, model: (4, 4). second: another
        picture, right of ``split``, a fraction of the region's width. region_size: in pixels, by default of the bound
        frame buffer. depth: the scene and nearer parts of the surface hide it. stripes: distance, in pixels, of stripes
        over texels of alpha below 1, 0 for none.
        """
        matrix = np.asarray(view_projection, np.float64) @ np.asarray(model, np.float64)
        column = _UNSPLIT if second is None else split * (region_size or viewport_size())[0]
        constants = {
            "u_toward": toward_viewer(view_projection) if depth else 0.0,
            "u_split": column,
            "u_opacity": opacity,
            "u_stripes": stripes,
        }
        bound = {"u_picture": picture, "u_second": picture if second is None else second}
        # The surface writes depth too: while an engine compiles, no scene depth hides its far side.
        _draw(self._shader, self._batch, matrix, constants, bound, depth, write=depth)

    def close(self) -> None:
        """Free shader and triangles."""
        self._shader = self._batch = None


class Drawing:
    """Draws lines, points, triangles and flat pictures in a window; ``close`` frees its shaders.

    Colours are display values, (4,) for all or (N, 4). Without a matrix, points are (N, 2) pixels from the lower left
    corner of the target; with one, (4, 4) to clip coordinates, they are (N, 3). The drawing state is restored.
    """

    def __init__(self) -> None:
        context.ensure()
        self._line = self._plain = None
        self._squares: dict[tuple[float, float], Surface] = {}  # by the part of the picture on it

    def draw_flat(
        self,
        picture: Texture,
        lower_left_px: Size,
        size_px: Size,
        second: Texture | None = None,
        split: float = 0.5,
        opacity: float = 1.0,
        part: tuple[float, float] = (0.0, 1.0),
        stripes: float = 0.0,
    ) -> None:
        """Draw a picture in a rectangle of the region, and ``second`` right of ``split`` of the region's width.

        part: drawn range of the picture's width, 0…1. stripes: as in Surface.
        """
        if part not in self._squares:
            corners = np.array([[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]], np.float32).reshape(2, 3, 2)
            uvs = corners * (part[1] - part[0], 1) + (part[0], 0)
            self._squares[part] = Surface(np.concatenate([corners, np.zeros((2, 3, 1))], axis=-1), uvs)
        place = np.diag([size_px[0], size_px[1], 1.0, 1.0])
        place[:2, 3] = lower_left_px
        self._squares[part].draw(picture, _pixels(), place, second, split, None, opacity, False, stripes)

    def draw_lines(
        self,
        points: np.ndarray,
        colors: Color,
        width: float,
        matrix: np.ndarray | None = None,
        depth: bool = False,
        strip: bool = False,
    ) -> None:
        """Draw lines with round ends: points 0–1, 2–3, …, or with ``strip`` one line through all of them.

        width: in pixels. depth: the scene in front hides them.
        """
        points, colors = _points(points), _colors(colors, len(points))
        step = 1 if strip else 2
        starts, stops = slice(0, len(points) - 1, step), slice(1, None, step)
        self._draw_strokes(points[starts], points[stops], colors[starts], colors[stops], width, matrix, depth)

    def draw_points(
        self, points: np.ndarray, colors: Color, size: float, matrix: np.ndarray | None = None, depth: bool = False
    ) -> None:
        """Draw discs of ``size`` pixels diameter. depth: the scene in front hides them."""
        points = _points(points)
        colors = _colors(colors, len(points))
        self._draw_strokes(points, points, colors, colors, size, matrix, depth)

    def draw_triangles2d(self, points: np.ndarray, colors: Color) -> None:
        """Draw triangles: three points (3·T, 2) each, in pixels of the region."""
        if self._plain is None:
            self._plain = _shader(
                "plain", {"position": "VEC2", "color": "VEC4"}, {"v_color": "VEC4"}, {"u_matrix": "MAT4"}, smooth=True
            )
        points = np.reshape(points, (-1, 2))
        if len(points):
            batch = _batch({"position": points, "color": _colors(colors, len(points))})
            _draw(self._plain, batch, _pixels(), {}, {}, False)

    def close(self) -> None:
        """Free the shaders."""
        for square in self._squares.values():
            square.close()
        self._squares.clear()
        self._line = self._plain = None

    def _draw_strokes(
        self,
        begins: np.ndarray,
        ends: np.ndarray,
        begin_colors: np.ndarray,
        end_colors: np.ndarray,
        width: float,
        matrix: np.ndarray | None,
        depth: bool,
    ) -> None:
        if not len(begins):
            return
        if self._line is None:
            self._line = _line_shader()
        columns = {
            "begin": begins, "end": ends, "begin_color": begin_colors, "end_color": end_colors
        }  # fmt: skip
        columns = {name: np.repeat(values, len(_CORNERS), axis=0) for name, values in columns.items()}
        batch = _batch({**columns, "corner": np.tile(_CORNERS, (len(begins), 1))})
        toward = toward_viewer(matrix) if depth and matrix is not None else 0.0
        constants = {"u_size": viewport_size(), "u_width": width, "u_toward": toward}
        _draw(self._line, batch, _pixels() if matrix is None else matrix, constants, {}, depth)


def viewport_size() -> Size:
    """Return the width and height of the target in pixels."""
    import gpu

    _, _, width, height = gpu.state.viewport_get()
    return float(width), float(height)


def toward_viewer(view_projection: np.ndarray) -> float:
    """Return the offset of clip z that moves a surface nearer to the eye by a thousandth of its distance.

    In an orthographic view: by a thousandth of half its width. view_projection: (4, 4).
    """
    m = np.asarray(view_projection, np.float64)
    if np.any(m[3, :3]):
        # Depth is a + b / distance: b is clip z minus a times the distance.
        a = m[2, :3] @ m[3, :3] / (m[3, :3] @ m[3, :3])
        return float(_PULL * (m[2, 3] - a * m[3, 3]))
    return -float(_PULL * np.linalg.norm(m[2, :3]) / np.linalg.norm(m[0, :3]))


def _pixels() -> np.ndarray:
    """Return the matrix from the target's pixels to clip coordinates."""
    width, height = viewport_size()
    return np.array([[2 / width, 0, 0, -1], [0, 2 / height, 0, -1], [0, 0, 0, 0], [0, 0, 0, 1]])


def _points(points: np.ndarray) -> np.ndarray:
    """Return (N, 3) of (N, 2) or (N, 3)."""
    points = np.atleast_2d(np.asarray(points, np.float32))
    return np.pad(points, ((0, 0), (0, 3 - points.shape[-1])))


def _colors(colors: Color, count: int) -> np.ndarray:
    return np.broadcast_to(np.asarray(colors, np.float32), (count, 4))


def _batch(columns: dict[str, np.ndarray]) -> Any:
    """Return a batch of triangles from float vertex attributes, name → (N, 2) to (N, 4)."""
    import gpu

    layout = gpu.types.GPUVertFormat()
    for name, values in columns.items():
        layout.attr_add(id=name, comp_type="F32", len=values.shape[-1], fetch_mode="FLOAT")
    vertices = gpu.types.GPUVertBuf(layout, len(next(iter(columns.values()))))
    for name, values in columns.items():
        vertices.attr_fill(name, np.ascontiguousarray(values, np.float32))
    return gpu.types.GPUBatch(type="TRIS", buf=vertices)


def _surface_shader() -> Any:
    return _shader(
        "surface",
        {"position": "VEC3", "uv": "VEC2"},
        {"v_uv": "VEC2"},
        {"u_matrix": "MAT4", "u_toward": "FLOAT", "u_split": "FLOAT", "u_opacity": "FLOAT", "u_stripes": "FLOAT"},
        ("u_picture", "u_second"),
        smooth=True,
    )


def _line_shader() -> Any:
    ends = {"begin": "VEC3", "end": "VEC3", "begin_color": "VEC4", "end_color": "VEC4", "corner": "VEC2"}
    between = {"v_begin": "VEC2", "v_end": "VEC2", "v_begin_color": "VEC4", "v_end_color": "VEC4"}
    constants = {"u_matrix": "MAT4", "u_size": "VEC2", "u_width": "FLOAT", "u_toward": "FLOAT"}
    return _shader("line", ends, between, constants, place=True)


def _shader(
    name: str,
    vertex: dict[str, str],
    between: dict[str, str],
    constants: dict[str, str],
    samplers: Sequence[str] = (),
    smooth: bool = False,
    place: bool = False,
) -> Any:
    """Compile window/NAME_vertex.glsl and window/NAME.glsl. between: varyings, flat unless ``smooth``.

    place: add the interpolated v_place.
    """
    import gpu

    def info() -> Any:
        made = gpu.types.GPUShaderCreateInfo()
        for slot, (attribute, kind) in enumerate(vertex.items()):
            made.vertex_in(slot, kind, attribute)
        passed = gpu.types.GPUStageInterfaceInfo(f"window_{name}")
        for varying, kind in between.items():
            (passed.smooth if smooth else passed.flat)(kind, varying)
        if place:
            passed.smooth("VEC2", "v_place")
        made.vertex_out(passed)
        for slot, sampler in enumerate(samplers):
            made.sampler(slot, "FLOAT_2D", sampler)
        for constant, kind in constants.items():
            made.push_constant(kind, constant)
        made.push_constant("BOOL", "srgbTarget")
        made.fragment_out(0, "VEC4", "o_color")
        return made

    stages = {"vertex": read_source(f"window/{name}_vertex.glsl"), "fragment": read_source(f"window/{name}.glsl")}
    return compile_shader(f"window/{name}.glsl", info, stages)


def _draw(
    shader: Any,
    batch: Any,
    matrix: np.ndarray,
    constants: dict[str, Any],
    bound: dict[str, Texture],
    depth: bool,
    write: bool = False,
) -> None:
    import gpu
    from mathutils import Matrix

    with _state(depth, write):
        shader.bind()
        for name, texture in bound.items():
            shader.uniform_sampler(name, texture)
        for name, value in {"u_matrix": Matrix(np.asarray(matrix, np.float64).tolist()), **constants}.items():
            shader.uniform_float(name, value)
        try:
            batch.draw(shader)
        finally:
            gpu.shader.unbind()


@contextmanager
def _state(depth: bool, write: bool) -> Iterator[None]:
    """Set alpha blending and the depth test, and restore the drawing state afterwards."""
    import gpu

    before = gpu.state.depth_test_get(), gpu.state.depth_mask_get(), gpu.state.blend_get()
    gpu.state.depth_test_set("LESS_EQUAL" if depth else "NONE")
    gpu.state.depth_mask_set(write)
    gpu.state.blend_set("ALPHA")
    try:
        yield
    finally:
        gpu.state.depth_test_set(before[0])
        gpu.state.depth_mask_set(before[1])
        gpu.state.blend_set(before[2])
