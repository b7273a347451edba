"""Passes: one kernel run over the texels of its targets, as fragments or as a compute dispatch."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from ..core.errors import GpuUnavailableError
from . import context, context_guard
from .bands import Bands
from .compiler import compile_shader
from .library import read_source
from .textures import CHANNELS, Texture

Entry = Literal["fragment", "compute"]
EntryChoice = Entry | Literal["auto"]  # auto: whichever the probe finds faster
MAX_OUTPUTS = 6  # colour attachments that every supported device and version has
_GROUP = (8, 8)  # texels of a compute work group
_GLSL = {1: ("float", "FLOAT"), 4: ("vec4", "VEC4")}


@dataclass(frozen=True)
class Packed:
    """Numbers of a texel, four to an RGBA32F texture: NAME_0, NAME_1, … of ``textures``. room: of their array in GLSL.

    A kernel that samples u_NAME has ``void read_NAME(ivec2 texel, out float c[room])``, 0 beyond the last texture; one
    that puts out o_NAME has ``void write_NAME(inout float c[room])``.
    """

    textures: int
    room: int = 12


@dataclass(frozen=True)
class Output:
    """What a kernel writes: the GLSL variable's name and the texture's format (R32F, RGBA32F, RGBA16F, or Packed)."""

    name: str
    format: str | Packed = "RGBA32F"


Samplers = Mapping[str, str | Packed]
Defines = Mapping[str, str | int | float]
Includes = Mapping[str, str | Path]


@dataclass(frozen=True)
class Kernel:
    """A kernel: the file with ``bool texel_kernel(ivec2 texel)``, which returns false to leave a texel as it was.

    The function is not called kernel because that is a keyword of Metal, into which Blender translates it on macOS.
    source: path under shaders/ or of the user's own. outputs: at most 6 textures, all of one size. samplers: name →
    FLOAT_2D, FLOAT_2D_ARRAY or Packed. constants: name → INT or FLOAT (128 bytes in all). defines: name → value. given:
    what an #include of that name brings, as text (generated declarations) or as the path of a file (a model).
    """

    source: str | Path
    outputs: tuple[Output, ...]
    samplers: Samplers
    constants: Mapping[str, str]
    defines: Defines
    given: Includes = field(default_factory=dict)

    @property
    def targets(self) -> list[tuple[str, str]]:
        """Name and format of each texture that is written."""
        return [pair for output in self.outputs for pair in _textures(output.name, output.format, "RGBA32F")]

    def declared(self, source: str) -> dict[str, str]:
        """Return the textures that the source of this kernel reads, with their kinds: kernels share their tables."""
        named = set(re.findall(r"\b(?:u|read)_\w+", source))
        return {
            each: kind_of_each
            for name, kind in self.samplers.items()
            for each, kind_of_each in _textures(name, kind, "FLOAT_2D")
            if each in named or (isinstance(kind, Packed) and f"read_{name.removeprefix('u_')}" in named)
        }

    def needed(self, source: str) -> dict[str, str]:
        """Return the constants that the source of this kernel names, with their kinds: kernels share their tables."""
        named = set(re.findall(r"\bu_\w+", source))
        return {name: kind for name, kind in self.constants.items() if name in named}


class Pass:
    """A kernel, compiled where it is first run. Fragment and compute entries take the same arguments, write the same.

    Compiling may take a second, on software renderers most of it in the first draw: who has a window to keep alive
    runs a pass for the first time in a slice of its own.
    """

    def __init__(self, kernel: Kernel, entry: Entry = "fragment"):
        if not 1 <= len(kernel.targets) <= MAX_OUTPUTS:
            raise ValueError(f"a kernel has 1 to {MAX_OUTPUTS} outputs, {kernel.source} has {len(kernel.targets)}")
        context.ensure()
        self.kernel, self.entry = kernel, entry
        self._shader: Any = None
        self._triangle: Any = None
        self._framebuffers: dict[tuple[int, ...], Any] = {}
        self._constants: dict[str, str] = {}
        self._active: set[str] = set()
        self._samplers: set[str] = set()

    def compile(self) -> Pass:
        """Compile now what would be at the first run; return the pass. Raises ShaderError, GpuUnavailableError."""
        if self._shader is None:
            source = self._sources()
            declared = _declared(self.kernel, source)
            self._constants = self.kernel.needed(source)
            build = self._compute if self.entry == "compute" else self._fragment
            self._shader = build(source, declared)
            self._active = {name for name in self._constants if _has_uniform(self._shader, name)}
            self._samplers = {name for name in declared if _has_uniform(self._shader, name)}
        return self

    def run(
        self,
        targets: Sequence[Texture],
        textures: Mapping[str, Texture],
        constants: Mapping[str, int | float] = {},
        rows: tuple[int, int] | None = None,
    ) -> None:
        """Run the kernel over rows [start, stop) of the targets (all rows where None). Returns before it is done."""
        import gpu

        first, last = rows or (0, targets[0].height)
        shader = self.compile()._shader
        shader.bind()
        try:
            for name in self._samplers:
                shader.uniform_sampler(name, textures[name])
            for name, kind in self._constants.items():
                value = constants[name]  # on every backend: Vulkan keeps those that OpenGL's compiler removes
                if name in self._active:
                    (shader.uniform_int if kind == "INT" else shader.uniform_float)(name, value)
            if self.entry == "compute":
                self._dispatch(targets, first, last)
            else:
                self._draw(targets, first, last)
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

    def at_once(
        self,
        bands: Bands,
        targets: Sequence[Texture],
        textures: Mapping[str, Texture],
        constants: Mapping[str, int | float] = {},
    ) -> Iterator[None]:
        """Run something short over all rows, then yield."""
        return bands.once(lambda: self.run(targets, textures, constants), lambda: self.fence(targets))

    def framebuffer(self, targets: Sequence[Texture]) -> Any:
        """Return the frame buffer that has ``targets`` as attachments, made once for each set of targets and window.

        Frame buffers belong to the context in which they are made, and every window has one of its own.
        """
        import gpu

        window = context_guard.active()
        key = (id(window), *(id(target) for target in targets))
        if key not in self._framebuffers:
            self._framebuffers[key] = (gpu.types.GPUFrameBuffer(color_slots=list(targets)), window, tuple(targets))
        return self._framebuffers[key][0]

    def fence(self, targets: Sequence[Texture]) -> None:
        """Wait until all that was drawn into ``targets`` is there."""
        framebuffer = self.framebuffer(targets)
        with framebuffer.bind():  # its size is not known before
            framebuffer.read_color(0, 0, 1, 1, 4, 0, "FLOAT")

    def close(self) -> None:
        """Free the shader and its frame buffers."""
        self._framebuffers.clear()
        self._shader = self._triangle = None

    def _info(self, declared: Mapping[str, str]) -> Any:
        import gpu

        info = gpu.types.GPUShaderCreateInfo()
        for name, value in self.kernel.defines.items():
            info.define(name, str(value))
        for slot, (name, kind) in enumerate(declared.items()):
            info.sampler(slot, kind, name)
        for name, kind in self._constants.items():
            info.push_constant(kind, name)
        return info

    def _sources(self) -> str:
        source = read_source(self.kernel.source, self.kernel.given)
        return _packed_functions(self.kernel, source) + source

    def _fragment(self, source: str, declared: Mapping[str, str]) -> Any:
        from gpu_extras.batch import batch_for_shader

        sources = {
            "vertex": read_source("common/full_screen.glsl"),
            "fragment": source + read_source("common/entry_fragment.glsl"),
        }
        shader = compile_shader(self.kernel.source, lambda: self._fragment_info(declared), sources)
        self._triangle = batch_for_shader(shader, "TRIS", {"position": [(-1, -1), (3, -1), (-1, 3)]})
        return shader

    def _fragment_info(self, declared: Mapping[str, str]) -> Any:
        info = self._info(declared)
        for slot, (name, texture_format) in enumerate(self.kernel.targets):
            info.fragment_out(slot, _GLSL[CHANNELS[texture_format]][1], name)
        info.vertex_in(0, "VEC2", "position")
        return info

    def _compute(self, source: str, declared: Mapping[str, str]) -> Any:
        source = read_source("common/outputs_compute.glsl") + source
        sources = {"compute": source + read_source("common/entry_compute.glsl")}
        return compile_shader(self.kernel.source, lambda: self._compute_info(declared), sources)

    def _compute_info(self, declared: Mapping[str, str]) -> Any:
        info = self._info(declared)
        for slot, (name, texture_format) in enumerate(self.kernel.targets):
            info.image(slot, texture_format, "FLOAT_2D", f"u_image_{slot}", qualifiers={"WRITE"})
            info.define(f"OUTPUT_{slot}", name)
            info.define(f"OUTPUT_{slot}_TYPE", _GLSL[CHANNELS[texture_format]][0])
        for name in ("u_first_row", "u_last_row", "u_columns"):
            info.push_constant("INT", name)
        info.local_group_size(*_GROUP, 1)
        return info

    def _draw(self, targets: Sequence[Texture], first: int, last: int) -> None:
        import gpu

        framebuffer = self.framebuffer(targets)
        blend = gpu.state.blend_get()
        gpu.state.blend_set("NONE")  # a draw callback is called with whatever its window blends with
        try:
            with framebuffer.bind():
                gpu.state.viewport_set(0, first, targets[0].width, last - first)
                self._triangle.draw(self._shader)
        finally:
            gpu.state.blend_set(blend)

    def _dispatch(self, targets: Sequence[Texture], first: int, last: int) -> None:
        import gpu

        shader, width = self._shader, targets[0].width
        for slot, target in enumerate(targets):
            shader.image(f"u_image_{slot}", target)
        shader.uniform_int("u_first_row", first)
        shader.uniform_int("u_last_row", last)
        shader.uniform_int("u_columns", width)
        groups = (-(-width // _GROUP[0]), -(-(last - first) // _GROUP[1]))
        gpu.compute.dispatch(shader, *groups, 1)


def _textures(name: str, kind: str | Packed, each: str) -> list[tuple[str, str]]:
    """Return name and kind of every texture that a name stands for; packed ones are of the kind ``each``."""
    return [(f"{name}_{i}", each) for i in range(kind.textures)] if isinstance(kind, Packed) else [(name, kind)]


def _packed_functions(kernel: Kernel, source: str) -> str:
    """Return the functions that read and write the packed numbers of which the source speaks."""
    named = set(re.findall(r"\b(?:read|write)_\w+", source))
    bound = [(f"read_{name.removeprefix('u_')}", name, kind) for name, kind in kernel.samplers.items()]
    bound += [(f"write_{output.name.removeprefix('o_')}", output.name, output.format) for output in kernel.outputs]
    lines = [read_source("common/packed.glsl") + '#line 1 "packed"']
    for function, name, kind in bound:
        if not isinstance(kind, Packed) or function not in named:
            continue
        if function.startswith("read_"):
            lines += [f"void {function}(ivec2 texel, out float c[{kind.room}])", "{"]
            lines += [f"    UNPACK({name}_{i}, texel, c, {4 * i})" for i in range(kind.textures)]
            lines += [f"    c[{i}] = 0.0;" for i in range(4 * kind.textures, kind.room)]
        else:
            lines += [f"void {function}(inout float c[{kind.room}])", "{"]
            lines += [f"    {name}_{i} = PACK(c, {4 * i});" for i in range(kind.textures)]
        lines.append("}")
    return "\n".join([*lines, ""])


def _declared(kernel: Kernel, source: str) -> dict[str, str]:
    """Return ``kernel.declared``. Raises GpuUnavailableError where the device has no room: some have only 16 units."""
    declared = kernel.declared(source)
    if len(declared) > (most := context.max_samplers()):
        raise GpuUnavailableError(
            f"this GPU reads {most} textures in a shader, {kernel.source} needs {len(declared)}; choose a model or a"
            " preset of fewer dimensions, or another device"
        )
    return declared


def _has_uniform(shader: Any, name: str) -> bool:
    """Return whether the compiler kept a uniform: setting one that it removed is an error in Blender."""
    try:
        shader.uniform_from_name(name)
    except ValueError:
        return False
    return True
