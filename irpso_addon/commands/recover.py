"""``recover CAPTURE``: recovers maps, material and report from a capture."""

from __future__ import annotations

import json
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack, nullcontext
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ..blender.materials import result_blend
from ..cluster.transport import joined
from ..core.errors import InputError
from ..core.files import write_json
from ..core.interrupt import delayed_signals
from ..core.progress_bar import StepBars
from ..core.steps import run_steps
from ..exports.asset import write_to_shelf
from ..gpu import context, probe
from ..pipeline.drive import CHECKPOINT, Saving, drive, was_previewed
from ..pipeline.job import Job
from ..pipeline.live import LIVE, LivePicture
from ..pipeline.lock import locked_folder
from ..pipeline.preview import PART, can_be_smaller, smaller
from ..pipeline.ranks import leave_with_error, run_on_ranks
from ..pipeline.result import ResultMaps, make_material, pictures_of, report_of, result_maps, subject_of
from ..pipeline.run import Run
from ..reflectance.model import digest_of_own_model
from ..results.report import plain
from ..results.write import BLEND, MODEL_DIGEST, REPORT, check_output_folder, remove_result, write_maps
from ..solver.planning.forecast import forecast, forecast_text
from ..solver.views.held_out import relit_line
from ..solver.views.history import History
from .options.job_options import blend_of, derived_maps_of, job_of
from .options.slots import EACH, asset_names, export_named, open_slots, write_assets
from .options.values import OF_ASSETS, shelf_of, silent, warn, warn_quietly

INTERRUPTED = "interrupted"  # key of a report: a signal came when the search had ended
_FINISHING = "irpso: the result is being written; interrupt again to stop at once"
PREVIEW = "preview"  # folder of a long recovery's preview, in the result's, and a setting in its report
_LONG_SECONDS = 1200  # forecast from which on a recovery has a preview by default
_PACE_SPREAD = 1.2  # largest ratio of the seconds per texel of the whole and of its preview, either way


def run(options: Namespace) -> dict:
    """Recover, write everything, return the report. An interrupt leaves a checkpoint in the output folder."""
    ranks = joined()
    if ranks is not None:
        if options.preview:
            error = InputError("--preview: a run over ranks writes no preview; leave it out")
            return leave_with_error(ranks, options, error)
        with ExitStack() as held:
            return _planned(options, run_on_ranks(
                ranks, options, lambda: _job_of_ranks(options, ranks.leads, held), StepBars(silent(options)),
                lambda run: _recovered(options, run, _was_previewed(options)),
            ))  # fmt: skip
    with _locked(options):
        if options.slots == EACH:
            return _each_slot(options)
        return _recover(options, job_of(options))


def _locked(options: Namespace) -> AbstractContextManager[None]:
    """Return the lock of the output folder, for a run that writes into it. Raises InputError for an unusable folder."""
    return nullcontext() if options.dry_run else locked_folder(check_output_folder(options.output))


def _recover(options: Namespace, job: Job) -> dict:
    _check_asset(options, job)
    probed = probe.probe()
    context.ensure()
    run = Run(job, StepBars(silent(options)))
    plan = run.first_plan()
    seconds = forecast(plan.work, probed, plan.most_work)
    if options.dry_run:
        return _planned(options, {"plan": plan, "seconds": seconds})
    if not silent(options):
        sys.stderr.write(f"{plan.texels} texels, {plan.observations} photographs: {forecast_text(seconds)}\n")
    if options.preview and not can_be_smaller(job):
        raise InputError(
            "--preview: a map of --fixed has the full size and cannot be made smaller; leave one of the two out"
        )
    wanted = options.preview or (options.preview is None and seconds[0] >= _LONG_SECONDS and can_be_smaller(job))
    if options.resume:  # it wrote its preview before
        return _recovered(options, run, _was_previewed(options))
    return _recovered(options, run, wanted and _preview(options, smaller(job), plan.work))


def _was_previewed(options: Namespace) -> bool:
    return options.resume and was_previewed(Path(options.output) / CHECKPOINT)


def _check_asset(options: Namespace, job: Job) -> None:
    """Raise InputError, before anything slow, where the asset has no place in its library."""
    if options.asset is not None:
        path = shelf_of(options, options.asset).path(options.asset_name or job.name)
        if path.resolve() == (Path(options.output) / BLEND).resolve():
            raise InputError(f"{path}: is the result's own file; give another --asset-name, or another -o")


