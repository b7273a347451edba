"""``calibrate CAPTURE_OR_IMAGES``: calibrates lights from balls in photographs, or from the subject's shading."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Generator, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from ..blender.images import decode
from ..calibration.ball_calibration import AUTO, Calibrated, ball_of_text, calibrate_steps
from ..calibration.ball_report import report_of
from ..calibration.balls.lights import Request
from ..calibration.photographs import camera_keys, lens_of_files, read_photographs, with_camera
from ..calibration.write import checked_output, places, table_path, write_calibration, write_lights
from ..capture.formats.table import CARD_DISTANCE
from ..capture.framing import axis_cosine, framed
from ..capture.spec import CaptureSpec, build_capture
from ..capture.types import Capture
from ..core.errors import InputError
from ..core.optional import present
from ..core.paths import DEFAULT_MODEL
from ..core.progress_bar import ProgressBar
from ..gpu import context, probe
from ..pipeline.flat_card import FlatCard, flat_card_steps, part_warnings, width_keys
from ..pipeline.known_shape import KnownShape, known_shape_steps
from ..pipeline.uncalibrated import Uncalibrated, uncalibrated_steps
from ..reflectance.model import load_model
from .options.job_options import subject_of
from .options.values import numbers_of_text, positive, silent, warn, warn_quietly
from .options.videos import frames_of_videos

NONE = "none"  # value of --ball
_SHOWN_WARNINGS = 12
_SAME_LENS = 0.05  # relative difference of the angles of one lens, by EXIF and as measured

Found = TypeVar("Found")


def run(options: Namespace) -> dict:
    """Find the lights and write them. Raises InputError and then writes nothing."""
    with frames_of_videos(options) as frames:
        return _calibrated(Namespace(**vars(options), frames=frames))


def _calibrated(options: Namespace) -> dict:
    """Find the lights and write them. options: the command's, and ``frames`` of videos."""
    keys = _camera(options)
    if NONE in (options.ball or []):
        _check_ballless(options)
        if options.flat:
            return _by_falloff(options, keys)
        return _by_shape(options, keys) if options.blend else _by_shading(options, keys)
    for name in ("inside_out", "flat", "blend", "object", "slots", "occluder"):
        if getattr(options, name):
            raise InputError(f"--{name.replace('_', '-')}: needs --ball none; add it, or leave the option out")
    requests = [ball_of_text(text) for text in options.ball or [AUTO]]
    masks = [r.mask for r in requests if r.mask is not None]
    out = checked_output(Path(options.output), options.replace)
    spec, keys = _photographs(options, keys, masks)
    lamp_distance = positive("--lamp-distance", options.lamp_distance)
    request = Request(options.kind, options.lights, lamp_distance, _albedo(options.albedo))
    bar = ProgressBar("calibrate", silent(options))
    steps = calibrate_steps(spec, requests, request, decode, positive("--radius", options.radius), options.view)
    calibrated = bar.run(steps, lambda part: (part, "reading"))
    write_calibration(calibrated, out, keys, options.replace)
    report = report_of(calibrated)
    if not silent(options):
        sys.stdout.write(_summary(calibrated, out, options.radius))
    warn_quietly(options, calibrated.warnings)
    errors = [light.error for light in calibrated.result.lights if light.light is not None]
    return {
        "output": str(out),
        "photographs": len(calibrated.names),
        "lights": len(errors),
        "error_degrees": round(float(np.median(errors)), 4),
        **{key: report[key] for key in ("kind", "near", "how", "camera", "warnings")},
    }


def _check_ballless(options: Namespace) -> None:
    """Raise InputError for an option that contradicts --ball none."""
    if options.ball != [NONE]:
        raise InputError("--ball none: finds lights without a ball; omit the other --ball")
    for name, default in (("kind", AUTO), ("radius", None), ("lamp_distance", None), ("albedo", None), ("view", None)):
        if getattr(options, name) != default:
            raise InputError(f"--{name.replace('_', '-')}: applies to balls; leave it out with --ball none")
    if options.flat and options.blend:
        raise InputError("--flat and --blend: a flat card needs no mesh; give one of them")
    if options.flat and options.inside_out:
        raise InputError("--inside-out: a flat card (--flat) has no relief; leave it out")
    if options.flat and options.lights == "distant":
        raise InputError("--lights distant: matt shading of a flat card does not show directions; put a ball beside it")
    if options.blend and options.inside_out:
        raise InputError("--inside-out: a mesh (--blend) has one side; leave it out")
    for name in ("object", "slots", "occluder"):
        if getattr(options, name) and not options.blend:
            raise InputError(f"--{name}: is for meshes: give --blend FILE")


