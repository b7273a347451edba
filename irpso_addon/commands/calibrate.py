"""``calibrate CAPTURE_OR_IMAGES``: the lights of photographs from balls in them."""

from __future__ import annotations

import os
import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np

from ..calibration.ball import Ball, tangents, to_pixels
from ..calibration.job import Calibrated, ball_of_text, calibrate_steps, report_of, report_text, written_table
from ..calibration.lights import FoundLight, Request
from ..calibration.photographs import camera_keys, read_photographs, with_camera
from ..calibration.views import BallView
from ..capture.diligent import DIRECTIONS, FILENAMES, INTENSITIES
from ..capture.table import TABLE
from ..errors import InputError
from ..files import new_folder
from ..maps.ball_sheet import BallTile, ball_sheet
from ..maps.blender_images import decode, encode_png
from .progress import ProgressBar

_REPORT, _PICTURE = "report.json", "balls.png"
_SHOWN_WARNINGS = 12


def run(options: Namespace) -> dict:
    """Find the lights and write them. Raises InputError; then nothing is written."""
    keys = _camera(options)
    requests = [ball_of_text(text) for text in options.ball]
    masks = [r.mask for r in requests if r.mask is not None]
    out = _checked_output(Path(options.output))
    draft = read_photographs(Path(options.capture), options.colour_space, masks)
    if keys:
        draft = with_camera(draft, keys, "--camera" if options.camera else "--fov")
    request = Request(options.kind, options.lights, _positive("--distance", options.distance), _albedo(options.albedo))
    bar = ProgressBar("calibrate", options.quiet or options.json)
    steps = calibrate_steps(draft, requests, request, decode, _positive("--radius", options.radius), options.view)
    while True:
        try:
            bar.show(next(steps) / len(draft.shots), "reading")
        except StopIteration as stop:
            found = stop.value
            break
    bar.show(1.0, "done")
    bar.close()
    _write(found, out, keys)
    report = report_of(found)
    if not options.quiet and not options.json:
        sys.stdout.write(_summary(found, out))
    errors = [light.error for light in found.result.lights if light.light is not None]
    return {
        "output": str(out),
        "photographs": len(found.names),
        "lights": len(errors),
        "error_degrees": round(float(np.median(errors)), 4),
        **{key: report[key] for key in ("kind", "near", "how", "camera", "warnings")},
    }


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


def _positive(option: str, value: float | None) -> float | None:
    if value is not None and not (np.isfinite(value) and value > 0):
        raise InputError(f"{option} {value:g}: give a number above 0")
    return value


def _albedo(text: str | None) -> tuple[float, float, float] | None:
    if text is None:
        return None
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (1, 3) or not all(0 < n <= 1 for n in numbers):
        raise InputError(f"--albedo {text}: give one number, or r,g,b, each above 0 and up to 1")
    r, g, b = np.broadcast_to(numbers, 3).tolist()
    return r, g, b


def _checked_output(out: Path) -> Path:
    """Return where to write. Raises InputError where that is there already: nothing is overwritten."""
    if out.suffix.lower() == ".toml":
        for path in (out, _beside(out, _REPORT), _beside(out, _PICTURE)):
            if path.exists():
                raise InputError(f"{path}: is there already; choose another name for -o, or delete it first")
    elif out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: is there already and not empty; choose a new folder, or a .toml file for -o")
    return out


def _beside(table: Path, name: str) -> Path:
    return table.with_name(f"{table.stem}_{name}")


def _write(found: Calibrated, out: Path, keys: dict[str, Any]) -> None:
    """Write table, report and picture, and in a folder of its own the lists of a DiLiGenT capture too."""
    if out.suffix.lower() == ".toml":
        texts = {_beside(out, _REPORT): report_text(found), out: written_table(found, out.parent, keys)}
        _write_beside(out, texts, picture(found))
        return
    text = written_table(found, out, keys)
    with new_folder(out) as partial:
        (partial / TABLE).write_text(text, encoding="utf-8")
        (partial / _REPORT).write_text(report_text(found), encoding="utf-8")
        encode_png(partial / _PICTURE, picture(found), 8)
        for name, lines in _lists(found).items():
            (partial / name).write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def _write_beside(out: Path, texts: dict[Path, str], image: np.ndarray) -> None:
    """Write a table with its report and picture; the table comes last, and where it cannot be written none stays."""
    partials = {path: path.with_name(f".{path.name}.partial-{os.getpid()}") for path in texts}
    shown = _beside(out, _PICTURE)
    hidden = shown.with_name(f".{shown.stem}.partial-{os.getpid()}.png")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        for path, text in texts.items():
            partials[path].write_text(text, encoding="utf-8")
        encode_png(hidden, image, 8)
        os.replace(hidden, shown)
        for path in texts:
            os.replace(partials[path], path)
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error.strerror or error}); choose another place") from error
    finally:
        for path in (*partials.values(), hidden):
            path.unlink(missing_ok=True)


