"""The three layouts are read, and a written capture comes back."""

from dataclasses import replace
from shutil import copy

import numpy as np
import pytest

from irpso_addon.calibration.photographs import has_lights, read_photographs
from irpso_addon.capture import (
    Camera,
    Capture,
    CaptureError,
    Light,
    Observation,
    read_capture,
    write_capture,
    write_exr,
)
from irpso_addon.capture.formats import registry
from irpso_addon.capture.formats.diligent import spec_of_folder
from irpso_addon.capture.formats.registry import CaptureFormat
from irpso_addon.capture.read import read_spec
from irpso_addon.capture.spec import CaptureKind
from irpso_addon.core.errors import InputError
from tests.builders.captures import LIGHTS, decode_png, shade, sphere, write_diligent, write_png

FRAMES = np.random.default_rng(5).random((5, 6, 8)).astype(np.float32)


def test_a_diligent_folder_gives_images_lights_mask_and_camera(tmp_path):
    mask = np.zeros((6, 8), bool)
    mask[4, 2:5] = True
    write_diligent(tmp_path, FRAMES, LIGHTS * 2, mask)
    (tmp_path / "light_intensities.txt").write_text("1 2 3\n2 2 2\n0.5 1 1\n1, 1, 1\n4 4 4\n")
    (tmp_path / "camera.toml").write_text("fov_degrees = 90\nprincipal_point = [3.5, 2]\n")
    capture = read_capture(tmp_path)
    for observation, frame, light in zip(capture.observations, FRAMES, LIGHTS, strict=True):
        np.testing.assert_array_equal(observation.read()[..., 1], frame)
        np.testing.assert_allclose(observation.light.vector, light, atol=1e-8)
    assert capture.observations[0].light.intensity == (1, 2, 3)
    np.testing.assert_array_equal(capture.masks[0], mask)
    camera = capture.cameras[0]
    assert camera.perspective and camera.centre == (3.5, 2)
    np.testing.assert_allclose(camera.scale, (4, 4))


def test_intensities_may_be_one_number_a_line_and_are_1_without_the_file(tmp_path):
    write_diligent(tmp_path, FRAMES)
    assert read_capture(tmp_path).observations[3].light.intensity == (1, 1, 1)
    (tmp_path / "light_intensities.txt").write_text("1\n2\n3\n4\n5\n")
    assert read_capture(tmp_path / "filenames.txt").observations[3].light.intensity == (4, 4, 4)


@pytest.mark.parametrize(
    ("text", "perspective", "scale"),
    [
        ("focal_length_px = 20", True, (20, 20)),
        ("focal_length_px = [20, 21]", True, (20, 21)),
        ("orthographic = true\nworld_width = 4", False, (2, 2)),
        ("world_width = 4", False, (2, 2)),
        ("world_width = 4\nworld_height = 2", False, (2, 3)),
        ("", False, (4, 4)),
    ],
)
def test_camera_toml_describes_the_camera(tmp_path, text, perspective, scale):
    write_diligent(tmp_path, FRAMES)
    (tmp_path / "camera.toml").write_text(text)
    camera = read_capture(tmp_path).cameras[0]
    assert camera.perspective == perspective and camera.scale == scale and camera.centre == (4, 3)


def test_png_images_come_through_the_decoder_upright(tmp_path):
    codes = np.random.default_rng(2).integers(0, 65535, (4, 5, 3))
    write_png(tmp_path / "a.png", codes, 16)
    write_png(tmp_path / "mask.png", np.full((4, 5, 1), 255))
    (tmp_path / "filenames.txt").write_text("a.png\n")
    (tmp_path / "light_directions.txt").write_text("0 0 1\n")
    found = read_capture(tmp_path, decode_png).observations[0].read()
    np.testing.assert_allclose(found[..., :3], codes[::-1] / 65535, atol=1e-7)
    with pytest.raises(InputError, match="a.png: is a PNG file.*decoder"):
        read_capture(tmp_path)


def test_an_lp_file_finds_its_images_by_the_last_part_of_dead_paths(tmp_path):
    names = ["with two spaces.exr", "dead.exr", "windows dead.exr", "CASE.exr", "Both.exr"]
    for name, frame in zip(names, FRAMES, strict=True):
        write_exr(tmp_path / name, {"": {"Y": frame}})
    written = ["with two spaces.exr", "/no/such/folder/dead.exr", r"C:\my pictures\windows dead.exr", "case.EXR",
               r"D:\x\BOTH.EXR"]  # fmt: skip
    rows = [f"{n} {x} {y} {z}" for n, (x, y, z) in zip(written, 3 * LIGHTS, strict=True)]
    (tmp_path / "dome.lp").write_text("5\r\n" + "\r\n".join(rows) + "\r\n\r\n")
    for path in (tmp_path, tmp_path / "dome.lp"):
        capture = read_capture(path)
        for observation, frame, light in zip(capture.observations, FRAMES, LIGHTS, strict=True):
            np.testing.assert_array_equal(observation.read()[..., 0], frame)
            np.testing.assert_allclose(observation.light.vector, light, atol=1e-12)
        assert capture.masks[0].all() and not capture.cameras[0].perspective


