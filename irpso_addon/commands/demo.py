"""``demo``: runs the paper's experiment, from rendering to material; --quick in small sizes."""

from __future__ import annotations

import sys
import time
from argparse import Namespace
from dataclasses import asdict
from pathlib import Path

from ..blender.materials import material, result_blend
from ..blender.materials.margins import blender_maps
from ..blender.mesh import extract_mesh
from ..blender.scenes import head
from ..capture.types import Light
from ..core.progress_bar import ProgressBar
from ..demo import experiment, pictures
from ..gpu import context, probe
from ..reflectance.model import load_model
from ..results.maps import Maps
from ..results.report import build_report, ground_truth_errors, quantiles
from ..results.write import check_output_folder, check_replaces_nothing, write_maps
from ..solver.settings.schedule import load_schedule
from .options.values import silent

_VIEW_HEIGHT = 250  # pixels of the head in the figures
_PHASES = ("photograph", *experiment.STAGES, experiment.JOINT)


def run(options: Namespace) -> dict:
    """Run the experiment; write figures, maps, material and report into the output folder and into its joint/."""
    started = time.perf_counter()
    folder = check_output_folder(options.output)
    for place in (folder, folder / experiment.JOINT):  # before minutes of work
        check_replaces_nothing(place, load_model(experiment.MODEL))
    schedule = load_schedule(options.preset)
    probe.probe()
    context.ensure()
    size = experiment.QUICK if options.quick else experiment.PAPER
    bar = ProgressBar("demo", silent(options))

    def report(phase: str, fraction: float) -> None:
        bar.show((_PHASES.index(phase) + fraction) / len(_PHASES), phase)

    subject = head.build_scene()
    found = experiment.photograph(extract_mesh(subject), head.scene_camera(size.camera), size, report)
    photographed = time.perf_counter() - started
    marks = experiment.choose_marks(found)
    runs = {}
    for stage in experiment.STAGES:
        strip = size.strip if stage == "normal" and size.strip[-1] <= size.stage_iterations else ()
        runs[stage] = experiment.recover_stage(
            found, schedule, stage, size.stage_iterations, options.seed, options.entry, report, marks=marks, strip=strip
        )
    joint = experiment.recover_jointly(found, schedule, size.joint_iterations, options.seed, options.entry, report)
    history = runs["normal"]
    if not history.snapshots:
        history = experiment.recover_stage(
            found, schedule, "normal", size.strip[-1], options.seed, options.entry, report, strip=size.strip
        )
    bar.close()
    result = _write(options, folder, found, runs, joint, history, marks, photographed, subject)
    result["seconds_in_all"] = round(time.perf_counter() - started, 1)
    if not silent(options):
        sys.stdout.write(_summary(result, folder))
    return result


def _write(
    options: Namespace,
    folder: Path,
    found: experiment.Subject,
    runs: dict[str, experiment.Run],
    joint: experiment.Run,
    history: experiment.Run,
    marks: tuple[tuple[int, int], ...],
    photographed: float,
    subject: object,
) -> dict:
    lights = [Light(tuple(float(v) for v in light[:3])) for light in found.domain.lights]
    light = pictures.shown_light(lights)
    view = pictures.View(found, head.scene_camera(_VIEW_HEIGHT))
    large = pictures.View(found, head.scene_camera(2 * _VIEW_HEIGHT))
    staged = pictures.staged_maps(runs)
    all_runs = {**runs, experiment.JOINT: joint}
    errors = {}  # of the image in % of white, and of each searched parameter
    for name, done in all_runs.items():
        truth = {parameter: found.truth[parameter] for parameter in done.errors}
        image = {"unit": "%", **quantiles(done.image_errors)}
        errors[name] = {"image": image, **ground_truth_errors(done.maps, truth, found.evaluated)}
    seconds = {"photograph": photographed, **{name: done.seconds for name, done in all_runs.items()}}
    report = build_report(
        staged, settings={**{k: v for k, v in vars(options).items() if k != "command"},
                          "preset": asdict(load_schedule(options.preset))},
        seed=options.seed, gpu=context.describe()["renderer"], iterations=runs["normal"].iterations[-1],
        evaluations=sum(done.evaluations for done in all_runs.values()), seconds=seconds,
        ground_truth=found.truth, evaluated=found.evaluated,
    )  # fmt: skip
    report["lights"], report["runs"] = len(lights), errors
    figures = {
        "preview": pictures.comparison(view, staged.values, light),
        "convergence": pictures.curves(large, runs, marks, light),
        "strip": pictures.history(view, history),
        "frames": pictures.frames(view, lights),
    }
    write_maps(_turned(found, staged), folder, report, figures)
    joint_figures = {"preview": pictures.comparison(view, joint.maps.values, light)}
    write_maps(
        _turned(found, joint.maps),
        folder / experiment.JOINT,
        {**report, "runs": {"joint": errors["joint"]}},
        joint_figures,
    )
    material.apply_material(subject, material.build_material(_turned(found, joint.maps), subject.name))
    result_blend.save_result_blend(folder)
    return {"output": str(folder), "excluded_fraction": report["excluded_fraction"], "texels": report["texels"],
            "runs": errors, "seconds": report["seconds"]}  # fmt: skip


def _turned(found: experiment.Subject, maps: Maps) -> Maps:
    return blender_maps(maps, found.mesh, found.bake, found.domain.seams)


def _summary(result: dict, folder: Path) -> str:
    lines = [
        f"{result['texels']} texels recovered, {100 * result['excluded_fraction']:.1f} % of them left out of the"
        f" figures below (n·v < {experiment.GRAZING}); {result['seconds_in_all']:.0f} s in all; written to {folder}"
    ]
    for name, errors in result["runs"].items():
        start = "all parameters free" if name == experiment.JOINT else "random start, the other maps known"
        lines.append(f"{name}: {start}")
        for what, error in errors.items():
            lines.append(
                f"    {what:12} mean {error['mean']:.4f} {error['unit']}  99th percentile {error['p99']:.4f}"
                f"  largest {error['max']:.3f}"
            )
    return "\n".join(lines) + "\n"
