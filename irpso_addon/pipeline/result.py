"""The results of a run: maps in Blender's frames, report and pictures, and the material on its subject."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..blender.materials import material
from ..blender.materials.margins import blender_maps
from ..blender.materials.surface_check import check_surface
from ..capture.card import near_lights
from ..capture.inspect.units import card_problems
from ..capture.types import Capture
from ..core.errors import InputError, some
from ..core.optional import present
from ..geometry.domain import Domain, subset
from ..geometry.relief.height import Height
from ..geometry.surface.bake import surface_bake
from ..gpu import context
from ..results.derived_map import DerivedMap, indirect_map
from ..results.derived_maps import DerivedMaps, derived_maps
from ..results.maps import Maps
from ..results.report import build_report, limit_warnings, mode_warnings, photograph_shares, prior_shares
from ..solver.lights.checks import light_warnings
from ..solver.lights.contradiction import contradiction
from ..solver.settings.resolve import unsearched_names
from ..solver.views.held_out import preview_names
from ..solver.views.pictures import confidence_preview, error_preview
from .job import Job
from .run import Run

_NO_EXTRAS = DerivedMaps()
_OBLONG = 0.005  # relative difference of the sides of a pixel
_MIN_SEEN = 0.1  # of the mesh's texels: with fewer, the mesh probably stands elsewhere
_SAMPLED, _MIN_OVEREXPOSED = 1 << 12, 1e-3  # texels that are looked at; part of the subject that is warned of
_UNSTATED = (1.0, 1.0, 1.0)  # the intensity of lights in a capture that states none


@dataclass(frozen=True)
class ResultMaps:
    """Maps of a run. in_solver_frames, in_blender_frames: with normals and grain in the solver's, in Blender's tangent
    frames.

    derived: maps besides the model's. height: the relief, None unless the user wants it.
    """

    in_solver_frames: Maps
    in_blender_frames: Maps
    derived: list[DerivedMap]
    height: Height | None


def result_maps(run: Run, maps: Maps, extras: DerivedMaps = _NO_EXTRAS) -> ResultMaps:
    """Return the last ``maps`` of the run, with derived maps. Raises InputError where one cannot be made."""
    job, domain = run.job, present(run.domain)
    extras.check(maps.model)
    written = maps if job.mesh is None else blender_maps(maps, job.mesh, surface_bake(domain.bake), domain.seams)
    derived, height = derived_maps(extras, maps, written, domain.bake, job.mesh, job.capture.cameras[0])
    if (share := run.indirect_share) is not None:
        derived.append(indirect_map(share, maps.solved))
    return ResultMaps(maps, written, derived, height)


def report_of(
    run: Run, recovered: ResultMaps, settings: Mapping[str, Any], seconds: float, warnings: list[str] | None = None
) -> dict[str, Any]:
    """Return the report. settings: the user's. seconds, warnings: of the search."""
    job, maps, progress, domain = run.job, recovered.in_solver_frames, present(run.progress), present(run.domain)
    run.relight(maps)
    report = build_report(
        maps, settings={**settings, "preset": asdict(job.schedule), **run.settings}, seed=job.seed,
        gpu=str(context.describe()["renderer"]), iterations=progress.iteration_in_all, evaluations=progress.evaluations,
        seconds={**run.seconds, "solve": seconds}, ground_truth=run.truth, noise=domain.noise,
    )  # fmt: skip
    priors = job.schedule.fitness.priors
    of_capture = [*job.warnings, *capture_warnings(job.capture, exposures=not run.scaled)]
    report |= run.findings | run.relit[1] | {"warnings": [*maps_warnings(run, maps), *of_capture, *(warnings or [])]}
    if job.capture.encoding is not None and job.capture.encoding.known_by != "format":
        report["colour_space"] = job.capture.encoding.colour_space
    unsearched = unsearched_names(job.schedule, job.model, job.fixed)
    if priors and (shares := prior_shares(maps, unsearched)):
        report |= {"priors_decided": shares, "photographs_decided": photograph_shares(maps, unsearched)}
    if job.capture.left_out:
        report["left_out"] = [asdict(image) for image in job.capture.left_out]
    if job.held_out:
        report["held_out"] = [job.listed_numbers[k] for k in job.held_out_indices]
    if job.mesh is not None:
        report["solved_slots"] = list(job.mesh.solved_slots)
    report["unseen_texels"] = int((domain.bake.coverage & ~maps.solved).sum())
    if run.lights is not None:
        report["lights"] = run.lights.report(job.numbers)
    return report | ({} if recovered.height is None else {"height": recovered.height.described()})


def maps_warnings(run: Run, maps: Maps) -> list[str]:
    """Return warnings of the search, of its lights and of its last ``maps``."""
    job, domain = run.job, present(run.domain)
    modes = mode_warnings(maps, job.schedule.fitness.priors)
    of_lights = _light_warnings(run, domain, maps)
    of_mesh = [*_coverage_warnings(domain, maps), *_unseen_warnings(domain, job.capture)]
    of_mesh += _overexposed_warnings(domain, maps)
    unsearched = unsearched_names(job.schedule, job.model, job.fixed)
    of_card = [*_place_warnings(job), *_oblong_warnings(job)]
    return [*limit_warnings(maps, unsearched), *modes, *of_lights, *run.warnings, *of_mesh, *of_card]


def _coverage_warnings(domain: Domain, maps: Maps) -> list[str]:
    """Return a warning where the photographs show next to nothing of a mesh: it may stand elsewhere."""
    whole, seen = np.count_nonzero(domain.bake.coverage), np.count_nonzero(maps.solved)
    if domain.card or seen >= _MIN_SEEN * whole:
        return []
    return [
        f"the photographs show {seen} of the mesh's {whole} texels lit: check the mesh's place and unit, --object and"
        " the cameras, and that its normals point outward"
    ]


