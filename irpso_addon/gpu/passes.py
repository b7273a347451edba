"""Passes: one kernel run over the texels of its targets, as fragments or as a compute dispatch."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from . import context, context_guard
from .bands import Bands
from .kernel import MAX_OUTPUTS, Entry, Kernel
from .program import GROUP, Program, program_of
from .textures import Texture

_MAX_FRAMEBUFFERS = 12  # of a pass: a refinement draws into five sets of textures, in two windows


class Pass:
    """A kernel, compiled at its first run. Fragment and compute entries take the same arguments and write the same.

    Compiling may take a second, on software renderers most of it in the first draw: callers with a window give the
    first run of a pass a slice of its own.
    """

    def __init__(self, kernel: Kernel, entry: Entry = "fragment"):
        if not 1 <= len(kernel.targets) <= MAX_OUTPUTS:
            raise ValueError(f"a kernel has 1 to {MAX_OUTPUTS} outputs, {kernel.source} has {len(kernel.targets)}")
        context.ensure()
        self.kernel, self.entry = kernel, entry
        self._program: Program | None = None
        self._framebuffers: dict[tuple[int, ...], Any] = {}

    def compile(self) -> Program:
        """Compile the kernel, unless done; return the program. Raises ShaderError, GpuUnavailableError."""
        self._program = self._program or program_of(self.kernel, self.entry)
        return self._program

    def run(
        self,
        targets: Sequence[Texture],
        textures: Mapping[str, Texture],
        constants: Mapping[str, int | float] = {},
        rows: tuple[int, int] | None = None,
    ) -> None:
        """Start the kernel over rows [start, stop) of the targets (None: all); return before the GPU has finished."""
        import gpu

        first, last = rows or (0, targets[0].height)
        program = self.compile()
        shader = program.shader
        shader.bind()
        try:
            for name in program.samplers:
                shader.uniform_sampler(name, textures[name])
            for name, kind in program.constants.items():
                value = constants[name]  # on every backend: Vulkan keeps constants that OpenGL's compiler removes
                if name in program.active:
                    (shader.uniform_int if kind == "INT" else shader.uniform_float)(name, value)
            if self.entry == "compute":
                self._dispatch(shader, targets, first, last)
            else:
                self._draw(program, targets, first, last)
        finally:
            gpu.shader.unbind()

    def in_bands(
        self,
        name: str,
        bands: Bands,
        seconds: float,
        targets: Sequence[Texture],
        textures: Mapping[str, Texture],
        constants: Mapping[str, int | float] = {},
        counted: bool = False,
    ) -> Iterator[None]:
        """Run over all rows in bands of about ``seconds``, timed under a name; yields after each. As ``Bands.run``."""
        return bands.run(
            name, targets[0].height, seconds, lambda rows: self.run(targets, textures, constants, rows),
            lambda: self.fence(targets), counted,
        )  # fmt: skip

    def in_one_draw(
        self,
        bands: Bands,
        targets: Sequence[Texture],
        textures: Mapping[str, Texture],
        constants: Mapping[str, int | float] = {},
    ) -> Iterator[None]:
        """Run a short pass over all rows in one draw, then yield."""
        return bands.once(lambda: self.run(targets, textures, constants), lambda: self.fence(targets))

    def framebuffer(self, targets: Sequence[Texture]) -> Any:
        """Return the frame buffer that has ``targets`` as attachments, kept for the last sets of targets and windows.

        Frame buffers belong to the context in which they are made, and every window has one of its own. A frame buffer
        keeps its targets alive, also those that a halo from other tiles has replaced.
        """
        import gpu

        window = context_guard.active()
        key = (id(window), *(id(target) for target in targets))
        if key not in self._framebuffers:
            if len(self._framebuffers) == _MAX_FRAMEBUFFERS:
                self._framebuffers.pop(next(iter(self._framebuffers)))
            self._framebuffers[key] = (gpu.types.GPUFrameBuffer(color_slots=list(targets)), window, tuple(targets))
        return self._framebuffers[key][0]

    def fence(self, targets: Sequence[Texture]) -> None:
        """Wait until the GPU has finished all draws into ``targets``."""
        framebuffer = self.framebuffer(targets)
        with framebuffer.bind():  # its size is unknown before it is bound
            framebuffer.read_color(0, 0, 1, 1, 4, 0, "FLOAT")

    def close(self) -> None:
        """Free the frame buffers, and the program unless another pass uses it."""
        self._framebuffers.clear()
        self._program = None

    def _draw(self, program: Program, targets: Sequence[Texture], first: int, last: int) -> None:
        import gpu

        framebuffer = self.framebuffer(targets)
        blend = gpu.state.blend_get()
        gpu.state.blend_set("NONE")  # in a draw callback the window's blend mode is active
        try:
            with framebuffer.bind():
                gpu.state.viewport_set(0, first, targets[0].width, last - first)
                program.triangle.draw(program.shader)
        finally:
            gpu.state.blend_set(blend)

    def _dispatch(self, shader: Any, targets: Sequence[Texture], first: int, last: int) -> None:
        import gpu

        width = targets[0].width
        for slot, target in enumerate(targets):
            shader.image(f"u_image_{slot}", target)
        shader.uniform_int("u_first_row", first)
        shader.uniform_int("u_last_row", last)
        shader.uniform_int("u_columns", width)
        groups = (-(-width // GROUP[0]), -(-(last - first) // GROUP[1]))
        gpu.compute.dispatch(shader, *groups, 1)
