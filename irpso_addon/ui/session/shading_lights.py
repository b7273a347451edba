"""Lights of photographs without a ball: from the shading of relief, of a known mesh or of a flat card."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import bpy

from ...blender.images import decode
from ...calibration.write import write_lights
from ...capture.formats.table import CARD_DISTANCE
from ...capture.framing import AUTO, Framing, found_corner_steps, framed
from ...capture.spec import CaptureSpec, build_steps
from ...capture.types import Capture, Light
from ...core.errors import InputError
from ...core.paths import DEFAULT_MODEL
from ...core.steps import map_steps
from ...geometry.surface.mesh import MeshData
from ...gpu import context as gpu_context
from ...gpu import probe
from ...pipeline.flat_card import flat_card_steps, width_keys
from ...pipeline.known_shape import known_shape_steps
from ...pipeline.uncalibrated import uncalibrated_steps
from ...reflectance.model import load_model
from .job import mesh_of, subject_object

WAYS = ("NONE", "MESH", "FLAT")
_SEARCHED = 0.2  # fraction of the work, at the end of a search for corners


@dataclass(frozen=True)
class ShadingRequest:
    """way: one of WAYS; NONE: from relief. lights: "auto", "distant" or "near", over a mesh. inside_out: of relief.

    corners: whether those of a flat card are searched. card_width: of a flat card, 0 if unknown. mesh: of MESH.
    """

    way: str
    lights: str = "auto"
    inside_out: bool = False
    corners: bool = False
    card_width: float = 0.0
    mesh: MeshData | None = None


@dataclass(frozen=True)
class _Answer:
    """lights: of each photograph. report, warnings: theirs. keys: of the cameras. card: keys of the table."""

    lights: list[Light]
    report: dict[str, Any]
    warnings: tuple[str, ...]
    keys: Mapping[str, Any]
    card: Mapping[str, Any] = field(default_factory=dict)


def known_mesh() -> MeshData:
    """Return the mesh that the photographs show, by the scene's settings. Raises InputError."""
    obj = subject_object(bpy.context)
    if obj is None:
        raise InputError("Object: is no mesh; choose the mesh that the photographs show")
    return mesh_of(bpy.context.scene.irpso, obj)


def shading_light_steps(
    spec: CaptureSpec, keys: Mapping[str, Any], request: ShadingRequest, table: Path
) -> Generator[float, None, tuple[str, ...]]:
    """Yield the fraction done; write the lights of photographs as a new table and return the warnings.

    keys: of the cameras. Raises InputError and then writes nothing.
    """
    probe.probe()
    gpu_context.ensure()
    whole = yield from map_steps(build_steps(spec, decode), lambda _: 0.0)
    if request.way == "FLAT":
        answer = yield from _of_card(whole, spec, keys, request)
    else:
        answer = yield from _of_relief(framed(whole, spec.framing), keys, request)
    write_lights(spec, answer.keys, answer.lights, answer.report, table, answer.card)
    return answer.warnings


def _of_relief(capture: Capture, keys: Mapping[str, Any], request: ShadingRequest) -> Generator[float, None, _Answer]:
    if request.mesh is not None:
        shape = yield from known_shape_steps(capture, request.mesh, request.lights)
        return _Answer(shape.lights, shape.report(), shape.warnings, keys)
    found = yield from uncalibrated_steps(capture, load_model(DEFAULT_MODEL), inside_out=request.inside_out)
    return _Answer(found.lights, found.report(), found.warnings, keys)


def _of_card(
    whole: Capture, spec: CaptureSpec, keys: Mapping[str, Any], request: ShadingRequest
) -> Generator[float, None, _Answer]:
    framing, begun = spec.framing, 0.0
    if request.card_width:
        whole, framing = replace(whole, card_distance=None), replace(framing, card_width=request.card_width)
    if request.corners or framing.corners == AUTO:
        looking = found_corner_steps(whole, replace(framing, crop=None))
        framing, _ = yield from map_steps(looking, lambda part: _SEARCHED * part)
        begun = _SEARCHED
    fitting = flat_card_steps(framed(whole, framing))
    found = yield from map_steps(fitting, lambda part: begun + (1 - begun) * part)
    if not (keys or spec.views[0].lens):
        keys = width_keys(whole.cameras[0])
    card = {**_part(framing), CARD_DISTANCE: found.capture.card_distance}
    return _Answer(found.lights, found.report(), found.warnings, keys, card)


def _part(framing: Framing) -> dict[str, Any]:
    """Return the keys of the part of the photographs that is the card."""
    if framing.corners:
        return {"corners": [list(corner) for corner in framing.corners]}
    return {"crop": [int(value) for value in framing.crop]} if framing.crop else {}
