"""Videos through Blender's movie reader, and the commands that make photographs of them."""

import json
import re
import shlex
import shutil
import tomllib
from dataclasses import replace

import bpy
import numpy as np
import pytest

from irpso_addon.blender.images import decode
from irpso_addon.blender.movie import Movie, cicp_of, opened_movie
from irpso_addon.capture.images.image import ImageRef, ImageStore
from irpso_addon.core.errors import InputError
from tests.builders.captures import write_png
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


def test_a_folder_of_videos_gives_the_frames_of_all_and_the_next_command_is_one_to_paste(video, tmp_path):
    folder, out = tmp_path / "vidéos à moi", tmp_path / "my frames"
    folder.mkdir()
    shutil.copy(video, folder / video.name)
    code, said, err = run_cli("frames", folder, "-o", out, "--count", "8")
    assert code == 0 and len(list(out.iterdir())) == 8, err
    assert shlex.split(said.splitlines()[-1].partition("next: ")[2]) == ["irpso", "calibrate", str(out)]
    (tmp_path / "empty").mkdir()
    code, _, err = run_cli("frames", tmp_path / "empty", "-o", tmp_path / "none")
    assert code == 2 and err == f"irpso: {tmp_path / 'empty'}: holds no video; give a video, or a folder of videos\n"
    for words in ([], ["--count", "8"]):
        code, _, err = run_cli("calibrate", tmp_path / "nothing.mp4", "-o", tmp_path / "none", *words)
        assert code == 2 and "nothing.mp4: is not there; give a folder of photographs, a video, or a capture" in err


@pytest.mark.parametrize("moved", [False, True])
def test_a_video_that_shows_no_lights_is_refused_and_writes_nothing(moved, tmp_path):
    shifts = [(round(6 * np.sin(k)), round(6 * np.cos(2 * k))) for k in range(24)]
    large = [lit(*scene(), light) for light in LIGHTS]
    frames = [np.roll(f, s, (0, 1)) for f, s in zip(large, shifts, strict=True)] if moved else LINEAR[:1] * 12
    write_video(tmp_path / "a.avi", [rec709(frame) for frame in frames])
    code, _, err = run_cli("frames", tmp_path / "a.avi", "-o", tmp_path / "out")
    assert code == 2 and ("a.avi: the camera moves" if moved else "a.avi: shows 1 light") in err
    assert [path.name for path in tmp_path.iterdir()] == ["a.avi"]


def test_videos_of_one_name_keep_all_their_frames(tmp_path):
    frames = [rec709(frame) for frame in LINEAR]
    videos = [tmp_path / name for name in ("1/lamp.mkv", "2/lamp.mkv", "lamp_2.mkv", "LAMP.mkv")]
    for path, part in zip(videos, (frames[::4], frames[1::4], frames[2::4], frames[3::4]), strict=True):
        path.parent.mkdir(exist_ok=True)
        write_video(path, part, "FFV1")
    code, out, err = run_cli("frames", *videos, "-o", tmp_path / "out", "--count", "24", "--json")
    assert (code, err) == (0, "")
    written = [path.name for path in (tmp_path / "out").iterdir()]
    assert len(written) == len(json.loads(out)["frames"]) == 24
    assert {name[:-10].lower() for name in written} == {"lamp", "lamp_2", "lamp_3", "lamp_4"}


