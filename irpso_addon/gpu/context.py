"""GPU context with or without a window: creation, limits of the device, clean end of the process."""

from __future__ import annotations

import ctypes
import os
import shutil
import sys
from contextlib import nullcontext
from pathlib import Path

from ..core.errors import GpuUnavailableError
from ..core.interrupt import interrupted_afterwards
from .output import caught_output

_SOFTWARE = ("llvmpipe", "softpipe", "lavapipe", "swiftshader")
# OpenGL enums of free memory in KiB: GL_NVX_gpu_memory_info, GL_ATI_meminfo.
_FREE_KIB = (0x9049, 0x87FC)
_ready = False


def ensure(quiet: bool = True) -> None:
    """Make a GPU context in this process, once. Raises GpuUnavailableError where bpy or the context is missing.

    quiet: discard EGL's messages, which complain about optional configurations.

    Without a usable EGL Blender kills the process, which Python cannot catch: call ``probe.probe()`` first, which tries
    it in a child process.
    """
    global _ready
    if _ready:
        return
    try:
        import bpy
        import gpu
    except ImportError as error:
        raise GpuUnavailableError(f"Blender's Python module does not load ({error}); run 'make doctor'") from error
    if bpy.app.background:
        with interrupted_afterwards(), caught_output() if quiet else nullcontext():
            if hasattr(gpu, "init"):  # since Blender 5.2
                gpu.init()
            else:
                _render_once()
    try:
        gpu.platform.renderer_get()
    except SystemError as error:
        raise GpuUnavailableError(f"no GPU context could be created ({error}); run 'make doctor'") from error
    _ready = True


def describe() -> dict[str, str | int]:
    """Return the renderer, vendor, version, backend and limits of the context."""
    ensure()
    import gpu

    return {
        "renderer": gpu.platform.renderer_get(),
        "vendor": gpu.platform.vendor_get(),
        "version": gpu.platform.version_get(),
        "backend": gpu.platform.backend_type_get(),
        "max_texture_size": max_texture_size(),
        "max_texture_layers": gpu.capabilities.max_texture_layers_get(),
    }


def is_software(renderer: str) -> bool:
    """Return whether the renderer of that name is software on the host's processor."""
    return any(name in renderer.lower() for name in _SOFTWARE)


def is_software_vulkan(renderer: str, backend: str) -> bool:
    """Return whether the device is Mesa's software Vulkan, on which Blender crashes (SIGSEGV) after about 65 000 draws.

    Blender allocates a descriptor set per draw and recycles their pool when the driver reports it full. lavapipe never
    does, and maps memory for every set; Linux allows a process 65 530 mappings (vm.max_map_count). Measured with
    Blender 5.2.2 and Mesa 26.2.6, without any add-on: 264 sets per redraw of the default window, a crash in the 248th
    redraw (tests/gui/software_vulkan.py).
    """
    return backend == "VULKAN" and is_software(renderer)


def on_software_vulkan() -> bool:
    """Return whether the current context is ``is_software_vulkan``."""
    import gpu

    return is_software_vulkan(gpu.platform.renderer_get(), gpu.platform.backend_type_get())


def free_device_memory() -> int | None:
    """Return the free bytes of the device's memory from its OpenGL driver; None where the driver has no such query.

    Blender has no query for it. Correct on an H100 with NVIDIA's driver.
    """
    import gpu

    if gpu.platform.backend_type_get() != "OPENGL" or is_software(gpu.platform.renderer_get()):
        return None
    try:
        driver = ctypes.CDLL("opengl32" if sys.platform == "win32" else "libGL.so.1")
    except OSError:
        return None
    for name in _FREE_KIB:
        answer = (ctypes.c_int * 4)()
        driver.glGetError()  # clears errors of earlier calls
        driver.glGetIntegerv(name, answer)
        if driver.glGetError() == 0 and answer[0] > 0:
            return answer[0] << 10
    return None


def max_texture_size() -> int:
    """Return the longest side of a 2-D texture, in texels."""
    import gpu

    return gpu.capabilities.max_texture_size_get()


def max_samplers() -> int:
    """Return the number of textures that one shader can read."""
    import gpu

    return gpu.capabilities.max_textures_frag_get()


def exit_process(code: int) -> None:
    """End the process now with ``code``, with flushed buffers.

    This skips the interpreter's shutdown: bpy 4.5 never returns from it once a GPU context exists, and 4.2 crashes in
    it when GPU objects outlive the context. It removes Blender's folder of temporary files.
    """
    if bpy := sys.modules.get("bpy"):
        temporary = Path(bpy.app.tempdir)
        if temporary.name.startswith("blender_"):  # else it is the system's own folder
            shutil.rmtree(temporary, ignore_errors=True)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _render_once() -> None:
    """Render an empty scene with an engine that requests a GPU context, which stays current (before 5.2)."""
    import bpy

    class ContextEngine(bpy.types.RenderEngine):  # type: ignore[misc]
        bl_idname = "IRPSO_CONTEXT"
        bl_label = "IRPSO GPU context"
        bl_use_gpu_context = True

        def render(self, depsgraph: object) -> None:
            """Draw nothing: only the context is needed."""

    bpy.utils.register_class(ContextEngine)
    scene = bpy.data.scenes.new("IRPSO context")
    camera = bpy.data.cameras.new("IRPSO context")
    scene.camera = bpy.data.objects.new("IRPSO context", camera)
    try:
        scene.render.engine = ContextEngine.bl_idname
        scene.render.resolution_x = scene.render.resolution_y = 4
        scene.render.use_compositing = scene.render.use_sequencer = False
        bpy.ops.render.render(scene=scene.name)
    finally:
        bpy.data.objects.remove(scene.camera)
        bpy.data.cameras.remove(camera)
        bpy.data.scenes.remove(scene)
        bpy.utils.unregister_class(ContextEngine)
