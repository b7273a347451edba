"""Finds the lights of a folder of photographs, from balls or from shading, and imports it as a capture."""

from __future__ import annotations

import math
from collections.abc import Generator
from functools import lru_cache
from pathlib import Path

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, FloatVectorProperty, StringProperty

from ...blender.images import decode
from ...calibration.ball_calibration import BallRequest, calibrate_steps
from ...calibration.balls.lights import Request
from ...calibration.photographs import lens_of_files, read_photographs, with_camera
from ...calibration.write import write_calibration
from ...capture.formats.table import TABLE
from ...capture.spec import CaptureSpec
from ...core.errors import InputError
from ...core.files import check_writable
from ..common import failures
from ..common.features import RELATIVE_PATH
from ..common.file_paths import absolute, first_free
from ..common.sliced import SlicedOperator
from ..common.words import n_, rpt
from ..panels.mesh import draw_mesh
from ..session import session
from ..session.scene_capture import spec_of
from ..session.shading_lights import WAYS, ShadingRequest, known_mesh, shading_light_steps
from .capture_import import CARD_SETTINGS, capture_at, import_again
from .video import VideoBrowser, is_video

_KINDS = (
    ("auto", "Automatic", "Mirror balls if any are found, else matte ones. For a mask or a circle choose the kind"),
    ("mirror", "Mirror", "A shiny ball: its highlight gives the light's direction"),
    ("matte", "Matte", "A ball like plaster: its shading gives direction and strength. Needs linear images"),
)
_FOUND_BY = (
    ("AUTO", "Balls", "Mirror or matte balls beside the subject, which are searched in the photographs"),
    ("MASK", "Ball in a Mask", "A ball that an image shows, white on black"),
    ("CIRCLE", "Ball in a Circle", "A ball whose center and radius in pixels are known"),
    ("MESH", "Known Mesh", "No ball: the shading of a mesh of this scene that the photographs show"),
    ("FLAT", "Flat Card", "No ball: the fall-off of lamps that stand near a flat, matt card"),
    ("NONE", "Relief", "No ball: distant lights, by the shading and material of a subject with relief"),
)
_DISTANCES = (
    ("auto", "Automatic", "Positions where the photographs determine them, else directions"),
    ("distant", "Distant", "Directions"),
    ("near", "Near", "Positions"),
)
_CARDS = (
    ("FRAME", "As Framed", "The part that Frame, under Subject, shows; of another folder the whole photographs"),
    ("FIND", "Find Corners", "Find the card's corners: by printed markers, or as the only rectangle in the picture"),
)
_PHOTOGRAPH_SETTINGS = ("picture_scale", "chart_photograph", "chart_corners")  # which new lights do not change


def free_table(folder: Path) -> Path:
    """Return the first path of capture.toml, capture_1.toml, … in a folder that does not exist."""
    return first_free(folder, Path(TABLE).stem, Path(TABLE).suffix)


@lru_cache(maxsize=1)  # a dialog is drawn often
def _cameras(photographs: str, changed: float) -> tuple[str, ...]:
    """Return the camera names of a folder of photographs; () if it cannot be read. changed: key of the cache."""
    try:
        return tuple(view.name for view in read_photographs(Path(photographs)).views)
    except InputError:
        return ()


def _camera_names(operator, context, text: str) -> tuple[str, ...]:
    try:
        path = absolute(operator.photographs, "Photographs")
        return _cameras(str(path), path.stat().st_mtime) if operator.photographs else ()
    except (InputError, OSError):
        return ()


class ChoosePhotographs(VideoBrowser, bpy.types.Operator):
    """Choose the folder of photographs of one subject, each under another lamp, or a video of a lamp that is carried
    around it. Then their lights are found, or taken from a rig"""

    bl_idname = "irpso.choose_photographs"
    bl_label = "Choose Photographs"
    bl_options = {"INTERNAL"}

    directory: StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE"})
    filter_image: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})
    rig: StringProperty(options={"HIDDEN", "SKIP_SAVE"})  # which gives the lights

    def invoke(self, context, event):
        """Open the file browser; for a rig without videos, which have no photograph for each lamp."""
        self.filter_movie = not self.rig
        return super().invoke(context, event)

    def execute(self, context):
        """Open the dialog of Find Lights, or Apply Rig, for the chosen folder; make photographs of a video first."""
        try:
            chosen = absolute(self.filepath or self.directory, "Photographs")
            if self.rig and is_video(chosen):
                raise InputError(f"{chosen}: is a video; a rig needs a photograph for each lamp: choose their folder")
        except InputError as error:
            return failures.report_and_cancel(self, error)
        if self.rig:
            bpy.ops.irpso.apply_rig("INVOKE_DEFAULT", rig=self.rig, photographs=str(capture_at(chosen)))
        elif is_video(chosen):
            bpy.ops.irpso.photographs_of_video(filepath=str(chosen))
        else:
            bpy.ops.irpso.find_lights("INVOKE_DEFAULT", photographs=str(capture_at(chosen)))
        return {"FINISHED"}


