"""Whether the GPU context that is current is the one in which something was made."""

from __future__ import annotations

from typing import Any


class ContextGuard:
    """Remembers the context that is current, outside of any drawing.

    Textures are shared by all contexts of Blender, frame buffers belong to one: bound in another, OpenGL goes on
    drawing into whatever was bound before, without an error (measured on 4.3.2). A modal operator's events come in the
    context of its window, draw callbacks all in one of their own, bpy.app.timers in that of the window drawn last.
    """

    def __init__(self) -> None:
        self._window = active()

    def holds(self) -> bool:
        """Return whether the same context is current, outside of any drawing."""
        return self._window is not None and active() is self._window


def active() -> Any:
    """Return the frame buffer of the window whose context is current: Blender hands out one object for each.

    None where no context is current, as for timers once a window has been closed, until the next one is drawn.
    """
    import gpu

    try:
        gpu.types.GPUFrameBuffer()  # it asks for a context; asked without one, the state below kills the process
    except RuntimeError:
        return None
    return gpu.state.active_framebuffer_get()
