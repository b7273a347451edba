"""The run of a job: read → lights → plan → prepare → recovery, in steps that a window can interleave."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from ..blender.materials.tangent_frames import maps_from_blender
from ..blender.ray_caster import ray_caster_steps
from ..capture.inspect.damage import with_skip_remedy
from ..core.errors import InputError
from ..core.optional import present
from ..core.steps import map_steps, one_step, run_steps
from ..geometry.build import card_steps, loading_steps, mesh_steps
from ..geometry.domain import Domain, GeometryBake, subset
from ..geometry.light.interreflection_geometry import CardInterreflection, InterreflectionGeometry, MeshInterreflection
from ..geometry.samples import place_of
from ..geometry.surface.bake import surface_bake
from ..results.maps import Maps
from ..results.report import UNIT_LENGTH
from ..solver.engine.engine import RecoveryEngine
from ..solver.engine.modes import with_modes
from ..solver.engine.progress import Progress
from ..solver.factory import planned_recovery
from ..solver.lights.contradiction import can_tell
from ..solver.lights.light_texels import draw_texels
from ..solver.lights.refine import Lights, chosen_steps
from ..solver.planning.make_plan import covered_texels, make_plan, untiled
from ..solver.planning.memory import free_memory
from ..solver.planning.plan import Plan
from ..solver.settings.fixed import full_map
from ..solver.settings.schedule import Schedule
from ..solver.state.prepare import Prepared, prepare
from ..solver.views.held_out import distinct_names, relit_steps
from .job import Job

T = TypeVar("T")
MapsOf = Mapping[str, np.ndarray]  # parameter name → its map
READ, LIGHTS, PREPARE = "read", "lights", "prepare"  # the steps, as shown
_CACHE_SHARE = 0.1  # of the free memory, for a cached preparation


@dataclass
class RunCache:
    """Cache of one run's results for the next: the domain of a ``Job.source``, its lights and its preparation.

    lights_key, prepared_key: the settings of each. A domain under estimated lights is not cached.
    """

    source: tuple[Any, ...] | None = None
    domain: Domain | None = None
    lights_key: tuple[Any, ...] | None = None
    lights: Lights | None = None
    prepared_key: tuple[Any, ...] | None = None
    prepared: Prepared | None = None

    def clear(self) -> None:
        """Empty the cache."""
        self.source = self.domain = self.lights_key = self.lights = self.prepared_key = self.prepared = None


class Run:
    """The run of a job. domain: of all observations, under the estimated lights; fitted: of those not held out.

    domain, fitted, recovery: None before ``open`` and after ``close``. fixed, truth: the job's, in the frames of the
    domain's texels. lights: None where they stay as given. seconds: of each step. progress, settings, findings,
    warnings: of the last ``maps``, for the report.
    """

    def __init__(
        self,
        job: Job,
        show: Callable[[str, float], None] = lambda step, fraction: None,
        elsewhere: Callable[[Callable[[], Any]], Generator[None, None, Any]] = one_step,
        kept: RunCache | None = None,
    ):
        """``open`` begins the work.

        show: called with a step and its fraction done, 0…1, from any thread. elsewhere: runs a numpy function and
        yields meanwhile. kept: the cache of former runs.
        """
        self.job = job
        self._show, self._elsewhere, self._kept = show, elsewhere, RunCache() if kept is None else kept
        self.domain: Domain | None = None
        self.fitted: Domain | None = None
        self.lights: Lights | None = None
        self.recovery: RecoveryEngine | None = None
        self.fixed, self.truth = job.fixed, job.truth
        self.seconds: dict[str, float] = {}
        self.progress: Progress | None = None
        self.settings: dict[str, Any] = {}
        self.findings: dict[str, Any] = {}
        self.warnings: tuple[str, ...] = ()
        self._plan: Plan | None = None
        self._relit: tuple[dict[str, np.ndarray], dict[str, Any]] = {}, {}  # picture and figures of held-out images
        self._relit_at: Progress | None = None
        self._held_out_indirect: Callable[[int], np.ndarray | float] = lambda held_out: 0.0

    def first_plan(self) -> Plan:
        """Return the plan from the subject's outline alone, before reading images. Raises InputError."""
        if self._plan is None:
            cached = self._cached()
            place = None if cached is None else place_of(cached.stack)
            self._plan = self._planned(covered_texels(self.job.capture, self.job.mesh, self.job.size), place)
        return self._plan

    def open(self) -> Generator[None, None, None]:
        """Read, calibrate lights, plan and prepare the recovery, yielding often. Raises InputError, ShaderError."""
        self.domain = yield from self._timed(READ, self._read())
        check_fixed_normals(self.job, self.domain.solvable)
        self.fixed, self.truth = in_solver_frames(self.job, self.domain.bake)
        if self._wants_lights(self.domain):
            self.lights = yield from self._timed(LIGHTS, self._find_lights(self.domain))
            if self.lights is not None:
                self.domain = self._lit(self.domain, self.lights)
        yield from self._timed(PREPARE, self._begin(self.domain))

    @property
    def scaled(self) -> bool:
        """Whether estimated intensities are in use, which differ from the given ones."""
        return self.lights is not None and self.lights.scaled

    def maps(self, confidence: bool = True) -> Maps:
        """Return the maps so far, in the solver's frames. confidence: as for a recovery."""
        recovery = present(self.recovery)
        self.progress, self.settings = recovery.progress, self._described(recovery)
        self.findings, self.warnings = recovery.findings, recovery.warnings
        return with_modes(recovery.maps(confidence))

    def indirect(self, observation: int) -> np.ndarray | float:
        """Return the indirect light, (H, W, 3) or 0: the subtracted one, or if held out that of ``relight_steps``."""
        if observation in self.job.fitted:
            return present(self.recovery).indirect(observation)
        held_out = self.job.held_out_indices
        return self._held_out_indirect(observation - held_out.start) if observation in held_out else 0.0

    @property
    def indirect_share(self) -> np.ndarray | None:
        """The share of the light that was indirect, as ``RecoveryEngine.indirect_share``."""
        return present(self.recovery).indirect_share

    def device_warnings(self) -> list[str]:
        """Return warnings about the devices of the recovery."""
        return []

    def relight_steps(self, maps: Maps) -> Generator[None, None, None]:
        """Render the held-out observations from the last ``maps``, yielding often."""
        domain, progress = present(self.domain), present(self.progress)
        held_out = self.job.held_out_indices
        if self.recovery is not None and held_out:
            self._held_out_indirect = yield from self.recovery.indirect_in(subset(domain, held_out, domain.solvable))
        names = distinct_names([shot.name for shot in self.job.capture.observations], self.job.listed_numbers)
        steps = relit_steps(domain, maps, held_out, names, self._elsewhere, self.indirect)
        self._relit, self._relit_at = (yield from steps), progress

    @property
    def is_relit(self) -> bool:
        """Whether ``relit`` is up to date, or nothing is held out."""
        progress = self.recovery.progress if self.recovery is not None else self.progress
        return not self.job.held_out or (progress is not None and self._relit_at == progress)

    @property
    def relit(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """The picture of the held-out observations beside their renders, and the figures for the report."""
        return self._relit

    def relight(self, maps: Maps) -> None:
        """Do ``relight_steps`` at once, if ``relit`` is older than the last maps."""
        if self.job.held_out and self._relit_at != self.progress:
            run_steps(self.relight_steps(maps))

    def change(self, schedule: Schedule) -> None:
        """Continue with another schedule from the current state. Raises InputError; then nothing has changed."""
        schedule = self.job.possible(schedule)
        if schedule.levels != self.job.schedule.levels:
            raise InputError(
                f"Levels: a running recovery has {self.job.schedule.levels}; set Levels back to this, or stop"
            )
        if schedule.interreflection != self.job.schedule.interreflection:
            raise InputError("Interreflection: a running recovery keeps its settings; set them back, or stop")
        before = present(self.recovery)
        self.recovery, self.job = before.reconfigure(schedule), replace(self.job, schedule=schedule)
        before.close()

    def close(self) -> None:
        """Free all that lies on the GPU, and the domain."""
        if self.recovery is not None:
            self.recovery.close()
        self.recovery = self.domain = self.fitted = None

    def _read(self) -> Generator[None, None, Domain]:
        job, kept = self.job, self._kept
        self._show(READ, 0.0)
        plan = self.first_plan()  # raises InputError before the images are read
        if (cached := self._cached()) is not None:
            return cached
        kept.clear()  # memory may not hold two domains
        scratch = job.scratch if plan.stack_on == "scratch" else None
        if job.mesh is None:
            steps = card_steps(job.capture, scratch=scratch)
        else:
            steps = mesh_steps(job.capture, job.mesh, *job.size, scratch=scratch, shadows=job.shadows)
        count, made = loading_steps(job.capture, job.mesh is not None), itertools.count(1)
        with with_skip_remedy(job.skip_damaged):
            domain = yield from map_steps(steps, lambda _: self._show(READ, min(1.0, next(made) / count)))
        if job.source is not None:
            kept.source, kept.domain = job.source, domain
        return domain

    def _cached(self) -> Domain | None:
        """Return the domain of an equal source that the last run has read."""
        kept, source = self._kept, self.job.source
        return kept.domain if source is not None and kept.source == source else None

    def _wants_lights(self, domain: Domain) -> bool:
        lights = self.job.lights
        if lights.intensities == "estimate" or lights.degrees != 0:
            return True
        return lights.intensities == "auto" and can_tell(domain, np.asarray(self.job.fitted))

    def _find_lights(self, domain: Domain) -> Generator[None, None, Lights | None]:
        """Return the estimated lights, or the cached ones of an equal job; None where they stay as given."""
        job, kept = self.job, self._kept
        self._show(LIGHTS, 0.0)
        key = job.lights, job.model, job.seed, job.entry
        cacheable = kept.domain is domain and not job.fixed
        if cacheable and kept.lights_key == key:
            return kept.lights
        texels = yield from self._elsewhere(lambda: draw_texels(domain, job.seed, np.asarray(job.fitted)))
        steps = chosen_steps(
            domain, job.model, job.seed, self.fixed, intensities=job.lights.intensities,
            refine_degrees=job.lights.degrees, fitted=job.fitted, entry=job.entry, texels=texels,
        )  # fmt: skip
        estimated = yield from map_steps(steps, lambda fraction: self._show(LIGHTS, fraction))
        if cacheable:
            kept.lights_key, kept.lights = key, estimated
        return estimated

    def _lit(self, domain: Domain, lights: Lights) -> Domain:
        """Return the domain under estimated lights."""
        return lights.applied(domain)

    def _planned(self, coverage: np.ndarray, stack_on: str | None = None) -> Plan:
        """Return the plan for texels (H, W) bool, as many at once as memory allows now. Raises InputError."""
        job = self.job
        return make_plan(
            coverage, job.model, job.schedule, job.fixed, len(job.capture.observations), len(job.held_out),
            memory=job.memory, entry=job.entry, stack_on=stack_on, mesh=job.mesh,
        )  # fmt: skip

    def _begin(self, domain: Domain) -> Generator[None, None, None]:
        """Plan, prepare, and make the recovery."""
        job = self.job
        self._show(PREPARE, 0.0)
        self._plan = plan = self._planned(domain.solvable, present(self._plan).stack_on)
        self.fitted = fitted = subset(domain, job.fitted)
        prepared = None
        if job.schedule.levels == 1:  # else each level is prepared by itself
            prepared = yield from self._prepared(fitted, untiled(plan))
        yield
        self.recovery = planned_recovery(
            plan, fitted, job.model, job.schedule, job.seed, self.fixed, job.entry, job.scratch, prepared,
            self._interreflection_geometry(),
        )  # fmt: skip

    def _interreflection_geometry(self) -> InterreflectionGeometry | None:
        """Return the geometry of interreflection; None for a schedule without its rounds."""
        job, settings = self.job, self.job.schedule.interreflection
        if settings.estimates == 0:
            return None
        fineness = settings.resolution, settings.rays
        if job.mesh is not None:
            return MeshInterreflection(job.mesh, ray_caster_steps, *fineness, shadowed=job.shadows)
        normal = job.model.normal
        return CardInterreflection(job.capture.cameras[0], normal, ray_caster_steps, *fineness)

    def _prepared(self, fitted: Domain, pack: bool) -> Generator[None, None, Prepared]:
        """Return the preparation, or the cached one of an equal job. pack: as for ``prepare``."""
        schedule, kept = self.job.schedule, self._kept
        key = self.job.model, schedule.swarm.start, schedule.fitness, pack
        cacheable = kept.domain is self.domain
        if cacheable and kept.prepared is not None and kept.prepared_key == key:
            return kept.prepared
        if cacheable:
            kept.prepared = None
        model, show = self.job.model, partial(self._show, PREPARE)
        prepared = yield from self._elsewhere(lambda: prepare(fitted, model, schedule, pack, show))
        if cacheable and pack and prepared.stack.nbytes < _CACHE_SHARE * free_memory():
            kept.prepared_key, kept.prepared = key, prepared
        return prepared

    def _described(self, recovery: RecoveryEngine) -> dict[str, Any]:
        """Return the settings of the report that are not the user's."""
        return {"entry": recovery.entry, "tiles": len(present(self._plan).tiles)}

    def _timed(self, name: str, steps: Generator[None, None, T]) -> Generator[None, None, T]:
        """Run steps; add up in ``seconds`` the time in them, without the caller's between them."""
        self.seconds[name] = 0.0
        while True:
            started = time.perf_counter()
            try:
                next(steps)
            except StopIteration as stop:
                return stop.value
            finally:
                self.seconds[name] += time.perf_counter() - started
            yield


def check_fixed_normals(job: Job, solvable: np.ndarray) -> None:
    """Raise InputError, as ``full_map``, for fixed normals that are none; ``in_solver_frames`` gives them the length 1.

    solvable: (H, W) bool.
    """
    if (normal := job.model.normal) in job.fixed:
        full_map(job.model, normal, job.fixed[normal], solvable)


def in_solver_frames(job: Job, bake: GeometryBake) -> tuple[MapsOf, MapsOf | None]:
    """Return the job's fixed maps and ground truth with normals and grain in the frames of the domain's texels.

    Normals of the truth without the length 1, which say that there is none, stay without a direction. Its lobes are in
    the order in which they are recovered.
    """
    given = job.truth
    if given and not {*job.model.ordered} & set(job.fixed):
        given = job.model.with_ordered_lobes(given)
    if job.mesh is None:
        return job.fixed, given
    normal = job.model.normal
    turn = partial(maps_from_blender, job.model, mesh=job.mesh, bake=surface_bake(bake))
    truth = given and turn(values=given)
    if given and truth and normal in truth:
        known = np.abs(np.linalg.norm(np.asarray(given[normal], np.float64), axis=-1) - 1) < UNIT_LENGTH
        truth = {**truth, normal: truth[normal] * known[..., None]}
    return turn(values=job.fixed), truth