def _lists(found: Calibrated) -> dict[str, list[str]]:
    """Return the lines of the lists that other programs read: names, directions (or positions), intensities."""
    kept = [(name, light.light) for name, light in zip(found.names, found.result.lights, strict=True) if light.light]
    vectors = [" ".join(f"{v:.8f}" for v in light.vector) for _, light in kept]
    lists = {FILENAMES: [name for name, _ in kept]}
    lists["light_positions.txt" if found.result.near else DIRECTIONS] = vectors
    if found.result.kind == "matte":
        lists[INTENSITIES] = [" ".join(f"{v:.8f}" for v in light.intensity) for _, light in kept]
    return lists


def picture(found: Calibrated) -> np.ndarray:
    """Return (H, W, 3) display values: each ball in each photograph with what was found, and the lights on a dome."""
    tiles = []
    lights = found.result.lights
    for number, (name, light) in enumerate(zip(found.names, lights, strict=True)):
        tiles += [_tile(f"{number + 1} {name}", view, number, light, b) for b, view in enumerate(found.result.views)]
    told = [(light, next(s for s in light.sights if s is not None)) for light in lights if light.light is not None]
    title = f"{len(told)} lights from {len(found.result.views)} {found.result.kind} balls: {found.result.how}"
    doubtful = [bool(light.warnings) for light, _ in told]
    return ball_sheet(tiles, np.array([sight.direction for _, sight in told]), doubtful, title)


def _tile(label: str, view: BallView, number: int, light: FoundLight, which: int) -> BallTile:
    sight = light.sights[which]
    mark = curve = None
    if sight is not None and np.isfinite(sight.pixel).all():
        mark = _in_tile(view, sight.pixel[None])[0]
    elif sight is not None:
        curve = _in_tile(view, _terminator(view.ball, sight.direction))
        mark = _in_tile(view, to_pixels(view.ball.camera, sight.point[None]))[0]
    outline = _in_tile(view, view.ball.outline)
    return BallTile(label, view.values[number], outline, mark, curve, bool(light.warnings))


def _in_tile(view: BallView, pixels: np.ndarray) -> np.ndarray:
    return (pixels - view.pixels[0, 0]) / view.block + 0.5


def _terminator(ball: Ball, direction: np.ndarray) -> np.ndarray:
    """Return (N, 2) pixels of the circle where light ends, as far as it is seen."""
    across, upward = tangents(direction)
    phi = np.linspace(0, 2 * np.pi, 120)[:, None]
    normals = np.cos(phi) * across + np.sin(phi) * upward
    points = ball.centre + ball.radius * normals
    view = -points if ball.camera.perspective else np.broadcast_to((0.0, 0.0, 1.0), points.shape)
    hidden = (normals * view).sum(axis=-1) <= 0
    pixels = to_pixels(ball.camera, points)
    pixels[hidden] = -1e6
    start = int(np.argmax(hidden))
    return np.roll(pixels, -start, axis=0)


def _summary(found: Calibrated, out: Path) -> str:
    result = found.result
    told = [light for light in result.lights if light.light is not None]
    camera = result.views[0].ball.camera
    lines = [
        f"{len(told)} lights of {len(found.names)} photographs, {result.how}",
        f"standard error: median {np.median([t.error for t in told]):.2f}°, largest {max(t.error for t in told):.2f}°",
    ]
    for view in result.views:
        lines.append(
            f"{view.ball.name}: radius {view.ball.radius_px:.1f} pixels, outline known to {view.ball.error_px[0]:.2f}"
        )
    if not camera.perspective:
        lines.append("camera: orthographic; of a lens that is not very long give --fov or --camera")
    lines += [f"warning: {warning}" for warning in found.warnings[:_SHOWN_WARNINGS]]
    if len(found.warnings) > _SHOWN_WARNINGS:
        lines.append(f"and {len(found.warnings) - _SHOWN_WARNINGS} more warnings in the report")
    return "\n".join([*lines, f"written to {out}"]) + "\n"
