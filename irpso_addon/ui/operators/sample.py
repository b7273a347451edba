"""Opens the sample capture: renders it in a child process, finds its lights and imports it."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Generator, Sequence
from dataclasses import replace
from pathlib import Path

import bpy
from bpy.props import StringProperty

from ...blender.images import decode
from ...calibration.ball_calibration import BallRequest, calibrate_steps, written_table
from ...calibration.balls.lights import Request
from ...calibration.photographs import lens_of_files, read_photographs, with_camera
from ...calibration.write import write_calibration
from ...capture.images.image import ImageStore
from ...core.errors import InputError
from ...core.steps import map_steps
from ...gpu.child import child_command
from ...sample import layout
from ...sample.render_sample import FOLDER, PHOTOGRAPHS
from ...sample.truth import PAGE
from ..common.features import RELATIVE_PATH
from ..common.file_paths import absolute
from ..common.sliced import SlicedOperator
from ..common.words import iface, n_, rpt
from ..session import session
from .capture_import import begin_check
from .find_lights import free_table

_NAME = "tile"  # of the capture, and so of the card and its material
_RENDER_PART = 0.95  # fraction of the progress
_CHILD = (
    "import json; from irpso_addon.cli import main; from irpso_addon.gpu.context import exit_process;"
    " exit_process(main(json.loads(sys.argv[-1])))"
)
_POLL_SECONDS = 0.05
_FAULT = re.compile(r"irpso: |\w+Error: ")  # a line with an error of the command line or of Python
_PERCENT = re.compile(r"(\d+) %")


class OpenSample(SlicedOperator, bpy.types.Operator):
    """Open a capture to practise on: photographs of a tile beside a mirror ball, rendered once by Cycles"""

    bl_idname = "irpso.open_sample"
    bl_label = "Open Sample"
    bl_options = {"UNDO"}  # without REGISTER, as Find Lights
    doing = n_("Opening the sample")

    folder: StringProperty(
        name="Folder", description="Folder of the sample. The sample is rendered into it, unless the folder holds"
        " it already",
        subtype="DIR_PATH", **RELATIVE_PATH,
    )  # fmt: skip

    @classmethod
    def poll(cls, context) -> bool:
        """Whether no recovery runs, which would compete for the processor."""
        return session.idle(cls)

    def invoke(self, context, event):
        """Open the dialog."""
        self.folder = self.folder or str(Path.home() / "irpso-sample")
        return context.window_manager.invoke_props_dialog(self, width=420)

    def draw(self, context) -> None:
        """Draw the dialog."""
        column = self.layout.column()
        text = iface("Cycles renders {count} photographs, in a minute or two", count=PHOTOGRAPHS)
        column.label(text=text, icon="INFO", translate=False)
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(self, "folder")

    def execute(self, context):
        """Render the sample unless it is there, find the lights by its ball, and import the photographs."""
        return self.begin(context, self._open_steps())

    def finished(self, context, result):
        """Import the table, with the tile as the card."""
        path, size = result
        if bpy.ops.irpso.import_capture(filepath=str(path)) != {"FINISHED"}:
            return {"CANCELLED"}
        settings, made = context.scene.irpso, layout.make_layout(size, 1, 0)
        settings.framing, settings.crop = "CROP", layout.tile_crop(made.camera)
        settings.card_distance = made.card_distance
        begin_check(context.scene)  # again: the check of the import did not know the distance
        self.report({"INFO"}, rpt("The sample is open; {file} says what is in it", file=path.parents[1] / PAGE))
        return {"FINISHED"}

    def _open_steps(self) -> Generator[float, None, tuple[Path, tuple[int, int]]]:
        """Yield the fraction done (0…1); return the table's path and the photographs' size. Raises InputError."""
        if not self.folder:
            raise InputError("Folder: no folder is chosen; choose one for the sample")
        folder = absolute(self.folder, "Folder")
        photographs = folder / FOLDER
        if not (folder / PAGE).is_file() or not photographs.is_dir():
            yield from map_steps(_rendering(folder), lambda part: _RENDER_PART * part)
        spec = replace(read_photographs(photographs), name=_NAME)
        keys = lens_of_files(spec, decode)
        request = Request("mirror", distance=layout.LAMP_DISTANCE)
        spec = with_camera(spec, keys, "EXIF") if keys else spec  # without EXIF, an earlier table has the lens
        steps = calibrate_steps(spec, [BallRequest()], request, decode, layout.BALL_RADIUS)
        calibration = yield from map_steps(steps, lambda part: _RENDER_PART + (1 - _RENDER_PART) * part)
        text = written_table(calibration, photographs, keys).encode()
        same = (path for path in sorted(photographs.glob("*.toml")) if path.read_bytes() == text)
        if (table := next(same, None)) is None:  # not opened before, or the table was edited since
            table = free_table(photographs)
            write_calibration(calibration, table, keys)
        return table, ImageStore(decode).size(spec.observations[0].image)


def _rendering(folder: Path, options: Sequence[str] = ()) -> Generator[float, None, None]:
    """Yield the fraction rendered by a child process. If closed early, kill it and delete its files. Raises InputError.

    options: of the command ``sample``.
    """
    command = child_command(_CHILD, [json.dumps(["sample", "-o", str(folder), *options])])
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as temporary:
        log = Path(temporary) / "log.txt"
        with open(log, "wb") as file:
            child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=file)
        try:
            while child.poll() is None:
                time.sleep(_POLL_SECONDS)
                yield int((_PERCENT.findall(log.read_text("utf-8", "replace")) or ["0"])[-1]) / 100
        finally:
            if child.poll() is None:
                child.kill()
                child.wait()
                shutil.rmtree(folder.with_name(f".{folder.name}.partial-{child.pid}"), ignore_errors=True)
        if child.returncode:
            lines = log.read_text("utf-8", "replace").strip().splitlines()
            faults = [line.removeprefix("irpso: ") for line in lines if _FAULT.match(line)]
            raise InputError((faults or lines or [f"the process ended with code {child.returncode}"])[-1])


CLASSES = (OpenSample,)
