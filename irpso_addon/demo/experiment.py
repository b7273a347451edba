"""The paper's three recoveries, each with the other maps fixed, and one joint recovery."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..capture.camera import Camera
from ..capture.types import Light
from ..geometry.build import domain_from_mesh
from ..geometry.domain import Domain
from ..geometry.surface.bake import SurfaceBake, bake_camera, bake_uv
from ..geometry.surface.mesh import MeshData
from ..reflectance.model import ReflectanceModel, load_model
from ..results.maps import Maps
from ..results.preview import spread_marks
from ..results.report import parameter_error
from ..solver.engine.recovery import Recovery
from ..solver.settings.schedule import Schedule
from ..solver.views.forward import Renderer, camera_renderer, dome, rendered_capture
from .truth import material_at

MODEL = "cook_torrance_two_lobe"
STAGES = ("diffuse", "normal", "specular")
LATITUDES, LONGITUDES = 10, 20  # the paper's 200 lights
GRAZING = 0.1  # n·v of the true normal: texels below are excluded, and their number is reported
JOINT = "joint"
Report = Callable[[str, float], None]


@dataclass(frozen=True)
class Size:
    """Size of an experiment. texels: (W, H). camera: image height in pixels. strip: iterations of the snapshots."""

    texels: tuple[int, int]
    camera: int
    stage_iterations: int
    joint_iterations: int
    strip: tuple[int, ...]


# The paper's 150×225. With about twenty camera pixels along a texel the resampling error is below the solver's own,
# except at grazing views; with ten it was three quarters of the error in normals.
PAPER = Size((150, 225), 2400, 1000, 2000, (0, 100, 300, 1000, 2000))
QUICK = Size((80, 120), 600, 600, 800, (0, 30, 100, 300, 600))


@dataclass
class Run:
    """One recovery. iterations: (N,). errors: parameter → (N, marks) at the marked texels, in degrees or % of range.

    snapshots: iteration → maps. image_errors: (K, texels) absolute differences in % of white.
    """

    name: str
    maps: Maps
    seconds: float
    evaluations: int
    iterations: list[int] = field(default_factory=list)
    errors: dict[str, list[np.ndarray]] = field(default_factory=dict)
    snapshots: dict[int, Maps] = field(default_factory=dict)
    image_errors: np.ndarray | None = None


@dataclass
class Subject:
    """The subject: domain, truth, and the evaluated texels."""

    mesh: MeshData
    camera: Camera
    bake: SurfaceBake
    domain: Domain
    model: ReflectanceModel
    truth: dict[str, np.ndarray]
    evaluated: np.ndarray


def photograph(mesh: MeshData, camera: Camera, size: Size, report: Report) -> Subject:
    """Render the camera's images under 200 lights, and resample them to the texels of the mesh's UV square."""
    model = load_model(MODEL)
    lights = [Light(tuple(float(v) for v in direction)) for direction in dome(LATITUDES, LONGITUDES)]
    view = bake_camera(mesh, camera)
    renderer = camera_renderer(view, model, material_at(view), camera, lights)
    capture = rendered_capture(
        "demo", [renderer], [camera], [view.coverage], lights, lambda done: report("photograph", done)
    )
    # The renders have no cast shadows, and the truth is at the texels' centres.
    switches = {"shadows": False, "falloff": False, "areas": False}
    domain = domain_from_mesh(capture, mesh, *size.texels, **switches)
    renderer.close()
    bake = bake_uv(mesh, *size.texels)
    truth = material_at(bake)
    toward = camera.position - bake.position
    facing = (world_normals(bake, truth["normal"]) * toward).sum(axis=-1) / np.linalg.norm(toward, axis=-1)
    return Subject(mesh, camera, bake, domain, model, truth, domain.solvable & (facing > GRAZING))


def recover_stage(
    subject: Subject, schedule: Schedule, stage: str, iterations: int, seed: int, entry: str, report: Report, **more
) -> Run:
    """Recover one stage from a random start with the other maps fixed, by the paper's fitness, mean |e|."""
    searched = {p.name for p in subject.model.parameters if p.stage == stage}
    fixed = {name: value for name, value in subject.truth.items() if name not in searched}
    changed = schedule.replaced(search=[stage], iterations=iterations, cycles=1, start="random", loss="l1")
    return _recover(subject, changed, fixed, stage, seed, entry, report, **more)


def recover_jointly(
    subject: Subject, schedule: Schedule, iterations: int, seed: int, entry: str, report: Report, **more
) -> Run:
    """Recover all maps jointly, in the preset's stages and cycles, with ``iterations`` in all."""
    changed = schedule.replaced(iterations=max(1, iterations // (schedule.cycles * len(schedule.stages))))
    return _recover(subject, changed, {}, JOINT, seed, entry, report, **more)


def _recover(
    subject: Subject,
    schedule: Schedule,
    fixed: dict[str, np.ndarray],
    name: str,
    seed: int,
    entry: str,
    report: Report,
    marks: tuple[tuple[int, int], ...] = (),
    strip: tuple[int, ...] = (),
) -> Run:
    iterations = schedule.cycles * sum(stage.iterations for stage in schedule.stages)
    interval = max(1, iterations // 50)
    stops = sorted({*range(0, iterations, interval), iterations, *strip})
    seconds, iteration = 0.0, 0
    result = Run(name, None, 0.0, 0)
    searched = [p for p in subject.model.parameters if p.name not in fixed]
    with Recovery(subject.domain, subject.model, schedule, seed, fixed, entry) as recovery:
        for stop in stops:
            start = time.perf_counter()
            progress = recovery.step(stop - iteration)
            iteration = stop
            maps = recovery.maps(confidence=stop == iterations)
            seconds += time.perf_counter() - start
            report(name, progress.fraction)
            result.iterations.append(stop)
            for p in searched:
                error = parameter_error(p, maps.values[p.name], subject.truth[p.name])
                result.errors.setdefault(p.name, []).append(np.array([error[y, x] for x, y in marks]))
            if stop in strip:
                result.snapshots[stop] = maps
        result.maps, result.seconds, result.evaluations = maps, seconds, progress.evaluations
    result.image_errors = image_errors(subject, result.maps)
    return result


def image_errors(subject: Subject, maps: Maps) -> np.ndarray:
    """Return (K, T): |render − reference|, mean of RGB, of every observation at the T evaluated texels, in % of white.

    White is radiance 1: a white Lambertian surface that faces the light.
    """
    domain = subject.domain
    renderer = Renderer(domain.bake, maps.model, maps.values, domain.lights, domain.intensities, domain.views)
    errors = []
    for k in range(domain.observations):
        rendered = renderer.render(k)[..., :3]
        errors.append(100 * np.abs(rendered - domain.stack.layer(k)[..., :3]).mean(axis=-1)[subject.evaluated])
    renderer.close()
    return np.stack(errors)


def world_normals(bake: SurfaceBake, normals: np.ndarray) -> np.ndarray:
    """Return tangent-space normals (H, W, 3) in world axes."""
    return np.einsum("hwi,hwij->hwj", normals, bake.frames())


def choose_marks(subject: Subject) -> tuple[tuple[int, int], ...]:
    """Return (x, y) of four texels far apart in the camera's view."""
    rows, columns = np.nonzero(subject.evaluated)
    pixels, _ = subject.camera.project(subject.bake.position[rows, columns])
    return tuple((int(columns[i]), int(rows[i])) for i in spread_marks(pixels))
