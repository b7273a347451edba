"""Draw handlers of the overlay, while a session exists. An exception in one is reported and ends the overlay."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy

from ...gpu import context_guard
from ..common import failures
from ..common.words import n_
from ..session import session
from .session_overlay import SessionOverlay
from .surface import why_unseen

_OVERLAY = n_("The overlay")  # its name in messages of failures
_IDLE_SECONDS = 0.1  # between reads of the settings while the session pauses

installed: list[tuple[type, Any]] = []
_overlay: SessionOverlay | None = None
_failed: session.Session | None = None  # the session whose overlay has failed and does not restart


def is_seen_in(context, space) -> bool:
    """Return whether a 3D viewport of the context's window shows the subject."""
    if _overlay is None:
        return False
    with context.temp_override(area=next(a for a in context.screen.areas if a.spaces.active == space)):
        return not why_unseen(bpy.context, _overlay.running, _overlay.running.subject(), _overlay.home_scene)


def why_hidden(context) -> str:
    """Return a sentence on why the context's editor has no overlay, "" if it has one."""
    if _failed is not None and _failed is session.current():
        return _failed.failure
    return "" if _overlay is None or context.space_data is None else _overlay.why_hidden(context)


def redraw() -> None:
    """Redraw the 3D viewports and Image editors of all windows."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in ("VIEW_3D", "IMAGE_EDITOR"):
                area.tag_redraw()


def _follow() -> None:
    """Start, update or end the overlay: the sessions' listener, called in the GPU context of their work."""
    global _failed
    running = session.current()
    if _overlay is not None and running is not _overlay.running:
        _end()
    if running is not _failed:
        _failed = None
    if running is None or running is _failed or bpy.app.background:
        return
    if _overlay is None:
        _guarded(running, _begin, running)
    if _overlay is not None and running is not _failed and _overlay.is_due():
        _guarded(running, _overlay.update)


def _begin(running: session.Session) -> None:
    global _overlay
    _overlay = SessionOverlay(running, bpy.context.scene.session_uid)
    for space, method, kind in (
        (bpy.types.SpaceView3D, "draw_view", "POST_VIEW"),
        (bpy.types.SpaceView3D, "draw_pixels", "POST_PIXEL"),
        (bpy.types.SpaceImageEditor, "draw_image", "POST_PIXEL"),
    ):
        installed.append((space, space.draw_handler_add(draw, (method,), "WINDOW", kind)))
    bpy.app.timers.register(_idle, first_interval=_IDLE_SECONDS)
    redraw()


def _end() -> None:
    global _overlay
    while installed:
        space, handle = installed.pop()
        space.draw_handler_remove(handle, "WINDOW")
    if bpy.app.timers.is_registered(_idle):
        bpy.app.timers.unregister(_idle)
    if _overlay is not None:
        _overlay.close()
        _overlay = None
        redraw()


@failures.reported(_OVERLAY)
def _idle() -> float | None:
    """Apply changed settings while the session pauses, when nothing else calls ``update``."""
    if _overlay is None or _overlay.running is _failed:
        _end()
        return None
    if not _overlay.running.active:
        # Without a current context, after the closing of a window: drawing one makes its context current.
        if context_guard.active() is None or _guarded(_overlay.running, _overlay.update):
            redraw()
        if _guarded(_overlay.running, _overlay.wants_redraw):
            redraw()
    return _IDLE_SECONDS


def _guarded(running: session.Session, work: Callable[..., Any], *arguments: Any) -> Any:
    """Call ``work``. An exception is reported and ends the overlay of this session for good."""
    global _failed
    with failures.reported(_OVERLAY):
        return work(*arguments)
    _failed = running
    return None


def draw(method: str) -> None:
    """Draw a part of the overlay: Blender's draw handler. method: of ``SessionOverlay``."""
    # Handlers are not removed here, because Blender is iterating over them.
    if _overlay is not None and _overlay.running is not _failed and not _overlay.running.closed:
        _guarded(_overlay.running, getattr(_overlay, method), bpy.context)


def register() -> None:
    """Listen to the sessions."""
    session.listeners.append(_follow)


def unregister() -> None:
    """Remove the overlay and its listener."""
    global _failed
    session.listeners.remove(_follow)
    _end()
    _failed = None
