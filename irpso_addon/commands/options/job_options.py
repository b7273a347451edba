"""Options of ``recover`` as a ``Job``."""

from __future__ import annotations

import sys
from argparse import Namespace
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from ...blender.images import decode
from ...blender.materials import material
from ...blender.mesh import extract_mesh
from ...blender.occluders import named_occluders, with_occluders
from ...blender.scenes.scene import empty_blend, mesh_object, open_blend
from ...blender.scenes.scene_capture import capture_of_open_file, wide_lights_around
from ...capture.framing import AUTO, Framing, framed, with_found_corners
from ...capture.images.image import ImageStore
from ...capture.inspect.damage import with_skip_remedy
from ...capture.inspect.sufficiency import check_normal
from ...capture.read import read_spec, whole_capture
from ...capture.spec import reframed
from ...capture.types import Capture
from ...core.errors import InputError
from ...core.udim import ONE_SQUARE
from ...geometry.surface.mesh import MeshData
from ...geometry.surface.slots import slot_names, slots_of_text
from ...pipeline.drive import CHECKPOINT, check_every
from ...pipeline.job import Job, LightOptions, possible_schedule
from ...pipeline.live import LIVE, is_live_picture
from ...reflectance.model import ReflectanceModel, load_model
from ...results.derived_maps import DerivedMaps, normals_of_text
from ...results.read import read_maps
from ...results.write import check_output_folder, check_replaces_nothing
from ...solver.lights import refine
from ...solver.planning.make_plan import scratch_folder
from ...solver.planning.memory import parse_memory
from ...solver.settings.schedule import Schedule
from ...solver.state.checkpoint import check_replaceable, glance
from ...solver.views.held_out import held_out_last
from .hold_out import held_out_list
from .values import (
    check_shelf,
    check_size,
    fixed_from_options,
    framing_from_options,
    positive,
    schedule_from_options,
    silent,
    size_option,
)

_RESOLUTION = "512"


def job_of(options: Namespace, opened: bool = False) -> Job:
    """Return the job of the options. A resumed run with ``entry`` "auto" gets its former entry.

    opened: the open file already holds the mesh. Raises InputError.
    """
    folder = _output_folder(options)
    if options.asset is None:
        check_shelf(options, "give its library, --asset LIBRARY")
    options.blend = blend_of(options)
    resolution = size_option("--resolution", options.resolution or _RESOLUTION)
    model = load_model(options.model)
    check_replaces_nothing(folder, model)
    schedule = schedule_from_options(options)
    refine.check(True, options.refine_directions)
    check_every(options.checkpoint_every)
    if options.memory:
        parse_memory(options.memory)
    _check_mesh_options(options)
    subject, mesh, name = subject_of(options, opened)
    schedule = possible_schedule(schedule, mesh is not None and options.shadows)
    _check_checkpoint(options, folder / CHECKPOINT, model, schedule)
    tiles = ONE_SQUARE if mesh is None else mesh.tiles
    derived_maps_of(options).check(model)
    fixed = fixed_from_options(options.fixed, model, tiles)
    truth = read_maps(options.ground_truth, model, tiles) if options.ground_truth else None
    with with_skip_remedy(options.skip_damaged):
        capture = _capture(options, folder)
    held_out = capture.numbers(held_out_list(options.hold_out, capture.listed_names, capture.listed_cameras))
    capture, _ = held_out_last(capture, held_out)
    size = capture.masks[0].shape[::-1] if mesh is None else mesh.domain_size(*resolution)
    job = Job(
        capture=capture, name=name or capture.name, model=model, schedule=schedule, seed=options.seed, size=size,
        scratch=scratch_folder(folder), mesh=mesh, object_uid=None if subject is None else subject.session_uid,
        fixed=fixed, truth=truth, held_out=tuple(held_out),
        lights=LightOptions(options.intensities, options.refine_directions), shadows=options.shadows,
        skip_damaged=options.skip_damaged, entry=options.entry, memory=options.memory,
        resumed=folder / CHECKPOINT if options.resume else None,
        warnings=tuple(wide_lights_around(subject)) if _is_scene(options.capture) else (),
    )  # fmt: skip
    _check_fitted(options, job)
    _check_sizes(options, job)
    material.check_material(job.model, job.name)
    if subject is not None:
        material.check_object(subject)
    return job


def derived_maps_of(options: Namespace) -> DerivedMaps:
    """Return the choice of derived maps. Raises InputError."""
    return DerivedMaps(normals_of_text("--normals", options.normals), options.height, options.displacement)


def blend_of(options: Namespace) -> str | None:
    """Return the Blender file with the mesh: --blend, or a capture that is a scene itself. Raises InputError."""
    if not _is_scene(options.capture):
        return options.blend
    if options.blend and Path(options.blend).resolve() != Path(options.capture).resolve():
        raise InputError(f"--blend {options.blend}: the capture is a scene and holds the mesh; omit --blend")
    return options.capture


def _output_folder(options: Namespace) -> Path:
    folder, source = check_output_folder(options.output), Path(options.capture)
    if folder.resolve() in (source.resolve(), source.parent.resolve() if source.is_file() else None):
        raise InputError(f"{folder}: holds the capture, and a result could replace its images; choose another with -o")
    return folder


