"""Develops the capture's photographs to linear images, and imports the result."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path

import bpy
import numpy as np
from bpy.props import EnumProperty, StringProperty

from ...blender.images import decode
from ...calibration.developing.measure import MeasureOptions, Progress, SearchedCard
from ...calibration.developing.write import develop_steps
from ...calibration.radiometry.source import images_in, read_source
from ...capture.images.image import ImageStore
from ...core.errors import InputError
from ...core.steps import map_steps
from ..common import failures
from ..common.features import RELATIVE_PATH
from ..common.file_paths import absolute, first_free
from ..common.polls import has_files
from ..common.sliced import SlicedOperator
from ..common.words import n_, rpt
from ..session.scene_capture import capture_path
from .capture_import import CARD_SETTINGS, import_again

_COLOURS = (
    ("NONE", "None", "The camera's own colors"),
    ("AUTO", "Find Chart", "The 24-patch chart is found in the photographs, or in the chart's own"),
    ("MARKED", "Marked Chart", "The chart lies at the corners that were clicked"),
    ("GREY", "Find Gray Card", "White balance by a gray card that is found, an even and neutral rectangle"),
)
_FILES = {"subtype": "FILE_PATH", **RELATIVE_PATH}


def free_folder(source: Path, word: str) -> Path:
    """Return the first folder NAME_word, NAME_word_1, … beside a capture's folder that does not exist."""
    home = source if source.is_dir() else source.parent
    return first_free(home.parent, f"{home.name}_{word}")


def reported(operator: bpy.types.Operator, capture: Path, warnings: list[str], written: str) -> set[str]:
    """Report the first warning about a new capture, and ``written``; return the operator's result."""
    if warnings:
        more = rpt(" (and {count} more, in report.json)", count=len(warnings) - 1) if len(warnings) > 1 else ""
        operator.report({"WARNING"}, failures.message_of(InputError(warnings[0])) + more)
    operator.report({"INFO"}, rpt("{what} written to {name}", what=written, name=capture.name))
    return {"FINISHED"}


class IRPSO_OT_develop(SlicedOperator, bpy.types.Operator):
    """Make linear images of the capture's photographs, with their colors by a 24-patch chart, and import them. The
    photographs stay as they are"""

    bl_idname = "irpso.develop"
    bl_label = "Develop"
    bl_options = {"UNDO"}  # without REGISTER, as Find Lights
    doing = n_("Developing")
    names = {
        "--colour-chart auto": "Colors", "--colour-chart": "Colors", "--response": "Response", "--dark": "Dark Frames",
        ", or use --scale-dark": "", "--flat": "Flat Fields", "--white auto": "Colors",
        ", let nothing cover the card, or give its place as X,Y,W,H": ", and let nothing cover the card",
        "give the one that is, as X,Y,W,H": "choose a photograph that shows it alone, as Chart",
        "give its corners as X1,Y1,…,X4,Y4": "use Mark Chart in Photograph",
    }  # fmt: skip

    colours: EnumProperty(name="Colors", description="Colors and brightness by a chart", items=_COLOURS, default="AUTO")
    dark: StringProperty(
        name="Dark Frames", description="A photograph with the lamp off and the same exposure, or a folder of them",
        **_FILES,
    )  # fmt: skip
    flat: StringProperty(
        name="Flat Fields", description="A photograph of an even white surface, or a folder of them", **_FILES
    )
    response: StringProperty(
        name="Response", description="The camera's response curve, a file of irpso response. Empty: sRGB for 8 bits",
        **_FILES,
    )  # fmt: skip

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there are photographs in files."""
        return has_files(cls, context)

    def invoke(self, context, event):
        """Open the dialog."""
        return context.window_manager.invoke_props_dialog(self, width=420)

    def draw(self, context) -> None:
        """Draw the dialog."""
        column, settings = self.layout.column(), context.scene.irpso
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(self, "colours")
        if self.colours != "NONE":
            column.prop(settings, "chart_photograph")
        if self.colours == "MARKED" and not any(settings.chart_corners):
            column.label(text="Mark the chart first", icon="INFO")
        for name in ("dark", "flat", "response"):
            column.prop(self, name)

    def execute(self, context):
        """Develop into a new folder beside the capture's, and import it. On an error nothing is written."""
        return self.begin(context, map_steps(self._develop_steps(context.scene.irpso), lambda step: step.done))

    def _develop_steps(self, settings) -> Generator[Progress, None, tuple[Path, dict]]:
        """Yield the progress; return the new folder and the report. Raises InputError."""
        source = capture_path(settings)
        options = self._options(settings)
        out = free_folder(source, "linear")
        photographs = read_source(source, decode, None, settings.colour_space, options.left_out)
        report = yield from develop_steps(ImageStore(decode), photographs, options, out, {"capture": str(source)})
        return out, report

    def _options(self, settings) -> MeasureOptions:
        """Return the dialog's options. Raises InputError."""
        corners: np.ndarray | str | None = None
        if self.colours == "MARKED":
            if not any(settings.chart_corners):
                raise InputError("Colors: no chart is marked; choose Mark Chart in Photograph first")
            corners = np.reshape(settings.chart_corners, (4, 2)).astype(np.float64)
        elif self.colours == "AUTO":
            corners = "auto"
        chart = settings.chart_photograph if self.colours != "NONE" else ""
        return MeasureOptions(
            response=absolute(self.response, "Response") if self.response else None,
            chart=absolute(chart, "Chart") if chart else None,
            darks=tuple(_files(self.dark, "Dark Frames")),
            flats=tuple(_files(self.flat, "Flat Fields")),
            white=SearchedCard() if self.colours == "GREY" else None,
            colour_chart=corners,
            colour_space=settings.colour_space,
        )

    def finished(self, context, result: tuple[Path, dict]) -> set[str]:
        """Import the images, and report the chart's color error or the gray card's place."""
        out, report = result
        summary = rpt("Linear images")
        if chart := report.get("colour_chart"):
            before, after = (chart["delta_e_2000"][key]["mean"] for key in ("before", "after"))
            summary = rpt(
                "Colors of the chart: ΔE2000 {before:.1f} → {after:.1f} on average; linear images", before=before,
                after=after,
            )  # fmt: skip
        if card := report.get("grey_card"):
            summary = rpt(
                "Gray card found in {file} at {place}; linear images", file=Path(card["file"]).name, place=card["patch"]
            )
        import_again(context.scene, out, ("picture_scale", *CARD_SETTINGS))
        return reported(self, out, report["warnings"], summary)


def _files(text: str, setting: str) -> list[Path]:
    """Return the image that a setting names, or those of the folder. Raises InputError if there are none."""
    if not text:
        return []
    path = absolute(text, setting)
    files = images_in(path) if path.is_dir() else [path] if path.is_file() else []
    if not files:
        raise InputError(f"{setting}: {path} holds no images; choose a photograph, or a folder of them")
    return files


CLASSES = (IRPSO_OT_develop,)
