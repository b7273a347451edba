"""Lights from a ball: calibrates the lights of a folder of photographs and imports it as a capture."""

from __future__ import annotations

import math
from pathlib import Path

import bpy
from bpy.props import EnumProperty, FloatProperty, FloatVectorProperty, StringProperty

from ...blender.images import decode
from ...calibration.balls.lights import Request
from ...calibration.job import BallRequest, calibrate_steps
from ...calibration.photographs import read_photographs, with_camera
from ...calibration.write import write_calibration
from ...capture.formats.table import TABLE
from ...core.errors import InputError
from ...core.steps import run_steps
from ..common.features import RELATIVE_PATH
from ..common.file_paths import absolute

_KINDS = (
    ("auto", "Automatic", "Mirror balls if any are found, else matte ones. For a mask or a circle choose the kind"),
    ("mirror", "Mirror", "A shiny ball: its highlight gives the light's direction"),
    ("matte", "Matte", "A ball like plaster: its shading gives direction and strength. Needs linear images"),
)
_FOUND_BY = (
    ("AUTO", "Automatic", "All balls in the photographs are searched"),
    ("MASK", "Mask", "An image of the photographs' size, white on the ball"),
    ("CIRCLE", "Circle", "Center and radius in pixels"),
)


def free_table(folder: Path) -> Path:
    """Return the first path of capture.toml, capture_1.toml, … in a folder that does not exist."""
    names = (TABLE, *(f"{Path(TABLE).stem}_{number}.toml" for number in range(1, 10_000)))
    return next(folder / name for name in names if not (folder / name).exists())


class LightsFromBall(bpy.types.Operator):
    """Find the light's direction in every photograph from a ball in the picture, and import the photographs"""

    bl_idname = "irpso.lights_from_ball"
    bl_label = "Lights from a Ball"
    bl_options = {"REGISTER"}

    photographs: StringProperty(
        name="Photographs", description="Folder of the photographs, or a capture whose lights are replaced",
        subtype="FILE_PATH", **RELATIVE_PATH,
    )  # fmt: skip
    kind: EnumProperty(name="Ball", description="Surface of the ball", items=_KINDS, default="auto")
    found_by: EnumProperty(
        name="Place", description="How the ball is found in the photographs", items=_FOUND_BY, default="AUTO"
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
    fov: FloatProperty(
        name="Field of View", description="The camera's, over the image's width. 0: that of the capture's camera",
        subtype="ANGLE", min=0, max=math.radians(170),
    )  # fmt: skip

    def invoke(self, context, event):
        """Open the dialog."""
        self.photographs = self.photographs or context.scene.irpso.capture_path
        return context.window_manager.invoke_props_dialog(self, width=420)

    def draw(self, context) -> None:
        """Draw the dialog."""
        column = self.layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(self, "photographs")
        column.prop(self, "kind")
        column.prop(self, "found_by")
        if self.found_by != "AUTO":
            column.prop(self, "mask" if self.found_by == "MASK" else "circle")
        column.prop(self, "fov")

    def execute(self, context):
        """Find the lights, write a new table beside the photographs and import it. On an error nothing is written."""
        manager = context.window_manager
        manager.progress_begin(0, 1)
        try:
            path, warnings = self._calibrated(context, manager)
        except InputError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            manager.progress_end()
        bpy.ops.irpso.import_capture(filepath=str(path))
        if warnings:
            more = f" (and {len(warnings) - 1} more, in the report beside it)" if len(warnings) > 1 else ""
            self.report({"WARNING"}, warnings[0] + more)
        else:
            self.report({"INFO"}, f"Lights written to {path.name}; look at {path.stem}_balls.png")
        return {"FINISHED"}

    def _calibrated(self, context, manager) -> tuple[Path, tuple[str, ...]]:
        """Return the table's path and the warnings. Raises InputError."""
        if not self.photographs:
            raise InputError("Photographs: no folder is chosen; choose the folder of the photographs")
        source = absolute(self.photographs, "Photographs")
        if not source.exists():
            raise InputError(f"{source}: does not exist; choose the folder of the photographs")
        ball = self._ball()
        colour_space = context.scene.irpso.colour_space
        spec = read_photographs(source, colour_space, [ball.mask] if ball.mask else [])
        keys = {"fov_degrees": math.degrees(self.fov)} if self.fov > 0 else {}
        if keys:
            spec = with_camera(spec, keys, "Field of View")
        steps = calibrate_steps(spec, [ball], Request(self.kind), decode)
        calibration = run_steps(steps, manager.progress_update)
        table = free_table(source if source.is_dir() else source.parent)
        write_calibration(calibration, table, keys)
        return table, calibration.warnings

    def _ball(self) -> BallRequest:
        if self.found_by == "AUTO":
            return BallRequest()
        if self.kind == "auto":
            raise InputError("Ball: is Automatic; for a mask or a circle choose Mirror or Matte")
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
