"""``recover CAPTURE``: a capture to maps, material and report."""

from __future__ import annotations

import sys
import time
from argparse import Namespace
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from ..blender.images import decode
from ..blender.materials import material
from ..blender.materials.margins import blender_maps
from ..blender.materials.tangent_frames import from_blender, turned_normals
from ..blender.mesh import extract_mesh
from ..blender.scenes.scene import empty_blend, mesh_object, open_blend
from ..blender.scenes.scene_capture import capture_of_open_file, wide_lights_around
from ..capture.inspect.damage import naming_remedy
from ..capture.inspect.sufficiency import check_normal
from ..capture.read import read_capture
from ..capture.types import Capture
from ..cluster.transport import joined
from ..core.errors import InputError
from ..core.udim import ONE_SQUARE
from ..geometry.build import card_steps, loading_steps, mesh_steps
from ..geometry.domain import Domain, subset
from ..geometry.relief.height import Height
from ..geometry.surface.mesh import MeshData
from ..geometry.surface.slots import slot_names, slots_of_text
from ..gpu import context, probe
from ..reflectance.model import ReflectanceModel, load_model
from ..results.derived_maps import DerivedMaps, derived_maps, normals_of_text
from ..results.maps import Maps
from ..results.read import read_maps
from ..results.report import build_report, limit_warnings, mode_warnings, prior_shares
from ..results.write import check_output_folder, write_maps
from ..solver.engine.modes import with_modes
from ..solver.engine.progress import Progress
from ..solver.lights.refine import Lights
from ..solver.planning.memory import parse_memory
from ..solver.planning.plan import Plan
from ..solver.planning.planning import AnyRecovery, covered_texels, make_plan, planned_recovery, scratch_folder, untiled
from ..solver.settings.schedule import Schedule
from ..solver.state.checkpoint import glance
from ..solver.state.prepare import Prepared, prepare
from ..solver.views.held_out import held_out_last, order_of, preview_names, relit_line, relit_preview
from ..solver.views.history import History
from ..solver.views.pictures import confidence_preview, error_preview
from .each_slot import EACH, recover_each
from .lights import check_lights, found_lights, light_warnings
from .live import LIVE, LivePicture
from .options import check_size, fixed_from_options, held_out_list, positive, schedule_from_options, size_option
from .progress import ProgressBar, counted, silent, unseen_reports
from .solve import CHECKPOINT, Saving, check_every, drive

BLEND = "material.blend"
_RESOLUTION = "512"


@dataclass
class Job:
    """What the options come down to, all checked before anything slow is begun.

    numbers: what observations are numbered in their files, from 0, where ``capture`` has them in another order.
    """

    capture: Capture
    model: ReflectanceModel
    schedule: Schedule
    fixed: dict[str, np.ndarray]
    truth: dict[str, np.ndarray] | None
    held_out: list[int]
    folder: Path
    resolution: tuple[int, int]
    subject: object | None
    mesh: MeshData | None
    name: str
    derived: DerivedMaps
    seconds: dict[str, float] = field(default_factory=dict)
    numbers: list[int] | None = None


@dataclass
class Solved:
    """What a recovery has come to. settings: for the report, beside the options."""

    maps: Maps
    progress: Progress
    history: History
    settings: dict
    warnings: list[str]


def run(options: Namespace, opened: bool = False) -> dict:
    """Recover and write everything; returns the report. An interrupt leaves a checkpoint in the output folder.

    opened: whether the mesh is in the file that is open, to be taken as it is.
    """
    ranks = joined()
    if ranks is not None:
        from .ranked import recover_on_ranks  # which is made of what is below

        return recover_on_ranks(ranks, options)
    if options.slots == EACH:
        return recover_each(options, _blend_of(options), partial(run, opened=True), BLEND)
    started = time.perf_counter()
    job = check(options, opened)
    probe.probe()
    context.ensure()
    plan = _plan(options, job, job.mesh, covered_texels(job.capture, job.mesh, job.resolution))
    if options.dry_run:
        if not silent(options):
            sys.stdout.write("\n".join(plan.lines()) + "\n")
        return {"plan": plan.as_dict()}
    domain = _domain(options, job, job.mesh, plan)
    job.seconds["read"] = time.perf_counter() - started
    kept = [k for k in range(domain.observations) if k not in job.held_out]
    started = time.perf_counter()
    lights = found_lights(domain, kept, job.model, job.fixed, options)
    if lights is not None:
        domain = lights.applied(domain)
        job.seconds["lights"] = time.perf_counter() - started
    plan = _plan(options, job, job.mesh, domain.solvable, plan.stack_on)
    started = time.perf_counter()
    fitted = subset(domain, kept)
    with planned_recovery(
        plan, fitted, job.model, job.schedule, options.seed, job.fixed, options.entry,
        scratch_folder(Path(options.output)), _prepared(options, job, fitted, plan),
    ) as recovery:  # fmt: skip
        job.seconds["prepare"] = time.perf_counter() - started
        solved = solve(options, job, recovery)
        solved.settings |= {"tiles": len(plan.tiles)}
    return finish(options, job, domain, kept, lights, solved)


