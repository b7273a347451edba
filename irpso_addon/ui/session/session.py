"""The window's session: the one recovery that runs or waits to be kept, and who follows it."""

from __future__ import annotations

from collections.abc import Callable

import bpy
from bpy.app.handlers import persistent

from ...pipeline.run import Kept
from ..common import failures
from ..common.polls import usable
from ..common.words import n_
from . import unkept
from .job import SceneJob
from .recovery import Session

listeners: list[Callable[[], None]] = []  # called for every redraw
_current: Session | None = None
_kept = Kept()  # data of the last run, for the next one


def current() -> Session | None:
    """Return the session that runs or waits to be kept, or None."""
    return _current


def idle(operator: type[bpy.types.Operator]) -> bool:
    """Return whether no recovery works now; the poll of what would share its processor or GPU."""
    return usable(operator, _current is None or not _current.active, "A recovery runs: pause or stop it first")


def begin(job: SceneJob) -> Session:
    """Begin a session; drops the former one."""
    global _current
    if _current is not None:
        _current.close()
    failures.clear()
    _current = Session(job, _kept, _changed)
    _notify()
    return _current


def end() -> None:
    """Drop the session, if any."""
    if _current is not None:
        _current.close()


def _changed(one: Session) -> None:
    global _current
    if one.closed and one is _current:
        _current = None
    _notify()


def _notify() -> None:
    for listener in list(listeners):
        listener()


def forget() -> None:
    """Store unkept maps, then drop the session and its data, because the file changes."""
    if _current is not None:
        unkept.store(_current)
    end()
    _kept.clear()


def register() -> None:
    """Watch for the loading of another file."""
    bpy.app.handlers.load_pre.append(_on_load)


def unregister() -> None:
    """End the session and stop watching."""
    forget()
    bpy.app.handlers.load_pre.remove(_on_load)


@persistent
@failures.reported(n_("Leaving the file"))
def _on_load(*_: object) -> None:
    forget()
