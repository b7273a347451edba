"""What a run has found: maps in Blender's frames, report and pictures, and the material on its subject."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..blender.materials import material
from ..blender.materials.margins import blender_maps
from ..capture.types import Capture
from ..core.errors import InputError
from ..geometry.domain import subset
from ..geometry.relief.height import Height
from ..gpu import context
from ..results.derived_map import DerivedMap
from ..results.derived_maps import DerivedMaps, derived_maps
from ..results.maps import Maps
from ..results.report import build_report, limit_warnings, mode_warnings, prior_shares
from ..solver.lights.refine import contradiction
from ..solver.views.held_out import preview_names
from ..solver.views.pictures import confidence_preview, error_preview
from .job import Job
from .run import Run

_NONE = DerivedMaps()
_GIVEN_AS_ONE = (1.0, 1.0, 1.0)  # the intensity of lights in a capture that states none


@dataclass(frozen=True)
class Found:
    """Maps of a run. solver: with normals in the solver's frames; written: in those of Blender's normal maps.

    extras: maps besides the model's. height: the relief, None where it was not asked for.
    """

    solver: Maps
    written: Maps
    derived: list[DerivedMap]
    height: Height | None


def found_of(run: Run, maps: Maps, wanted: DerivedMaps = _NONE) -> Found:
    """Return what is written of ``maps``, the last of the run. Raises InputError where an extra cannot be made."""
    job = run.job
    wanted.check(maps.model)
    written = maps if job.mesh is None else blender_maps(maps, job.mesh, run.domain.bake, run.domain.seams)
    return Found(maps, written, *derived_maps(wanted, maps, written, run.domain.bake, job.mesh, job.capture.cameras[0]))


def report_of(
    run: Run, found: Found, settings: Mapping[str, Any], seconds: float, warnings: list[str] | None = None
) -> dict[str, Any]:
    """Return the report. settings: as they were asked for. seconds: of the search. warnings: what came up in it."""
    job, maps, progress = run.job, found.solver, run.progress
    run.relight(maps)
    report = build_report(
        maps, settings={**settings, "preset": asdict(job.schedule), **run.settings}, seed=job.seed,
        gpu=context.describe()["renderer"], iterations=progress.iteration_in_all, evaluations=progress.evaluations,
        seconds={**run.seconds, "solve": seconds}, ground_truth=run.truth, noise=run.domain.noise,
    )  # fmt: skip
    priors = job.schedule.fitness.priors
    found_wrong = [*limit_warnings(maps, job.fixed), *mode_warnings(maps, priors), *_light_warnings(run, maps)]
    read_wrong = [*job.warnings, *capture_warnings(job.capture)]
    report |= run.relit[1] | {"warnings": [*found_wrong, *read_wrong, *(warnings or [])]}
    if job.capture.encoding is not None and job.capture.encoding.known_by != "format":
        report["colour_space"] = job.capture.encoding.colour_space
    if priors and (shares := prior_shares(maps, job.fixed)):
        report["priors_decided"] = shares
    if job.capture.left_out:
        report["left_out"] = [asdict(one) for one in job.capture.left_out]
    report["unseen_texels"] = int((run.domain.bake.coverage & ~maps.covered).sum())
    if run.lights is not None:
        report["lights"] = run.lights.report(job.numbers)
    return report | ({} if found.height is None else {"height": found.height.described()})


def capture_warnings(capture: Capture) -> list[str]:
    """Return what was noticed on reading a capture: images left out, an encoding that had to be guessed."""
    lines = [f"left out: {one.why}" for one in capture.left_out]
    encoding = capture.encoding
    text = "" if encoding is None or encoding.known_by == "format" else encoding.message()
    return [*lines, text] if text else lines


def _light_warnings(run: Run, maps: Maps) -> list[str]:
    """Return what makes the lights doubtful: those that were found, or intensities that the capture does not state."""
    job, lights = run.job, run.lights
    if lights is not None and (lights.factors != 1).any():
        return lights.warnings(job.lights.intensities == "estimate")
    if any(tuple(observation.light.intensity) != _GIVEN_AS_ONE for observation in job.capture.observations):
        return []
    fitted = subset(run.domain, job.fitted)
    text = contradiction(fitted, maps.model, maps.values, frozenset(job.fixed), job.seed)
    return [text] if text else []


def pictures_of(run: Run, found: Found) -> dict[str, np.ndarray]:
    """Return file stem → (H, W, 3) display values: renders beside photographs, confidence, and those held out relit."""
    run.relight(found.solver)
    names = preview_names(run.job.capture, run.job.unseen)
    preview = error_preview(run.domain, found.solver, run.truth, names)
    return {"preview": preview} | confidence_preview(found.solver) | run.relit[0]


def subject_of(job: Job) -> Any:
    """Return the object that the material is for, None for a card that has none yet. Raises InputError."""
    subject = material.subject_object(job.object_uid, job.name)
    if job.mesh is not None and subject is None:
        raise InputError(f"'{job.name}' has been deleted: undo that and keep again, or export the maps")
    if subject is not None:
        material.check_object(subject)
    return subject


def make_material(job: Job, subject: Any, found: Found, height: Height | None, folder: Path | None = None) -> tuple:
    """Put what was found on its subject as material; return material and object, which is made for a card.

    subject: of ``subject_of``. height: the relief that displaces the surface. folder: for pictures, None to pack them.
    Raises InputError.
    """
    maps = found.written
    uv_map = "" if job.mesh is None else material.other_uv_map(subject, job.mesh.uv_map)
    made = material.build_material(maps, job.name, folder, uv_map, height)
    if job.mesh is None:
        subject = material.card_object(job.name, *maps.covered.shape, height is not None)
    material.apply_material(subject, made, () if job.mesh is None else job.mesh.solved_slots)
    return made, subject