def test_a_format_in_the_registry_is_read_and_its_lights_are_known_to_calibrations(tmp_path, monkeypatch):
    """A new format needs its entry in FORMATS alone."""
    write_diligent(tmp_path)
    lights = (tmp_path / "light_directions.txt").rename(tmp_path / "a.lights")
    made = CaptureFormat(
        CaptureKind.DILIGENT, "one .lights file", lambda folder: list(folder.glob("*.lights")),
        lambda path, colour_space: replace(spec_of_made(path), name="made"), suffixes=(".lights",),
    )  # fmt: skip

    def spec_of_made(path):
        copy(path, tmp_path / "light_directions.txt")
        return spec_of_folder(path.parent)

    assert not has_lights(tmp_path) and read_photographs(tmp_path).kind is CaptureKind.IMAGES
    monkeypatch.setattr(registry, "FORMATS", (made, *registry.FORMATS))
    assert has_lights(tmp_path)
    for path in (tmp_path, lights):
        assert read_spec(path).name == read_photographs(path).name == "made"


def two_cameras():
    """A capture with everything in it that the table can say."""
    turn = np.array([[0, 0, 1, 5], [1, 0, 0, -2.25], [0, 1, 0, 1 / 3], [0, 0, 0, 1]])
    cameras = (Camera.from_fov(8, 6, 37.5, turn), Camera(8, 6, (2.5, 2.5), (3.0, 2.0), np.eye(4), perspective=False))
    mask = np.zeros((6, 8), bool)
    mask[1, 2] = mask[5, 7] = True
    stack = np.random.default_rng(7).random((4, 6, 8, 4)).astype(np.float32)
    stack[0, ..., 3] = 1
    lights = (
        Light((0.0, 0.6, 0.8)),
        Light((1.5, -2.0, 3.0), (0.1, 0.2, 0.3), distant=False),
        Light((1.0, 0.0, 0.0), (2.0, 2.0, 2.0)),
        Light((0.0, 0.0, 1.0), (1 / 3, 0.0, 7.0)),
    )
    names = ("first", 'with "quotes" \\ and\ttab', "ünïcode ☀", "del\x7f")
    observations = tuple(
        Observation(name, lambda k=k: stack[k], light, k % 2)
        for k, (name, light) in enumerate(zip(names, lights, strict=True))
    )
    return Capture("two", observations, cameras, (mask, np.ones((6, 8), bool))), stack


@pytest.mark.parametrize("single_file", [False, True])
@pytest.mark.parametrize("half", [False, True])
def test_a_written_capture_comes_back(tmp_path, single_file, half):
    capture, stack = two_cameras()
    write_capture(capture, tmp_path / "out", half=half, single_file=single_file)
    found = read_capture(tmp_path / "out")
    assert found.name == "two" and len(found.observations) == 4
    for k, (a, b) in enumerate(zip(found.observations, capture.observations, strict=True)):
        assert (a.name, a.camera, a.light.distant) == (b.name, b.camera, b.light.distant)
        np.testing.assert_allclose(a.light.vector, b.light.vector, rtol=1e-15)
        assert a.light.intensity == b.light.intensity
        np.testing.assert_array_equal(a.read(), stack[k].astype(np.float16) if half else stack[k])
    for a, b in zip(found.cameras, capture.cameras, strict=True):
        assert (a.width, a.height, a.centre, a.perspective) == (b.width, b.height, b.centre, b.perspective)
        np.testing.assert_allclose(a.scale, b.scale, rtol=1e-15)
        np.testing.assert_array_equal(a.matrix, b.matrix)
    for a, b in zip(found.masks, capture.masks, strict=True):
        np.testing.assert_array_equal(a, b)
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert files == {"capture.toml", "images.exr"} if single_file else {"capture.toml", "000.exr", "mask_0.exr"} < files
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_writing_refuses_a_used_folder_and_leaves_no_partial_files(tmp_path):
    capture, _ = two_cameras()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "precious").write_text("x")
    with pytest.raises(InputError, match="out: is there already and not empty; choose"):
        write_capture(capture, tmp_path / "out")

    def fail():
        raise CaptureError("the third image is gone")

    broken = (*capture.observations[:2], Observation("x", fail, Light((0, 0, 1))))
    for single in (False, True):
        with pytest.raises(CaptureError, match="third image"):
            write_capture(Capture("b", broken, capture.cameras, capture.masks), tmp_path / "new", single_file=single)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["out", "precious"]


