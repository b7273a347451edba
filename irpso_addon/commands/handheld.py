"""``handheld PHOTOS``: cameras and lights of photographs taken by hand with the phone's flash on."""

from __future__ import annotations

import math
import sys
from argparse import Namespace
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..blender.images import decode
from ..blender.scenes.card_mesh import CARD, save_card
from ..calibration.handheld.handheld_calibration import Handheld, handheld_steps
from ..calibration.handheld.write import report_of, report_text, table_text
from ..calibration.photographs import CAMERA, camera_keys, read_photographs, relative_path
from ..capture.formats.diligent import FILENAMES
from ..capture.formats.table import TABLE
from ..capture.formats.toml_file import FOCAL_KEYS
from ..capture.images.exif import field_of_view
from ..capture.images.exr_header import is_exr
from ..capture.images.image import ImageStore
from ..capture.spec import CaptureKind, CaptureSpec, build_capture
from ..capture.types import Capture
from ..core.errors import InputError
from ..core.files import check_unused, new_folder
from ..core.progress_bar import ProgressBar
from .options.values import numbers_of_text, shell_quoted, silent, warn_quietly

BLEND = "card.blend"
_REPORT = "report.json"
_SAME_ZOOM = 0.01  # relative difference of focal lengths
_TEXELS = 512  # of the shorter side, in the command that is proposed


def run(options: Namespace) -> dict:
    """Find cameras and lights and write them. Raises InputError and then writes nothing."""
    out = Path(options.output)
    check_unused(out)
    spec = _photographs(options)
    offset = _offset(options.flash_offset)
    capture, lens = _with_lens(build_capture(spec, decode), spec, options.fov)
    bar = ProgressBar("handheld", silent(options))
    store = ImageStore(decode)
    orientations = [store.tag(observation.image) or 1 for observation in spec.observations]
    handheld = bar.run(handheld_steps(capture, lens, offset, orientations), lambda part: (part, "photographs"))
    handheld = replace(handheld, warnings=(*handheld.warnings, *_lens_warnings(spec.source)))
    table = table_text(spec, handheld, out)
    with new_folder(out) as partial:
        (partial / TABLE).write_text(table, encoding="utf-8")
        (partial / _REPORT).write_text(report_text(spec, handheld), encoding="utf-8")
        save_card(partial / BLEND, handheld.field)
    warn_quietly(options, handheld.warnings)
    if not silent(options):
        sys.stdout.write(_summary(handheld, out))
    return {"output": str(out), **report_of(spec, handheld)}


def _photographs(options: Namespace) -> CaptureSpec:
    """Return the photographs of a folder, each with a camera of its own, which has its name."""
    path = Path(options.photographs)
    if not path.is_dir():
        raise InputError(f"{path}: is no folder; give the folder of the photographs")
    spec = read_photographs(path, options.colour_space)
    if spec.kind is not CaptureKind.IMAGES:
        raise InputError(f"{path}: holds a capture with lights; give a folder of photographs alone")
    view = replace(spec.views[0], mask=None)
    names = _distinct_names(path, spec)
    observations = tuple(
        replace(s, name=name, camera=n) for n, (s, name) in enumerate(zip(spec.observations, names, strict=True))
    )
    return replace(
        spec,
        observations=observations,
        views=tuple(replace(view, name=observation.name) for observation in observations),
    )


def _distinct_names(folder: Path, spec: CaptureSpec) -> list[str]:
    """Return the names of photographs: of equal ones the paths. Raises InputError where one is listed twice."""
    paths = [observation.image.path for observation in spec.observations]
    counts = Counter(path.resolve() for path in paths)
    if twice := next((path for path in paths if counts[path.resolve()] > 1), None):
        raise InputError(f"{folder / FILENAMES}: lists {twice} twice; remove one of the lines")
    names = Counter(observation.name for observation in spec.observations)
    return [
        observation.name if names[observation.name] == 1 else relative_path(path, folder)
        for observation, path in zip(spec.observations, paths, strict=True)
    ]


