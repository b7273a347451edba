"""State machine of the window's recovery, stepped in time slices until its maps are kept or dropped."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from dataclasses import replace
from pathlib import Path
from typing import Any
from uuid import uuid4

import bpy
import numpy as np

from ...blender.materials.material import subject_object
from ...core.udim import ONE_SQUARE
from ...geometry.domain import Domain
from ...gpu import context
from ...pipeline.result import maps_warnings
from ...pipeline.run import LIGHTS, PREPARE, READ, Run, RunCache
from ...results.maps import Maps
from ...solver.engine.engine import RecoveryEngine
from ...solver.engine.progress import Progress, TimeLeft
from ...solver.lights.refine import Lights
from ...solver.settings.schedule import Schedule
from ...solver.views.display import Display
from ...solver.views.held_out import relit_line
from ...solver.views.tiled_view import TiledDisplay, display_of
from ..common import failures
from ..common.words import iface, n_
from . import stored_recoveries
from .probes import Probes
from .scene_job import SceneJob
from .worker import Worker

_ERROR_SECONDS = 0.5  # seconds between measurements of the mean error, each a small render

_TITLES = {READ: n_("Reading images"), LIGHTS: n_("Finding the lights"), PREPARE: n_("Fitting a first guess")}


class Session:
    """A recovery that runs, or whose maps wait to be kept. It does not change the scene.

    state: "loading", "preparing", "running" (also while held-out photographs are relit), "paused" or "done". title: the
    current step, for the panel. history: (iteration, mean error) pairs. error: the last mean error, a fraction of
    white. seconds: search time. longest_stall_s: the longest tick. warnings: of a finished recovery, except that a
    parameter has two modes, which needs its confidence. failure: the error that ended the session, "" for none.
    files: those of the kept maps, which an undo leaves on the disk.

    data: results of the previous run, for reuse. changed: called with the session for every redraw and by ``close``.
    """

    def __init__(self, job: SceneJob, data: RunCache, changed: Callable[[Session], None]):
        self._data, self._changed = data, changed
        self._worker = Worker()
        self.job_run = Run(job, self._on_step, self._worker.run, data)
        self.state, self.title, self.failure = "loading", _TITLES[READ], ""
        self.display: Display | TiledDisplay | None = None
        self.probes = Probes(self._notify)
        self.history: list[tuple[int, float]] = []
        self.error: float | None = None
        self.warnings: tuple[str, ...] = ()
        self.files: set[Path] = set()
        self.seconds = 0.0
        self.longest_stall_s = 0.0
        self.closed = False
        self.runs = 0  # starts of the modal operator: each resume starts another
        self._uuid = uuid4().hex
        self._state_before_pause = self.state
        self._fraction = 0.0  # fraction done of reading, lights or preparation
        self._time_left, self._seconds_left = TimeLeft(), None
        self._measured_at = 0.0  # time of the last measurement of the error
        self._relighting: Generator[None, None, None] | None = None
        self._opening: Generator[None, None, None] | None = self._open()

    @property
    def job(self) -> SceneJob:
        """The job."""
        return self.job_run.job

    @property
    def domain(self) -> Domain | None:
        """The domain of all observations, None before it is read."""
        return self.job_run.domain

    @property
    def fitted(self) -> Domain | None:
        """The domain of the observations that are not held out."""
        return self.job_run.fitted

    @property
    def recovery(self) -> RecoveryEngine | None:
        """The recovery, None before it has begun."""
        return self.job_run.recovery

    @property
    def lights(self) -> Lights | None:
        """The refined lights, None if the capture's own are used."""
        return self.job_run.lights

    @property
    def mesh(self):
        """The mesh at the start of the recovery, None for a card."""
        return self.job.mesh

    @property
    def tiles(self) -> tuple[int, ...]:
        """The UDIM tiles of the domain, side by side from the left."""
        return ONE_SQUARE if self.mesh is None else self.mesh.tiles

    @property
    def progress(self) -> Progress | None:
        """The recovery's progress, None before its start."""
        return self.recovery.progress if self.recovery is not None else None

    @property
    def fraction(self) -> float:
        """The fraction done (0…1) of the current step: reading, lights, preparation, or recovery."""
        return self._fraction if self.recovery is None else self.recovery.progress.fraction

    @property
    def rate(self) -> float:
        """Evaluations per second, on average since the start."""
        return self.recovery.progress.evaluations / self.seconds if self.recovery is not None and self.seconds else 0.0

    @property
    def seconds_left(self) -> float | None:
        """The estimated remaining time, None while there is too little data."""
        return self._seconds_left

    @property
    def stamp(self) -> str:
        """The stamp of a material with the current maps, "" before the recovery has begun."""
        if self.recovery is None:
            return ""
        at = self.recovery.progress
        return f"{self._uuid} {at.stage}.{at.iteration} {at.evaluations} {'done' if at.done else 'running'}"

    @property
    def kept(self) -> bool:
        """Whether a used material of the open file holds the current maps; false after an undo or more iterations."""
        return self.stamp in stored_recoveries.kept_stamps()

    @property
    def stopped(self) -> bool:
        """Whether the user ended the recovery before its last iteration; ``resume`` continues."""
        return self.state == "done" and self.recovery is not None and not self.recovery.progress.done

    @property
    def relighting(self) -> bool:
        """Whether the recovery has ended and held-out photographs are being relit."""
        return self._relighting is not None

    @property
    def held_out_line(self) -> str:
        """The error of the current maps on held-out photographs as a translated line, "" if it is not measured."""
        return relit_line(self.job_run.relit[1], iface) if self.job_run.is_relit else ""

    def observation(self, view: Any) -> int:
        """Return the index, in the job's capture, of the fitted observation that ViewSettings ``view`` choose."""
        return self.job.fitted_at(view.index(self.job.capture.listed))

    @property
    def restoring(self) -> bool:
        """Whether a stored recovery is not loaded yet. Until then its schedule cannot change."""
        return self.job.resumed is not None and self._opening is not None

    @property
    def active(self) -> bool:
        """Whether there is work to do now."""
        return self.state in ("loading", "preparing", "running")

    def home_scene(self) -> bpy.types.Scene | None:
        """Return the scene whose settings the recovery has, None if it was deleted."""
        return next((scene for scene in bpy.data.scenes if scene.session_uid == self.job.scene_uid), None)

    def subject(self):
        """Return the bpy object of the mesh or of the kept card; None if it does not exist."""
        return subject_object(self.job.object_uid, self.job.name)

    def tick(self, budget_s: float) -> None:
        """Work for about ``budget_s`` seconds. Any error ends the session and sets ``failure``."""
        if not self.active or self.closed:
            return
        started, searching = time.perf_counter(), not self.relighting
        try:
            self._advance(started + budget_s)
            self._measure_error()
        except Exception as error:  # noqa: BLE001  Blender calls a modal operator again after an error
            self.failure = failures.report(n_("The recovery"), error)
            self.close()
        took = time.perf_counter() - started
        self.longest_stall_s = max(self.longest_stall_s, took)
        if self.recovery is not None and searching:
            self.seconds += took
            self._seconds_left = self._time_left.after(self.seconds, self.recovery.progress)
        self._notify()

    def run(self) -> None:
        """Work to the end, for background mode. An error closes the session and is raised."""
        try:
            while self.active:
                self._advance(time.perf_counter() + 0.5)
        except BaseException:
            self.close()
            raise

    def pause(self) -> None:
        """Pause until ``resume``."""
        if self.active:
            self._state_before_pause, self.state = self.state, "paused"
            self._notify()

    def resume(self, schedule: Schedule | None = None) -> None:
        """Continue after a pause or stop, with another schedule if one is given.

        Raises InputError if that schedule does not fit.
        """
        if self.state != "paused" and not self.stopped:
            return
        if schedule is not None and self.job.possible(schedule) != self.job.schedule:
            self._replace_schedule(schedule)
        self.state = self._state_before_pause
        self._notify()

    def finish(self) -> None:
        """End the search, then relight held-out photographs; a second call skips that. Then the maps can be kept."""
        if not self.job_run.is_relit and not self.relighting:
            self._relighting = self._relight()
            self.state, self.title = "running", n_("Relighting unseen photographs")
            self._notify()
            return
        self._end_relighting()
        if not (self.job.held_out and self.job_run.is_relit):  # else relighting ended with the check
            self._check()
        self.state = "done"
        self.title = n_("Stopped") if self.stopped else n_("Done")
        self._notify()

    def maps(self, confidence: bool = True) -> Maps:
        """Return the current maps in the solver's frames. confidence: whether with standard deviations."""
        return self.job_run.maps(confidence)

    def relight(self, maps: Maps) -> None:
        """Relight held-out photographs with the current ``maps``, unless this is done already."""
        if not self.job_run.is_relit:
            self._end_relighting()
            self.job_run.relight(maps)

    def close(self) -> None:
        """Free all GPU memory; may be called at any time and repeatedly."""
        self.closed, self.state = True, "done"
        self._opening = None
        self._end_relighting()
        self._worker.wait()
        if self.display is not None:
            self.display.close()
        self.job_run.close()
        self.display = None
        self._notify()

    def _notify(self) -> None:
        self._changed(self)

    def _advance(self, deadline: float) -> None:
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
        except Exception as error:  # noqa: BLE001  an error in a comparison must not lose the maps
            failures.report(n_("Relighting unseen photographs"), error)
        self.finish()

    def _relight(self) -> Generator[None, None, None]:
        maps = self.maps(confidence=False)  # here, an error ends the relighting alone
        yield from self.job_run.relight_steps(maps)
        self._check(maps)

    def _check(self, maps: Maps | None = None) -> None:
        """Set the warnings of the current maps. maps: these, where they are read already."""
        self.warnings = self.recovery.warnings
        try:
            self.warnings = tuple(maps_warnings(self.job_run, maps or self.maps(confidence=False)))
        except Exception as error:  # noqa: BLE001  an error in a check must not lose the maps
            failures.report(n_("Checking the maps"), error)

    def _end_relighting(self) -> None:
        self._worker.wait()
        self._relighting = None

    def _open(self) -> Generator[None, None, None]:
        """Read, prepare, and start the recovery, or load the one to resume. Yields often, for redraws."""
        context.ensure()
        yield from self.job_run.open()
        if self.job.resumed is not None:
            arrays = self.recovery.load(self.job.resumed)
            self.history = [(int(iteration), float(error)) for iteration, error in arrays[stored_recoveries.HISTORY]]
            self.seconds = float(arrays[stored_recoveries.SECONDS])
        self.display = display_of(self.recovery)
        self.state = "running"
        if self.job.resumed is not None:  # a stored recovery opens paused
            self.title = self.recovery.progress.title
            self.pause()
            if self.recovery.progress.done:
                self.finish()

    def _on_step(self, step: str, fraction: float) -> None:
        """Set title, state and fraction (0…1) of a step. The worker thread calls this too, even during a pause."""
        self._fraction = fraction
        if self.title != _TITLES[step]:
            self.title, self.state = _TITLES[step], "loading" if step == READ else "preparing"

    def _replace_schedule(self, schedule: Schedule) -> None:
        if self.recovery is None:  # the preparation depends on the schedule
            self._worker.wait()
            self.job_run = Run(replace(self.job, schedule=schedule), self._on_step, self._worker.run, self._data)
            self._opening, self._state_before_pause = self._open(), "loading"
            return
        self.job_run.change(schedule)
        self._end_relighting()
        self._state_before_pause = "running"
        self.display.close()
        self._time_left = TimeLeft()
        self.display = display_of(self.recovery)

    def _measure_error(self) -> None:
        """Measure the mean error, at most every _ERROR_SECONDS seconds, and once at the end."""
        now = time.perf_counter()
        if self.recovery is None or self.relighting or now - self._measured_at < _ERROR_SECONDS and self.active:
            return
        progress = self.recovery.progress
        if progress.iteration < 0 and self.history:
            return
        self._measured_at = now
        self.error = float(self.recovery.mean_error())
        if np.isfinite(self.error):
            self.history.append((progress.iteration_in_all, self.error))
