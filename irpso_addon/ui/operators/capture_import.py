"""Imports a capture's files by file browser, drag and drop or File > Import, and checks them in time slices."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
from bpy.app.handlers import persistent
from bpy.props import StringProperty

from ...blender.images import decode
from ...blender.scenes.scene import middle_of
from ...blender.scenes.scene_capture import wide_lights
from ...calibration.photographs import CAMERA, is_photograph
from ...capture.card import card_depth, card_middle
from ...capture.formats.registry import EXTENSIONS, SUFFIXES, captures_in
from ...capture.inspect import sufficiency
from ...capture.inspect.frames import Finding
from ...capture.inspect.report import Report, inspect_steps
from ...capture.read import read_spec
from ...capture.spec import CaptureSpec
from ...capture.types import Capture
from ...core.errors import GpuUnavailableError, InputError
from ...gpu import probe
from ..common import drawing, failures
from ..common.file_paths import absolute, relative_to
from ..common.polls import NO_CAPTURE, usable
from ..common.words import n_, rpt
from ..properties import findings
from ..properties.scene_settings import UPDATE_CALLBACKS, model_of
from ..session.scene_capture import capture_of, capture_path, is_marked, keep_corners, store_light_facts, with_card
from ..session.scene_job import subject_object

# Limits of a slice, in seconds. Between slices Blender handles events and redraws; the next slice lasts as long as
# this took. After each image Blender redraws all views. If that takes a second (software renderer on a busy machine),
# constant slices of the shortest length would leave nearly all the time to drawing.
_SHORTEST, _LONGEST = 0.02, 0.5
_PAUSE = 0.005  # seconds until the next slice
_REDRAW_SECONDS = 0.25  # seconds between redraws of the check's progress
_EXTENSIONS = ";".join(EXTENSIONS)
_AREAS = ("VIEW_3D", "IMAGE_EDITOR")
CARD_SETTINGS = ("subject", "framing", "crop", "corners", "card_distance", "card_width")


@dataclass
class _Check:
    """A running check. scene: its session_uid. path: the absolute capture_path of the settings.

    doing: the current step, in words. slice_end: end of the last slice. redrawn: last redraw of the panel. Both times
    are by ``time.perf_counter``.
    """

    scene: int
    path: str
    steps: Generator[str, None, Report]
    doing: str = ""
    slice_end: float = 0.0
    redrawn: float = 0.0


_running: list[_Check] = []  # at most one


def checking(scene) -> str:
    """Return the current step of the check of a scene's capture, in words; "" if no check is running."""
    if not _running or _running[0].scene != scene.session_uid or not bpy.app.timers.is_registered(_tick):
        return ""
    return _running[0].doing


def import_again(scene, path: Path, names: Sequence[str]) -> None:
    """Import another table of the same photographs; the settings of these names stay."""
    settings = scene.irpso
    # A copy: a vector property would change with the setting.
    values = [getattr(settings, name) for name in names]
    former = [value if isinstance(value, str | float | int) else tuple(value) for value in values]
    bpy.ops.irpso.import_capture(filepath=str(path))
    for name, value in zip(names, former, strict=True):
        setattr(settings, name, value)
    if settings.card_distance or settings.card_width:
        begin_check(scene)  # again: the check of the import did not know them


def capture_at(path: Path) -> Path:
    """Return the capture's path for a chosen one: a file that is a capture as it is, for any other file its folder."""
    if path.is_file() and (path.suffix.lower() not in SUFFIXES or path.name.lower() == CAMERA):
        return path.parent
    return path


def subject_of(spec: CaptureSpec) -> str:
    """Return "CARD" for a single camera without a pose, which looks straight at a card; else "MESH"."""
    return "CARD" if len(spec.views) == 1 and not spec.views[0].placed else "MESH"


def goals_of(settings) -> tuple[str, ...]:
    """Return the ``sufficiency.GOALS`` of the maps to be recovered, for which the lights must suffice."""
    try:
        model = model_of(settings)
    except InputError:
        return ("normals",)
    fixed = {item.name for item in settings.parameters if not item.recover}
    recovered = [parameter for parameter in model.parameters if parameter.name not in fixed]
    goals = ["normals"] if any(parameter.is_normal for parameter in recovered) else []
    if any(parameter.kind == "search" and not parameter.is_normal for parameter in recovered):
        goals.append("two lobes" if model.ordered else "roughness")
    return tuple(goals)


