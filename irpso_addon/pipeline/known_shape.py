"""Calibrates lights from photographs of a mesh, by Lambertian shading over its known normals."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np

from ..calibration.shading.known import (
    LampFit,
    Samples,
    cells,
    fit_steps,
    free_normals,
    free_scale,
    linear_lamps,
    nearer,
)  # fmt: skip
from ..calibration.shading.lamp_colours import coloured, whitened
from ..calibration.shading.lamps import Lamps
from ..capture.bounds import without_bounds
from ..capture.types import Capture, Light
from ..core.errors import InputError
from ..core.steps import map_steps
from ..geometry.build import loading_steps, mesh_steps
from ..geometry.domain import Domain
from ..geometry.light.shadows import ShadowCaster, texel_size
from ..geometry.surface.bake import bake_camera, surface_bake, uv_coverage
from ..geometry.surface.mesh import MeshData
from ..solver.lights.light_texels import evenly_facing

MIN_PHOTOGRAPHS = 4  # photographs
_COVERED_TEXELS = 40_000  # of the mesh's domain, about: one camera sees a third
_SIDES = 64, 1024  # texels, least and most, along a side of the domain
_TEXELS = 2500  # in the fit; twice as many change lights by less than their errors
_VIEWS = 3  # photographs, at least, that show a texel of the fit
_MIN_TEXELS, _MIN_LIT = 300, 50  # in the fit, and lit in each photograph
_SHADOW_ROUNDS = 2  # of predicting the cast shadows under the lights so far
_READ_PART = 0.4  # of the work, at the end of reading
_NEUTRAL_LIGHT = Light((0.0, 0.0, 1.0))  # of all photographs while reading
_MIN_DETERMINED = 0.2  # 0.36 to 0.94 on a pot and a rough monkey, below 0.01 on a plane and on three faces
_MIN_EXPLAINED = 0.3  # of a photograph's squared radiance: 0.01 where its lamp is 57° off or more, else 0.5 to 0.9
_MAX_ERROR = 10.0  # degrees, mean standard error of the directions
# Median angle in degrees between the mesh's normals and those of the photographs (warning, error): 0.5 where a
# pot's mesh is exact, 8.7 where a material has relief that the mesh lacks (lights 4° off), 12 where the pot is
# moved by 5 % of its width (11°), 15 where it is turned by 20° (10°), 20 where it is moved by 25 % of its width (31°).
_DOUBTFUL_MISMATCH, _MAX_MISMATCH = 10.0, 18.0
# Share of the outline that does not fit (warning, error). A displaced ball is shaded like one in place under rotated
# lights: only its outline differs. Moved by 5 % of its width, 6 % of its mask are off, and lights 8°.
_DOUBTFUL_OUTSIDE, _MAX_OUTSIDE = 0.04, 0.2
_BLACK_SHARE = 0.02  # of the 90th percentile of radiance: darker texels are black


@dataclass(frozen=True)
class KnownShape:
    """Lights calibrated over a mesh. capture: with these lights. fit: of the lamps. near: whether they have positions.

    determined: 0 to 1 (``linear_lamps``). mismatch: degrees, median angle between the mesh's normals and those that the
    photographs have under the lights. texels: their number in the fit.
    """

    capture: Capture
    fit: LampFit
    near: bool
    determined: float
    mismatch: float
    texels: int
    warnings: tuple[str, ...]

    def report(self) -> dict[str, Any]:
        """Return the table of the report."""
        rows = light_rows(self.capture, self.fit, self.near)
        return {
            "kind": "shape",
            "near": self.near,
            "how": "by the shading of the mesh",
            "texels": self.texels,
            "determined": round(self.determined, 4),
            "misfit": round(self.fit.misfit, 5),
            "normals_differ_degrees": round(self.mismatch, 3),
            "lights": rows,
            "warnings": list(self.warnings),
        }


def light_rows(capture: Capture, fit: LampFit, near: bool) -> list[dict[str, Any]]:
    """Return the report's row of each light, with its standard errors."""
    rows = []
    strengths, distances = fit.errors[:, 3], fit.distance_errors
    for number, observation in enumerate(capture.observations):
        row = {
            "name": observation.name,
            "position" if near else "direction": list(observation.light.vector),
            "intensity": list(observation.light.intensity),
            "error_degrees": round(float(fit.degrees[number]), 3),
            "strength_error": round(float(strengths[number]), 4),
        }
        rows.append({**row, "distance_error": round(float(distances[number]), 4)} if near else row)
    return rows


