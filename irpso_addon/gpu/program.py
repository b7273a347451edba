"""Programs: kernels compiled for the GPU; passes that are alive at the same time share them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any
from weakref import WeakSet, WeakValueDictionary

from ..core.errors import GpuUnavailableError
from . import context
from .compiler import compile_shader
from .kernel import Entry, Kernel, Packed
from .library import read_source
from .textures import CHANNELS

GROUP = (8, 8)  # texels of a compute work group
_GLSL = {1: ("float", "FLOAT"), 4: ("vec4", "VEC4")}


class Program:
    """A compiled kernel. samplers, constants: those its source uses. active: constants that the compiler kept."""

    def __init__(self, kernel: Kernel, entry: Entry, source: str):
        """Compile a kernel. source: its own, with all that it includes. Raises ShaderError, GpuUnavailableError."""
        self.kernel = kernel
        declared = _declared(kernel, source)
        self.constants = kernel.needed(source)
        self.triangle: Any = None
        self.shader: Any = (self._compute if entry == "compute" else self._fragment)(source, declared)
        self.active = {name for name in self.constants if _has_uniform(self.shader, name)}
        self.samplers = {name for name in declared if _has_uniform(self.shader, name)}

    def _info(self, declared: Mapping[str, str]) -> Any:
        import gpu

        info = gpu.types.GPUShaderCreateInfo()
        for name, value in self.kernel.defines.items():
            info.define(name, str(value))
        for slot, (name, kind) in enumerate(declared.items()):
            info.sampler(slot, kind, name)
        for name, kind in self.constants.items():
            info.push_constant(kind, name)
        return info

    def _fragment(self, source: str, declared: Mapping[str, str]) -> Any:
        from gpu_extras.batch import batch_for_shader

        sources = {
            "vertex": read_source("common/full_screen.glsl"),
            "fragment": source + read_source("common/entry_fragment.glsl"),
        }
        shader = compile_shader(self.kernel.source, lambda: self._fragment_info(declared), sources)
        self.triangle = batch_for_shader(shader, "TRIS", {"position": [(-1, -1), (3, -1), (-1, 3)]})
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
        info.local_group_size(*GROUP, 1)
        return info


_alive: WeakValueDictionary[tuple[str, str, str], Program] = WeakValueDictionary()
_keepers: WeakSet[ProgramCache] = WeakSet()


class ProgramCache:
    """Keeps all requested programs until closed, for recoveries that follow one another.

    Without it each recovery compiles its kernels anew: a third of the time of many small ones.
    """

    def __init__(self) -> None:
        self._programs: set[Program] = set()
        _keepers.add(self)

    def add(self, program: Program) -> None:
        """Keep a program."""
        self._programs.add(program)

    def close(self) -> None:
        """Release all programs; those without a pass are freed."""
        self._programs.clear()


def program_of(kernel: Kernel, entry: Entry) -> Program:
    """Return the program of a kernel: a living one with equal source and declarations, or a new one."""
    source = source_of(kernel)
    key = (entry, source, repr((kernel.outputs, kernel.samplers, kernel.constants, kernel.defines)))
    program = _alive.get(key)
    if program is None:
        program = _alive[key] = Program(kernel, entry, source)
    for keeper in _keepers:
        keeper.add(program)
    return program


def source_of(kernel: Kernel) -> str:
    """Return the GLSL of a kernel with its includes, without Blender's declarations and without an entry."""
    source = read_source(kernel.source, kernel.includes)
    return _packed_functions(kernel, source) + source


def _packed_functions(kernel: Kernel, source: str) -> str:
    """Return the GLSL functions that read and write the packed numbers named in the source."""
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
    """Return ``kernel.declared``. Raises GpuUnavailableError above the device's texture units: some have only 16."""
    declared = kernel.declared(source)
    if len(declared) > (most := context.max_samplers()):
        raise GpuUnavailableError(
            f"this GPU reads {most} textures in a shader, {kernel.source} needs {len(declared)}; choose a model or a"
            " preset of fewer dimensions, or another device"
        )
    return declared


def _has_uniform(shader: Any, name: str) -> bool:
    """Return whether the compiled shader has a uniform: setting a removed one is an error in Blender."""
    try:
        shader.uniform_from_name(name)
    except ValueError:
        return False
    return True