@pytest.mark.parametrize("of", ["capture", "observation"])
def test_a_name_that_is_no_utf_8_is_refused_by_name(tmp_path, of):
    # A Latin-1 file name on Linux, as Python decodes it (PEP 383); TOML is UTF-8.
    capture, _ = two_cameras()
    name = b"caf\xe9".decode("utf-8", "surrogateescape")
    first = replace(capture.observations[0], name=name)
    named = replace(capture, name=name) if of == "capture" else replace(
        capture, observations=(first, *capture.observations[1:])
    )  # fmt: skip
    with pytest.raises(InputError, match=r"'caf\\udce9': this name is not valid UTF-8.*; rename it") as refused:
        write_capture(named, tmp_path / "out")
    str(refused.value).encode()
    assert not list(tmp_path.iterdir())


def test_an_empty_folder_may_be_written_into(tmp_path):
    capture, _ = two_cameras()
    (tmp_path / "out").mkdir()
    write_capture(capture, tmp_path / "out")
    assert len(read_capture(tmp_path / "out").observations) == 4


def test_a_table_may_name_parts_by_number_and_one_file_for_all(tmp_path):
    write_exr(tmp_path / "all.exr", {f"p{k}": {"Y": frame} for k, frame in enumerate(FRAMES)})
    rows = "".join(f"[[observation]]\npart = {k}\nlight_position = [0, 0, {k + 1}]\n" for k in (4, 0))
    (tmp_path / "capture.toml").write_text(f'image = "all.exr"\n[[camera]]\nfov_degrees = 40\n{rows}')
    capture = read_capture(tmp_path / "capture.toml")
    np.testing.assert_array_equal(capture.observations[0].read()[..., 0], FRAMES[4])
    np.testing.assert_array_equal(capture.observations[1].read()[..., 0], FRAMES[0])
    assert capture.observations[0].light == Light((0.0, 0.0, 5.0), distant=False)


def test_the_colour_space_argument_overrides_the_table(tmp_path):
    write_png(tmp_path / "a.png", np.full((2, 2, 3), 128))
    (tmp_path / "capture.toml").write_text(
        'colour_space = "linear"\n[[camera]]\n[[observation]]\nimage = "a.png"\nlight_direction = [0, 0, 1]\n'
    )
    assert read_capture(tmp_path, decode_png).observations[0].read()[0, 0, 0] == np.float32(128 / 255)
    found = read_capture(tmp_path, decode_png, colour_space="srgb").observations[0].read()[0, 0, 0]
    np.testing.assert_allclose(found, 0.2158605, rtol=1e-5)


@pytest.mark.parametrize("half", [False, True])
def test_a_stated_colour_space_overrides_that_of_an_exr(tmp_path, half):
    codes = np.linspace(-0.1, 1.5, 48).reshape(6, 8)
    write_diligent(tmp_path, codes[None], LIGHTS[:1], half=half)
    stored = codes.astype(np.float16 if half else np.float32)
    for space in ("auto", "linear"):
        np.testing.assert_array_equal(read_capture(tmp_path, colour_space=space).observations[0].read()[..., 0], stored)
    stored = stored.astype(np.float64)
    expected = np.where(stored <= 0.04045, stored / 12.92, ((np.maximum(stored, 0) + 0.055) / 1.055) ** 2.4)
    found = read_capture(tmp_path, colour_space="srgb").observations[0].read()
    np.testing.assert_allclose(found, np.dstack([expected] * 3 + [np.ones((6, 8))]), rtol=1e-5)


def test_a_ball_read_back_has_the_normals_it_was_shaded_with(tmp_path):
    normals, mask = sphere()
    lights = LIGHTS[:3] * [1, 1, 1] + [[0, 0, 0], [0, 0.2, 0], [0, 0.2, 0]]
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    capture = read_capture(write_diligent(tmp_path, shade(normals, lights), lights, mask))
    stack = np.stack([o.read()[..., 0] for o in capture.observations])
    lit = mask & (stack > 0).all(axis=0)
    found = np.linalg.solve([o.light.vector for o in capture.observations], stack[:, lit]).T / 0.8
    np.testing.assert_allclose(found, normals[lit], atol=1e-5)
