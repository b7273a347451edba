"""The window's current Session, of which there is at most one, and its listeners."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ...blender.materials.textures import remove_superseded, superseded
from ...core.errors import InputError
from ...pipeline.run import RunCache
from ..common import failures
from ..common.polls import usable
from ..common.words import n_
from . import stored_recoveries
from .recovery import Session
from .scene_job import SceneJob

_LEAVING = n_("Leaving the file")
listeners: list[Callable[[], None]] = []  # called for every redraw
_current: Session | None = None
_superseded: set[Path] = set()  # files of maps that nothing shows once another file is loaded
_previous_run = RunCache()  # results of the last run that the next one may reuse


def current() -> Session | None:
    """Return the session that runs or waits to be kept, or None."""
    return _current


def idle(operator: type[bpy.types.Operator]) -> bool:
    """Return whether no recovery is working. Poll of operators that compete with one for processor or GPU."""
    return usable(operator, _current is None or not _current.active, "A recovery runs: pause or stop it first")


def begin(job: SceneJob) -> Session:
    """Close the former session and begin a new one; unkept maps of the former are stored.

    Raises InputError where they cannot be stored; the former session then stays.
    """
    global _current
    if _current is not None:
        if not stored_recoveries.store(_current):
            raise InputError(
                f"the recovery of '{_current.job.name}' could not be stored (Blender's log says why); keep or close it"
            )
        _current.close()
    failures.clear()
    _current = Session(job, _previous_run, _on_change)
    _notify()
    return _current


def end() -> None:
    """Close the session, if any."""
    if _current is not None:
        _current.close()


def _on_change(running: Session) -> None:
    global _current
    if running.closed and running is _current:
        _current = None
    _notify()


def _notify() -> None:
    for listener in list(listeners):
        listener()


def reset() -> None:
    """Before the file changes: store unkept maps, or say in the panel that they are lost; close the session."""
    if _current is not None and not stored_recoveries.store(_current):
        lost = f"the recovery of '{_current.job.name}' could not be stored and is lost (Blender's log says why)"
        failures.report(_LEAVING, InputError(lost))
    end()
    _previous_run.clear()


def register() -> None:
    """Add the handlers of loading another file."""
    bpy.app.handlers.load_pre.append(_on_load)
    bpy.app.handlers.load_post.append(_after_loading)


def unregister() -> None:
    """End the session, remove the files of maps that nothing shows, and remove the handlers."""
    reset()
    remove_superseded(superseded())
    bpy.app.handlers.load_post.remove(_after_loading)
    bpy.app.handlers.load_pre.remove(_on_load)


@persistent
@failures.reported(_LEAVING)
def _on_load(*_: object) -> None:
    global _superseded
    reset()
    _superseded = superseded()


@persistent
@failures.reported(_LEAVING)
def _after_loading(*_: object) -> None:  # not after a load that failed: the file and its steps of Undo are still there
    remove_superseded(_superseded)