def _prepared(options: Namespace, job: Job, domain: Domain, plan: Plan) -> Prepared | None:
    """Return what is found before the search, showing how far that is; None where each level finds its own."""
    if job.schedule.levels > 1:
        return None
    bar = ProgressBar("prepare", silent(options), tenths=False)
    prepared = prepare(domain, job.model, job.schedule, untiled(plan), bar.show)
    bar.close()
    return prepared


def solve(options: Namespace, job: Job, recovery: AnyRecovery) -> Solved:
    """Run a recovery to its end, showing how far it is."""
    live = LivePicture(job.folder / LIVE, recovery)
    history = History(recovery, job.truth, live.show if options.live else None)
    saving = Saving(job.folder / CHECKPOINT, options.resume, options.checkpoint_every)
    job.seconds["solve"], unsaved = drive(recovery, history, saving, silent(options))
    warnings = [*unsaved, *live.warnings]
    return Solved(recovery.maps(), recovery.progress, history, {"entry": recovery.entry}, warnings)


def finish(
    options: Namespace, job: Job, domain: Domain, kept: list[int], lights: Lights | None, solved: Solved
) -> dict:
    """Write everything and return the report. domain: of all observations. lights: where they were looked for."""
    started = time.perf_counter()
    maps, mesh = with_modes(solved.maps), job.mesh
    relit, relighting = relit_preview(domain, maps, job.held_out, job.capture)
    report = build_report(
        maps, settings={**_settings(options), "preset": asdict(job.schedule), **solved.settings}, seed=options.seed,
        gpu=context.describe()["renderer"], iterations=solved.progress.iterations_in_all,
        evaluations=solved.progress.evaluations, seconds=job.seconds, ground_truth=job.truth,
        noise=domain.noise,
    )  # fmt: skip
    warnings = light_warnings(lights, job.capture, domain, kept, maps, job.fixed, options)
    warnings += wide_lights_around(job.subject) if _is_scene(options.capture) else []
    left_out = job.capture.left_out
    warnings += [f"left out: {one.why}" for one in left_out]
    encoding = job.capture.encoding
    if encoding is not None and encoding.known_by != "format":
        report["colour_space"] = encoding.colour_space
        warnings += [text] if (text := encoding.message()) else []
    warnings = [*limit_warnings(maps, job.fixed), *mode_warnings(maps, job.schedule.fitness.priors), *warnings]
    report |= relighting | {"warnings": [*warnings, *solved.warnings]}
    if job.schedule.fitness.priors and (shares := prior_shares(maps, job.fixed)):
        report["priors_decided"] = shares
    if left_out:
        report["left_out"] = [asdict(one) for one in left_out]
    report["unseen_texels"] = int((domain.bake.coverage & ~maps.covered).sum())
    if lights is not None:
        report["lights"] = lights.report(job.numbers)
    preview = error_preview(domain, maps, job.truth, preview_names(job.capture, job.held_out))
    pictures = {"preview": preview, "convergence": solved.history.picture(maps)} | confidence_preview(maps)
    pictures |= relit
    written = maps if mesh is None else blender_maps(maps, mesh, domain.bake, domain.seams)
    derived, height = derived_maps(job.derived, maps, written, domain.bake, mesh, job.capture.cameras[0])
    if height is not None:
        report["height"] = height.described()
    write_maps(written, job.folder, report, pictures, derived)
    _write_material(written, job, job.subject, mesh, height if job.derived.displacement else None)
    for name in (CHECKPOINT, *[LIVE] * options.live):
        (job.folder / name).unlink(missing_ok=True)
    if not silent(options):
        sys.stdout.write(_summary(report, job.folder, time.perf_counter() - started))
    elif options.quiet and not options.json:
        sys.stderr.write("".join(f"irpso: warning: {text}\n" for text in report["warnings"]))
    return {"output": str(job.folder), **{key: report[key] for key in report if key not in ("settings", "maps")}}


