"""Drawing in Blender's windows: lines, points, triangles and pictures, from draw callbacks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from . import context
from .compiler import compile_shader
from .library import read_source

Color = Sequence[float] | np.ndarray  # (4,) or (N, 4) display values and alpha
Size = tuple[float, float]
_PULL = 1e-3  # of the way to the eye: a thousandth moves no pixel, and clears the rounding of two transformations
_UNSPLIT = 1e9  # a column right of every window
# Of a line's rectangle, two triangles: x along it, y across.
_CORNERS = np.array([[0, -1], [1, -1], [1, 1], [0, -1], [1, 1], [0, 1]], np.float32)


class Surface:
    """Triangles with a picture on them, kept on the GPU; ``close`` frees them.

    positions: (T, 3, 3). uvs: (T, 3, 2), 0…1 over the picture.
    """

    def __init__(self, positions: np.ndarray, uvs: np.ndarray):
        context.ensure()
        self._shader = _surface_shader()
        columns = {"position": np.reshape(positions, (-1, 3)), "uv": np.reshape(uvs, (-1, 2))}
        self._batch = _batch(columns)

    def draw(
        self,
        picture: Any,
        view_projection: np.ndarray,
        model: np.ndarray,
        second: Any = None,
        split: float = 0.5,
        region_size: Size | None = None,
        opacity: float = 1.0,
        depth: bool = True,
        stripes: float = 0.0,
    ) -> None:
        """Draw it with a picture on it, in a POST_VIEW callback or wherever a frame buffer is bound.

        picture: a texture of display values, nothing being drawn where its alpha is 0. view_projection, model: (4, 4).
        second: another picture, right of ``split``, a fraction of the region's width. region_size: in pixels, by
        default of what is drawn into. depth: whether what the scene has in front hides it, and its near side its far
        side. stripes: how many pixels apart stripes are over texels of alpha below 1, 0 for none.
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
        # Its own depth too: engines that are still compiling draw no scene that would hide its far side.
        _draw(self._shader, self._batch, matrix, constants, bound, depth, write=depth)

    def close(self) -> None:
        """Free shader and triangles."""
        self._shader = self._batch = None


class Drawing:
    """What draws lines, points, triangles and flat pictures in a window; ``close`` frees its shaders.

    Colours are display values, (4,) for all or (N, 4). Without a matrix, points are (N, 2) pixels from the lower left
    corner of what is drawn into; with one, (4, 4) to clip coordinates, they are (N, 3). The drawing state is left as it
    was found.
    """

    def __init__(self) -> None:
        context.ensure()
        self._line = self._plain = None
        self._squares: dict[tuple[float, float], Surface] = {}  # by the part of the picture that is on it

    def draw_flat(
        self,
        picture: Any,
        lower_left_px: Size,
        size_px: Size,
        second: Any = None,
        split: float = 0.5,
        opacity: float = 1.0,
        part: tuple[float, float] = (0.0, 1.0),
        stripes: float = 0.0,
    ) -> None:
        """Draw a picture in a rectangle of the region, and ``second`` right of a fraction of the region's width.

        part: from where to where of the picture's width is drawn, 0…1. stripes: as of a Surface.
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
        """Draw lines with round ends: points 0–1, 2–3, …, or, with ``strip``, one through all of them.

        width: in pixels. depth: whether what the scene has in front hides them.
        """
        points, colors = _points(points), _colors(colors, len(points))
        step = 1 if strip else 2
        ends = slice(0, len(points) - 1, step), slice(1, None, step)
        self._draw_strokes(*(points[part] for part in ends), *(colors[part] for part in ends), width, matrix, depth)

    def draw_points(
        self, points: np.ndarray, colors: Color, size: float, matrix: np.ndarray | None = None, depth: bool = False
    ) -> None:
        """Draw discs ``size`` pixels across. depth: whether what the scene has in front hides them."""
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
    """Return the width and height in pixels of what is being drawn into."""
    import gpu

    return tuple(float(side) for side in gpu.state.viewport_get()[2:])


def toward_viewer(view_projection: np.ndarray) -> float:
    """Return what to add to clip z so that a surface passes for one a thousandth of the way nearer to the eye.

    Of an orthographic view (4, 4): nearer by a thousandth of half its width.
    """
    m = np.asarray(view_projection, np.float64)
    if np.any(m[3, :3]):
        # Depth is a + b / distance: b is what clip z has besides a times the distance.
        a = m[2, :3] @ m[3, :3] / (m[3, :3] @ m[3, :3])
        return float(_PULL * (m[2, 3] - a * m[3, 3]))
    return -float(_PULL * np.linalg.norm(m[2, :3]) / np.linalg.norm(m[0, :3]))


def _pixels() -> np.ndarray:
    """The matrix from pixels of what is drawn into to clip coordinates."""
    width, height = viewport_size()
    return np.array([[2 / width, 0, 0, -1], [0, 2 / height, 0, -1], [0, 0, 0, 0], [0, 0, 0, 1]])


def _points(points: np.ndarray) -> np.ndarray:
    """Return (N, 3) of (N, 2) or (N, 3)."""
    points = np.atleast_2d(np.asarray(points, np.float32))
    return np.pad(points, ((0, 0), (0, 3 - points.shape[-1])))


def _colors(colors: Color, count: int) -> np.ndarray:
    return np.broadcast_to(np.asarray(colors, np.float32), (count, 4))


def _batch(columns: dict[str, np.ndarray]) -> Any:
    """Return triangles of vertices with float attributes, (N, 2) to (N, 4) by name."""
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
    """Compile window/NAME_vertex.glsl and window/NAME.glsl. between: from one to the other, flat unless smooth.

    place: whether v_place, which is interpolated, comes on top.
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
    bound: dict[str, Any],
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
    """Blend over what is there, behind what is nearer or not, and leave the drawing state as it was."""
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
