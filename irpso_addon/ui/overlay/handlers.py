"""The draw handlers: there while a session is, gone when it ends; what fails in one ends the overlay and is told."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy

from ..common import failures
from ..session import session
from .stage import Stage
from .surface import why_unseen

_OVERLAY = "The overlay"  # as failures call it
_IDLE_SECONDS = 0.1  # between looks at the settings while the session rests

_handles: list[tuple[type, Any]] = []
_stage: Stage | None = None
_failed: session.Session | None = None  # whose overlay has ended; it is not begun again


def is_seen_in(context, space) -> bool:
    """Return whether a 3-D viewport of the context's window shows the subject."""
    if _stage is None:
        return False
    with context.temp_override(area=next(a for a in context.screen.areas if a.spaces.active == space)):
        return not why_unseen(bpy.context, _stage.running, _stage.running.subject(), _stage.home_scene)


def why_hidden(context) -> str:
    """Return why the editor of a context draws nothing of the session, in a sentence; "" where it draws."""
    if _failed is not None and _failed is session.current():
        return _failed.failure
    return "" if _stage is None or context.space_data is None else _stage.why_hidden(context)


def handler_count() -> int:
    """Return how many draw handlers there are."""
    return len(_handles)


def redraw(only: int = 0) -> None:
    """Have the 3-D viewports and Image editors drawn anew, of all windows or of the one at an address."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas if only in (0, window.as_pointer()) else ():
            if area.type in ("VIEW_3D", "IMAGE_EDITOR"):
                area.tag_redraw()


def _follow() -> None:
    """Begin with a session, go on with it, and end with it. Called where the session works."""
    global _failed
    running = session.current()
    if _stage is not None and running is not _stage.running:
        _end()
    if running is not _failed:
        _failed = None
    if running is None or running is _failed or bpy.app.background:
        return
    if _stage is None:
        _guarded(running, _begin, running)
    if _stage is not None and running is not _failed and _stage.is_due():
        _guarded(running, _stage.update)


def _begin(running: session.Session) -> None:
    global _stage
    _stage = Stage(running, bpy.context.scene.session_uid)
    for space, draw, kind in (
        (bpy.types.SpaceView3D, _draw_view, "POST_VIEW"),
        (bpy.types.SpaceView3D, _draw_pixels, "POST_PIXEL"),
        (bpy.types.SpaceImageEditor, _draw_image, "POST_PIXEL"),
    ):
        _handles.append((space, space.draw_handler_add(draw, (), "WINDOW", kind)))
    bpy.app.timers.register(_idle, first_interval=_IDLE_SECONDS)
    redraw()


def _end() -> None:
    global _stage
    while _handles:
        space, handle = _handles.pop()
        space.draw_handler_remove(handle, "WINDOW")
    if bpy.app.timers.is_registered(_idle):
        bpy.app.timers.unregister(_idle)
    if _stage is not None:
        _stage.close()
        _stage = None
        redraw()


@failures.told(_OVERLAY)
def _idle() -> float | None:
    """Heed changed settings while the session rests and nobody else does."""
    if _stage is None or _stage.running is _failed:
        _end()
        return None
    if not _stage.running.active:
        if _stage.in_own_context():
            if _guarded(_stage.running, _stage.update):
                redraw()
        else:
            redraw(_stage.own_window)  # drawing a window makes its context current, until another is drawn
        if _guarded(_stage.running, _stage.wants_redraw):
            redraw()
    return _IDLE_SECONDS


def _guarded(running: session.Session, work: Callable[..., Any], *arguments: Any) -> Any:
    """Do some work; an exception ends the overlay of this session once and for all, and is told."""
    global _failed
    with failures.told(_OVERLAY):
        return work(*arguments)
    _failed = running
    return None


def _draw(method: Callable[[Stage, Any], None]) -> None:
    # Handlers are not removed here: Blender is going through the list of them.
    if _stage is not None and _stage.running is not _failed and not _stage.running.closed:
        _guarded(_stage.running, method, _stage, bpy.context)


def _draw_view() -> None:
    _draw(Stage.draw_view)


def _draw_pixels() -> None:
    _draw(Stage.draw_pixels)


def _draw_image() -> None:
    _draw(Stage.draw_image)


def register() -> None:
    """Follow the sessions."""
    session.listeners.append(_follow)


def unregister() -> None:
    """Take out what is drawn, and follow no longer."""
    global _failed
    session.listeners.remove(_follow)
    _end()
    _failed = None
