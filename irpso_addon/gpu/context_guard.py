"""The window whose GPU context is current, because frame buffers cannot be used in another."""

from __future__ import annotations

from typing import Any


def active() -> Any:
    """Return the frame buffer of the window whose context is current: one object per window, outside of draw callbacks.

    None where no context is current, as in timers between the closing of a window and the next draw.

    All contexts of Blender share textures, but a frame buffer belongs to one: bound in another, OpenGL keeps drawing
    into the previous target, without an error (measured on 4.3.2). Events of a modal operator run in the context of its
    window, all draw callbacks in one of their own, bpy.app.timers in that of the window drawn last.
    """
    import gpu

    try:
        gpu.types.GPUFrameBuffer()  # requires a context; without one, the state below kills the process
    except RuntimeError:
        return None
    return gpu.state.active_framebuffer_get()