class FindLights(SlicedOperator, bpy.types.Operator):
    """Find the light of every photograph from a ball in the picture, or from the subject's shading, and import them"""

    bl_idname = "irpso.find_lights"
    bl_label = "Find Lights"
    bl_options = {"UNDO"}  # without REGISTER: Adjust Last Operation would begin it again at each change
    doing = n_("Finding lights")
    names = {
        "give its place as X,Y,R (--ball)": "choose Lights From: Ball in a Circle",
        "--ball none": "Lights From: Relief", "--ball auto": "Lights From: Balls", "second --ball": "second ball",
        "--ball": "Lights From", "--kind mirror": "Mirror", "--kind matte": "Matte", "--kind": "Surface",
        "--view": "Camera", "--flat without --blend": "Lights From: Flat Card", "--flat": "Lights From: Flat Card",
        "--lights distant": "Lights: Distant", "--lights": "Lights",
        "--radius": "Ball Radius", "--lamp-distance": "Lamp Distance", "--fov": "Field of View",
        "--inside-out": "Inside Out",
    }  # fmt: skip

    photographs: StringProperty(
        name="Photographs", description="Folder of the photographs, or a capture whose lights are replaced",
        subtype="FILE_PATH", options={"SKIP_SAVE", *RELATIVE_PATH.get("options", ())},
    )  # fmt: skip
    found_by: EnumProperty(name="Lights From", description="What shows the lights", items=_FOUND_BY, default="AUTO")
    kind: EnumProperty(name="Surface", description="Surface of the ball", items=_KINDS, default="auto")
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
    camera: StringProperty(name="Camera", description="The camera that saw the balls", search=_camera_names)
    lights: EnumProperty(name="Lights", description="Directions or positions", items=_DISTANCES, default="auto")
    radius: FloatProperty(
        name="Ball Radius", description="Radius of all balls, in the unit of the lights' positions, for example"
        " millimeters. 0: unknown", min=0, soft_max=1000, precision=3,
    )  # fmt: skip
    distance: FloatProperty(
        name="Lamp Distance", description="Distance from the ball to all lamps, in the unit of Ball Radius: the"
        " length of the string by which the lamp is held. With it one ball gives positions, not only"
        " directions. 0: unknown",
        min=0, soft_max=10_000, precision=3,
    )  # fmt: skip
    albedo: FloatVectorProperty(
        name="Albedo", description="Reflectance of a matte ball in red, green and blue, 0 to 1. It makes light"
        " strengths absolute. 0: unknown; strengths are relative to the first photograph's", size=3, min=0, max=1,
        precision=3,
    )  # fmt: skip
    card: EnumProperty(name="Card", description="Where the flat card is", items=_CARDS, default="FRAME")
    card_width: FloatProperty(
        name="Card Width", description="Width of the shown part of the card, in the unit of the lights' positions."
        " 0: that of the capture or of printed markers; without these, positions are in widths of the picture",
        min=0, soft_max=10_000, precision=3,
    )  # fmt: skip
    inside_out: BoolProperty(
        name="Inside Out", description="Use the other of two possible reliefs, if the recovered one looks inside"
        " out. Only a mask with the subject's outline can decide between them",
    )  # fmt: skip
    fov: FloatProperty(
        name="Field of View", description="The camera's full angle over the image's width. 0: that of the"
        " capture's camera, or of the photographs' EXIF",
        subtype="ANGLE", min=0, max=math.radians(170),
    )  # fmt: skip

    @classmethod
    def poll(cls, context) -> bool:
        """Whether no recovery runs, which would compete for the GPU."""
        return session.idle(cls)

    def invoke(self, context, event):
        """Open the dialog."""
        self.photographs = self.photographs or context.scene.irpso.capture_path
        return context.window_manager.invoke_props_dialog(self, width=420)

    def draw(self, context) -> None:
        """Draw the dialog: the entries for the choice of From."""
        column = self.layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(self, "photographs")
        column.prop(self, "found_by")
        for name in self._entries(context):
            column.prop(self, name)
        if self.found_by == "MESH":
            draw_mesh(column, context)
        column.prop(self, "fov")

    def _entries(self, context) -> list[str]:
        """Return the names of the properties for the choice of From."""
        if self.found_by in WAYS:
            return {"MESH": ["lights"], "FLAT": ["card", "card_width"], "NONE": ["inside_out"]}[self.found_by]
        camera = ["camera"] * (len(_camera_names(self, context, "")) > 1)
        outline = {"MASK": ["mask"], "CIRCLE": ["circle"]}.get(self.found_by, [])
        sizes = ["radius", *["distance"] * (self.radius > 0), *["albedo"] * (self.kind == "matte")]
        return [*camera, "kind", *outline, "lights", *sizes]

    def execute(self, context):
        """Find the lights, write a new table beside the photographs and import it. On an error nothing is written."""
        return self.begin(context, self._find_steps(context.scene.irpso))

    def finished(self, context, result):
        """Import the table, restore the settings of the same photographs, and report the first warning."""
        (path, warnings, measured), settings = result, context.scene.irpso
        names: tuple[str, ...] = ()
        if self._is_capture:
            names = _PHOTOGRAPH_SETTINGS if self.found_by == "FLAT" else (*CARD_SETTINGS, *_PHOTOGRAPH_SETTINGS)
        import_again(context.scene, path, names)
        if self.found_by == "MESH":
            settings.subject = "MESH"
        if warnings:
            count = len(warnings) - 1
            more = rpt(" (and {count} more, in the report beside it)", count=count) if count else ""
            self.report({"WARNING"}, failures.message_of(InputError(warnings[0]), self.names) + more)
        picture = rpt("; look at {file}", file=f"{path.stem}_balls.png") if self.found_by not in WAYS else ""
        distance = rpt("; Card Distance is that of the table below the balls") if measured else ""
        self.report({"INFO"}, rpt("Lights written to {name}", name=path.name) + picture + distance)
        return {"FINISHED"}

    def _find_steps(self, settings) -> Generator[float, None, tuple[Path, tuple[str, ...], bool]]:
        """Yield the fraction done (0…1); return the table's path, warnings, and whether balls gave ``card_distance``.

        Raises InputError.
        """
        shading = self._shading() if self.found_by in WAYS else None
        balls = [] if shading else self._balls()
        source, spec = self._photographs(settings, [ball.mask for ball in balls if ball.mask])
        keys = {"fov_degrees": math.degrees(self.fov)} if self.fov > 0 else lens_of_files(spec, decode)
        if keys:
            spec = with_camera(spec, keys, "Field of View")
        table = free_table(source if source.is_dir() else source.parent)
        check_writable(table.parent, "copy the photographs to a folder that can be written")
        if shading:
            return table, (yield from shading_light_steps(spec, keys, shading, table)), False
        r, g, b = self.albedo
        albedo = (r, g, b) if self.kind == "matte" and min(r, g, b) > 0 else None
        request = Request(self.kind, self.lights, (self.distance or None) if self.radius else None, albedo)
        found = yield from calibrate_steps(
            spec, balls, request, decode, self.radius or None, self.camera or None, self.dropped.splitlines()
        )
        write_calibration(found, table, keys)
        return table, found.warnings, found.new_distance is not None

    def _photographs(self, settings, masks: list[Path]) -> tuple[Path, CaptureSpec]:
        """Return the photographs' path and spec; the settings frame those of the scene's capture. Raises InputError."""
        if not self.photographs:
            raise InputError("Photographs: no folder is chosen; choose the folder of the photographs")
        source = absolute(self.photographs, "Photographs")
        if not source.exists():
            raise InputError(f"{source}: does not exist; choose the folder of the photographs")
        if is_video(source):
            raise InputError(f"{source}: is no folder of photographs; choose Photographs of a Video first")
        self._is_capture = settings.capture_path != "" and absolute(settings.capture_path, "Capture") == source
        return source, spec_of(settings) if self._is_capture else read_photographs(source, settings.colour_space, masks)

    def _shading(self) -> ShadingRequest:
        mesh = known_mesh() if self.found_by == "MESH" else None
        return ShadingRequest(self.found_by, self.lights, self.inside_out, self.card == "FIND", self.card_width, mesh)

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


CLASSES = (ChoosePhotographs, FindLights)