def _preview(options: Namespace, job: Job, work: float) -> bool:
    """Write the maps of a smaller job into OUT/preview; print the forecast time of ``work``, the whole's.

    Returns False where the smaller job fails.
    """
    folder = Path(options.output) / PREVIEW
    run = Run(job, StepBars(silent(options)))
    preview_work = run.first_plan().work
    try:
        with ExitStack() as writing:
            report, _, _, interrupted = _solved(options, run, folder, Saving(None), writing, {PREVIEW: PART})
    except InputError as error:  # which the whole job may not have
        warn([f"no preview: {error}"])
        return False
    if options.live:
        (folder / LIVE).unlink(missing_ok=True)
    if interrupted():
        raise KeyboardInterrupt(f"{folder} holds the preview")
    if not silent(options):
        seconds = report["seconds"]["solve"] * work / preview_work
        time_left = forecast_text((seconds / _PACE_SPREAD, seconds * _PACE_SPREAD))
        sys.stderr.write(f"preview of 1/{PART}: {folder}; at this speed the whole takes {time_left}\n")
    return True


def _remove_former_preview(folder: Path) -> None:
    """Remove the preview of a former run, whose maps are not those of the new result."""
    try:
        part = json.loads((folder / REPORT).read_text(encoding="utf-8"))["settings"][PREVIEW]
    except (OSError, ValueError, LookupError, TypeError):
        return
    if part == PART:  # else the folder is another result
        remove_result(folder)


def _planned(options: Namespace, result: dict) -> dict:
    """Print the plan of a dry run, and its forecast time if any; return both as plain data, or another result as is."""
    if "plan" not in result:
        return result
    plan, seconds = result["plan"], result.get("seconds")
    if not silent(options):
        time_line = [f"search        {forecast_text(seconds)}"] if seconds else []
        sys.stdout.write("\n".join([*plan.lines(), *time_line]) + "\n")
    return {"plan": plan.as_dict(), **({"seconds": seconds} if seconds else {})}


def _job_of_ranks(options: Namespace, leads: bool, held: ExitStack) -> Job:
    """Return the job. held: gets the lock of the output folder, on the leading rank."""
    if options.slots == EACH:
        raise InputError(f"--slots {EACH}: ranks recover one slot at a time; name the slot")
    if leads:
        held.enter_context(_locked(options))
    quiet = options.quiet
    options.quiet = quiet or not leads  # restored: all ranks compare their options
    try:
        job = job_of(options)
    finally:
        options.quiet = quiet
    _check_asset(options, job)
    return job


def _each_slot(options: Namespace) -> dict:
    """Recover the slots of each material into its own folder; return the reports by folder name.

    One file beside them holds all materials. Assets are written at the end, all or none: a run that starts again has
    none to refuse. Raises InputError before anything slow if a slot has no usable UV map, or its asset no place.
    """
    folder, chosen = open_slots(options, blend_of(options))
    assets = asset_names(options, chosen)
    reports: dict[str, dict] = {}
    for label, slots in chosen.items():
        slot = {"slots": ",".join(map(str, slots)), "output": str(folder / label)}
        without = dict.fromkeys(("asset", *OF_ASSETS)) if assets else {}
        slot_options = Namespace(**{**vars(options), **slot, **without})
        try:
            with export_named(options, reports), _locked(slot_options):
                reports[label] = _recover(slot_options, job_of(slot_options, opened=True))
            if reports[label].get(INTERRUPTED):
                raise KeyboardInterrupt(f"{folder / label} holds its result, the slots after it have none")
        except InputError as error:
            raise InputError(f"slot '{label}': {error}") from error
    if options.dry_run:
        return {"slots": reports}
    result = {"texels": sum(report["texels"] for report in reports.values()), "slots": reports}
    write_json(folder / REPORT, plain(result))  # first: it makes the other file one of ours
    result_blend.save_blend(folder / BLEND)
    if assets:
        with export_named(options, reports):
            for label, path in write_assets(options, chosen, assets).items():
                reports[label]["asset"] = path
    return {"output": str(folder), **result}


def _recovered(options: Namespace, run: Run, previewed: bool) -> dict:
    """Run to the end, write everything, and return the report. previewed: whether OUT/preview is of this run."""
    folder = Path(options.output)
    saving = Saving(folder / CHECKPOINT, options.resume, options.checkpoint_every, previewed)
    with ExitStack() as writing:
        writing.callback(_remove_live, options, folder)
        report, found, started, interrupted = _solved(options, run, folder, saving, writing)
        height = found.height if options.displacement else None
        _, subject = make_material(run.job, subject_of(run.job), found, height)
        result_blend.save_result_blend(folder)
        (folder / CHECKPOINT).unlink(missing_ok=True)
        if not previewed:
            _remove_former_preview(folder / PREVIEW)
    if interrupted():
        report[INTERRUPTED] = True
    if options.asset is not None:
        shelf = shelf_of(options, options.asset)
        slots = () if run.job.mesh is None else run.job.mesh.solved_slots
        report["asset"] = str(write_to_shelf(shelf, subject, options.asset_name or run.job.name, slots))
    if not silent(options):
        sys.stdout.write(_summary(report, folder, time.perf_counter() - started))
    warn_quietly(options, report["warnings"])
    return {"output": str(folder), **{key: report[key] for key in report if key not in ("settings", "maps")}}


