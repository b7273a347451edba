"""Makes photographs of a video of a lamp that is carried around the subject, then opens Find Lights for them."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path

import bpy
from bpy.props import BoolProperty, IntProperty, StringProperty

from ...blender.frames import COUNT, Frames, frame_steps
from ...calibration.photographs import is_photograph, videos_of
from ...calibration.video import MIN_FRAMES
from ...core.errors import InputError
from ...core.steps import map_steps
from ..common import failures
from ..common.file_paths import absolute, first_free
from ..common.sliced import SlicedOperator
from ..common.words import n_, rpt
from ..session import session


class VideoBrowser:
    """Base of a ``bpy.types.Operator`` that begins with a file browser for videos and folders."""

    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_movie: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})
    filter_folder: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})

    @classmethod
    def poll(cls, context) -> bool:
        """Whether no recovery runs."""
        return session.idle(cls)

    def invoke(self, context, event):
        """Open the file browser, which shows the other properties beside the files."""
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}


class PhotographsOfVideo(VideoBrowser, SlicedOperator, bpy.types.Operator):
    """Choose a video of a lamp that is carried around the subject, or a folder of such videos. The frames that differ
    most in light become photographs beside it; their lights are found next"""

    bl_idname = "irpso.photographs_of_video"
    bl_label = "Photographs of a Video"
    bl_options = {"REGISTER"}
    doing = n_("Choosing frames")
    names = {"--count": "Photographs"}
    of_capture = False

    count: IntProperty(
        name="Photographs", description="Most frames that become photographs. Each takes time in the recovery;"
        " roughness needs 20 or more", min=MIN_FRAMES, soft_max=200, default=COUNT,
    )  # fmt: skip

    def execute(self, context):
        """Write the photographs into a new folder. On an error nothing is written."""
        return self.begin(context, map_steps(self._write_steps(), lambda step: step[0]))

    def _write_steps(self) -> Generator[tuple[float, str], None, tuple[Path, Frames]]:
        """Yield (fraction done, step); return the new folder and its frames. Raises InputError."""
        if not self.filepath:
            raise InputError("Video: no file is chosen; choose a video, or a folder of videos")
        source = absolute(self.filepath, "Video")
        videos = videos_of(source)
        if not videos:
            raise InputError(f"{source}: holds no video; choose a video, or a folder of videos")
        folder = source if source.is_dir() else source.parent
        out = first_free(folder, f"{videos[0].stem}_photographs")
        return out, (yield from frame_steps(videos, out, self.count))

    def finished(self, context, result: tuple[Path, Frames]) -> set[str]:
        """Report the photographs, and open the dialog of Find Lights for them."""
        out, frames = result
        for warning in frames.warnings:
            self.report({"WARNING"}, failures.message_of(InputError(warning), self.names))
        count, total = len(frames.files), frames.total
        self.report(
            {"INFO"}, rpt("{count} of {total} frames written to {name}", count=count, total=total, name=out.name)
        )
        if not bpy.app.background:
            bpy.ops.irpso.find_lights("INVOKE_DEFAULT", photographs=str(out))
        return {"FINISHED"}


def is_video(chosen: Path) -> bool:
    """Return whether a chosen file is a video, or a folder holds videos and no photographs."""
    if chosen.is_dir() and any(is_photograph(path) for path in chosen.iterdir()):
        return False
    return bool(videos_of(chosen))


CLASSES = (PhotographsOfVideo,)
