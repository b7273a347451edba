"""The one recovery of the window: opened, stepped in slices, looked at, kept or dropped."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from typing import Any
from uuid import uuid4

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...blender.materials.material import STAMP, subject_object
from ...core.udim import ONE_SQUARE
from ...geometry.domain import Domain
from ...gpu import context
from ...gpu.context_guard import ContextGuard
from ...pipeline.run import LIGHTS, PREPARE, READ, Kept, Run
from ...results.maps import Maps
from ...solver.engine.engine import RecoveryEngine
from ...solver.engine.progress import Progress, TimeLeft
from ...solver.lights.refine import Lights
from ...solver.settings.schedule import Schedule
from ...solver.views.display import Display
from ...solver.views.held_out import relit_line
from ...solver.views.tiled_view import TiledDisplay, display_of
from ..common import failures
from . import unkept
from .job import SceneJob

MOST_PROBES = 4
_POLL_SECONDS = 0.002  # between looks at the thread that prepares
_ERROR_EVERY = 0.5  # seconds between looks at the mean error, which costs a small render

_TITLES = {READ: "Reading images", LIGHTS: "Finding the lights", PREPARE: "Fitting a first guess"}

listeners: list[Callable[[], None]] = []  # called when there is something new to draw
_current: Session | None = None
_kept = Kept()  # of the last run: a second one need not wait


@dataclass
class Probe:
    """A texel that is watched. curve: (iteration, error) as often as it was looked at. slot: of its colour, 0…3."""

    row: int
    column: int
    curve: list[tuple[int, float]] = field(default_factory=list)
    slot: int = 0

    @property
    def number(self) -> int:
        """What it is called, 1…4: it keeps that as long as it is watched, and its colour."""
        return self.slot + 1


class Session:
    """One recovery under way or waiting to be kept. Nothing of the scene is changed by it.

    state: "loading", "preparing", "running", "paused" or "done"; it runs as well while photographs held out are relit.
    title: what is being done, for people. work: the job on its way. history: (iteration, mean error) now and then.
    longest_stall_s: the longest that one tick took. failure: why it ended, "" while nothing is wrong.
    """

    def __init__(self, job: SceneJob):
        self.work = Run(job, self._note, self._threaded, _kept)
        self.state, self.title, self.failure = "loading", _TITLES[READ], ""
        self.display: Display | TiledDisplay | None = None
        self.probes: list[Probe] = []
        self.history: list[tuple[int, float]] = []
        self.error: float | None = None
        self.seconds = 0.0
        self.longest_stall_s = 0.0
        self.closed = False
        self.runs = 0  # of the modal operator, which is begun anew by each resuming
        self._guard: ContextGuard | None = None
        self._uuid = uuid4().hex
        self._paused_in = self.state
        self._part = 0.0  # of the images, the lights or the first guess
        self._time_left, self._left = TimeLeft(), None
        self._asked = 0.0  # when the error was looked at last
        self._thread: threading.Thread | None = None
        self._relighting: Generator[None, None, None] | None = None
        self._opening: Generator[None, None, None] | None = self._open()

    @property
    def job(self) -> SceneJob:
        """What was asked for."""
        return self.work.job

    @property
    def domain(self) -> Domain | None:
        """The domain of all observations, None before it is read."""
        return self.work.domain

    @property
    def fitted(self) -> Domain | None:
        """The domain of the observations that are not held out."""
        return self.work.fitted

    @property
    def recovery(self) -> RecoveryEngine | None:
        """The recovery, None before it has begun."""
        return self.work.recovery

    @property
    def lights(self) -> Lights | None:
        """The lights that were found, None where they stay as given."""
        return self.work.lights

    @property
    def mesh(self):
        """The mesh as it was when the recovery began, None for a card."""
        return self.job.mesh

    @property
    def tiles(self) -> tuple[int, ...]:
        """The UDIM tiles that stand side by side in the domain, from the left."""
        return ONE_SQUARE if self.mesh is None else self.mesh.tiles

    @property
    def progress(self) -> Progress | None:
        """How far the recovery is, None before it has begun."""
        return self.recovery.progress if self.recovery is not None else None

    @property
    def fraction(self) -> float:
        """How far what is under way is: the images, the lights, the first guess, or the recovery."""
        return self._part if self.recovery is None else self.recovery.progress.fraction

    @property
    def rate(self) -> float:
        """Evaluations per second, on average since the start."""
        return self.recovery.progress.evaluations / self.seconds if self.recovery is not None and self.seconds else 0.0

    @property
    def seconds_left(self) -> float | None:
        """An estimate, None while there is too little to tell from."""
        return self._left

    @property
    def stamp(self) -> str:
        """What tells a material that holds just what has been found by now, "" before there is anything."""
        return f"{self._uuid} {self.recovery.progress.evaluations}" if self.recovery is not None else ""

    @property
    def kept(self) -> bool:
        """Whether a material of the open file holds what has been found: not after an undo, nor once it has gone on."""
        stamp = self.stamp
        return bool(stamp) and any(made.get(STAMP) == stamp for made in bpy.data.materials)

    @property
    def stopped(self) -> bool:
        """Whether it was ended by hand before its last iteration; ``resume`` goes on."""
        return self.state == "done" and self.recovery is not None and not self.recovery.progress.done

    @property
    def relighting(self) -> bool:
        """Whether the recovery has ended, and the photographs held out are being relit."""
        return self._relighting is not None

    @property
    def unseen(self) -> str:
        """How well the maps relight the photographs held out, "" where that is not known of them as they are now."""
        return relit_line(self.work.relit[1]) if self.work.is_relit else ""

    def observation(self, view: Any) -> int:
        """Return the index in the job's capture of the observation that a scene's ViewSettings show: a fitted one."""
        return self.job.fitted_at(view.index(len(self.job.capture.observations)))

    @property
    def in_own_context(self) -> bool:
        """Whether the recovery may be touched: in a window, its own graphics context is current."""
        return self._guard is None or self._guard.holds()

    @property
    def active(self) -> bool:
        """Whether there is work to be done now."""
        return self.state in ("loading", "preparing", "running")

    def subject(self):
        """Return the bpy object of the mesh, or of the card once it was kept; None where there is none (any more)."""
        return subject_object(self.job.object_uid, self.job.name)

    def tick(self, budget_s: float) -> None:
        """Work for about so long. Whatever fails ends the session, with ``failure`` set."""
        if not self.active or self.closed:
            return
        started, searching = time.perf_counter(), not self.relighting
        try:
            self._work(started + budget_s)
            self._look()
        except Exception as error:  # noqa: BLE001  a modal operator that raises is called again, and again
            self.failure = failures.report("The recovery", error)
            self.close()
        took = time.perf_counter() - started
        self.longest_stall_s = max(self.longest_stall_s, took)
        if self.recovery is not None and searching:
            self.seconds += took
            self._left = self._time_left.after(self.seconds, self.recovery.progress)
        _tell()

    def run(self) -> None:
        """Work to the end: for background mode. Raises what ``tick`` would have kept as a failure, and ends with it."""
        try:
            while self.active:
                self._work(time.perf_counter() + 0.5)
        except BaseException:
            self.close()
            raise

    def pause(self) -> None:
        """Rest until ``resume``."""
        if self.active:
            self._paused_in, self.state = self.state, "paused"
            _tell()

    def resume(self, schedule: Schedule | None = None) -> None:
        """Go on where it was paused or stopped, with another schedule from what has been found, where one is given.

        Raises InputError where that schedule does not fit.
        """
        if self.state != "paused" and not self.stopped:
            return
        if schedule is not None and schedule != self.job.schedule:
            self._change(schedule)
        self.state = self._paused_in
        _tell()

    def finish(self) -> None:
        """Go on no further; what has been found waits to be kept, once the photographs held out are relit.

        A second call does not wait for these.
        """
        if not self.work.is_relit and not self.relighting:
            self._relighting = self._relight()
            self.state, self.title = "running", "Relighting unseen photographs"
            _tell()
            return
        self._leave_relighting()
        self.state = "done"
        self.title = "Stopped" if self.stopped else "Done"
        _tell()

    def maps(self, confidence: bool = True) -> Maps:
        """Return what has been found so far, in the solver's frames. confidence: as for a Recovery."""
        return self.work.maps(confidence)

    def relight(self, maps: Maps) -> None:
        """Relight the photographs held out from ``maps``, just found, where that has not been done."""
        if not self.work.is_relit:
            self._leave_relighting()
            self.work.relight(maps)

    def add_probe(self, row: int, column: int) -> Probe | None:
        """Watch a texel. Return the oldest of four, which makes room for a fifth; None where there is room."""
        dropped = self.probes.pop(0) if len(self.probes) == MOST_PROBES else None
        free = set(range(MOST_PROBES)) - {probe.slot for probe in self.probes}
        self.probes.append(Probe(row, column, slot=min(free)))
        _tell()
        return dropped

    def probe(self, number: int) -> Probe | None:
        """Return the probe of a number, the oldest where there is none of that number, None where there are none."""
        return next((probe for probe in self.probes if probe.number == number), next(iter(self.probes), None))

    def remove_probe(self, index: int) -> None:
        """Stop watching a texel."""
        del self.probes[index]
        _tell()

    def close(self) -> None:
        """Free all that lies on the GPU. It may be called at any time, and again."""
        global _current
        self.closed, self.state = True, "done"
        self._opening = None
        self._leave_relighting()
        self._join()
        if self.display is not None:
            self.display.close()
        self.work.close()
        self.display = None
        if _current is self:
            _current = None
        _tell()

    def _join(self) -> None:
        """Wait for the thread that prepares: it reads arrays that are about to go. It takes a second or two at most."""
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _work(self, deadline: float) -> None:
        if self._opening is not None:
            self._advance_opening(deadline)
        elif self._relighting is not None:
            self._advance_relighting(deadline)
        elif self.state == "running":
            progress = self.recovery.step(time_budget_s=max(0.001, deadline - time.perf_counter()))
            self.title = progress.title
            if progress.done:
                self.finish()

    def _advance_opening(self, deadline: float) -> None:
        while self._opening is not None:
            try:
                next(self._opening)
            except StopIteration:
                self._opening = None
            if time.perf_counter() >= deadline:
                return

    def _advance_relighting(self, deadline: float) -> None:
        try:
            for _ in self._relighting:
                if time.perf_counter() >= deadline:
                    return
        except Exception as error:  # noqa: BLE001  what has been found must not be lost with a comparison
            failures.report("Relighting unseen photographs", error)
        self.finish()

    def _relight(self) -> Generator[None, None, None]:
        """Relight the photographs held out from the maps of this moment, yielding often."""
        yield from self.work.relighting(self.maps(confidence=False))

    def _leave_relighting(self) -> None:
        self._join()
        self._relighting = None

    def _open(self) -> Generator[None, None, None]:
        """Read, prepare, begin: the way to the first picture, yielding where a window may be drawn."""
        context.ensure()
        yield from self.work.open()
        if self.job.resumed is not None:
            self._take(self.recovery.load(self.job.resumed))
        self._watch()
        self.state = "running"
        if self.job.resumed is not None:  # at rest, as it was
            self.title = self.recovery.progress.title
            self.pause()
            if self.recovery.progress.done:
                self.finish()

    def _watch(self) -> None:
        """Have pictures made of the recovery, in the graphics context of this moment."""
        self._guard = None if bpy.app.background else ContextGuard()
        self.display = display_of(self.recovery)

    def _take(self, notes: dict[str, np.ndarray]) -> None:
        """Take what was noted with a recovery that is gone on from."""
        self.history = [(int(iteration), float(error)) for iteration, error in notes[unkept.HISTORY]]
        self.seconds = float(notes[unkept.SECONDS])

    def _note(self, step: str, fraction: float) -> None:
        """Note how far a step is. A thread does so too, while the session may be paused."""
        self._part = fraction
        if self.title != _TITLES[step]:
            self.title, self.state = _TITLES[step], "loading" if step == READ else "preparing"

    def _threaded(self, function: Callable[[], Any]) -> Generator[None, None, Any]:
        """Return what a function of numpy returns: it runs in a thread of its own, so that the window lives on."""
        found: list[Any] = []

        def work() -> None:
            try:
                found.append(function())
            except BaseException as error:  # noqa: BLE001  raised again where it is waited for
                found.append(error)

        self._thread = threading.Thread(target=work, name="irpso prepare")
        self._thread.start()
        while self._thread.is_alive():
            self._thread.join(_POLL_SECONDS)
            yield
        self._thread = None
        if isinstance(found[0], BaseException):
            raise found[0]
        return found[0]

    def _change(self, schedule: Schedule) -> None:
        if self.recovery is None:  # it has not begun: what was prepared was for the other one
            self._join()
            self.work = Run(replace(self.job, schedule=schedule), self._note, self._threaded, _kept)
            self._opening, self._paused_in = self._open(), "loading"
            return
        self.work.change(schedule)
        self._leave_relighting()
        self._paused_in = "running"
        self.display.close()
        self._time_left = TimeLeft()  # its work is another
        self._watch()

    def _look(self) -> None:
        """Note the mean error now and then."""
        now = time.perf_counter()
        if self.recovery is None or self.relighting or now - self._asked < _ERROR_EVERY and self.active:
            return
        progress = self.recovery.progress
        if progress.iteration < 0 and self.history:
            return
        self._asked = now
        self.error = float(self.recovery.mean_error())
        if np.isfinite(self.error):
            self.history.append((progress.iteration_in_all, self.error))


def current() -> Session | None:
    """Return the session that runs or waits to be kept, None where there is none."""
    return _current


def begin(job: SceneJob) -> Session:
    """Begin a session; one that waits to be kept is dropped."""
    global _current
    if _current is not None:
        _current.close()
    failures.clear()
    _current = Session(job)
    _tell()
    return _current


def end() -> None:
    """Drop the session, if there is one."""
    if _current is not None:
        _current.close()


def _tell() -> None:
    for listener in list(listeners):
        listener()


def forget() -> None:
    """Drop the session and what was read for it: the file is another one now. What is not kept is stored."""
    if _current is not None:
        unkept.store(_current)
    end()
    _kept.clear()


def register() -> None:
    """Watch for another file being loaded."""
    bpy.app.handlers.load_pre.append(_on_load)


def unregister() -> None:
    """End what runs, and stop watching."""
    forget()
    bpy.app.handlers.load_pre.remove(_on_load)


@persistent
@failures.reported("Leaving the file")
def _on_load(*_: object) -> None:
    forget()