def check_capture(scene) -> None:
    """Begin the check of files, or check the scene's own cameras and lights at once. Store an error as a finding."""
    settings = scene.irpso
    try:
        if settings.source == "SCENE":
            _check_scene(scene)
        elif settings.capture_path:
            begin_check(scene)
    except InputError as error:
        settings.checked_path = settings.capture_path if settings.source == "FILES" else ""
        settings.summary = ""
        fault = Finding(getattr(error, "code", "capture"), failures.message_of(error), severity="error")
        findings.keep(settings, [fault])


def begin_check(scene) -> None:
    """Check the scene's capture: at once in background, in time slices if there is a window."""
    settings = scene.irpso
    goals = dict.fromkeys(("normals", *goals_of(settings)))  # the panel shows only findings on recovered maps
    steps = inspect_steps(
        capture_path(settings), decode, settings.colour_space, tuple(goals), settings.card_distance or None,
        settings.skip_damaged, settings.card_width or None,
        partial(with_card, _card_settings(settings)) if is_marked(settings) else None,
    )  # fmt: skip
    _running[:] = [_Check(scene.session_uid, _absolute(settings), steps, n_("Checking"))]
    if bpy.app.background:
        _slice(_running[0], math.inf)
    elif not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=_PAUSE)


def _card_settings(settings) -> SimpleNamespace:
    """Return a copy of the settings of the card and its part: an undo invalidates pointers while a check runs."""
    values = {name: getattr(settings, name) for name in (*CARD_SETTINGS, "picture_scale")}
    return SimpleNamespace(**values | {name: tuple(values[name]) for name in ("crop", "corners")})


def _tick() -> float | None:
    """Work for one slice; return the seconds to the next for Blender's timer, None to end it."""
    if not _running:
        return None
    check, now = _running[0], time.perf_counter()
    more = False
    with failures.reported(n_("The check")):
        more = _slice(check, min(max(now - check.slice_end, _SHORTEST), _LONGEST))
    if not more:
        _running.clear()
    check.slice_end = time.perf_counter()
    if not more or check.slice_end - check.redrawn > _REDRAW_SECONDS:
        check.redrawn = check.slice_end
        drawing.redraw_sidebars()
    return _PAUSE if more else None


def _absolute(settings) -> str:
    return bpy.path.abspath(settings.capture_path)


def _slice(check: _Check, seconds: float) -> bool:
    """Continue a check for about ``seconds``; return whether it is unfinished."""
    scene = next((scene for scene in bpy.data.scenes if scene.session_uid == check.scene), None)
    if scene is None or _absolute(scene.irpso) != check.path:
        _running.clear()
        return False
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        try:
            check.doing = next(check.steps)
        except StopIteration as stop:
            _running.clear()
            _store(scene.irpso, stop.value)
            return False
    return True


def _store(settings, report: Report) -> None:
    settings.checked_path = settings.capture_path
    settings.summary = "\n".join(f"{what}: {value}" for what, value in report.facts)
    settings.checked_images, settings.checked_texels = report.images, report.texels
    if report.corners is not None and settings.framing == "FILE":
        keep_corners(settings, report.corners)  # so that Recover need not search again
    if not bpy.app.background:
        with suppress(GpuUnavailableError):  # Recover says so
            probe.measured()
    folder = report.path if report.path.is_dir() else report.path.parent
    findings.keep(settings, report.findings, f"{folder}{os.sep}")


class ImportCapture(bpy.types.Operator):
    """Choose photographs with known lights: their folder, an .lp list, a capture.toml, or any file beside them"""

    bl_idname = "irpso.import_capture"
    bl_label = "Import Capture"
    bl_options = {"REGISTER", "UNDO"}

    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    directory: StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE"})
    filter_glob: StringProperty(default=_EXTENSIONS.replace(".", "*."), options={"HIDDEN"})

    def invoke(self, context, event):
        """Open the file browser, unless a file was dropped."""
        if self.filepath or self.directory:
            return self.execute(context)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context):
        """Make the files the scene's capture and begin the check. If they are no capture, the settings stay."""
        settings, chosen, path = context.scene.irpso, self.filepath or self.directory, None
        try:
            if not chosen:
                raise InputError("no file or folder was chosen; choose a capture")
            path = capture_at(absolute(chosen, "Capture"))
            spec = read_spec(path, settings.colour_space)
        except InputError as error:
            self.report({"ERROR"}, _refusal(error, path))
            return {"CANCELLED"}
        settings.source = "FILES"
        if settings.capture_path != (stored := _stored_path(path)):  # the same capture keeps subject and card distance
            settings.capture_path, settings.subject = stored, subject_of(spec)
        store_light_facts(settings, spec)
        settings.summary = f"kind: {spec.kind}\nimages: {len(spec.observations)}"
        settings.findings.clear()
        settings.checked_path = ""
        settings.view.observation = 1
        begin_check(context.scene)
        self.report({"INFO"}, rpt("{name}: {count} images", name=spec.name, count=len(spec.observations)))
        _warn(self, settings)
        return {"FINISHED"}