def test_a_video_whose_end_is_missing_is_warned_of(tmp_path):
    write_video(tmp_path / "whole.mkv", [rec709(frame) for frame in LINEAR])
    data = (tmp_path / "whole.mkv").read_bytes()
    (tmp_path / "cut.mkv").write_bytes(data[: len(data) * 6 // 10])
    for name, warned in (("whole", False), ("cut", True)):
        code, out, _ = run_cli("frames", tmp_path / f"{name}.mkv", "-o", tmp_path / name, "--count", "6", "--json")
        warnings = " ".join(json.loads(out)["warnings"])
        assert code == 0 and bool(re.search(r"cut\.mkv: \d+ of 24 frames repeat the one before", warnings)) == warned
        assert ("cut off, or its frame rate varies: look at the photographs" in warnings) == warned


def test_a_frame_that_changes_when_it_is_read_again_is_warned_of(video, tmp_path, monkeypatch):
    """As in damaged videos, where a decoder conceals by what it read before."""
    read, real = [], Movie.frame

    def frame(self, index):
        read.append(index)
        picture = real(self, index)
        return replace(picture, values=1 - picture.values) if read.count(index) > 1 and index % 2 else picture

    monkeypatch.setattr(Movie, "frame", frame)
    code, out, _ = run_cli("frames", video, "-o", tmp_path / "out", "--count", "8", "--json")
    reply = json.loads(out)
    odd = sum(number % 2 == 0 for number in reply["frames"])  # numbers are from 1
    assert code == 0 and f"{odd} of the photographs changed when they were read again" in " ".join(reply["warnings"])


def test_another_file_than_a_video_is_refused(tmp_path):
    (tmp_path / "a.mp4").write_bytes(b"no video at all")
    with (
        pytest.raises(InputError, match=r"a\.mp4: is no video that Blender can decode"),
        opened_movie(tmp_path / "a.mp4"),
    ):
        pass


@pytest.mark.parametrize(
    ("suffix", "display", "codes"),
    [("mp4", "Rec.2100-PQ", (9, 16)), ("mkv", "Rec.2100-HLG", (9, 18)), ("mkv", "sRGB", (1, 1))],
)
def test_a_video_in_hdr_is_refused(suffix, display, codes, tmp_path):
    path = tmp_path / f"hdr.{suffix}"
    filmed_by_blender(path, {"mp4": "MPEG4", "mkv": "MKV"}[suffix], display)
    assert cicp_of(path) == codes
    code, _, err = run_cli("frames", path, "-o", tmp_path / "out")
    said = "shows 1 light" if display == "sRGB" else "it is an HDR picture (PQ or HLG), which is not read; film without"
    assert code == 2 and f"hdr.{suffix}: {said}" in err


def filmed_by_blender(path, container, display):
    """Write two frames of a grey sky in H.265 of 10 bits."""
    scene = bpy.data.scenes.new("film")
    if not hasattr(scene.render.image_settings, "media_type"):
        pytest.skip("Blender before 5.0 writes no HDR video")
    scene.display_settings.display_device = display
    scene.view_settings.view_transform = "Standard"
    scene.world = bpy.data.worlds.new("sky")
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    scene.render.engine, scene.cycles.samples = "CYCLES", 1
    scene.render.resolution_x = scene.render.resolution_y = 64
    scene.frame_end, scene.render.filepath = 2, str(path)
    output, codec = scene.render.image_settings, scene.render.ffmpeg
    output.media_type, output.file_format, output.color_depth = "VIDEO", "FFMPEG", "8"
    codec.format, codec.codec = container, "H265"
    output.color_depth = "10"
    bpy.ops.render.render(animation=True, scene=scene.name)


BALL = (70.0, 30.0, 22.0)  # x, y and radius in pixels, from the upper left corner


def with_ball(height=64, width=96):
    """Return normals and albedo of the scene with a matte ball."""
    normals, albedo = scene(height, width)
    y, x = np.mgrid[:height, :width] + 0.5
    right, up = (x - BALL[0]) / BALL[2], -(y - BALL[1]) / BALL[2]
    inside = np.hypot(right, up) < 1
    toward = np.sqrt(np.maximum(1 - right**2 - up**2, 0))
    ball = inside[..., None]
    return np.where(ball, np.stack([right, up, toward], axis=-1), normals), np.where(ball, 0.6, albedo)


def filmed(path, lights, size=(64, 96)):
    normals, albedo = with_ball(*size)
    write_video(path, [rec709(lit(normals, albedo, light)) for light in lights], "FFV1")


def calibrate(source, out, *options):
    place = ",".join(f"{number:g}" for number in BALL)
    return run_cli("calibrate", source, "-o", out, "--ball", place, "--kind", "matte", "--json", *options)


@pytest.mark.parametrize("form", ["a video", "two videos in a folder"])
def test_videos_are_calibrated_without_a_step_between(form, tmp_path):
    (tmp_path / "films").mkdir()
    if form == "a video":
        filmed(tmp_path / "films" / "a.mkv", LIGHTS)
    else:
        filmed(tmp_path / "films" / "a.mkv", LIGHTS[:12])
        filmed(tmp_path / "films" / "b.mkv", LIGHTS[12:])
    source = tmp_path / "films" / ("a.mkv" if form == "a video" else "")
    code, out, err = calibrate(source, tmp_path / "capture", "--count", "8")
    assert (code, err) == (0, "") and json.loads(out)["lights"] == 8
    table = tomllib.loads((tmp_path / "capture" / "capture.toml").read_text())
    for row in table["observation"]:
        assert (tmp_path / "capture" / row["image"]).is_file()
        stem, number = row["name"].removesuffix(".png").split("_")
        truth = LIGHTS[int(number) - 1 + 12 * (stem == "b")]
        assert np.degrees(np.arccos(np.dot(row["light_direction"], truth))) < 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["capture", "capture_photographs", "films"]
    code, _, err = calibrate(source, tmp_path / "capture", "--replace")
    assert code == 2 and "capture_photographs: is there already and not empty; calibrate these frames" in err


def test_frames_of_a_video_whose_lights_are_not_found_are_removed(video, tmp_path):
    code, _, err = run_cli("calibrate", video, "-o", tmp_path / "capture")
    assert code == 2 and "no ball was found" in err
    assert list(tmp_path.iterdir()) == []


def test_a_video_of_another_size_than_the_photographs_is_refused(tmp_path):
    folder = tmp_path / "films"
    folder.mkdir()
    filmed(folder / "a.mkv", LIGHTS)
    write_png(folder / "photograph.png", np.full((64, 100, 3), 90, np.uint8), 8)
    code, _, err = calibrate(folder, tmp_path / "capture")
    assert code == 2 and "photograph.png: is 100×64 pixels where its camera has 96×64" in err
    filmed(folder / "photograph.mkv", LIGHTS, (64, 100))  # a live photograph: the photograph's own video
    (folder / "a.mkv").unlink()
    code, _, err = calibrate(folder, tmp_path / "capture", "--count", "8")
    assert code == 2 and "--count: applies to videos, and" in err


def test_videos_of_several_sizes_are_refused(tmp_path):
    filmed(tmp_path / "a.mkv", LIGHTS)
    filmed(tmp_path / "b.mkv", LIGHTS, (64, 100))
    code, _, err = run_cli("frames", tmp_path / "a.mkv", tmp_path / "b.mkv", "-o", tmp_path / "out")
    assert code == 2 and "b.mkv: is 100×64 pixels" in err and not (tmp_path / "out").exists()