def known_shape_steps(
    capture: Capture, mesh: MeshData, kind: str = "auto", seed: int = 0
) -> Generator[float, None, KnownShape]:
    """Calibrate the lights of a capture whose subject is a mesh; yield the fraction done, return the result.

    The capture's own lights are ignored. The mesh is in world coordinates; one or several cameras see it. Each texel
    has an unknown albedo. Fits of the lights and predictions of the mesh's cast shadows alternate. All intensities have
    a common unknown factor. kind: "distant", "near" or "auto": near where the fall-off proves it (``nearer``). Raises
    InputError where photographs and mesh do not determine the lights, or contradict each other.
    """
    if len(capture.observations) < MIN_PHOTOGRAPHS:
        raise InputError(
            f"{len(capture.observations)} photographs are too few to find lights over a mesh; take"
            f" {MIN_PHOTOGRAPHS} or more"
        )
    unlit = tuple(replace(observation, light=_NEUTRAL_LIGHT) for observation in capture.observations)
    domain = yield from _read(replace(capture, observations=unlit, card_distance=None), mesh)
    outside = max(_outside_mesh(capture, mesh), _black(domain))
    if outside > _MAX_OUTSIDE:
        raise InputError(
            f"'{mesh.name}': {outside:.0%} of its outline is off in the photographs; check that mesh and cameras are in"
            " one place and unit, and that masks show the mesh alone"
        )
    rows, columns = _chosen(domain, mesh, seed)
    samples, colours = _samples(domain, rows, columns, seed)
    _check_lit(capture, samples)
    bake = surface_bake(domain.bake)
    caster = ShadowCaster(mesh, bake, texel_size(mesh, bake))
    fitting = _fit(samples, caster, rows * domain.shape[1] + columns, kind)
    steps = count(1)
    fit, near, determined = yield from map_steps(fitting, lambda _: 1 - (1 - _READ_PART) * 0.985 ** next(steps))
    mismatch = float(np.nanmedian(free_normals(samples, fit)))
    _check_known(capture, mesh, fit, determined, mismatch)
    lights = coloured(fit.lamps.lights(near, free_scale(samples, fit)), colours)
    observations = tuple(
        replace(observation, light=light) for observation, light in zip(capture.observations, lights, strict=True)
    )
    warnings = _warnings(mesh, mismatch, outside)
    return KnownShape(
        replace(capture, observations=observations), fit, near, determined, mismatch, len(rows), warnings
    )  # fmt: skip


def _read(capture: Capture, mesh: MeshData) -> Generator[float, None, Domain]:
    """Return the mesh's domain, without predicted shadows; yield the fraction done."""
    covered = int(uv_coverage(mesh, *mesh.domain_size(256, 256)).sum())
    side = int(np.clip(256 * np.sqrt(_COVERED_TEXELS / max(covered, 1)), *_SIDES))
    steps = mesh_steps(capture, mesh, *mesh.domain_size(side, side), shadows=False)
    total, made = loading_steps(capture, on_mesh=True), count(1)
    return (yield from map_steps(steps, lambda _: _READ_PART * min(1.0, next(made) / total)))


