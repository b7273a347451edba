"""One method on one capture in a process of its own, so that its memory is its own: what peers_table starts.

Usage: python -m benchmarks.peer_child CAPTURE METHOD RESULT.npz [--quick]
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import product, subjects
from benchmarks.peers.problem import PeerResult, Problem, Sample, angles, peak_memory_mb, problem_of
from irpso_addon.geometry.domain import Domain

DATA = Path(os.environ.get("IRPSO_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
BUNNY = "bunny_specular"
FIELD_OF_VIEW = 49.8  # degrees, of its perspective camera; the folder does not have it
CAPTURES = ("clean", "dirty", BUNNY)
PRODUCT = ("standard", product.LM_ALONE)
LINEAR = ("plain least squares", "least squares", "trimmed", "trimmed 45–60", "l1", "sparse bayesian", "low rank")
# Number of texels of the slow methods. A smaller sample is a part of a larger one.
ITERATIVE = {
    "adam": 64, "l-bfgs": 64, "l-bfgs per texel": 64, "scipy least_squares": 32, "pyswarms": 10,
    "differential evolution": 10,
}  # fmt: skip
METHODS = (*PRODUCT, *LINEAR, *ITERATIVE)
POINTS = 24  # samples of the program's trace


@dataclass(frozen=True)
class Subject:
    """A capture with its model. truth: parameter → (H, W, components); a real capture may lack some."""

    domain: Domain
    model: str
    truth: Mapping[str, np.ndarray]


def subject(name: str, quick: bool) -> Subject:
    """Return a capture by name; the real one is in the folder IRPSO_DATA, or ../shared/data."""
    if name != BUNNY:
        card = subjects.make_card(8 if quick else 64, 20 if quick else 100, subjects.DEGRADATIONS[name], seed=1)
        return Subject(card.domain, card.model, card.truth)
    from irpso_addon.blender.images import decode
    from irpso_addon.capture import read_capture, read_exr
    from irpso_addon.capture.camera import Camera
    from irpso_addon.geometry.build import domain_from_card

    channels = read_exr(DATA / BUNNY / "normal_gt.exr")[""]
    truth = np.stack([channels[c] for c in "RGB"], axis=-1).astype(np.float64)
    truth /= np.maximum(np.linalg.norm(truth, axis=-1, keepdims=True), 1e-9)
    capture = read_capture(DATA / BUNNY, decode)
    camera = Camera.from_fov(capture.cameras[0].width, capture.cameras[0].height, FIELD_OF_VIEW)
    domain = domain_from_card(replace(capture, cameras=(camera,)))
    return Subject(_thinned(domain, 12) if quick else domain, "principled", {"normal": truth})


def _thinned(domain: Domain, every: int) -> Domain:
    """Return the domain with one texel of many covered."""
    y, x = np.mgrid[: domain.shape[0], : domain.shape[1]]
    coverage = domain.bake.coverage & (y % every == 0) & (x % every == 0)
    return replace(domain, bake=replace(domain.bake, coverage=coverage), solvable=domain.solvable & coverage)


def errors_at(model: str, values: Mapping[str, np.ndarray], problem: Problem) -> dict[str, np.ndarray]:
    """Return parameter → (T,) errors of values (T, components), for parameters in both."""
    return subjects.errors_of(model, values, problem.truth)


def solve(capture: str, method: str, quick: bool) -> dict[str, Any]:
    """Return texels (T, 2), errors, seconds a texel, evaluations, and the trace of errors.

    seconds: processor time of all threads; wall: by the clock.
    """
    made = subject(capture, quick)
    problem = problem_of(made.domain, made.model, made.truth)
    if method in ITERATIVE:
        problem = problem.subset(subjects.sample(problem.count, 2 if quick else ITERATIVE[method]))
    began = np.array([time.perf_counter(), time.process_time()])
    if method in PRODUCT:
        result, processor = _product(made, method, problem, quick)
    else:
        result = _linear(method, problem) if method in LINEAR else _iterative(method, problem, quick)
        wall, spent = np.array([time.perf_counter(), time.process_time()]) - began
        # The method's share of the wall time: recording the trace and trying other settings do not count.
        processor = np.array([s.seconds for s in result.trace] + [result.seconds]) * spent / wall
    errors = errors_at(made.model, result.values, problem)
    trace = [
        (spent / problem.count, s.evaluations, errors_at(made.model, s.values, problem))
        for s, spent in zip(result.trace, processor, strict=False)
    ]
    return {
        "texels": problem.texels, "errors": errors, "wall": result.seconds / problem.count,
        "seconds": float(processor[-1]) / problem.count,
        "evaluations": float(np.mean(result.evaluations)),
        "memory": result.memory_mb if trace else peak_memory_mb(),
        "settings": {k: str(v) for k, v in result.settings.items()}, "trace": trace,
    }  # fmt: skip


def _product(made: Subject, method: str, problem: Problem, quick: bool) -> tuple[PeerResult, np.ndarray]:
    schedule = product.schedule_of(method)
    total = product.iterations_of(made.domain, made.model, schedule)
    points = product.spaced(total, 3 if quick else POINTS)
    run = product.recover(made.domain, made.model, schedule, points=points)
    at = tuple(problem.texels.T)
    trace = tuple(Sample(s.seconds, s.evaluations, {n: v[at] for n, v in s.values.items()}) for s in run.trace)
    values = {name: value[at] for name, value in run.values.items()}
    evaluations = np.array([run.evaluations])
    return PeerResult(method, values, evaluations, run.seconds, peak_memory_mb(), {}, trace), np.array(run.trace_work)


def _linear(method: str, problem: Problem) -> PeerResult:
    """Run a Lambertian method with each of its settings; return the result with the least normal error."""
    from benchmarks.peers import lambertian

    fixed = {
        "plain least squares": (lambertian.least_squares, {}),
        "trimmed 45–60": (lambertian.trimmed, {"low": 45, "high": 60}),
    }
    if method in fixed:
        run, settings = fixed[method]
        return run(problem, **settings)
    results = [lambertian.METHODS[method](problem, **settings) for settings in lambertian.SETTINGS[method]]
    return min(results, key=lambda r: float(angles(r.values["normal"], problem.truth["normal"]).mean()))


def _iterative(method: str, problem: Problem, quick: bool) -> PeerResult:
    run, settings = _peers(quick)[method]
    return run(problem, **settings)


def _peers(quick: bool) -> dict[str, tuple[Callable[..., PeerResult], dict[str, Any]]]:
    from benchmarks.peers import descent, least_squares, swarms

    few = {"iterations": 10} if quick else {}
    torch = {"threads": 1, **few}
    one = {"workers": 1}  # in this process, whose time is measured
    return {
        "adam": (descent.adam, torch),
        "l-bfgs": (descent.lbfgs, torch),
        "l-bfgs per texel": (descent.lbfgs_per_texel, torch),
        "scipy least_squares": (least_squares.scipy_least_squares, one),
        "pyswarms": (swarms.pyswarms_global_best, {**one, **few}),
        "differential evolution": (swarms.differential_evolution, {**one, **({"generations": 5} if quick else {})}),
    }


def main() -> None:
    """Solve, and write the result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture", choices=CAPTURES)
    parser.add_argument("method", choices=METHODS)
    parser.add_argument("result", type=Path)
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    result = solve(options.capture, options.method, options.quick)
    arrays = {"texels": result.pop("texels")}
    arrays |= {f"error_{name}": error for name, error in result.pop("errors").items()}
    trace = result.pop("trace")
    for name in trace[0][2] if trace else ():
        arrays[f"trace_{name}"] = np.array([errors[name] for _, _, errors in trace], np.float32)
    arrays["times"] = np.array([(seconds, evaluations) for seconds, evaluations, _ in trace])
    np.savez(options.result, facts=json.dumps(result), **arrays)
    if options.method in PRODUCT:
        from irpso_addon.gpu import context

        context.exit_process(0)


if __name__ == "__main__":
    main()