def _remove_live(options: Namespace, folder: Path) -> None:
    """Remove the picture of --live, unless a checkpoint tells that the run goes on."""
    if options.live and not (folder / CHECKPOINT).exists():
        (folder / LIVE).unlink(missing_ok=True)


def _solved(
    options: Namespace,
    run: Run,
    folder: Path,
    saving: Saving,
    writing: ExitStack,
    changes: Mapping[str, Any] = MappingProxyType({}),
) -> tuple[dict, ResultMaps, float, Callable[[], bool]]:
    """Run to the end and write the maps into a folder.

    Return the report, the maps, when the search ended, and what tells whether a signal has come since then: until
    ``writing`` is closed, the first one only prints a line. changes: settings in the report that replace the options of
    these names.
    """
    digest = digest_of_own_model(options.model)
    run_steps(run.open())
    with run.recovery as recovery:
        live = LivePicture(folder / LIVE, recovery)
        history = History(recovery, run.truth, live.show if options.live else None)
        interrupted = writing.enter_context(delayed_signals(_FINISHING))  # from when no checkpoint holds the result
        seconds, unsaved = drive(recovery, history, saving, silent(options))
        maps = run.maps()
        warnings = [*unsaved, *live.warnings, *run.device_warnings()]
    started = time.perf_counter()
    found = result_maps(run, maps, derived_maps_of(options))
    settings = {key: value for key, value in vars(options).items() if key not in ("json", "quiet", "command")} | changes
    # For exports from another folder.
    settings["capture"] = str(Path(options.capture).resolve())
    if digest is not None:
        settings |= {"model": str(Path(options.model).resolve()), MODEL_DIGEST: digest}
    report = report_of(run, found, settings, seconds, warnings)
    pictures = pictures_of(run, found) | {"convergence": history.picture(maps)}
    write_maps(found.in_blender_frames, folder, report, pictures, found.derived)
    return report, found, started, interrupted


def _summary(report: dict, folder: Path, seconds: float) -> str:
    lines = [f"{report['texels']} texels, {report['seconds']['solve']:.1f} s, written to {folder} in {seconds:.1f} s"]
    if unseen := report["unseen_texels"]:
        lines.append(
            f"{unseen} more texels have no usable sample in any photograph and copy the nearest recovered texel"
        )
    if (found := report.get("interreflection", {})).get("share", 0) > 0:
        lines.append(
            f"light that the subject throws on itself: {found['share']:.0%} of what the photographs show; it leaves"
            f" {found['unknown_texels']} texels unknown"
        )
    if residual := report.get("residual"):
        mean, most = residual["mean"], residual["p99"]
        lines.append(
            f"fitted photographs: mean error of radiance {mean:.2%} of white, of 99 in 100 texels at most {most:.1%}"
        )
    for name, error in report.get("ground_truth", {}).items():
        figures = "nothing to compare"
        if error["mean"] is not None:
            figures = f"mean {error['mean']:.3f} {error['unit']}, median {error['median']:.3f}"
            figures += f", 99th percentile {error['p99']:.3f}"
        lines.append(f"{name} against ground truth: {figures}")
    if shares := report.get("photographs_decided"):
        decided = ", ".join(f"{name} on {share:.0%}" for name, share in shares.items())
        lines.append(f"decided by the photographs: {decided} of the texels; elsewhere by the model's prior, or unknown")
    if (share := report.get("unknown", {}).get("normal", 0)) >= 0.005:
        lines.append(f"normal: unknown on {share:.0%} of the texels")
    for name, psnr in report.get("relighting_psnr_db", {}).items():
        highlights = report["relighting_highlights_psnr_db"][name]
        figures = [f"{psnr:.2f} dB" if psnr is not None else "nothing to compare"]
        figures += [f"highlights {highlights:.2f} dB"] if highlights is not None else []
        lines.append(f"relit {name}: {', '.join(figures)}")
    lines += [line[0].lower() + line[1:]] if (line := relit_line(report)) else []
    lines += [f"warning: {text}" for text in report["warnings"]]
    return "\n".join(lines) + "\n"
