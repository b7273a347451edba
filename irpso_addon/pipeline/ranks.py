"""A job over MPI ranks: each rank reads and solves its own texels, rank 0 writes the result."""

from __future__ import annotations

import time
from argparse import Namespace
from collections.abc import Callable, Generator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ..capture.inspect.damage import with_skip_remedy
from ..cluster.agreement import abort_together, check_alike, choose_device
from ..cluster.partition import Partition, Split, around, check_fits, check_gathered, split
from ..cluster.recovery import Leader, RankedRecovery, serve
from ..cluster.transport import CollectiveError, Ranks
from ..cluster.worker import Worker
from ..core.errors import InputError, IrpsoError, print_error
from ..core.interrupt import exit_code_of, ignore_signals
from ..core.optional import present
from ..geometry.build import card_bake, check_seen, domain_from_card, domain_from_mesh, mesh_surface
from ..geometry.domain import Domain, GeometryBake, subset, with_texels
from ..geometry.seams.seams import SeamMap
from ..geometry.surface.bake import surface_bake
from ..gpu import context, probe
from ..solver.engine.engine import RecoveryEngine
from ..solver.interreflection.rounds import InterreflectionRounds
from ..solver.lights.refine import Lights
from ..solver.planning.cost import recovery_cost
from ..solver.planning.make_plan import covered_texels, device_limits, rays_surface, uv_borders
from ..solver.planning.memory import machine_memory
from ..solver.planning.plan import within_limits
from .job import Job
from .run import READ, Run, check_fixed_normals, in_solver_frames

Surface = tuple[GeometryBake, SeamMap | None]


class RankedRun(Run):
    """The run of a job over all ranks, on rank 0; the others ``serve``."""

    def __init__(self, job: Job, leader: Leader, seconds: float, show: Callable[[str, float], None]):
        """Take a job that all ranks have read. seconds: of reading."""
        super().__init__(job, show)
        self._leader, self._seconds = leader, seconds

    def device_warnings(self) -> list[str]:
        """Return a warning if ranks solve on different devices."""
        names = sorted(set(self._leader.ask(Worker.renderers)))
        if len(names) == 1:
            return []
        return [
            f"ranks used different devices ({', '.join(names)}): the last bits of the maps differ from those of a run"
            " on one of them"
        ]

    def _read(self) -> Generator[None, None, Domain]:
        yield from ()
        self.seconds[READ] = self._seconds
        return self._leader.domain

    def _lit(self, domain: Domain, lights: Lights) -> Domain:
        lit = lights.applied(domain)
        self._leader.take_lights(lit.lights, lit.intensities)
        return self._leader.domain

    def _begin(self, domain: Domain) -> Generator[None, None, None]:
        yield from ()
        job, solve = self.job, partial(RankedRecovery, self._leader)
        geometry = self._interreflection_geometry()
        settings = subset(domain, job.fitted), job.model, job.schedule, job.seed, self.fixed, job.entry
        if geometry is None:
            self.recovery = solve(*settings)
        else:
            self.recovery = InterreflectionRounds(*settings, geometry, solve=solve)

    def _described(self, recovery: RecoveryEngine) -> dict[str, Any]:
        messages, sent = zip(*self._leader.ask(Worker.sent), strict=True)
        return {
            "entry": recovery.entry, "ranks": self._leader.ranks.size, "messages": messages, "bytes_sent": sent
        }  # fmt: skip


def run_on_ranks(
    ranks: Ranks,
    options: Namespace,
    checked: Callable[[], Job],
    show: Callable[[str, float], None],
    lead: Callable[[RankedRun], dict[str, Any]],
) -> dict[str, Any]:
    """Return the result of ``lead`` on rank 0, or the plan of a dry run; on the other ranks an exit code.

    options: of ``recover``, the same on all ranks. checked: returns the job. An error on one rank stops all, within
    seconds; the last checkpoint stays.
    """
    result: dict[str, Any]
    leader: Leader | None = None
    try:
        with abort_together(ranks, lambda: leader is None or leader.busy):
            started = time.perf_counter()
            job = ranks.agreed(lambda: _divisible(checked()))
            check_alike(ranks, options, job.capture)
            worker, division = _worker_and_split(ranks, options, job)
            if worker is None:
                result = {"plan": division}
            elif ranks.leads:
                leader = Leader(worker)
                run = RankedRun(job, leader, time.perf_counter() - started, show)
                result = lead(run)
            else:
                result = {"exit_code": _serve_orders(worker)}
    except CollectiveError as collective:
        return leave_with_error(ranks, options, collective.error)
    except BaseException as error:
        if leader is not None:  # the other ranks wait for an order; a launcher's SIGTERM follows their end
            ignore_signals()
            leader.end(exit_code_of(error))
            if isinstance(error, IrpsoError):
                return leave_with_error(ranks, options, error)
            ranks.close()
        raise
    if leader is not None:
        leader.end()
    ranks.close()
    return result


