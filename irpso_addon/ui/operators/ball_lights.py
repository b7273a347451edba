"""Finds the lights of a folder of photographs, from balls or from shading, and imports it as a capture."""

from __future__ import annotations

import math
from collections.abc import Generator
from pathlib import Path

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, FloatVectorProperty, StringProperty

from ...blender.images import decode
from ...calibration.balls.lights import Request
from ...calibration.job import BallRequest, calibrate_steps
from ...calibration.photographs import lens_of_files, read_photographs, with_camera
from ...calibration.write import write_calibration, write_lights
from ...capture.formats.table import TABLE
from ...capture.framing import framed
from ...capture.spec import build_capture
from ...core.errors import InputError
from ...core.paths import DEFAULT_MODEL
from ...gpu import context as gpu_context
from ...gpu import probe
from ...pipeline.uncalibrated import uncalibrated_steps
from ...reflectance.model import load_model
from ..common import failures
from ..common.features import RELATIVE_PATH
from ..common.file_paths import absolute, first_free
from ..common.sliced import SlicedOperator
from ..session import session

_KINDS = (
    ("auto", "Automatic", "Mirror balls if any are found, else matte ones. For a mask or a circle choose the kind"),
    ("mirror", "Mirror", "A shiny ball: its highlight gives the light's direction"),
    ("matte", "Matte", "A ball like plaster: its shading gives direction and strength. Needs linear images"),
)
_FOUND_BY = (
    ("AUTO", "Automatic", "All balls in the photographs are searched"),
    ("MASK", "Mask", "An image of the photographs' size, white on the ball"),
    ("CIRCLE", "Circle", "Center and radius in pixels"),
    ("NONE", "No Ball", "Distant lights are found from the subject's own shading and material; it needs relief"),
)


def free_table(folder: Path) -> Path:
    """Return the first path of capture.toml, capture_1.toml, … in a folder that does not exist."""
    return first_free(folder, Path(TABLE).stem, Path(TABLE).suffix)


