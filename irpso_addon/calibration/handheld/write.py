"""Output of a hand-held calibration: a capture.toml with a camera and a near light per photograph, and a report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ...capture.formats.table import FORMAT
from ...capture.spec import CaptureSpec
from ...core.toml_text import toml_value
from ..photographs import relative_path
from .handheld_calibration import Handheld


def table_text(spec: CaptureSpec, handheld: Handheld, folder: Path) -> str:
    """Return the text of a capture.toml in ``folder``; image paths become relative to it."""
    lines = [f"format = {FORMAT}", f"name = {toml_value(spec.name)}"]
    for camera, number in zip(handheld.cameras, handheld.numbers, strict=True):
        lines += ["", "[[camera]]", f"name = {toml_value(spec.observations[number].name)}"]
        lines += [f"width = {camera.width}", f"height = {camera.height}"]
        lines += [f"matrix = {toml_value(camera.matrix.round(9).ravel())}", f"focal_length_px = {camera.scale[0]:.9g}"]
        lines += [f"distortion = {toml_value(list(camera.distortion))}"] if camera.distortion else []
    for position, camera, number, intensity in zip(
        handheld.lamps, handheld.cameras, handheld.numbers, handheld.intensities.tolist(), strict=True
    ):
        observation = spec.observations[number]
        lines += ["", "[[observation]]", f"image = {toml_value(relative_path(observation.image.path, folder))}"]
        if observation.image.colour_space != "auto":
            lines.append(f"colour_space = {toml_value(observation.image.colour_space)}")
        lines += [f"camera = {toml_value(observation.name)}", f"light_position = {toml_value(position.round(9))}"]
        lines += [f"light_intensity = {intensity:.9g}", f"light_axis = {toml_value((-camera.backward).round(9))}"]
        lines.append(f"light_cosine = {handheld.flash.beam:.4g}")
    return "\n".join(lines) + "\n"


def report_of(spec: CaptureSpec, handheld: Handheld) -> dict[str, Any]:
    """Return the report. The unit of length is the millimetre with a board, else the width of the recovered area."""
    used = [spec.observations[number].name for number in handheld.numbers]
    camera = handheld.cameras[0]
    return {
        "photographs": len(used),
        "left_out": [observation.name for observation in spec.observations if observation.name not in used],
        "markers": None if handheld.board is None else handheld.board.name,
        "error_px": round(handheld.error, 4),
        "views_degrees": round(handheld.views, 2),
        "fov_degrees": round(float(np.degrees(2 * np.arctan(camera.width / 2 / camera.scale[0]))), 3),
        "radial": round(camera.distortion[0], 5) if camera.distortion else 0.0,
        "field": [round(value, 5) for value in handheld.field],
        "flash_offset": handheld.flash.offset.round(5).tolist(),
        "flash_error": handheld.flash.error.round(5).tolist(),
        "beam_power": round(handheld.flash.beam, 3),
        "strengths": (handheld.intensities / np.exp(np.log(handheld.intensities).mean())).round(4).tolist(),
        "warnings": list(handheld.warnings),
    }


def report_text(spec: CaptureSpec, handheld: Handheld) -> str:
    """Return the report as JSON."""
    return json.dumps(report_of(spec, handheld), indent=1) + "\n"