def leave_with_error(ranks: Ranks, options: Namespace, error: IrpsoError) -> dict[str, Any]:
    """Leave the MPI job after an error of all ranks, which rank 0 prints; return the exit code, for ``main``.

    A launcher sends all ranks SIGTERM when the first has ended with such a code, so that rank 0 prints before the
    others can leave.
    """
    ignore_signals()
    if ranks.leads:
        print_error(error, options.json)
    options.json = False
    ranks.close()
    return {"exit_code": error.exit_code}


def _divisible(job: Job) -> Job:
    if job.schedule.levels > 1:
        raise InputError(
            f"levels = {job.schedule.levels}: several ranks do not solve a domain coarse to fine; set levels = 1, or"
            " start one process"
        )
    return job


def _worker_and_split(ranks: Ranks, options: Namespace, job: Job) -> tuple[Worker | None, Split]:
    """Return this rank's worker with its samples, and the domain's split; a dry run has no worker."""
    if not ranks.leads:
        options.quiet, options.json = True, False
    sharing = choose_device(ranks) if ranks.size > 1 else 1
    ranks.agreed(probe.probe)
    ranks.agreed(context.ensure)
    # Rank 0 splits the geometry itself: devices may differ in texels at a border.
    surface = None if options.dry_run else ranks.agreed(lambda: _surface(job))
    division = ranks.broadcast(ranks.agreed(lambda: _split(ranks, job, surface)))
    ranks.agreed(lambda: _check_fits(ranks, options, job, division, sharing))
    if options.dry_run:
        return None, division
    partition = _partition(ranks, job, division, present(surface))
    fixed, _ = ranks.agreed(lambda: in_solver_frames(job, partition.whole.bake))
    worker = Worker(ranks, partition, fixed)
    ranks.agreed(lambda: _check_lit(worker, job))
    ranks.agreed(lambda: check_fixed_normals(job, worker.domain.solvable))
    return worker, division


def _surface(job: Job) -> Surface:
    """Return the geometry of the whole domain, and its seams."""
    return (card_bake(job.capture), None) if job.mesh is None else mesh_surface(job.mesh, *job.size)


def _split(ranks: Ranks, job: Job, surface: Surface | None) -> Split:
    counts = len(job.capture.observations), len(job.held_out)
    coverage = surface[0].coverage if surface else covered_texels(job.capture, job.mesh, job.size)
    interreflecting = rays_surface(job.mesh, coverage, job.schedule)
    cost = recovery_cost(job.model, job.schedule, job.fixed, *counts, job.entry != "fragment", **interreflecting)
    height, width = coverage.shape
    borders = None if job.mesh is None else uv_borders(job.mesh, (height, width))
    limits = device_limits(context.free_device_memory())
    return split(coverage, within_limits(cost, coverage, limits), ranks.size, borders)


def _check_fits(ranks: Ranks, options: Namespace, job: Job, division: Split, sharing: int) -> None:
    """Raise InputError where memory is too small."""
    free = context.free_device_memory()
    held = 0 if options.dry_run else ranks.locals * division.geometry  # every rank has made it
    memory = machine_memory(job.memory, str(context.describe()["renderer"]), free, held)
    check_fits(division, ranks, memory, device_limits(free), sharing)
    if ranks.leads and options.checkpoint_every is not None:
        check_gathered(division, memory)


def _partition(ranks: Ranks, job: Job, division: Split, surface: Surface) -> Partition:
    """Read this rank's samples; return its part of the domain."""
    bake, seams = surface
    box = division.boxes[ranks.rank]
    part = None if box is None else around(division.shape, box, division.halo)

    def read() -> Domain | None:
        if part is None:
            return None
        with with_skip_remedy(job.skip_damaged):
            if job.mesh is None:
                return domain_from_card(job.capture, window=part)
            of_mesh = surface_bake(bake), present(seams)
            return domain_from_mesh(job.capture, job.mesh, *job.size, shadows=job.shadows, window=part, surface=of_mesh)

    window = ranks.agreed(read)
    lights_only = None  # the lights and views of all ranks, with 0 × 0 texels
    if window is not None:
        none = window.bake.map_arrays(lambda values: values[:0, :0])
        lights_only = with_texels(window, none, np.zeros((window.observations, 0, 0, 4)))
    of_all = ranks.broadcast(lights_only)
    # No camera that a rank sees texels with is blind to the whole mesh, and no light that it sees hidden from it.
    own = None if window is None else (set(window.unseen), set(window.shaded))
    parts = [sets for sets in ranks.allgather(own) if sets is not None]
    unseen, shaded = (tuple(sorted(set.intersection(*sets))) for sets in zip(*parts, strict=True))
    whole = replace(of_all, bake=bake, seams=seams, unseen=unseen, shaded=shaded)
    return Partition(whole, division.boxes, division.halo, window)


def _check_lit(worker: Worker, job: Job) -> None:
    """Raise InputError where no rank has a lit texel, as one process does."""
    what = "the card" if job.mesh is None else f"mesh '{job.mesh.name}'"
    check_seen(job.capture.name, worker.partition.whole, what)


def _serve_orders(worker: Worker) -> int:
    ignore_signals()  # rank 0 gets them too, and orders the end
    return serve(worker)
