"""``recover`` over the ranks of an MPI job: each reads and solves its own texels, rank 0 writes the result."""

from __future__ import annotations

import signal
import sys
import time
from argparse import Namespace
from dataclasses import replace

import numpy as np

from ..capture.inspect.damage import naming_remedy
from ..cluster.agreement import check_alike, choose_device, going_down_together
from ..cluster.partition import Partition, Split, around, check_fits, check_gathered, split
from ..cluster.recovery import Leader, RankedRecovery, serve
from ..cluster.transport import Agreed, Ranks
from ..cluster.worker import Worker
from ..core.errors import InputError, IrpsoError
from ..geometry.build import card_bake, domain_from_card, domain_from_mesh, mesh_surface
from ..geometry.domain import Domain, GeometryBake, laid_on
from ..geometry.seams.seams import SeamMap
from ..gpu import context, probe
from ..solver.planning.cost import recovery_cost
from ..solver.planning.memory import machine_memory
from ..solver.planning.planning import covered_texels, uv_borders
from .each_slot import EACH
from .lights import found_lights
from .progress import silent
from .recover import Job, check, finish, settle, solve


def recover_on_ranks(ranks: Ranks, options: Namespace) -> dict:
    """Recover and write everything, as ``recover`` does; the report is rank 0's, the others have an exit code.

    What stops one rank stops all, within seconds; the last checkpoint stays.
    """
    leader: Leader | None = None
    try:
        with going_down_together(ranks, lambda: leader is None or leader.busy):
            worker, job, found = _prepared(ranks, options)
            if worker is None:
                result = _planned(found, options)
            elif ranks.leads:
                leader = Leader(worker)
                result = _led(leader, job, options)
            else:
                result = {"exit_code": _served(worker)}
    except Agreed as agreed:
        return refused(ranks, options, agreed.error)
    except BaseException as error:
        if leader is not None:  # the others wait for an order
            leader.end(error.exit_code if isinstance(error, IrpsoError) else 130)
            ranks.close()
        raise
    if leader is not None:
        leader.end()
    ranks.close()
    return result


def refused(ranks: Ranks, options: Namespace, error: IrpsoError) -> dict:
    """Take leave of the job for what every rank has found wrong: rank 0 raises it, the others have an exit code."""
    ranks.close()
    if ranks.leads:
        raise error
    options.json = False
    return {"exit_code": error.exit_code}


def _prepared(ranks: Ranks, options: Namespace) -> tuple[Worker | None, Job, Split]:
    """Check everything, and read this rank's part of the observations; of a dry run the split alone is told."""
    started = time.perf_counter()
    job = ranks.agreed(lambda: _checked(options))
    check_alike(ranks, options, job.capture)
    if not ranks.leads:
        options.quiet, options.json = True, False
    sharing = choose_device(ranks) if ranks.size > 1 else 1
    ranks.agreed(lambda: (probe.probe(), context.ensure()))
    # Of what is recovered, not of its outline alone; and of one mind, whatever each device makes of a border.
    surface = None if options.dry_run else ranks.agreed(lambda: _surface(job))
    found = ranks.given(ranks.agreed(lambda: _split(ranks, options, job, surface)))
    ranks.agreed(lambda: _check_fits(ranks, options, found, sharing))
    if options.dry_run:
        return None, job, found
    partition = _partition(ranks, options, job, found, surface)
    ranks.agreed(lambda: settle(options, job, partition.whole))
    worker = Worker(ranks, partition, job.model, job.schedule, options.seed, job.fixed)
    ranks.agreed(lambda: _check_lit(worker, job))
    job.seconds["read"] = time.perf_counter() - started
    return worker, job, found


def _checked(options: Namespace) -> Job:
    if options.slots == EACH:
        raise InputError(f"--slots {EACH}: over several ranks one slot is recovered at a time; name it")
    job = check(options, False)
    if job.schedule.levels > 1:
        raise InputError(
            f"levels = {job.schedule.levels}: several ranks do not solve a domain coarse to fine; set levels = 1, or"
            " start one process"
        )
    return job