def _chosen(domain: Domain, mesh: MeshData, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns of texels that enough photographs show, their normals spread evenly over directions."""
    rows, columns = np.nonzero(domain.solvable)
    views = np.zeros(len(rows), int)
    for layer in domain.stack.layers():
        views += layer[rows, columns, 3] > 0
    rows, columns = rows[views >= _VIEWS], columns[views >= _VIEWS]
    if len(rows) < _MIN_TEXELS:
        raise InputError(
            f"'{mesh.name}': {_VIEWS} photographs show only {len(rows)} texels of it, {_MIN_TEXELS} are needed to"
            " find lights; check the cameras' poses, or put a ball into the photographs"
        )
    order = evenly_facing(domain.bake.normal[rows, columns], np.random.default_rng(seed))
    chosen = np.sort(order[:_TEXELS])
    return rows[chosen], columns[chosen]


def _samples(domain: Domain, rows: np.ndarray, columns: np.ndarray, seed: int) -> tuple[Samples, np.ndarray]:
    """Return the texels' samples, and the lamps' colours (K, 3)."""
    stack = without_bounds(domain.stack.texels(rows, columns)).astype(np.float64)
    values, colours = whitened(np.where(stack[..., 3:] > 0, stack[..., :3], 0), stack[..., 3])
    points, normals = (a[rows, columns].astype(np.float64) for a in (domain.bake.position, domain.bake.normal))
    return Samples(values, stack[..., 3], points, normals, cells(points, seed)), colours


def _check_lit(capture: Capture, samples: Samples) -> None:
    lit = ((samples.weight > 0) & (samples.values > 0)).sum(axis=1)
    if lit.min() < _MIN_LIT:
        number = int(lit.argmin())
        raise InputError(
            f"'{capture.observations[number].name}': shows only {lit[number]} lit texels of the mesh, {_MIN_LIT} are"
            " needed to find its light; leave the photograph out"
        )


def _fit(
    samples: Samples, caster: ShadowCaster, texels: np.ndarray, kind: str
) -> Generator[None, None, tuple[LampFit, bool, float]]:
    """Yield often; return the fit of the lamps, whether they are near, and ``KnownShape.determined``."""
    centre = samples.points.mean(axis=0)
    size = float(np.linalg.norm(samples.points - centre, axis=-1).max())
    lamps, determined = linear_lamps(samples, centre, size)
    shaded = samples
    for number in range(_SHADOW_ROUNDS + 1):
        fit, near = yield from _of_kind(shaded, lamps, kind)
        lamps = fit.lamps
        if number < _SHADOW_ROUNDS:
            weights = []
            for light in lamps.lights(near):
                weights.append(caster.weights(light, texels))
                yield
            shaded = replace(samples, weight=samples.weight * np.stack(weights))
    return fit, near, determined


def _of_kind(samples: Samples, lamps: Lamps, kind: str) -> Generator[None, None, tuple[LampFit, bool]]:
    """Return the fit of near or of distant lamps, and whether it is near."""
    far = None
    if kind != "near":
        far = yield from fit_steps(samples, replace(lamps, inverses=np.zeros(len(lamps.inverses))), near=False)
        if kind == "distant":
            return far, False
    close = yield from fit_steps(samples, lamps, near=True)
    return (close, True) if far is None or nearer(close, far) else (far, False)


def _check_known(capture: Capture, mesh: MeshData, fit: LampFit, determined: float, mismatch: float) -> None:
    if not determined >= _MIN_DETERMINED:
        raise InputError(
            f"'{mesh.name}': its visible part faces too few directions to separate lights from albedo; put a ball"
            " beside it, or if it is flat, use --flat without --blend"
        )
    if not mismatch <= _MAX_MISMATCH:
        raise InputError(
            f"'{mesh.name}': the photographs' shading contradicts the mesh, whose normals are off by {mismatch:.0f}° in"
            " the median; check that mesh and cameras are in one place and unit, or put a ball into the photographs"
        )
    check_explained(capture, fit, f"'{mesh.name}'")
    if not fit.degrees.mean() <= _MAX_ERROR:
        raise InputError(
            f"'{mesh.name}': lights from different parts of it differ by {fit.degrees.mean():.0f}°: lights cannot be"
            " found from its shading; put a ball into the photographs"
        )


def check_explained(capture: Capture, fit: LampFit, subject: str) -> None:
    """Raise InputError, naming the photograph, where the fit explains too little of its radiance."""
    worst = int(fit.explained.argmin())
    if not fit.explained[worst] >= _MIN_EXPLAINED:
        raise InputError(
            f"'{capture.observations[worst].name}': matt shading of {subject} explains only"
            f" {fit.explained[worst]:.0%} of its light; leave the photograph out, or put a ball into them"
        )


def _outside_mesh(capture: Capture, mesh: MeshData) -> float:
    """Return the share of the masks that the mesh itself does not cover; 0 where no camera has a mask."""
    missed = masked = 0
    for camera, mask in zip(capture.cameras, capture.masks, strict=True):
        if not mask.all():
            shown = bake_camera(mesh, camera).triangle
            covered = (shown >= 0) & (shown < len(mesh.positions))  # an occluder is not the mesh
            missed, masked = missed + int((mask & ~covered).sum()), masked + int(mask.sum())
    return missed / max(masked, 1)


def _black(domain: Domain) -> float:
    """Return the share of the mesh's visible texels that are black in all photographs, which show the background."""
    seen, bright = np.zeros(domain.shape, bool), np.zeros(domain.shape)
    for layer in domain.stack.layers():
        shown = layer[..., 3] > 0
        seen |= shown
        bright = np.maximum(bright, np.where(shown, layer[..., :3].mean(axis=-1), 0))
    if not seen.any():
        return 0.0
    return float((bright[seen] < _BLACK_SHARE * np.percentile(bright[seen], 90)).mean())


def _warnings(mesh: MeshData, mismatch: float, outside: float) -> tuple[str, ...]:
    lines = []
    if outside > _DOUBTFUL_OUTSIDE:
        lines.append(
            f"'{mesh.name}': {outside:.0%} of its outline is off in the photographs; where the mesh is in the wrong"
            " place, lights are off by more than their standard errors"
        )
    if mismatch > _DOUBTFUL_MISMATCH:
        lines.append(
            f"the normals of '{mesh.name}' differ from those of the photographs by {mismatch:.0f}° in the median: the"
            " mesh lacks detail, or is in the wrong place; the lights have the mean of these errors"
        )
    return tuple(lines)