def _check_mesh_options(options: Namespace) -> None:
    """Raise InputError for an option of meshes without a mesh, or of cards with one."""
    for option in ("crop", "corners", "card_width"):
        if options.blend and getattr(options, option) is not None:
            raise InputError(
                f"--{option.replace('_', '-')} applies to a flat card; leave it out with a mesh (--blend FILE)"
            )
    if options.blend and options.distance is not None:
        raise InputError(
            "--distance applies to a flat card; leave it out with a mesh (--blend FILE), which has its own position"
        )
    for option in ("object", "slots", "resolution", "occluder"):
        if getattr(options, option) and not options.blend:
            raise InputError(f"--{option} is for meshes: give --blend FILE (a card's maps have the images' size)")
    if not options.shadows and not options.blend:
        raise InputError("--no-shadows is for meshes: give --blend FILE, or leave it out (a card predicts no shadows)")


def _check_checkpoint(options: Namespace, path: Path, model: ReflectanceModel, schedule: Schedule) -> None:
    """Give a resumed run its former kind of pass, because the two kinds differ in the last bits.

    Raises InputError if the checkpoint is unusable or cannot be written, or a file of others would be replaced by it or
    by --live.
    """
    if path.is_dir():
        raise InputError(f"{path}: is a folder in the place of the checkpoint; choose another -o, or move it")
    if not options.resume:
        check_replaceable(path)
        live = path.parent / LIVE
        own = path.exists() or options.dry_run or is_live_picture(live)  # of an interrupted run, or not written
        if options.live and live.exists() and not own:
            raise InputError(f"{live}: would be replaced by --live; choose another -o, or move it")
        return
    if not path.is_file():
        raise InputError(f"--resume: {path.parent} holds no {CHECKPOINT}; run without --resume")
    identity = glance(path, {"model": model.name, "preset": asdict(schedule), "seed": options.seed})
    if options.entry == "auto":
        options.entry = identity["entry"]


def _capture(options: Namespace, folder: Path) -> Capture:
    """Return the capture; a scene's cameras and lights are read from the open file.

    Raises InputError where its photographs lie in the output folder.
    """
    if _is_scene(options.capture):
        capture = capture_of_open_file(options.colour_space, options.skip_damaged)
        return _framed(capture, Framing(**framing_from_options(options)), options)
    return file_capture(options, folder)


def file_capture(options: Namespace, apart: Path | None = None) -> Capture:
    """Return the capture of files, with the chosen part of the pictures.

    apart: a folder that must not hold its photographs. Raises InputError.
    """
    if options.distance and options.card_width:
        raise InputError("--distance and --card-width: give one of them")
    distance = positive("--distance", options.distance)
    spec = read_spec(options.capture, options.colour_space)
    if apart and apart.resolve() in {observation.image.path.parent.resolve() for observation in spec.observations}:
        raise InputError(f"{apart}: holds the photographs, and would mix them with the maps; choose another with -o")
    framing = replace(spec.framing, **framing_from_options(options))
    if distance:
        spec = replace(spec, card_distance=distance, framing=replace(framing, card_width=None))
    elif options.card_width:
        spec = replace(spec, framing=framing)
    else:
        spec = reframed(spec, framing, ImageStore(decode))
    return _framed(whole_capture(spec, decode, options.skip_damaged), spec.framing, options)


def _framed(capture: Capture, framing: Framing, options: Namespace) -> Capture:
    """Return the chosen part of the pictures; print detected corners."""
    if framing.corners == AUTO:
        framing, corners_text = with_found_corners(capture, framing)
        if not silent(options):
            sys.stdout.write(f"corners: {corners_text}\n")
    return framed(capture, framing)


def _is_scene(path: str) -> bool:
    return Path(path).suffix.lower() == ".blend"


def subject_of(options: Namespace, opened: bool = False) -> tuple[Any, MeshData | None, str]:
    """Return the object of --blend, its mesh, and the name of the result; for a card None, None and ""."""
    if not options.blend:
        empty_blend()
        return None, None, ""
    if not opened:
        open_blend(options.blend)
    subject = mesh_object(options.object)
    occluders = named_occluders(options.occluder, subject, "--occluder")
    if options.slots is None:
        return subject, with_occluders(extract_mesh(subject), occluders), subject.name
    slots = slots_of_text(options.slots, slot_names(subject))
    mesh = with_occluders(extract_mesh(subject, slots), occluders)
    return subject, mesh, material.slots_subject(subject, slots)


def _check_fitted(options: Namespace, job: Job) -> None:
    fitted = [job.capture.observations[k].light for k in job.fitted]
    if not fitted:
        raise InputError(f"{options.capture}: no observation is left to fit; hold out fewer")
    if any(parameter.is_normal and parameter.name not in job.fixed for parameter in job.model.parameters):
        rest = " without the photographs of --hold-out" if job.held_out else ""
        check_normal(f"{options.capture}{rest}", fitted)


def _check_sizes(options: Namespace, job: Job) -> None:
    shape = job.size[::-1]
    check_size(f"--ground-truth {options.ground_truth}", job.truth or {}, shape)
    for text in options.fixed:
        name = text.partition("=")[0].strip()
        check_size(f"--fixed {text}", {name: job.fixed[name]}, shape)