def _surface(job: Job) -> tuple[GeometryBake, SeamMap | None]:
    """Return the geometry of the whole domain, and its seams."""
    return (card_bake(job.capture), None) if job.mesh is None else mesh_surface(job.mesh, *job.resolution)


def _split(ranks: Ranks, options: Namespace, job: Job, surface: tuple[GeometryBake, SeamMap | None] | None) -> Split:
    counts = len(job.capture.observations), len(job.held_out)
    cost = recovery_cost(job.model, job.schedule, job.fixed, *counts, options.entry != "fragment")
    coverage = surface[0].coverage if surface else covered_texels(job.capture, job.mesh, job.resolution)
    borders = None if job.mesh is None else uv_borders(job.mesh, coverage.shape)
    return split(coverage, cost, ranks.size, borders)


def _check_fits(ranks: Ranks, options: Namespace, found: Split, sharing: int) -> None:
    memory = machine_memory(options.memory, str(context.describe()["renderer"]))
    check_fits(found, ranks, memory, sharing)
    if ranks.leads and options.checkpoint_every is not None:
        check_gathered(found, memory)


def _partition(
    ranks: Ranks, options: Namespace, job: Job, found: Split, surface: tuple[GeometryBake, SeamMap | None]
) -> Partition:
    """Read what this rank needs of the observations."""
    box = found.boxes[ranks.rank]
    part = None if box is None else around(found.shape, box, found.halo)

    def read() -> Domain | None:
        if part is None:
            return None
        with naming_remedy(options.skip_damaged):
            if job.mesh is None:
                return domain_from_card(job.capture, window=part)
            options_of = {"shadows": options.shadows, "window": part, "surface": surface}
            return domain_from_mesh(job.capture, job.mesh, *job.resolution, **options_of)

    window = ranks.agreed(read)
    bake, seams = surface
    of_all = ranks.given(window and _without_texels(window))
    whole = replace(of_all, bake=bake, seams=seams)
    return Partition(whole, found.boxes, found.halo, window)


def _without_texels(domain: Domain) -> Domain:
    """Return what all ranks have in common of a domain, to be sent to them: 0 × 0 texels."""
    return laid_on(domain, domain.bake.each(lambda values: values[:0, :0]), np.zeros((domain.observations, 0, 0, 4)))


def _check_lit(worker: Worker, job: Job) -> None:
    """Raise InputError where no rank sees anything lit, as one process would."""
    if not worker.partition.whole.solvable.any():
        what = "the card" if job.mesh is None else f"mesh '{job.mesh.name}'"
        raise InputError(
            f"no image of capture '{job.capture.name}' shows {what} lit; check its cameras, masks and exposure"
        )


def _led(leader: Leader, job: Job, options: Namespace) -> dict:
    """Do on rank 0 what ``recover`` does, the others at its orders."""
    ranks = leader.ranks
    kept = [k for k in range(leader.domain.observations) if k not in job.held_out]
    started = time.perf_counter()
    lights = found_lights(leader.domain, kept, job.model, job.fixed, options)
    if lights is not None:
        found = lights.applied(leader.domain)
        leader.take_lights(found.lights, found.intensities)
        job.seconds["lights"] = time.perf_counter() - started
    started = time.perf_counter()
    with RankedRecovery(leader, kept, options.entry) as recovery:
        job.seconds["prepare"] = time.perf_counter() - started
        solved = solve(options, job, recovery)
        messages, sent = zip(*leader.ask(Worker.sent), strict=True)
        solved.settings |= {"ranks": ranks.size, "messages": messages, "bytes_sent": sent}
        solved.warnings.extend(_unlike(leader.ask(Worker.renderers)))
    return finish(options, job, leader.domain, kept, lights, solved)


def _served(worker: Worker) -> int:
    # Rank 0 hears of it too, and orders what is to be done.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    return serve(worker)


def _unlike(renderers: list[str]) -> list[str]:
    if len(set(renderers)) == 1:
        return []
    names = ", ".join(sorted(set(renderers)))
    return [f"ranks solved on unlike devices ({names}): the last bits of maps are not those of one of them alone"]


def _planned(found: Split, options: Namespace) -> dict:
    if not silent(options):
        sys.stdout.write("\n".join(found.lines()) + "\n")
    return {"plan": found.as_dict()}