class LightsFromBall(SlicedOperator, bpy.types.Operator):
    """Find the light of every photograph from a ball in the picture, or from the subject's shading, and import them"""

    bl_idname = "irpso.lights_from_ball"
    bl_label = "Find Lights"
    bl_options = {"REGISTER"}
    doing = "Finding lights"

    photographs: StringProperty(
        name="Photographs", description="Folder of the photographs, or a capture whose lights are replaced",
        subtype="FILE_PATH", **RELATIVE_PATH,
    )  # fmt: skip
    kind: EnumProperty(name="Surface", description="Surface of the ball", items=_KINDS, default="auto")
    found_by: EnumProperty(
        name="Ball", description="How the ball is found in the photographs", items=_FOUND_BY, default="AUTO"
    )
    mask: StringProperty(
        name="Mask", description="Image of the photographs' size, white on the ball, black elsewhere",
        subtype="FILE_PATH", **RELATIVE_PATH,
    )  # fmt: skip
    circle: FloatVectorProperty(
        name="X, Y, Radius",
        description="Center and radius of the ball in pixels, from the upper left corner",
        size=3,
        min=0,
    )
    circles: StringProperty(
        name="Circles", description="Center and radius of several balls, x y radius x y radius …, in place of one",
        options={"HIDDEN", "SKIP_SAVE"},
    )  # fmt: skip
    dropped: StringProperty(
        name="Dropped", description="Photographs, one in a line, whose highlight is not the lamp's",
        options={"HIDDEN", "SKIP_SAVE"},
    )  # fmt: skip
    inside_out: BoolProperty(
        name="Inside Out", description="Take the other of two answers, if the relief looks inside out. Only a mask with"
        " the subject's outline tells them apart",
    )  # fmt: skip
    fov: FloatProperty(
        name="Field of View", description="The camera's, over the image's width. 0: that of the capture's camera, or of"
        " the photographs' EXIF",
        subtype="ANGLE", min=0, max=math.radians(170),
    )  # fmt: skip

    @classmethod
    def poll(cls, context) -> bool:
        """Whether no recovery runs: both would share the GPU."""
        return session.idle(cls)

    def invoke(self, context, event):
        """Open the dialog."""
        self.photographs = self.photographs or context.scene.irpso.capture_path
        return context.window_manager.invoke_props_dialog(self, width=420)

    def draw(self, context) -> None:
        """Draw the dialog."""
        column = self.layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(self, "photographs")
        column.prop(self, "found_by")
        if self.found_by != "NONE":
            column.prop(self, "kind")
        shown = {"MASK": "mask", "CIRCLE": "circle", "NONE": "inside_out"}.get(self.found_by)
        if shown:
            column.prop(self, shown)
        column.prop(self, "fov")

    def execute(self, context):
        """Find the lights, write a new table beside the photographs and import it. On an error nothing is written."""
        return self.begin(context, self._found())

    def finished(self, context, result):
        """Import the table, and report the first warning."""
        path, warnings = result
        bpy.ops.irpso.import_capture(filepath=str(path))
        if warnings:
            more = f" (and {len(warnings) - 1} more, in the report beside it)" if len(warnings) > 1 else ""
            self.report({"WARNING"}, failures.words(InputError(warnings[0])) + more)
        elif self.found_by == "NONE":
            self.report({"INFO"}, f"Lights written to {path.name}")
        else:
            self.report({"INFO"}, f"Lights written to {path.name}; look at {path.stem}_balls.png")
        return {"FINISHED"}

    def _found(self) -> Generator[float, None, tuple[Path, tuple[str, ...]]]:
        """Yield the fraction done; return the table's path and the warnings. Raises InputError."""
        if not self.photographs:
            raise InputError("Photographs: no folder is chosen; choose the folder of the photographs")
        source = absolute(self.photographs, "Photographs")
        if not source.exists():
            raise InputError(f"{source}: does not exist; choose the folder of the photographs")
        balls = [] if self.found_by == "NONE" else self._balls()
        colour_space = bpy.context.scene.irpso.colour_space
        spec = read_photographs(source, colour_space, [ball.mask for ball in balls if ball.mask])
        keys = {"fov_degrees": math.degrees(self.fov)} if self.fov > 0 else lens_of_files(spec, decode)
        if keys:
            spec = with_camera(spec, keys, "Field of View")
        table = free_table(source if source.is_dir() else source.parent)
        if balls:
            dropped = self.dropped.splitlines()
            calibration = yield from calibrate_steps(spec, balls, Request(self.kind), decode, dropped=dropped)
            write_calibration(calibration, table, keys)
            return table, calibration.warnings
        probe.probe()
        gpu_context.ensure()
        capture = framed(build_capture(spec, decode), spec.framing)
        found = yield from uncalibrated_steps(capture, load_model(DEFAULT_MODEL), inside_out=self.inside_out)
        write_lights(spec, keys, found.lights, found.report(), table)
        return table, found.warnings

    def _balls(self) -> list[BallRequest]:
        if self.circles:
            numbers = np.reshape([float(number) for number in self.circles.split()], (-1, 3))
            return [BallRequest(None, tuple(circle)) for circle in numbers.tolist()]
        return [self._ball()]

    def _ball(self) -> BallRequest:
        if self.found_by == "AUTO":
            return BallRequest()
        if self.kind == "auto":
            raise InputError("Surface: is Automatic; for a mask or a circle choose Mirror or Matte")
        if self.found_by == "CIRCLE":
            if not self.circle[2] > 0:
                raise InputError("Radius: is 0; set the ball's radius in pixels")
            return BallRequest(None, tuple(self.circle))
        mask = absolute(self.mask, "Mask") if self.mask else None
        if mask is None or not mask.is_file():
            fault = "no file is chosen" if mask is None else f"{mask} does not exist"
            raise InputError(f"Mask: {fault}; paint the ball white on black, in an image of the photographs' size")
        return BallRequest(mask)


CLASSES = (LightsFromBall,)
