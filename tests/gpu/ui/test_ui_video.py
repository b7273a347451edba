"""A video of a lamp that is carried around, made photographs of by the window's buttons."""

import bpy
import numpy as np
import pytest

from irpso_addon.capture.images.exr import write_exr
from irpso_addon.ui.operators.video import is_video
from tests.builders.video import direction, lit, rec709, scene, write_video

pytest.importorskip("cv2", reason="OpenCV, which writes the videos, is not installed")
pytestmark = [pytest.mark.bpy_only, pytest.mark.usefixtures("registered")]

LIGHTS = [direction(2 * np.pi * k / 12, 0.5 + 0.04 * k) for k in range(12)]


@pytest.fixture(scope="module")
def frames():
    normals, albedo = scene(64, 96)
    return [rec709(lit(normals, albedo, light)) for light in LIGHTS]


@pytest.fixture
def folder(tmp_path, frames):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    write_video(tmp_path / "lamp.mkv", frames, "FFV1")
    return tmp_path


def test_the_frames_of_a_video_become_photographs_beside_it(folder):
    for chosen, name in ((folder / "lamp.mkv", "lamp_photographs"), (folder, "lamp_photographs_1")):
        assert bpy.ops.irpso.photographs_of_video(filepath=str(chosen), count=8) == {"FINISHED"}
        written = sorted(path.suffix for path in (folder / name).iterdir())
        assert written == [".png"] * 8


def test_the_button_of_photographs_takes_a_video_too(folder):
    assert bpy.ops.irpso.choose_photographs(filepath=str(folder / "lamp.mkv")) == {"FINISHED"}
    assert len(list((folder / "lamp_photographs").iterdir())) == 12


def test_a_folder_of_photographs_is_none_of_videos(folder):
    assert is_video(folder) and is_video(folder / "lamp.mkv") and not is_video(folder / "none")
    write_exr(folder / "1.exr", {"": {"Y": np.ones((2, 2), np.float32)}})
    assert not is_video(folder) and is_video(folder / "lamp.mkv")


@pytest.mark.parametrize(("given", "message"), [
    ("", "Video: no file is chosen"), ("empty", "empty: holds no video; choose a video"),
    ("one light.mkv", "shows 1 light, too few for a recovery"),
])  # fmt: skip
def test_what_is_no_video_of_several_lights_is_refused_and_nothing_is_written(folder, frames, given, message):
    (folder / "empty").mkdir()
    write_video(folder / "one light.mkv", frames[:1] * 12, "FFV1")
    before = sorted(folder.rglob("*"))
    with pytest.raises(RuntimeError, match=message):
        bpy.ops.irpso.photographs_of_video(filepath=str(folder / given) if given else "")
    assert sorted(folder.rglob("*")) == before


def test_the_dialog_of_lights_sends_a_video_to_its_own_button(folder):
    with pytest.raises(RuntimeError, match="lamp.mkv: is no folder of photographs; choose Photographs of a Video"):
        bpy.ops.irpso.find_lights(photographs=str(folder / "lamp.mkv"))
