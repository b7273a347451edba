"""Operators that mark a card or a color chart in photographs: a click on each corner, in an Image editor."""

from __future__ import annotations

from collections.abc import Generator, Hashable, Iterator

import bpy
import numpy as np
from bpy.props import FloatVectorProperty

from ...blender.images import decode
from ...capture.frame.find import DetectedCorners, corner_steps
from ...capture.images.image import ImageRef, ImageStore
from ...capture.spec import build_capture
from ...core.steps import map_steps
from ..common.file_paths import absolute
from ..common.polls import has_files
from ..common.sliced import SlicedOperator
from ..common.words import n_, rpt
from ..overlay.paint import HALO, Painter
from ..session.scene_capture import crop_around, keep_corners, spec_steps
from .marking import Marking

_COLOUR = (1.0, 0.75, 0.2, 1.0)


class _CornerMarking(Marking):
    """Mixin of operators that take four corners clicked in a photograph."""

    bl_options = {"INTERNAL", "UNDO"}

    corners: FloatVectorProperty(
        name="Corners", description="X and Y of four corners, in pixels from the upper left corner of the photographs",
        size=8, min=0,
    )  # fmt: skip

    @classmethod
    def poll(cls, context):
        """Whether there are photographs in files."""
        return has_files(cls, context)

    def execute(self, context):
        """Store ``corners``, which may have any order."""
        self._store(context.scene.irpso, np.reshape(self.corners, (4, 2)))
        return {"FINISHED"}

    def invoke(self, context, event):
        """Show a photograph and wait for clicks."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        self._points: list[np.ndarray] = []
        return self.begin(context)

    def confirmed(self, context) -> bool:
        """Store the corners, if there are four."""
        if len(self._points) < 4:
            self.report({"INFO"}, rpt("{count} of 4 corners are marked; click the others", count=len(self._points)))
            return False
        height = self._size[1]
        marked = np.array(self._points) * self._size
        corners = around(np.stack([marked[:, 0], height - marked[:, 1]], axis=-1) * (1, -1)) * (1, -1)
        self._store(context.scene.irpso, corners)
        text = "  ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
        self.report({"INFO"}, rpt("Corners: {corners}", corners=text))
        return True

    def _store(self, settings, corners: np.ndarray) -> None:
        """Store corners (4, 2), in pixels from the upper left."""
        raise NotImplementedError

    def handles(self) -> dict[Hashable, np.ndarray]:
        """Return the places of the corners."""
        return dict(enumerate(self._points))

    def clicked(self, handle: Hashable | None, place: np.ndarray) -> Hashable | None:
        """Grab a corner, or add a new one."""
        if handle is None and len(self._points) < 4:
            self._points.append(place)
            return len(self._points) - 1
        return handle

    def moved(self, handle: Hashable, place: np.ndarray) -> None:
        """Move a corner."""
        self._points[int(str(handle))] = place

    def removed(self) -> None:
        """Remove the last corner."""
        self._points = self._points[:-1]

    def drawn(self, painter: Painter) -> None:
        """Draw the corners and the outline over the picture."""
        if not self._points:
            return
        points = np.array([self.pixel(point) for point in self._points])
        outline = around(points) if len(points) == 4 else points
        closed = np.concatenate([outline, outline[:1]]) if len(points) > 2 else outline
        if len(closed) > 1:
            painter.curve(closed, HALO, 4.0)
            painter.curve(closed, _COLOUR, 1.5)
        painter.rings(points, HALO, 7.0, 4.0)
        painter.rings(points, _COLOUR, 7.0, 1.5)


def take_corners(settings, corners: np.ndarray) -> None:
    """Store the corners (4, 2) of a card, in any order, in pixels from the upper left, and the crop around them."""
    ordered = around(corners * (1, -1)) * (1, -1)
    settings.corners = ordered.ravel().tolist()
    settings.crop = crop_around(corners)
    if settings.framing == "FILE":
        settings.framing = "CORNERS"


def around(points: np.ndarray) -> np.ndarray:
    """Return points (4, 2), y up, ordered clockwise around their mean, the upper left one first."""
    offsets = points - points.mean(axis=0)
    ordered = points[np.argsort(-np.arctan2(offsets[:, 1], offsets[:, 0]))]
    return np.roll(ordered, -int((ordered[:, 1] - ordered[:, 0]).argmax()), axis=0)


class IRPSO_OT_mark_card(_CornerMarking, bpy.types.Operator):
    """Click the four corners of the card in a photograph, in an Image editor. Backspace removes the last one, a corner
    can be dragged, Enter ends, Esc cancels"""

    bl_idname = "irpso.mark_card"
    bl_label = "Mark in Photograph"
    help_text = n_(
        "Click the four corners of the card; drag one to move it. Backspace removes the last. Enter ends, Esc cancels"
    )

    def _store(self, settings, corners: np.ndarray) -> None:
        take_corners(settings, corners)


class IRPSO_OT_mark_chart(_CornerMarking, bpy.types.Operator):
    """Click the four corners of the 24 patches of a color chart in its photograph, in an Image editor, in any order
    around it. Backspace removes the last one, a corner can be dragged, Enter ends, Esc cancels"""

    bl_idname = "irpso.mark_chart"
    bl_label = "Mark Chart in Photograph"
    help_text = n_(
        "Click the four corners of the chart's patches; drag one to move it. Backspace removes the last. Enter ends,"
        " Esc cancels"
    )

    def radiances(self, settings, most: int) -> Iterator[np.ndarray]:
        """Yield the chart's own photograph if it has one, else those of the capture."""
        if not settings.chart_photograph:
            yield from super().radiances(settings, most)
            return
        image = ImageRef(absolute(settings.chart_photograph, "Chart"), colour_space=settings.colour_space)
        yield ImageStore(decode).samples(image).rgba[..., :3]

    def _store(self, settings, corners: np.ndarray) -> None:
        settings.chart_corners = (around(corners * (1, -1)) * (1, -1)).ravel().tolist()


class IRPSO_OT_find_corners(SlicedOperator, bpy.types.Operator):
    """Find the card in its photographs: by a printed marker board around it, or as the one rectangle that shows"""

    bl_idname = "irpso.find_corners"
    bl_label = "Find Corners"
    bl_options = {"INTERNAL", "UNDO"}
    doing = n_("Finding corners")

    @classmethod
    def poll(cls, context):
        """Whether there are photographs in files."""
        return has_files(cls, context)

    def execute(self, context):
        """Read some photographs and store the corners."""
        return self.begin(context, self._search_steps(context.scene.irpso))

    def _search_steps(self, settings) -> Generator[float, None, DetectedCorners]:
        """Yield the fraction done (0…1); return the corners. Raises InputError."""
        spec = yield from map_steps(spec_steps(settings), lambda _: 0.0)
        return (yield from corner_steps(build_capture(spec, decode)))

    def finished(self, context, detected: DetectedCorners) -> set[str]:
        """Store the corners, and the width of a printed marker board's field."""
        keep_corners(context.scene.irpso, detected)
        self.report({"INFO"}, rpt("Corners: {corners}", corners=detected))
        return {"FINISHED"}

    def unused(self, detected: DetectedCorners) -> str:
        """Return the message if the capture has changed meanwhile."""
        return rpt("The corners are not used: another capture was chosen meanwhile")


CLASSES = (IRPSO_OT_mark_card, IRPSO_OT_mark_chart, IRPSO_OT_find_corners)
