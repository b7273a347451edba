"""Draws the paper's figures 1, 4, 5 and 6 for this run: maps on the head, in the camera's view."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..capture.camera import Camera
from ..capture.types import Light
from ..core.encode import encode_normal, fill_margin, srgb_from_linear
from ..geometry.surface.bake import bake_camera
from ..results.maps import Maps
from ..results.preview import Curves, PreviewRow, convergence, display_image, preview, strip
from ..results.report import error_unit, parameter_error
from ..solver.views.forward import camera_renderer
from .experiment import STAGES, Run, Subject, world_normals
from .truth import material_at

_TITLES = {"diffuse": "Diffuse color", "normal": "Normal", "specular": "Two-lobe roughness"}
_FRAMES = (35, 56, 75, 98, 134, 151)  # of the 200: from above, from both sides, from below
_SHOWN = 56  # frame of the previews


class View:
    """Resamples values per texel to the image of ``camera``."""

    def __init__(self, subject: Subject, camera: Camera):
        self.subject, self.camera = subject, camera
        self.bake = bake_camera(subject.mesh, camera)
        height, width = subject.domain.shape
        x, y = self.bake.uv[..., 0] * width, self.bake.uv[..., 1] * height
        texel = np.clip(y.astype(int), 0, height - 1), np.clip(x.astype(int), 0, width - 1)
        # At an island's border a pixel may hit a texel whose centre lies outside: it takes the nearest evaluated one.
        indices = np.stack(np.mgrid[:height, :width], axis=-1).astype(np.float32)
        excluded = tuple(np.argwhere(~subject.evaluated)[0])
        nearest = fill_margin(indices, subject.evaluated, texels=2, far=excluded).astype(int)
        self._texel = tuple(np.moveaxis(nearest[texel], -1, 0))
        self.covered = self.bake.coverage & subject.evaluated[self._texel]

    def show(self, texels: np.ndarray) -> np.ndarray:
        """Return the camera's view (H, W, …) of values per texel (h, w, …), by nearest texel."""
        return texels[self._texel]

    def normals(self, tangent_space: np.ndarray) -> np.ndarray:
        """Return (H, W, 3) display values of tangent-space normals per texel, in the camera's axes."""
        world = world_normals(self.subject.bake, tangent_space)
        return self.show(encode_normal(world @ self.camera.matrix[:3, :3]))

    def stage(self, stage: str, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return (H, W, 3) display values of a stage's maps."""
        if stage == "normal":
            return self.normals(values["normal"])
        parameters = [p for p in self.subject.model.parameters if p.stage == stage]
        return self.show(display_image(parameters, [values[p.name] for p in parameters]))

    def error(self, stage: str, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the error (H, W) of a stage's maps, mean over its parameters, in degrees or % of range."""
        return self.show(stage_error(self.subject, stage, values))


def stage_error(subject: Subject, stage: str, values: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the error (h, w) of a stage's maps per texel, mean over its parameters."""
    parameters = [p for p in subject.model.parameters if p.stage == stage]
    return np.mean([parameter_error(p, values[p.name], subject.truth[p.name]) for p in parameters], axis=0)


def comparison(view: View, values: Mapping[str, np.ndarray], light: Light) -> np.ndarray:
    """Return Fig. 6: ground truth, recovered and error of each map and of a render under ``light``."""
    subject = view.subject
    rows = []
    for stage in STAGES:
        unit = error_unit(next(p for p in subject.model.parameters if p.stage == stage))
        truth, recovered = view.stage(stage, subject.truth), view.stage(stage, values)
        rows.append(PreviewRow(_TITLES[stage], truth, recovered, view.error(stage, values), unit, view.covered))
    photograph, rendered = (
        _photograph(view, light, {name: view.show(v) for name, v in maps.items()}) for maps in (subject.truth, values)
    )
    error = 100 * np.abs(photograph - rendered).mean(axis=-1)
    rows.append(PreviewRow("Rendering", _display(photograph), _display(rendered), error, "%", view.covered))
    return preview(rows)


def frames(view: View, lights: list[Light]) -> np.ndarray:
    """Return Fig. 5: some of the photographs, (H, W, 3) display values."""
    renderer = camera_renderer(view.bake, view.subject.model, material_at(view.bake), view.camera, lights)
    pictures = [_display(renderer.render(k)[..., :3]) for k in _FRAMES]
    renderer.close()
    half = len(pictures) // 2
    return np.concatenate([np.concatenate(row, axis=1) for row in (pictures[half:], pictures[:half])], axis=0)


def curves(view: View, runs: Mapping[str, Run], marks: tuple[tuple[int, int], ...], light: Light) -> np.ndarray:
    """Return Fig. 4: the marked texels, and their errors over the iterations of every stage."""
    values = {p.name: runs[p.stage].maps.values[p.name] for p in view.subject.model.parameters}
    image = _display(_photograph(view, light, {name: view.show(v) for name, v in values.items()}))
    pixels, _ = view.camera.project(np.array([view.subject.bake.position[y, x] for x, y in marks], np.float64))
    panels = []
    for stage in STAGES:
        run = runs[stage]
        errors = np.mean([np.stack(error) for error in run.errors.values()], axis=0)
        unit = "°" if stage == "normal" else "%"
        panels.append(Curves(_TITLES[stage], np.array(run.iterations), errors, unit, log=True))
    return convergence(image, [(int(x), int(y)) for x, y in pixels], panels)


def history(view: View, run: Run) -> np.ndarray:
    """Return Fig. 1: the normal map at several iterations, its error below."""
    snapshots = sorted(run.snapshots.items())
    images = [view.stage("normal", maps.values) for _, maps in snapshots]
    errors = [view.error("normal", maps.values) for _, maps in snapshots]
    return strip(images, errors, [f"Iteration {n}" for n, _ in snapshots], "°", view.covered)


def shown_light(lights: list[Light]) -> Light:
    """Return the light of the comparisons of photograph and render."""
    return lights[_SHOWN]


def staged_maps(runs: Mapping[str, Run]) -> Maps:
    """Return the maps that each of the three stages searched, combined, with the residual of the last."""
    last = runs[STAGES[-1]].maps
    model = last.model
    values = {p.name: runs[p.stage].maps.values[p.name] for p in model.parameters}
    deviations = {p.name: runs[p.stage].maps.confidence[p.name] for p in model.parameters}
    return Maps(model, values, last.solved, last.residual, deviations)


def _photograph(view: View, light: Light, values: dict[str, np.ndarray]) -> np.ndarray:
    renderer = camera_renderer(view.bake, view.subject.model, values, view.camera, [light])
    image = renderer.render(0)[..., :3]
    renderer.close()
    return image


def _display(radiance: np.ndarray) -> np.ndarray:
    return srgb_from_linear(np.clip(radiance, 0, 1))