def _by_shape(options: Namespace, keys: dict[str, Any]) -> dict:
    """Find lights from the shading of a mesh and write them."""
    checked_output(Path(options.output), options.replace)
    mesh = present(subject_of(options)[1])
    spec, keys = _photographs(options, keys, [])
    result = _without_ball(options, known_shape_steps(_capture(spec), mesh, options.lights))
    kind = "near lights, with their positions," if result.near else "distant lights"
    line = f"{len(result.capture.lights)} {kind} by the shading of '{mesh.name}'; {_errors(result.fit.degrees)}"
    return _written_without_ball(options, spec, keys, result, line)


def _by_falloff(options: Namespace, keys: dict[str, Any]) -> dict:
    """Find near lights from the fall-off over a flat card and write them."""
    checked_output(Path(options.output), options.replace)
    spec, keys = _photographs(options, keys, [])
    whole = _whole(spec)
    used = framed(whole, spec.framing)
    result = _without_ball(options, flat_card_steps(used))
    result = replace(result, warnings=(*result.warnings, *part_warnings(whole, spec.framing)))
    if not (keys or spec.views[0].lens):
        keys = width_keys(whole.cameras[0])
    distance = present(result.capture.card_distance) / axis_cosine(whole.cameras[0], used.cameras[0])
    result = replace(result, capture=replace(result.capture, card_distance=distance))
    card = {} if spec.states_distance else {CARD_DISTANCE: distance}
    line = (
        f"{len(result.capture.lights)} near lights, with their positions, by their fall-off over a flat card;"
        f" {_errors(result.fit.degrees)}, and {result.distance_error:.0%} of their distance"
    )
    return _written_without_ball(options, spec, keys, result, line, card)


def _by_shading(options: Namespace, keys: dict[str, Any]) -> dict:
    """Find distant lights from the subject's shading and write them."""
    if options.lights == "near":
        raise InputError(
            "--lights near: places of lamps need balls or a known shape (--blend, --flat); --ball none alone finds"
            " directions of distant lights"
        )
    checked_output(Path(options.output), options.replace)
    spec, keys = _photographs(options, keys, [])
    steps = uncalibrated_steps(_capture(spec), load_model(DEFAULT_MODEL), inside_out=options.inside_out)
    result = _without_ball(options, steps)
    turned = f"; it turned them by {result.refined.turned.mean():.1f}°" if result.kept else ""
    line = (
        f"{len(result.errors)} distant lights by shading; parts of the subject agree to {result.errors.mean():.1f}°,"
        f" and before its material was recovered to {result.first.errors.mean():.1f}°{turned}"
    )
    return _written_without_ball(options, spec, keys, result, line)


def _capture(spec: CaptureSpec) -> Capture:
    return framed(_whole(spec), spec.framing)


def _whole(spec: CaptureSpec) -> Capture:
    probe.probe()
    context.ensure()
    return build_capture(spec, decode)


def _without_ball(options: Namespace, steps: Generator[float, None, Found]) -> Found:
    """Run the steps with a progress bar; return their result."""
    return ProgressBar("calibrate", silent(options)).run(steps, lambda part: (part, "shading"))


def _written_without_ball(
    options: Namespace,
    spec: CaptureSpec,
    keys: dict[str, Any],
    result: Uncalibrated | KnownShape | FlatCard,
    line: str,
    card: Mapping[str, Any] = MappingProxyType({}),
) -> dict:
    """Write the lights, print a line and the warnings, and return the command's result."""
    report, out, count = result.report(), Path(options.output), len(result.capture.lights)
    write_lights(spec, keys, result.capture.lights, report, out, card, options.replace)
    if not silent(options):
        lines = [line, *(f"warning: {warning}" for warning in result.warnings), f"written to {out}"]
        sys.stdout.write("\n".join(lines) + "\n")
    warn_quietly(options, result.warnings)
    return {"output": str(out), **report, "photographs": count, "lights": count}