def check(options: Namespace, opened: bool) -> Job:
    """Return what the options come down to. Raises InputError."""
    folder = check_output_folder(options.output)
    source = Path(options.capture)
    if folder.resolve() in (source.resolve(), source.parent.resolve() if source.is_file() else None):
        raise InputError(f"{folder}: holds the capture, whose images a result could replace; choose another with -o")
    options.blend = _blend_of(options)
    resolution = size_option("--resolution", options.resolution or _RESOLUTION)
    model = load_model(options.model)
    schedule = schedule_from_options(options)
    check_lights(options)
    check_every(options.checkpoint_every)
    if options.memory:
        parse_memory(options.memory)
    if options.object and not options.blend:
        raise InputError("--object names a mesh, but no --blend FILE is given to find it in")
    if options.resolution and not options.blend:
        raise InputError("--resolution is of a mesh's maps (--blend FILE); a card's maps have the size of the images")
    if options.blend and options.distance is not None:
        raise InputError("--distance is of a flat card from its camera; a mesh (--blend FILE) has its own place")
    if options.slots and not options.blend:
        raise InputError("--slots are of a mesh, but no --blend FILE is given to find it in")
    _check_checkpoint(options, folder / CHECKPOINT, model, schedule)
    subject, mesh, name = _subject(options, opened)
    tiles = ONE_SQUARE if mesh is None else mesh.tiles
    derived = DerivedMaps(normals_of_text("--normals", options.normals), options.height, options.displacement)
    derived.check(model)
    fixed = fixed_from_options(options.fixed, model, tiles)
    truth = read_maps(options.ground_truth, model, tiles) if options.ground_truth else None
    with naming_remedy(options.skip_damaged):
        capture = _capture(options)
    held_out = capture.numbers(held_out_list(options.hold_out, capture.listed))
    fitted = [one.light for k, one in enumerate(capture.observations) if k not in held_out]
    if not fitted:
        raise InputError(f"{options.capture}: no observation is left to fit; hold out fewer")
    if any(parameter.is_normal and parameter.name not in fixed for parameter in model.parameters):
        check_normal(options.capture, fitted)
    resolution = resolution if mesh is None else mesh.domain_size(*resolution)
    return Job(
        capture,
        model,
        schedule,
        fixed,
        truth,
        held_out,
        folder,
        resolution,
        subject,
        mesh,
        name or capture.name,
        derived,
    )


def _check_checkpoint(options: Namespace, path: Path, model: ReflectanceModel, schedule: Schedule) -> None:
    """Have --resume go on by the kind of pass that the run was begun with: the two differ in the last bits.

    Raises InputError where the checkpoint is of no use, or cannot be written later on.
    """
    if path.is_dir():
        raise InputError(f"{path}: is a folder, where a checkpoint would go; choose another -o, or move it away")
    if not options.resume:
        return
    if not path.is_file():
        raise InputError(f"--resume: {path.parent} holds no {CHECKPOINT}; run without --resume")
    found = glance(path, {"model": model.name, "preset": asdict(schedule), "seed": options.seed})
    if options.entry == "auto":
        options.entry = found["entry"]


def _blend_of(options: Namespace) -> str | None:
    """Return the file with the mesh: a capture that is a scene of Blender's holds it itself."""
    if not _is_scene(options.capture):
        return options.blend
    if options.blend and Path(options.blend).resolve() != Path(options.capture).resolve():
        raise InputError(
            f"--blend {options.blend}: the capture is a scene, which has the mesh in it; leave --blend out"
        )
    return options.capture


def _capture(options: Namespace) -> Capture:
    """Return the capture; that of a scene's own cameras and lights is the file that was opened for the mesh."""
    if _is_scene(options.capture):
        return capture_of_open_file(options.colour_space, options.skip_damaged)
    distance = positive("--distance", options.distance)
    capture = read_capture(options.capture, decode, options.colour_space, options.skip_damaged)
    return replace(capture, card_distance=distance or capture.card_distance)


def _is_scene(path: str) -> bool:
    return Path(path).suffix.lower() == ".blend"


def _subject(options: Namespace, opened: bool) -> tuple[object | None, MeshData | None, str]:
    """Return the object, its mesh, and the name for what is recovered of it; of a card the capture knows that."""
    if not options.blend:
        empty_blend()
        return None, None, ""
    if not opened:
        with unseen_reports():
            open_blend(options.blend)
    subject = mesh_object(options.object)
    if options.slots is None:
        return subject, extract_mesh(subject), subject.name
    slots = slots_of_text(options.slots, slot_names(subject))
    return subject, extract_mesh(subject, slots), material.slots_subject(subject, slots)