def _with_lens(capture: Capture, spec: CaptureSpec, fov: float | None) -> tuple[Capture, str]:
    """Return the capture with one focal length, and "known", "likely" or "unknown" for it. Raises InputError.

    fov: over the first photograph's width; None: of the folder's camera.toml, else of EXIF.
    """
    sizes = [(camera.width, camera.height) for camera in capture.cameras]
    if fov is not None and not 0 < fov < 180:
        raise InputError(f"--fov {fov:g}: give the full angle over the image's width, above 0 and below 180")
    first = capture.cameras[0]
    if fov is None and spec.views[0].lens and first.perspective:
        fov = math.degrees(2 * math.atan(first.width / 2 / first.scale[0]))
    angles: list[float | None] = [fov] * len(sizes)
    if fov is None:
        paths = [observation.image.path for observation in spec.observations]
        angles = [
            None if is_exr(path) else field_of_view(path.read_bytes(), *size)
            for path, size in zip(paths, sizes, strict=True)
        ]
    width = max(sizes[0])
    focals = [size[0] / 2 / math.tan(math.radians(angle) / 2)
              for angle, size in zip(angles, sizes, strict=True) if angle is not None]  # fmt: skip
    if fov is not None:  # --fov is over the first photograph's width; others may be upright
        focals = focals[:1]
    focal = float(np.median(focals)) if focals else float(width)
    if focals and max(abs(value / focal - 1) for value in focals) > _SAME_ZOOM:
        raise InputError("the photographs have different focal lengths, as their EXIF says; take all at one zoom")
    cameras = tuple(
        replace(camera, scale=(focal, focal), centre=(camera.width / 2, camera.height / 2), perspective=True)
        for camera in capture.cameras
    )
    return replace(capture, cameras=cameras), "known" if fov is not None else "likely" if focals else "unknown"


def _lens_warnings(folder: Path) -> list[str]:
    """Return a warning for keys of the folder's camera.toml that are not used, or []."""
    path = folder / CAMERA
    unused = sorted(camera_keys(path).keys() - FOCAL_KEYS) if path.exists() else []
    if not unused:
        return []
    return [
        f"{path}: not used: {', '.join(unused)}; handheld reads fov_degrees or focal_length_px, and measures the"
        " distortion"
    ]


def _offset(text: str | None) -> np.ndarray | None:
    if text is None:
        return None
    numbers = numbers_of_text(text) or []
    if len(numbers) != 3 or not np.isfinite(numbers).all():
        raise InputError(f"--flash-offset {text}: give X,Y,Z in millimetres: to the right, up, and toward you")
    return np.array(numbers)


def _summary(setup: Handheld, out: Path) -> str:
    unit = " mm" if setup.board else ""
    x, y, _ = setup.flash.offset
    x0, y0, x1, y1 = setup.field
    shorter = _TEXELS / min(x1 - x0, y1 - y0)
    size = f"{round((x1 - x0) * shorter)}x{round((y1 - y0) * shorter)}"
    by = (
        setup.board.name if setup.board else "features of the card; lengths are in widths of the part that is recovered"
    )
    lines: list[Any] = [
        f"{len(setup.cameras)} cameras by {by}",
        f"points are off by {setup.error:.2f} pixels (median); views differ by {setup.views:.0f}°",
        f"flash {x:.3g}, {y:.3g}{unit} to the right of the lens and above it, in pictures without EXIF rotation,"
        f" falling with the cosine to the power of {setup.flash.beam:.1f}",
        *(f"warning: {warning}" for warning in setup.warnings),
        f"written to {out}; recover it with: irpso recover {shell_quoted(out)} --blend {shell_quoted(out / BLEND)}"
        f" --object {CARD}"
        f" --resolution {size} -o OUT",
    ]
    return "\n".join(lines) + "\n"