def _refusal(error: InputError, path: Path | None) -> str:
    """Return the message of a refused capture. For photographs without a list of lights it names Find Lights."""
    if getattr(error, "code", "") != "kind" or path is None or not path.is_dir():
        return str(error)
    if captures_in(path) or not any(is_photograph(file) for file in path.iterdir()):
        return str(error)
    return f"{path}: holds photographs without a list of their lights; use Find Lights"


def _stored_path(path: Path) -> str:
    """Return the path to store in the .blend: relative to this file if the user's preferences say so."""
    text = str(path.resolve())
    relative = bpy.context.preferences.filepaths.use_relative_paths
    if not (relative and bpy.data.filepath):
        return text
    return relative_to(text, os.path.dirname(bpy.data.filepath))


def _warn(operator, settings) -> None:
    """Report the first finding, errors before warnings."""
    if shown := findings.shown(settings):
        more = rpt(" (and {count} more)", count=len(shown) - 1) if len(shown) > 1 else ""
        operator.report({"WARNING"}, shown[0].message + more)


class CheckCapture(bpy.types.Operator):
    """Check the capture: whether all images are there, aligned, well exposed and listed correctly"""

    bl_idname = "irpso.check_capture"
    bl_label = "Check Capture"

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there is a capture."""
        settings = context.scene.irpso
        there = settings.source == "SCENE" or bool(settings.capture_path)
        return usable(cls, there, NO_CAPTURE)

    def execute(self, context):
        """Begin the check of files, or check the scene's own cameras and lights at once."""
        check_capture(context.scene)
        _warn(self, context.scene.irpso)
        return {"FINISHED"}


def _check_scene(scene) -> None:
    """Check the scene's own cameras, lights and images; store the findings and the summary. Raises InputError."""
    settings = scene.irpso
    settings.checked_path, settings.summary = "", ""
    capture = capture_of(scene)
    place = _subject_place(settings, capture)
    sizes = ", ".join(f"{camera.width}×{camera.height}" for camera in capture.cameras)
    settings.summary = f"images: {len(capture.observations)}\ncameras: {len(capture.cameras)} ({sizes})"
    faults = [Finding("left_out", f"left out: {one.why}") for one in capture.left_out]
    if problem := sufficiency.no_normal(capture.lights):
        faults.append(Finding(f"lights_{problem.code}", f"{capture.name}: {problem.message}", "normals", "error"))
    wide = [] if place is None else wide_lights(scene, place)
    findings.keep(settings, [*faults, *(Finding("light_wide", text) for text in wide)])


def _subject_place(settings, capture: Capture) -> np.ndarray | None:
    """Return the centre (3,) of the card or of the mesh, None if no mesh is chosen. Raises InputError."""
    if settings.subject == "CARD":
        camera = capture.cameras[0]
        return camera.matrix[:3, :3] @ card_middle(camera, card_depth(capture)) + camera.position
    obj = subject_object(bpy.context)
    return None if obj is None else middle_of(obj)


class CaptureFiles(bpy.types.FileHandler):
    """Drag and drop of captures into a 3D viewport or an Image editor."""

    bl_idname = "IRPSO_FH_capture"
    bl_label = "IRPSO Capture"
    bl_import_operator = ImportCapture.bl_idname
    bl_file_extensions = _EXTENSIONS

    @classmethod
    def poll_drop(cls, context) -> bool:
        """Whether the area under the cursor takes captures."""
        return context.area is not None and context.area.type in _AREAS


def _menu(self, context) -> None:
    self.layout.operator(ImportCapture.bl_idname, text="IRPSO Capture (.lp, .toml, folder)")


CLASSES = (ImportCapture, CheckCapture, CaptureFiles)
for _name in ("skip_damaged", "colour_space"):
    UPDATE_CALLBACKS[_name] = lambda settings: check_capture(settings.id_data)


@persistent
def _on_load(*_: object) -> None:
    _running.clear()  # the check belongs to the former file


def register() -> None:
    """Add the entry to File > Import, and end a check when another file is loaded."""
    bpy.types.TOPBAR_MT_file_import.append(_menu)
    bpy.app.handlers.load_pre.append(_on_load)


def unregister() -> None:
    """Remove the entry and the handler, and end a running check."""
    bpy.app.handlers.load_pre.remove(_on_load)
    bpy.types.TOPBAR_MT_file_import.remove(_menu)
    _running.clear()
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
