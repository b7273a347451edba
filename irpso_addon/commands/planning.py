"""Planning a recovery before anything large is read: what is covered, what that asks for, what there is."""

from __future__ import annotations

import os
from argparse import Namespace
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..capture.types import Capture
from ..errors import InputError
from ..geometry.bake import uv_coverage
from ..geometry.build import check_card
from ..geometry.domain import Domain
from ..geometry.mesh import MeshData
from ..gpu import context
from ..reflectance.model import ReflectanceModel
from ..solver import checkpoint
from ..solver.memory import machine_memory
from ..solver.need import recovery_need
from ..solver.plan import Limits, Plan, plan_recovery
from ..solver.pyramid import Pyramid
from ..solver.recovery import Recovery
from ..solver.schedule import Schedule, refuse_levels
from ..solver.tiled import TiledRecovery


def covered_texels(capture: Capture, mesh: MeshData | None, resolution: tuple[int, int]) -> np.ndarray:
    """Return (H, W) bool: the texels of the domain that is to come, by its mask or its mesh alone."""
    return check_card(capture) if mesh is None else uv_coverage(mesh, *resolution)


def make_plan(
    options: Namespace,
    coverage: np.ndarray,
    model: ReflectanceModel,
    schedule: Schedule,
    known: Collection[str],
    observations: int,
    held_out: int,
    stack_on: str | None = None,
    resumed: Path | None = None,
) -> Plan:
    """Return the plan of a recovery of the covered texels, (H, W) bool. Raises InputError.

    stack_on: where the sample stack lies already. resumed: the checkpoint of a run that goes on, which keeps its tiles.
    """
    device = context.describe()
    memory = machine_memory(options.memory, str(device["renderer"]))
    limits = Limits(int(device["max_texture_size"]), int(device["max_texture_layers"]))
    need = recovery_need(model, schedule, known, observations, held_out, options.entry != "fragment")
    boxes = []
    if resumed is not None:
        boxes = checkpoint.tiles_of(resumed)[0] or [(0, 0, coverage.shape[1], coverage.shape[0])]
        _check_boxes(boxes, coverage)
    plan = plan_recovery(coverage, need, memory, limits, stack_on, boxes)
    if not _untiled(plan):
        refuse_levels(schedule)
    return plan


def _check_boxes(boxes: list[tuple[int, ...]], coverage: np.ndarray) -> None:
    """Raise InputError unless a checkpoint's tiles hold all texels of this domain."""
    rows, columns = coverage.shape
    left = coverage.copy()
    for box in boxes:
        x, y, width, height = box if len(box) == 4 else (0, 0, 0, 0)
        if not (width > 0 and height > 0 and 0 <= x <= columns - width and 0 <= y <= rows - height):
            raise InputError("--resume: the checkpoint is of a domain of another size; run without --resume")
        left[y : y + height, x : x + width] = False
    if left.any():
        raise InputError("--resume: the checkpoint's tiles leave some of this domain out; run without --resume")


def scratch_folder(output: Path) -> Path:
    """Return where scratch files go: TMPDIR where it is set, else beside the output folder."""
    if folder := os.environ.get("TMPDIR"):
        return Path(folder)
    folder = output.resolve().parent
    while not folder.is_dir():
        folder = folder.parent
    return folder


def held_out_last(capture: Capture, held_out: list[int]) -> tuple[Capture, list[int]]:
    """Return the capture with the observations held out at its end: what is fitted is then one piece of the stack."""
    kept = [k for k in range(len(capture.observations)) if k not in held_out]
    observations = tuple(capture.observations[k] for k in [*kept, *held_out])
    return replace(capture, observations=observations), list(range(len(kept), len(observations)))


def planned_recovery(
    plan: Plan,
    domain: Domain,
    model: ReflectanceModel,
    schedule: Schedule,
    known: dict[str, np.ndarray],
    options: Namespace,
) -> Recovery | Pyramid | TiledRecovery:
    """Return the recovery that the plan and the schedule ask for."""
    settings = (domain, model, schedule, options.seed, known, options.entry)
    if _untiled(plan):
        return Recovery(*settings) if schedule.levels == 1 else Pyramid(*settings)
    scratch = scratch_folder(Path(options.output)) if plan.state_on == "scratch" else None
    return TiledRecovery(*settings, boxes=plan.boxes, halo=plan.halo, on_device=plan.on_device, scratch=scratch)


def _untiled(plan: Plan) -> bool:
    return plan.boxes == [(0, 0, plan.shape[1], plan.shape[0])]
