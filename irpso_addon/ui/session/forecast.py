"""Estimates a recovery's search time from the settings, before it begins."""

from __future__ import annotations

from functools import lru_cache

from ...core.errors import InputError
from ...gpu import probe
from ...pipeline.job import possible_schedule
from ...reflectance.model import load_model
from ...solver.planning.cost import recovery_cost
from ...solver.planning.forecast import forecast, in_units
from ...solver.settings.schedule import Schedule
from ..common.file_paths import absolute
from ..common.words import iface
from ..properties import findings
from ..properties.model_items import CUSTOM
from ..properties.schedule_settings import schedule_of

_MESH_COVERAGE = 0.7  # fraction of a mesh's map that a usual UV map covers


def search_time(context) -> str:
    """Return the likely search time for the checked files as text, "" if it cannot be estimated."""
    settings = context.scene.irpso
    if settings.source != "FILES" or not findings.is_checked(settings) or not settings.checked_images:
        return ""
    if not probe.measured.cache_info().currsize:  # not measured yet: a panel must not wait for the probe
        return ""
    fixed = tuple(item.name for item in settings.parameters if not item.recover)
    try:
        mesh = settings.subject == "MESH"
        schedule = possible_schedule(schedule_of(settings.schedule), mesh and settings.shadows)
        work, most_work = _work_per_texel(_model(settings), schedule, fixed, settings.checked_images, mesh)
    except InputError:  # Recover says what is wrong
        return ""
    texels = _texels(settings)
    least, most, unit = in_units(forecast(texels * work, probe.measured(), texels * most_work))
    if least == 0:
        return iface("less than a minute")
    if unit == "hours":
        return iface("{least} to {most} hours", least=least, most=most)
    return iface("{least} to {most} minutes", least=least, most=most)


def _texels(settings) -> float:
    """Return the approximate number of texels of the maps."""
    if settings.subject == "MESH":
        return _MESH_COVERAGE * settings.resolution**2
    texels = settings.checked_texels
    if settings.framing == "CROP":
        texels = settings.crop[2] * settings.crop[3]
    elif settings.framing == "CORNERS":
        x, y = tuple(settings.corners)[::2], tuple(settings.corners)[1::2]
        texels = abs(sum(x[i - 1] * y[i] - x[i] * y[i - 1] for i in range(4))) / 2
    return texels * settings.picture_scale**2


def _model(settings) -> str:
    return settings.model if settings.model != CUSTOM else str(absolute(settings.model_path, "Model File"))


@lru_cache(maxsize=8)  # panels are drawn often
def _work_per_texel(
    model: str, schedule: Schedule, fixed: tuple[str, ...], observations: int, mesh: bool
) -> tuple[float, float]:
    """Return ``work`` and ``most_work`` of a Cost."""
    cost = recovery_cost(load_model(model), schedule, fixed, observations, known_shape=mesh)
    return cost.work, cost.most_work