def _place_warnings(job: Job) -> list[str]:
    """Return a warning of near lights behind a card."""
    if job.mesh is not None or not near_lights(job.capture):
        return []
    # Other problems count in widths of the whole picture; this capture may be a small part of it.
    return [text for code, text in card_problems(job.capture) if code == "light_behind"]


def _overexposed_warnings(domain: Domain, maps: Maps) -> list[str]:
    """Return a warning of texels without a recovered value because all that shows them is clipped."""
    rows, columns = np.nonzero(domain.bake.coverage & ~maps.solved)
    every = max(1, -(-len(rows) // _SAMPLED))
    clipped = domain.stack.texels(rows[::every], columns[::every])[..., 3] < 0
    count = every * int(clipped.any(axis=0).sum())
    if count < _MIN_OVEREXPOSED * domain.bake.coverage.sum():
        return []
    return [
        f"about {count} texels are overexposed in every photograph that shows them, and copy darker neighbours:"
        " photograph them with a shorter exposure as well"
    ]


def _oblong_warnings(job: Job) -> list[str]:
    """Return a warning of a card whose pixels are no squares."""
    width, height = (1 / scale for scale in job.capture.cameras[0].scale)
    if job.mesh is not None or abs(width / height - 1) < _OBLONG:
        return []
    return [
        f"the card's pixels are {width / height:.3g} times as wide as high: its normals and heights are right, but its"
        " object, relief and ambient occlusion take pixels for squares; scale the photographs to square pixels"
    ]


def _unseen_warnings(domain: Domain, capture: Capture) -> list[str]:
    """Return warnings of the photographs whose cameras see no texel of the mesh, and of those whose light is hidden."""
    lines = []
    if names := [capture.observations[k].name for k in domain.unseen]:
        lines.append(
            f"{len(names)} of the {len(capture.observations)} photographs show no texel of the mesh and are not used"
            f" ({some(names)}): check the poses of their cameras, and the mesh's place and unit"
        )
    if names := [capture.observations[k].name for k in domain.shaded if k not in domain.unseen]:
        lines.append(
            f"{len(names)} of the {len(capture.observations)} photographs are not used, because mesh or occluders hide"
            f" their light from all that the camera sees ({some(names)}): leave the lamps' own housings out of the"
            " occluders, check the lights, or do not predict shadows"
        )
    return lines


def capture_warnings(capture: Capture, reads: bool = True, exposures: bool = True) -> list[str]:
    """Return warnings of a capture: images left out, other exposures, a tilted card, an encoding against its radiance.

    reads: whether images are read to test the encoding, unless it is tested already. Panels must not read. exposures:
    whether other exposures matter; estimated intensities account for them.
    """
    lines = [*(f"left out: {image.why}" for image in capture.left_out), *(capture.warnings if exposures else ())]
    lines += capture.card_warnings
    encoding = capture.encoding
    if encoding is None or encoding.known_by == "format" or not (reads or encoding.is_tested):
        return lines
    return [*lines, text] if (text := encoding.message()) else lines


def _light_warnings(run: Run, domain: Domain, maps: Maps) -> list[str]:
    """Return warnings of room light, of the lights' order, of estimated lights, or of intensities not stated."""
    job, lights = run.job, run.lights
    fitted = subset(domain, job.fitted)
    warnings = light_warnings(fitted, job.seed, [job.capture.observations[k].name for k in job.fitted])
    if lights is not None:
        warnings += lights.warnings(job.lights.intensities == "estimate")
    if run.scaled:
        return warnings
    if any(tuple(observation.light.intensity) != _UNSTATED for observation in job.capture.observations):
        return warnings
    text = contradiction(fitted, maps.model, maps.values, frozenset(job.fixed), job.seed)
    return [*warnings, text] if text else warnings


def pictures_of(run: Run, recovered: ResultMaps) -> dict[str, np.ndarray]:
    """Return file stem → (H, W, 3) display values: renders beside photographs, confidence, held-out observations."""
    run.relight(recovered.in_solver_frames)
    names = preview_names(run.job.capture, run.job.held_out_indices)
    preview = error_preview(present(run.domain), recovered.in_solver_frames, run.truth, names, run.indirect)
    return {"preview": preview} | confidence_preview(recovered.in_solver_frames) | run.relit[0]


def subject_of(job: Job) -> Any:
    """Return the object that gets the material, None for a card without one. Raises InputError."""
    subject = material.subject_object(job.object_uid, job.name)
    if job.mesh is not None and subject is None:
        raise InputError(f"'{job.name}' has been deleted: undo that and keep again, or export the maps")
    if subject is not None:
        material.check_object(subject)
        if job.mesh is not None:
            check_surface(subject, job.mesh, job.name)
    return subject


def make_material(
    job: Job, subject: Any, found: ResultMaps, height: Height | None, folder: str | Path | None = None
) -> tuple[Any, Any]:
    """Assign the maps to their object as a material; return both. A card's object is created.

    subject: from ``subject_of``. height: the relief that displaces the surface. folder: of pictures, as for
    ``build_material``. Raises InputError.
    """
    maps = found.in_blender_frames
    uv_map = "" if job.mesh is None else material.other_uv_map(subject, job.mesh.uv_map)
    built = material.build_material(maps, job.name, folder, uv_map, height, subject)
    if job.mesh is None:
        rows, columns = maps.solved.shape
        subject = material.card_object(job.name, rows, columns, height is not None)
    material.apply_material(subject, built, () if job.mesh is None else job.mesh.solved_slots)
    return built, subject
