"""Videos through Blender's movie reader, and the command that makes photographs of one."""

import json

import bpy
import numpy as np
import pytest

from irpso_addon.blender.images import decode
from irpso_addon.blender.movie import cicp_of, opened_movie
from irpso_addon.capture.images.image import ImageRef, ImageStore
from irpso_addon.core.errors import InputError
from tests.builders.command_line import run_cli
from tests.builders.video import direction, lit, rec709, scene, write_video

pytestmark = pytest.mark.bpy_only
pytest.importorskip("cv2", reason="OpenCV, which writes the videos, is not installed")

NORMALS, ALBEDO = scene(64, 96)
LIGHTS = [direction(2 * np.pi * k / 24, 0.5 + 0.02 * k) for k in range(24)]
LINEAR = [lit(NORMALS, ALBEDO, light) for light in LIGHTS]


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    path = tmp_path_factory.mktemp("video") / "lamp.mkv"
    write_video(path, [rec709(frame) for frame in LINEAR], "FFV1")
    return path


def test_every_frame_is_read_in_any_order_and_nothing_is_left_behind(video):
    before = [len(bpy.data.images), len(bpy.data.textures), len(bpy.data.scenes), bpy.context.scene.frame_current]
    with opened_movie(video) as movie:
        assert (movie.size, movie.frames, movie.cicp) == ((96, 64), 24, (1, 1))
        for index in (0, 5, 23, 4, 4, 12):
            picture = movie.frame(index)
            # Of 4:2:0 chroma; the frame before and the one after are off by 0.03 and more.
            assert np.abs(picture.values[::-1] - rec709(LINEAR[index])).mean() < 0.01 and picture.bits == 8
    after = [len(bpy.data.images), len(bpy.data.textures), len(bpy.data.scenes), bpy.context.scene.frame_current]
    assert after == before


def test_the_command_writes_photographs_that_are_read_as_the_scenes_light(video, tmp_path):
    code, out, err = run_cli("frames", video, "-o", tmp_path / "out", "--count", "8", "--json")
    assert (code, err) == (0, "")
    chosen = json.loads(out)["frames"]
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == [f"frame_{number:05d}.png" for number in chosen] and len(names) == 8
    for number, name in zip(chosen, names, strict=True):
        found = ImageStore(decode).samples(ImageRef(tmp_path / "out" / name)).rgba[::-1, :, :3]
        assert np.abs(found - LINEAR[number - 1]).mean() < 0.01  # by sRGB's curve it would be 0.03


@pytest.mark.parametrize("moved", [False, True])
def test_a_video_that_shows_no_lights_is_refused_and_writes_nothing(moved, tmp_path):
    shifts = [(round(6 * np.sin(k)), round(6 * np.cos(2 * k))) for k in range(24)]
    large = [lit(*scene(), light) for light in LIGHTS]
    frames = [np.roll(f, s, (0, 1)) for f, s in zip(large, shifts, strict=True)] if moved else LINEAR[:1] * 12
    write_video(tmp_path / "a.avi", [rec709(frame) for frame in frames])
    code, _, err = run_cli("frames", tmp_path / "a.avi", "-o", tmp_path / "out")
    assert code == 2 and ("a.avi: the camera moves" if moved else "a.avi: shows 1 light") in err
    assert [path.name for path in tmp_path.iterdir()] == ["a.avi"]


def test_another_file_than_a_video_is_refused(tmp_path):
    (tmp_path / "a.mp4").write_bytes(b"no video at all")
    with (
        pytest.raises(InputError, match=r"a\.mp4: is no video that Blender can decode"),
        opened_movie(tmp_path / "a.mp4"),
    ):
        pass


def test_a_video_in_hdr_is_refused(video, tmp_path):
    # The box of an MP4's colours: Rec. 2020, HLG. Appended here, because no encoder is at hand.
    path = tmp_path / "hdr.mkv"
    path.write_bytes(video.read_bytes() + b"\0\0\0\x13colrnclx\0\x09\0\x12\0\x09\x80")
    assert cicp_of(path) == (9, 18) and cicp_of(video) == (1, 1)
    code, _, err = run_cli("frames", path, "-o", tmp_path / "out")
    assert code == 2 and "hdr.mkv: it is an HDR picture (PQ or HLG), which is not read; film without HDR" in err
