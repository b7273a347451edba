"""Planning of a recovery before large reads: coverage, cost, memory."""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from ...capture.types import Capture
from ...geometry.build import check_card
from ...geometry.light.card_relief import relief_triangles
from ...geometry.seams.edges import seam_edges
from ...geometry.surface.bake import uv_coverage
from ...geometry.surface.mesh import MeshData
from ...gpu import context
from ...reflectance.model import ReflectanceModel
from ..settings.levels import refuse_levels
from ..settings.schedule import Schedule
from .cost import recovery_cost
from .memory import amount, machine_memory
from .plan import (
    Borders,
    Limits,
    Plan,
    fits_textures,
    max_texture_bytes,
    plan_recovery,
    stack_bytes,
    tile_of,
    within_limits,
)


def covered_texels(capture: Capture, mesh: MeshData | None, resolution: tuple[int, int]) -> np.ndarray:
    """Return (H, W) bool: the domain's covered texels, from its mask or mesh alone."""
    return check_card(capture) if mesh is None else uv_coverage(mesh, *resolution)


def make_plan(
    coverage: np.ndarray,
    model: ReflectanceModel,
    schedule: Schedule,
    fixed: Collection[str],
    observations: int,
    held_out: int = 0,
    *,
    memory: str | None = None,
    entry: str = "auto",
    stack_on: str | None = None,
    mesh: MeshData | None = None,
) -> Plan:
    """Return the plan of a recovery of the covered texels, (H, W) bool. Raises InputError.

    memory: the budget, "4G" or "device=4G,host=8G", the free memory by default. entry: as for a Recovery. stack_on:
    place of a sample stack that has been read, or None. mesh: of the texels; its seams need memory too.
    """
    free = context.free_device_memory()
    limits = device_limits(free)
    surface = rays_surface(mesh, coverage, schedule)
    cost = recovery_cost(model, schedule, fixed, observations, held_out, entry != "fragment", **surface)
    held = stack_bytes(cost, coverage.size) if stack_on == "memory" else 0
    allowed = machine_memory(memory, str(context.describe()["renderer"]), free, held)
    borders = None if mesh is None else uv_borders(mesh, coverage.shape)
    plan = plan_recovery(coverage, cost, allowed, limits, stack_on, borders)
    if not untiled(plan):
        whole = tile_of(coverage, (0, 0, *plan.shape[::-1]), within_limits(cost, coverage, limits), borders)
        if fits_textures(whole, cost, limits):
            refuse_levels(schedule)
        refuse_levels(
            schedule,
            f"the domain exceeds this GPU's textures ({limits.side} texels a side, {amount(limits.texture)})",
            "choose fewer photographs, or a smaller --scale or --resolution",
        )
    return plan


def rays_surface(mesh: MeshData | None, coverage: np.ndarray, schedule: Schedule) -> dict[str, Any]:
    """Return what ``recovery_cost`` needs of interreflection's surface. coverage: (H, W) of a card if mesh is None."""
    if mesh is not None:
        return {"triangles": len(mesh.opaque), "known_shape": True, "tiles": len(mesh.tiles)}
    return {"triangles": relief_triangles(coverage.shape, schedule.interreflection.resolution)}


def device_limits(free: int | None) -> Limits:
    """Return the limits of this GPU's textures. free: bytes that the driver reports, or None."""
    device = context.describe()
    return Limits(int(device["max_texture_size"]), int(device["max_texture_layers"]), max_texture_bytes(free))


def uv_borders(mesh: MeshData, shape: tuple[int, ...]) -> Borders:
    """Return the border edges of a mesh's UV islands on (H, W) texels."""
    edges, _ = seam_edges(mesh, shape[1], shape[0])
    edges = edges.some(edges.other >= 0)
    return Borders((edges.start + edges.end) / 2, np.linalg.norm(edges.end - edges.start, axis=-1))


def scratch_folder(output: Path) -> Path:
    """Return the folder of scratch files: TMPDIR if it is set, else the nearest existing parent of the output."""
    if temporary := os.environ.get("TMPDIR"):
        return Path(temporary)
    return next(folder for folder in output.resolve().parents if folder.is_dir())


def untiled(plan: Plan) -> bool:
    """Return whether the domain is one tile."""
    return plan.boxes == [(0, 0, plan.shape[1], plan.shape[0])]