def _errors(degrees: np.ndarray) -> str:
    return f"standard error: median {np.median(degrees):.2f}°, largest {degrees.max():.2f}°"


def _photographs(options: Namespace, keys: dict[str, Any], masks: list[Path]) -> tuple[CaptureSpec, dict[str, Any]]:
    """Return the photographs, and the keys of their camera: ``keys``, or else those of their EXIF."""
    hidden = [*masks, *places(Path(options.output))]
    spec = read_photographs(Path(options.capture), options.colour_space, hidden, options.frames)
    where = "--camera" if options.camera else "--fov"
    exif = {} if options.camera else lens_of_files(spec, decode)
    if keys and exif and abs(exif["fov_degrees"] / keys["fov_degrees"] - 1) > _SAME_LENS:
        given, read = (f"{one['fov_degrees']:.1f}°" for one in (keys, exif))
        warn(
            [f"--fov: {given} over the width, but the photographs' EXIF says {read}; omit --fov unless it was measured"]
        )
    elif not keys and exif:
        keys, where = exif, "EXIF"
        if not silent(options):
            sys.stdout.write(f"camera: {keys['fov_degrees']:.1f}° over the width, as EXIF says; --fov overrides it\n")
    return (with_camera(spec, keys, where) if keys else spec), keys


def _camera(options: Namespace) -> dict[str, Any]:
    if options.camera and options.fov is not None:
        raise InputError("--camera and --fov: give one of them")
    if options.camera:
        return camera_keys(Path(options.camera))
    if options.fov is None:
        return {}
    if not 0 < options.fov < 180:
        raise InputError(f"--fov {options.fov:g}: give the full angle over the image's width, above 0 and below 180")
    return {"fov_degrees": options.fov}


def _albedo(text: str | None) -> tuple[float, float, float] | None:
    if text is None:
        return None
    numbers = numbers_of_text(text) or []
    if len(numbers) not in (1, 3) or not all(0 < n <= 1 for n in numbers):
        raise InputError(f"--albedo {text}: give one number, or r,g,b, each above 0 and up to 1")
    r, g, b = np.broadcast_to(numbers, 3).tolist()
    return r, g, b


def _summary(calibrated: Calibrated, out: Path, radius: float | None) -> str:
    result = calibrated.result
    errors = [light.error for light in result.lights if light.light is not None]
    camera = result.views[0].ball.camera
    lines = [f"{len(errors)} lights of {len(calibrated.names)} photographs, {result.how}", _errors(np.array(errors))]
    for ball in calibrated.found_balls:
        x, y = ball.centre[0], camera.height - ball.centre[1]
        shadow_text = "not confirmed by a shadow" if ball.shadow is None else f"its shadow agrees to {ball.shadow:.0%}"
        lines.append(
            f"found: {ball.kind} ball at {x:.1f},{y:.1f} of radius {ball.radius:.1f}; {ball.support:.0%} of its outline"
            f" shows, {shadow_text}"
        )
    for ball in (view.ball for view in result.views):
        lines.append(f"{ball.name}: radius {ball.radius_px:.1f} pixels, error of the outline {ball.error_px[0]:.2f}")
    if not camera.perspective:
        lines.append("camera: orthographic")
    elif result.near and radius is None:
        lines.append("positions are in radii of the ball; --radius converts them to world units")
    if calibrated.shows_distance:
        lines.append(_distance_line(calibrated, out))
    lines += [f"warning: {warning}" for warning in calibrated.warnings[:_SHOWN_WARNINGS]]
    if len(calibrated.warnings) > _SHOWN_WARNINGS:
        lines.append(f"and {len(calibrated.warnings) - _SHOWN_WARNINGS} more warnings in the report")
    return "\n".join([*lines, f"written to {out}"]) + "\n"


def _distance_line(calibrated: Calibrated, out: Path) -> str:
    if calibrated.new_distance is None:
        origin = "camera" if calibrated.result.views[0].ball.camera.perspective else "plane of the balls"
        return (
            f"the table under the balls is {calibrated.card_distance:.6g} from the {origin}; the capture's own"
            " card_distance or card_width stays"
        )
    return (
        f"{CARD_DISTANCE} = {calibrated.new_distance:g} written to {table_path(out)}, that of the table under the"
        " balls; a card on it is nearer by its thickness: change it there, or by --distance"
    )
