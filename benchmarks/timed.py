"""Times a recovery of a domain of repeated rows, in a process of its own that fig7 starts.

Usage: python -m benchmarks.timed JSON, with the fields of ``Job``; prints the result as JSON.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks import product, report, subjects
from benchmarks.peers.problem import peak_memory_mb
from benchmarks.product import now
from irpso_addon.geometry.domain import Domain, with_samples
from irpso_addon.gpu import context
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.engine.tiled import TiledRecovery
from irpso_addon.solver.planning.cost import Cost, recovery_cost
from irpso_addon.solver.planning.memory import Memory
from irpso_addon.solver.planning.plan import Box, Plan, plan_recovery
from irpso_addon.solver.settings.schedule import Schedule


@dataclass(frozen=True)
class Job:
    """A recovery of rows × columns texels. changes: of the preset, for Schedule.replaced. fixed: known parameters.

    chunks: of ``iterations`` each, timed separately after the swarms are placed and ``warm`` iterations, because
    drivers compile at the first use. covered: share of the texels. budget: bytes of textures for a tiled domain, else
    0; part: number of its tiles that are solved, 0 for all.
    """

    rows: int
    columns: int
    lights: int
    preset: str = "paper"
    changes: dict[str, Any] = field(default_factory=dict)
    fixed: tuple[str, ...] = ()
    iterations: int = 5
    chunks: int = 1
    entry: str = "fragment"
    covered: float = 1.0
    budget: int = 0
    part: int = 0
    warm: int = 1


def start(job: Job) -> dict[str, Any]:
    """Run a job in a process of its own; return its result."""
    process = subprocess.run(
        [sys.executable, "-m", "benchmarks.timed", json.dumps(asdict(job))], cwd=report.ROOT, check=True,
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    return json.loads(process.stdout.splitlines()[-1])


def repeated(job: Job) -> tuple[Domain, dict[str, np.ndarray]]:
    """Return a domain of one repeated row of texels, in the memory of that row, and the known maps."""
    shape = (job.rows, job.columns)
    row = subjects.make_card((1, job.columns), job.lights, subjects.NOISY, seed=3)
    up = np.broadcast_to(np.float32([0, 0, 1]), (*shape, 3))
    place = np.broadcast_to(row.domain.bake.position, (*shape, 3))
    coverage = np.ones(shape, bool)
    if job.covered < 1:
        coverage = np.random.default_rng(0).random(shape) < job.covered
    bake = replace(
        row.domain.bake, position=place, normal=up, tangent=np.broadcast_to(np.float32([1, 0, 0, 1]), (*shape, 4)),
        coverage=coverage, uv=place[..., :2],
    )  # fmt: skip
    samples = np.stack(list(row.domain.stack.layers()))
    domain = with_samples(replace(row.domain, bake=bake), np.broadcast_to(samples, (job.lights, *shape, 4)))
    fixed = {n: np.broadcast_to(np.float32(row.truth[n]), (*shape, row.truth[n].shape[-1])) for n in job.fixed}
    return domain, fixed


def measure(job: Job) -> dict[str, Any]:
    """Return seconds (clock, work) of the setup, of placing the swarms, and of every chunk; and the peak MB."""
    context.ensure()
    schedule = product.schedule_of(job.preset).replaced(**job.changes)
    tiles: dict[str, Any] = {}
    make: Callable[..., Any] = Recovery
    if job.budget:
        plan, cost = plan_of(job, schedule)
        tiles = {"tiles": len(plan.tiles), "on_device": plan.on_device, "resident": plan.resident}
        job, boxes = _part(job, plan)
        tiles["solved"] = len(boxes)
        device = None if plan.resident else min(plan.on_device, len(boxes) - 1)

        def make(*arguments, **settings):
            return TiledRecovery(*arguments, **settings, boxes=boxes, halo=cost.stencil_radius, on_device=device)

    _warm_up(job, schedule)
    before = peak_memory_mb()
    domain, fixed = repeated(job)
    began = now()
    recovery = make(domain, load_model(subjects.TWO_LOBES), schedule, 0, fixed, entry=job.entry)
    setup, began = now() - began, now()
    recovery.step(iterations=0)
    placing = now() - began
    placing += _synchronise(recovery)
    if job.warm:
        recovery.step(iterations=job.warm)
        _synchronise(recovery)
    chunks, evaluations = [], []
    for _ in range(job.chunks):
        made, began = recovery.progress.evaluations, now()
        recovery.step(iterations=job.iterations)
        spent = now() - began
        chunks.append(spent + _synchronise(recovery))
        evaluations.append(recovery.progress.evaluations - made)
    texels = int(np.count_nonzero(domain.solvable))
    clock, work = np.array(chunks).T.tolist()
    return {
        **tiles, "texels": texels, "setup": setup.tolist(), "placing": placing.tolist(), "clock": clock,
        "work": work, "evaluations": evaluations, "memory": peak_memory_mb() - before,
    }  # fmt: skip


def _warm_up(job: Job, schedule: Schedule) -> None:
    """Solve a few texels, so that the measured memory excludes the compilers'."""
    small = replace(job, rows=4, columns=4, covered=1.0)
    domain, fixed = repeated(small)
    with Recovery(domain, load_model(subjects.TWO_LOBES), schedule, 0, fixed, entry=job.entry) as recovery:
        recovery.step(iterations=2)
        recovery.mean_error()


def _synchronise(recovery: Any) -> np.ndarray:
    """Wait for the device; return the seconds (clock, work) of the wait, without those of the readback that waits.

    Draws are asynchronous: only a readback waits for them. Tiles that take turns on the device are read back already.
    """
    if recovery.capabilities.turns:
        return np.zeros(2)
    began = now()
    recovery.mean_error()
    middle = now()
    recovery.mean_error()
    return np.maximum((middle - began) - (now() - middle), 0.0)


def plan_of(job: Job, schedule: Schedule) -> tuple[Plan, Cost]:
    """Return the plan and cost of a job's whole domain within its budget."""
    cost = recovery_cost(load_model(subjects.TWO_LOBES), schedule, job.fixed, job.lights)
    # The plan reserves host memory for the stack or its file; here all rows share one row's memory.
    memory = Memory(job.budget, 1 << 44)
    return plan_recovery(np.ones((job.rows, job.columns), bool), cost, memory), cost


def _part(job: Job, plan: Plan) -> tuple[Job, list[Box]]:
    """Return the job of the first ``job.part`` adjacent tiles that form a rectangle, or of all, and their boxes."""
    count = job.part if 0 < job.part < len(plan.boxes) else len(plan.boxes)
    for first in range(len(plan.boxes) - count + 1):
        boxes = plan.boxes[first : first + count]
        x0, y0 = (min(box[i] for box in boxes) for i in (0, 1))
        x1, y1 = (max(box[i] + box[i + 2] for box in boxes) for i in (0, 1))
        if sum(w * h for _, _, w, h in boxes) == (x1 - x0) * (y1 - y0):
            return replace(job, rows=y1 - y0, columns=x1 - x0), [(x - x0, y - y0, w, h) for x, y, w, h in boxes]
    raise ValueError(f"no {count} tiles of {len(plan.boxes)} are a rectangle")


if __name__ == "__main__":
    found = measure(Job(**{k: tuple(v) if k == "fixed" else v for k, v in json.loads(sys.argv[1]).items()}))
    print(json.dumps(found))
    context.exit_process(0)