def _plan(
    options: Namespace, job: Job, mesh: MeshData | None, coverage: np.ndarray, stack_on: str | None = None
) -> Plan:
    counts = len(job.capture.observations), len(job.held_out)
    resumed = job.folder / CHECKPOINT if options.resume else None
    return make_plan(
        coverage, job.model, job.schedule, job.fixed, *counts,
        memory=options.memory, entry=options.entry, stack_on=stack_on, resumed=resumed, mesh=mesh,
    )  # fmt: skip


def _domain(options: Namespace, job: Job, mesh: MeshData | None, plan: Plan) -> Domain:
    scratch = scratch_folder(job.folder) if plan.stack_on == "scratch" else None
    if scratch is not None:
        job.numbers = order_of(len(job.capture.observations), job.held_out)
        job.capture, job.held_out = held_out_last(job.capture, job.held_out)
    if mesh is None:
        steps = card_steps(job.capture, scratch=scratch)
    else:
        steps = mesh_steps(job.capture, mesh, *job.resolution, scratch=scratch, shadows=options.shadows)
    with naming_remedy(options.skip_damaged):
        domain = counted(steps, "read", loading_steps(job.capture, mesh is not None), silent(options))
    settle(options, job, domain)
    return domain


def settle(options: Namespace, job: Job, domain: Domain) -> None:
    """Check what the options say of maps and the material against the domain, and turn normals into its frames."""
    check_size(f"--ground-truth {options.ground_truth}", job.truth or {}, domain.shape)
    for text in options.fixed:
        name = text.partition("=")[0].strip()
        check_size(f"--fixed {text}", {name: job.fixed[name]}, domain.shape)
    _try_material(job, job.subject)
    if job.mesh is not None:  # files hold normals in Blender's tangent frame, the solver has one of its own
        job.fixed = turned_normals(job.model, job.fixed, job.mesh, domain.bake, from_blender)
        job.truth = job.truth and turned_normals(job.model, job.truth, job.mesh, domain.bake, from_blender)


def _try_material(job: Job, subject: object | None) -> None:
    """Have what refuses the material do so before hours of work, and before any file."""
    material.check_material(job.model, job.name)
    if subject is not None:
        material.check_object(subject)


def _write_material(maps: Maps, job: Job, subject: object | None, mesh: MeshData | None, height: Height | None) -> None:
    uv_map = "" if mesh is None else material.other_uv_map(subject, mesh.uv_map)
    made = material.build_material(maps, job.name, uv_map=uv_map, height=height)
    if subject is None:
        subject = material.card_object(job.name, *maps.covered.shape, height is not None)
    material.apply_material(subject, made, () if mesh is None else mesh.solved_slots)
    with unseen_reports():
        material.save_blend(job.folder / BLEND)


def _settings(options: Namespace) -> dict:
    return {key: value for key, value in vars(options).items() if key not in ("json", "quiet", "command")}


def _summary(report: dict, folder: Path, seconds: float) -> str:
    lines = [f"{report['texels']} texels, {report['seconds']['solve']:.1f} s, written to {folder} in {seconds:.1f} s"]
    if unseen := report["unseen_texels"]:
        lines.append(f"{unseen} more texels are seen lit by no camera and hold what lies nearest")
    if residual := report.get("residual"):
        lines.append(f"residual: mean {residual['mean']:.5f}, 99th percentile {residual['p99']:.5f}")
    for name, error in report.get("ground_truth", {}).items():
        lines.append(
            f"{name} against ground truth: mean {error['mean']:.3f} {error['unit']}, median {error['median']:.3f},"
            f" 99th percentile {error['p99']:.3f}"
        )
    for name, share in report.get("priors_decided", {}).items():
        lines.append(f"{name}: the prior says more than the photographs on {share:.0%} of the texels")
    for name, psnr in report.get("relighting_psnr_db", {}).items():
        highlights = report["relighting_highlights_psnr_db"][name]
        told = [f"{psnr:.2f} dB" if psnr is not None else "nothing to compare"]
        told += [f"highlights {highlights:.2f} dB"] if highlights is not None else []
        lines.append(f"relit {name}: {', '.join(told)}")
    lines += [line[0].lower() + line[1:]] if (line := relit_line(report)) else []
    lines += [f"warning: {text}" for text in report["warnings"]]
    return "\n".join(lines) + "\n"
