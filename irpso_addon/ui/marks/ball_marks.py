"""Operator that corrects the balls of a calibration in a photograph, and finds the lights again."""

from __future__ import annotations

import json
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy.props import FloatVectorProperty, StringProperty

from ...capture.formats.table import TABLE
from ...core.errors import InputError
from ..common import failures
from ..common.file_paths import absolute
from ..common.polls import usable
from ..common.words import n_
from ..overlay.paint import HALO, Painter
from .marking import Marking

_COLOUR, _DROPPED_COLOUR = (1.0, 0.75, 0.2, 1.0), (1.0, 0.3, 0.25, 1.0)
_MAX_SHOWN = 24  # photographs whose brightest values are shown: each has a highlight
_CROSS = 5.0  # half the size of a dropped highlight's cross, in pixels at scale 1
_MIN_RADIUS = 5.0  # in pixels of the photographs
_MAX_BALLS = 10  # most balls


class IRPSO_OT_mark_balls(Marking, bpy.types.Operator):
    """Correct the balls that show the lights, in an Image editor: drag a circle's middle or its rim, click a highlight
    that is not the lamp's to drop it. Enter finds the lights again, Esc cancels"""

    bl_idname = "irpso.mark_balls"
    bl_label = "Correct Balls"
    bl_options = {"INTERNAL"}
    help_text = n_(
        "Drag a ball's middle or rim; click a highlight to drop it. Enter finds the lights again, Esc cancels"
    )

    moves: FloatVectorProperty(
        name="Moves", description="For each ball, in pixels: to the right, down, and of the radius", size=3 * _MAX_BALLS
    )
    dropped: StringProperty(name="Dropped", description="Photographs, one in a line, whose highlight is dropped")

    @classmethod
    def poll(cls, context):
        """Whether there are photographs in files."""
        settings = context.scene.irpso
        there = settings.source == "FILES" and settings.capture_path
        return usable(cls, there, "No capture: find its lights first")

    def execute(self, context):
        """Find the lights again with the balls moved by ``moves``, without the highlights of ``dropped``."""
        try:
            self._read(context)
        except InputError as error:
            return failures.report_and_cancel(self, error)
        self._circles += np.reshape(self.moves, (_MAX_BALLS, 3))[: len(self._circles)]
        self._dropped = set(self.dropped.splitlines())
        return self._find_lights()

    def invoke(self, context, event):
        """Show the photographs with the balls and wait for the mouse."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        try:
            self._read(context)
        except InputError as error:
            return failures.report_and_cancel(self, error)
        return self.begin(context, _MAX_SHOWN)

    def _read(self, context) -> None:
        """Read the report's circles (N, 3) and highlights, in pixels from the upper left. Raises InputError."""
        self._path = absolute(context.scene.irpso.capture_path, "Capture")
        report = report_beside(self._path)
        self._kind, self._input = report["kind"], report["asked"]
        self._circles = np.array([ball["circle"] for ball in report["balls"]][:_MAX_BALLS], float)
        self._highlights = [
            (light["name"], np.array(spot)) for light in report["lights"] for spot in light["highlights"] if spot
        ]
        self._dropped: set[str] = set()

    def _find_lights(self) -> set[str]:
        numbers = " ".join(f"{number:.3f}" for number in self._circles.ravel())
        return bpy.ops.irpso.find_lights(
            photographs=str(self._path), kind=self._kind, found_by="CIRCLE", circles=numbers,
            dropped="\n".join(sorted(self._dropped)), lights=self._input["lights"], radius=self._input["radius"] or 0,
            distance=self._input["distance"] or 0, albedo=self._input["albedo"] or (0, 0, 0),
        )  # fmt: skip

    def confirmed(self, context) -> bool:
        """Find the lights again."""
        self._find_lights()
        return True

    def handles(self) -> dict[Hashable, np.ndarray]:
        """Return the places of the circles' middles, the right ends of their rims, and the highlights."""
        places: dict[Hashable, np.ndarray] = {}
        for number, (x, y, radius) in enumerate(self._circles):
            places["middle", number] = self._place_of(x, y)
            places["rim", number] = self._place_of(x + radius, y)
        for number, (_, spot) in enumerate(self._highlights):
            places["spot", number] = self._place_of(*spot)
        return places

    def clicked(self, handle: Hashable | None, place: np.ndarray) -> Hashable | None:
        """Grab a middle or a rim; drop a highlight, or restore a dropped one."""
        if isinstance(handle, tuple) and handle[0] == "spot":
            self._dropped ^= {self._highlights[handle[1]][0]}
            return None
        return handle

    def moved(self, handle: Hashable, place: np.ndarray) -> None:
        """Move a circle's middle, or change its radius."""
        kind, number = handle if isinstance(handle, tuple) else ("", 0)
        x, y = place * self._size * (1, -1) + (0, self._size[1])
        if kind == "middle":
            self._circles[number, :2] = x, y
        else:
            distance = float(np.hypot(*(self._circles[number, :2] - (x, y))))
            self._circles[number, 2] = max(distance, _MIN_RADIUS)

    def drawn(self, painter: Painter) -> None:
        """Draw the circles with their handles, and the highlights; dropped ones are crossed out."""
        angles = np.linspace(0, 2 * np.pi, 97)
        for x, y, radius in self._circles:
            rim = zip(x + radius * np.cos(angles), y + radius * np.sin(angles), strict=True)
            curve = np.array([self.pixel(self._place_of(*point)) for point in rim])
            ends = np.array([self.pixel(self._place_of(x, y)), self.pixel(self._place_of(x + radius, y))])
            for colour, extra in ((HALO, 2.5), (_COLOUR, 0.0)):
                painter.curve(curve, colour, 1.5 + extra)
                painter.rings(ends, colour, 6.0, 1.5 + extra)
        for name, spot in self._highlights:
            place = self.pixel(self._place_of(*spot))
            painter.rings(place[None], _DROPPED_COLOUR if name in self._dropped else _COLOUR, 3.0)
            if name in self._dropped:
                arm = _CROSS * painter.scale
                painter.line(place - arm, place + arm, _DROPPED_COLOUR)
                painter.line(place - (arm, -arm), place + (arm, -arm), _DROPPED_COLOUR)

    def _place_of(self, x: float, y: float) -> np.ndarray:
        """Return the place of a pixel, which counts from the upper left corner."""
        return np.array([x, self._size[1] - y]) / self._size


def report_beside(table: Path) -> dict[str, Any]:
    """Return the report of the calibration that wrote a table. Raises InputError if it is missing or names no ball."""
    paths = [table.with_name(f"{table.stem}_report.json")]
    if table.name == TABLE:
        paths.append(table.with_name("report.json"))
    path = next((path for path in paths if path.is_file()), None)
    if path is None:
        raise InputError(f"{table.name}: has no report of a calibration beside it; use Find Lights first")
    report = json.loads(path.read_text(encoding="utf-8"))
    if not report.get("asked"):
        raise InputError(f"{path.name}: names no circles of balls; use Find Lights again")
    return report


CLASSES = (IRPSO_OT_mark_balls,)
