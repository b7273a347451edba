"""Estimates the lights of photographs without a ball, from the shading of relief, a known mesh or a flat card."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import bpy

from ...blender.images import decode
from ...calibration.write import write_lights
from ...capture.formats.table import CARD_DISTANCE
from ...capture.framing import AUTO, Framing, axis_cosine, found_corner_steps, framed
from ...capture.spec import CaptureSpec, build_steps
from ...capture.types import Capture, Light
from ...core.errors import InputError
from ...core.optional import present
from ...core.paths import DEFAULT_MODEL
from ...core.steps import map_steps
from ...geometry.surface.mesh import MeshData
from ...gpu import context as gpu_context
from ...gpu import probe
from ...pipeline.flat_card import flat_card_steps, part_warnings, width_keys
from ...pipeline.known_shape import known_shape_steps
from ...pipeline.uncalibrated import uncalibrated_steps
from ...reflectance.model import load_model
from .scene_job import mesh_of, subject_object

WAYS = ("NONE", "MESH", "FLAT")
_DETECTION = 0.2  # part of the progress for the detection of corners


@dataclass(frozen=True)
class ShadingRequest:
    """How to estimate lights. way: "NONE" (from relief of unknown shape), "MESH" or "FLAT" (from a flat card).

    Relief: inside_out takes the solution with inverted relief. mesh: for "MESH"; its lights are "auto", "distant" or
    "near". Flat card: corners, whether to detect its corners; card_width, 0 if unknown.
    """

    way: str
    lights: str = "auto"
    inside_out: bool = False
    corners: bool = False
    card_width: float = 0.0
    mesh: MeshData | None = None


@dataclass(frozen=True)
class _Estimate:
    """Lights, one per photograph. keys: the cameras' keys in the table of lights. card: the card's keys."""

    lights: list[Light]
    report: dict[str, Any]
    warnings: tuple[str, ...]
    keys: Mapping[str, Any]
    card: Mapping[str, Any] = field(default_factory=dict)


def known_mesh() -> MeshData:
    """Return the mesh that the settings name as the subject of the photographs. Raises InputError."""
    obj = subject_object(bpy.context)
    if obj is None:
        raise InputError("Object: is no mesh; choose the mesh that the photographs show")
    return mesh_of(bpy.context.scene.irpso, obj)


def shading_light_steps(
    spec: CaptureSpec, keys: Mapping[str, Any], request: ShadingRequest, table: Path
) -> Generator[float, None, tuple[str, ...]]:
    """Yield the fraction done (0…1); write the estimated lights as a new ``table`` and return the warnings.

    keys: the cameras' keys in the table. Raises InputError before it writes anything.
    """
    probe.probe()
    gpu_context.ensure()
    whole = yield from map_steps(build_steps(spec, decode), lambda _: 0.0)
    if request.way == "FLAT":
        estimate = yield from _of_card(whole, spec, keys, request)
    else:
        estimate = yield from _of_relief(framed(whole, spec.framing), keys, request)
    write_lights(spec, estimate.keys, estimate.lights, estimate.report, table, estimate.card)
    return estimate.warnings


def _of_relief(capture: Capture, keys: Mapping[str, Any], request: ShadingRequest) -> Generator[float, None, _Estimate]:
    if request.mesh is not None:
        shape = yield from known_shape_steps(capture, request.mesh, request.lights)
        return _Estimate(shape.capture.lights, shape.report(), shape.warnings, keys)
    fitted = yield from uncalibrated_steps(capture, load_model(DEFAULT_MODEL), inside_out=request.inside_out)
    return _Estimate(fitted.capture.lights, fitted.report(), fitted.warnings, keys)


def _of_card(
    whole: Capture, spec: CaptureSpec, keys: Mapping[str, Any], request: ShadingRequest
) -> Generator[float, None, _Estimate]:
    framing, start = spec.framing, 0.0
    if request.card_width:
        whole, framing = replace(whole, card_distance=None), replace(framing, card_width=request.card_width)
    if request.corners or framing.corners == AUTO:
        detection = found_corner_steps(whole, replace(framing, crop=None))
        framing, _ = yield from map_steps(detection, lambda part: _DETECTION * part)
        start = _DETECTION
    used = framed(whole, framing)
    fitted = yield from map_steps(flat_card_steps(used), lambda part: start + (1 - start) * part)
    fitted = replace(fitted, warnings=(*fitted.warnings, *part_warnings(whole, framing)))
    if not (keys or spec.views[0].lens):
        keys = width_keys(whole.cameras[0])
    distance = present(fitted.capture.card_distance) / axis_cosine(whole.cameras[0], used.cameras[0])
    card = {**_framing_keys(framing), CARD_DISTANCE: distance}
    report = {**fitted.report(), CARD_DISTANCE: distance}
    return _Estimate(fitted.capture.lights, report, fitted.warnings, keys, card)


def _framing_keys(framing: Framing) -> dict[str, Any]:
    """Return the table's keys for the corners or the crop of the card."""
    if framing.corners:
        return {"corners": [list(corner) for corner in framing.corners]}
    return {"crop": [int(value) for value in framing.crop]} if framing.crop else {}
