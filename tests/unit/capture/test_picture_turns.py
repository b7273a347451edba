"""Photographs that cameras of other programs show turned: developed ones, HEIC, and files whose tag is lost."""

import json
from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.capture import CaptureError, read_capture, read_exr, write_exr
from irpso_addon.capture.images import image
from irpso_addon.capture.images.exif import upright
from irpso_addon.capture.images.exr_header import Turn, read_exr_header
from irpso_addon.capture.images.headers import read_header
from irpso_addon.capture.images.raw import RawHeader
from irpso_addon.capture.poses import read_poses
from irpso_addon.commands import develop
from tests.builders.captures import chunk, decode_png, write_png
from tests.builders.command_line import run_cli
from tests.builders.exif import exif
from tests.builders.heif import heic
from tests.builders.poses import CENTRE, ROTATION, alicevision, colmap, metashape

SEEN = np.array([0.21, -0.11, 1.0])  # a point in the axes of the camera, x right, y down
LIT = "light_direction = [0, 0, 1]\n"


def decode(path):
    """Decode a PNG upright, as Blender's decoder does."""
    picture = decode_png(path)
    values = upright(picture.values, read_header(path).orientation)
    return replace(picture, values=np.ascontiguousarray(values))


def spot(width=64, height=48):
    """Return codes (H, W, 3), as a camera stores them, with one white pixel where COLMAP's camera shows the point."""
    codes = np.full((height, width, 3), 20)
    codes[int(50 * SEEN[1] + height / 2), int(50 * SEEN[0] + width / 2)] = 255
    return codes


def scan(folder, name="IMG_1.jpg", width=64, height=48):
    colmap(folder / "colmap")
    (folder / "colmap" / "cameras.txt").write_text(f"7 PINHOLE {width} {height} 50 50 {width / 2} {height / 2}\n")
    lines = (folder / "colmap" / "images.txt").read_text().replace("IMG_0001.JPG", name)
    (folder / "colmap" / "images.txt").write_text(lines)


def listed(folder, image, cameras="colmap", more=""):
    text = f'cameras = "{cameras}"\n[[observation]]\nimage = "{image}"\n{LIT}{more}'
    (folder / "capture.toml").write_text(text)


def assert_shows_the_point(capture):
    """The capture's camera sees the point at the white pixel of its picture."""
    at, _ = capture.cameras[0].project(CENTRE + SEEN @ ROTATION)
    picture = capture.observations[0].read()[..., 1]
    row, column = np.unravel_index(picture.argmax(), picture.shape)
    assert (int(at[0]), int(at[1])) == (column, row)


@pytest.mark.parametrize("size", [(64, 48), (48, 48)])
@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_a_developed_photograph_keeps_its_turn(tmp_path, monkeypatch, orientation, size):
    monkeypatch.setattr(develop, "decode", decode)
    raw, out = tmp_path / "raw", tmp_path / "out"
    raw.mkdir()
    write_png(raw / "IMG_1.png", spot(*size), extra=chunk(b"eXIf", exif(orientation=orientation)))
    scan(raw, width=size[0], height=size[1])
    listed(raw, "IMG_1.png")
    assert_shows_the_point(read_capture(raw, decode))
    (raw / "capture.toml").unlink()
    assert run_cli("develop", raw, "-o", out, "--quiet")[::2] == (0, "")
    (out / "filenames.txt").unlink()
    listed(out, "IMG_1.exr", cameras="../raw/colmap")
    capture = read_capture(out)
    assert_shows_the_point(capture)
    assert capture.warnings == ()


def test_an_exr_states_a_turn_only_if_it_has_one(tmp_path):
    grey = {"": {"Y": np.ones((2, 3), np.float32)}}
    for turn in (None, Turn(6, 1), Turn(3, 3)):
        write_exr(tmp_path / "a.exr", grey, turn=turn)
        (part,) = read_exr_header(tmp_path / "a.exr")
        assert part.turn == turn
        np.testing.assert_array_equal(read_exr(tmp_path / "a.exr")[""]["Y"], 1)
    write_exr(tmp_path / "a.exr", grey, turn=Turn(9, 9))
    assert read_exr_header(tmp_path / "a.exr")[0].turn is None


@pytest.mark.parametrize("orientation", [None, 1, 3])
@pytest.mark.parametrize(("picture", "camera"), [((48, 64), (64, 48)), ((64, 48), (48, 64))])
def test_a_quarter_turn_that_no_tag_states_is_not_called_cropped(tmp_path, picture, camera, orientation):
    extra = chunk(b"eXIf", exif(orientation=orientation)) if orientation else b""
    write_png(tmp_path / "IMG_1.png", np.full((*picture[::-1], 3), 9), extra=extra)
    scan(tmp_path, width=camera[0], height=camera[1])
    listed(tmp_path, "IMG_1.png")
    with pytest.raises(CaptureError) as error:
        read_capture(tmp_path, decode)
    sizes = "the picture is {}×{} pixels, its camera {}×{}".format(*picture, *camera)
    assert f"{sizes}, and no EXIF orientation in its file states a quarter turn; give the photo" in str(error.value)


STATED = "<orientation>{}</orientation><transform>"


def aligned(folder, program, orientation, square=False):
    """Write the cameras of a program that states the orientation of its photograph; return the file's name."""
    if program == "metashape":
        path = metashape(folder / "a.xml")
        text = path.read_text().replace("<transform>", STATED.format(orientation), 1)
        path.write_text(text.replace('height="480"', 'height="640"') if square else text)
        return path.name
    path = alicevision(folder / "a.sfm", intrinsics={"height": "640"} if square else {})
    table = json.loads(path.read_text())
    table["views"][0]["metadata"] = {"Exif:Orientation": str(orientation)}
    path.write_text(json.dumps(table))
    return path.name


@pytest.mark.parametrize("program", ["metashape", "alicevision"])
@pytest.mark.parametrize(
    ("photograph", "picture", "square", "doubted"),
    [
        (3, 1, False, True),
        (1, 3, False, True),
        (6, 1, True, True),
        (1, 8, True, True),
        (3, 3, False, False),
        (1, 1, False, False),
        (6, 8, True, False),  # both have been turned from what the camera stored
        (6, 1, False, False),  # the size tells
        ("", 3, False, False),
    ],
)
def test_a_turn_other_than_the_aligned_photographs_is_a_warning(
    tmp_path, program, photograph, picture, square, doubted
):
    cameras = aligned(tmp_path, program, photograph, square)
    shape = (160, 160, 3) if square else (120, 160, 3)
    write_png(tmp_path / "IMG_0001.png", np.full(shape, 9), extra=chunk(b"eXIf", exif(orientation=picture)))
    listed(tmp_path, "IMG_0001.png", cameras)
    warnings = read_capture(tmp_path, decode).warnings
    assert len(warnings) == doubted
    if doubted:
        words = f"aligned a photograph of EXIF orientation {photograph}, and the capture's picture has {picture}"
        assert words in warnings[0]


def test_a_cameras_first_image_may_be_left_out_as_damaged(tmp_path):
    scan(tmp_path)
    write_png(tmp_path / "a.png", spot(), extra=chunk(b"eXIf", exif(orientation=3)))
    write_png(tmp_path / "b.png", spot(), extra=chunk(b"eXIf", exif(orientation=3)))
    (tmp_path / "a.png").write_bytes((tmp_path / "a.png").read_bytes()[:40])
    rows = "".join(f'[[observation]]\nimage = "{name}.png"\ncamera = "IMG_1"\n{LIT}' for name in "ab")
    (tmp_path / "capture.toml").write_text(f'cameras = "colmap"\n{rows}')
    capture = read_capture(tmp_path, decode, skip_damaged=True)
    assert [observation.name for observation in capture.observations] == ["b.png"]
    assert_shows_the_point(capture)


@pytest.mark.parametrize(
    ("size", "tag", "mask_tag", "doubted"),
    [
        ((64, 48), 3, None, True),
        ((64, 48), 1, None, False),
        ((64, 48), 3, 3, False),
        ((64, 48), 6, None, False),  # the mask's size tells that it is upright
        ((64, 48), 8, None, False),
        ((48, 48), 6, None, True),
        ((48, 48), 8, 8, False),
    ],
)
def test_a_mask_that_may_lie_as_the_stored_photograph_is_a_warning(tmp_path, size, tag, mask_tag, doubted):
    scan(tmp_path, width=size[0], height=size[1])
    write_png(tmp_path / "IMG_1.png", spot(*size), extra=chunk(b"eXIf", exif(orientation=tag)))
    extra = chunk(b"eXIf", exif(orientation=mask_tag)) if mask_tag else b""
    mask = np.full((*(size[::-1] if tag < 6 or mask_tag else size), 1), 255)
    write_png(tmp_path / "mask.png", mask, extra=extra)
    listed(tmp_path, "IMG_1.png", more='[[camera]]\nname = "IMG_1.jpg"\nmask = "mask.png"\n')
    warnings = read_capture(tmp_path, decode).warnings
    assert len(warnings) == doubted and all("mask.png: the photographs have the EXIF or" in text for text in warnings)


def test_a_cameras_photograph_is_read_once_for_its_turn(tmp_path, monkeypatch):
    read, real = [], image.read_header
    monkeypatch.setattr(image, "read_header", lambda path: read.append(path.name) or real(path))
    scan(tmp_path)
    for name in "ab":
        write_png(tmp_path / f"{name}.png", spot())
    rows = "".join(f'[[observation]]\nimage = "{name}.png"\ncamera = "IMG_1"\n{LIT}' for name in "ab")
    (tmp_path / "capture.toml").write_text(f'cameras = "colmap"\n{rows}')
    read_capture(tmp_path, decode)
    assert sorted(read) == ["a.png", "a.png", "b.png"]  # the second for the sizes of all


def test_a_mask_on_its_side_is_to_be_turned(tmp_path):
    scan(tmp_path)
    write_png(tmp_path / "IMG_1.png", spot(), extra=chunk(b"eXIf", exif(orientation=6)))
    write_png(tmp_path / "mask.png", np.full((48, 64, 1), 255))
    listed(tmp_path, "IMG_1.png", more='[[camera]]\nname = "IMG_1.jpg"\nmask = "mask.png"\n')
    with pytest.raises(CaptureError, match="mask is 64×48 pixels, the images 48×64; turn it upright, as viewers"):
        read_capture(tmp_path, decode)
    (tmp_path / "mask.png").unlink()
    with pytest.raises(CaptureError, match="mask.png: this image is not there") as caught:
        read_capture(tmp_path, decode)
    assert caught.value.code == "mask_missing"


def test_a_stated_orientation_is_a_number_of_exif(tmp_path):
    for text, expected in (("6", {"IMG_0001": 6}), ("0", {}), ("9", {}), ("six", {}), ("", {})):
        found = read_poses(tmp_path / aligned(tmp_path, "metashape", text))
        assert found.orientations == expected


def heic_scan(folder, orientation, width, height):
    pytest.importorskip("pillow_heif")
    (folder / "IMG_1.heic").write_bytes(heic(np.full((48, 64, 3), 90), exif=exif(orientation=orientation)))
    scan(folder, "IMG_1.heic", width, height)
    listed(folder, "IMG_1.heic")


@pytest.mark.parametrize("stored", [True, False])
@pytest.mark.parametrize("orientation", [6, 8])
def test_the_size_tells_if_a_program_turned_a_heic_file(tmp_path, orientation, stored):
    """Of a stored picture the camera is turned by the tag, as of PNG; of an upright one it stays."""
    heic_scan(tmp_path, orientation, *((64, 48) if stored else (48, 64)))
    (found,) = read_capture(tmp_path).cameras
    write_png(tmp_path / "a.png", spot(), extra=chunk(b"eXIf", exif(orientation=orientation if stored else 1)))
    if not stored:
        write_png(tmp_path / "a.png", spot(48, 64))
    listed(tmp_path, "a.png", more='camera = "IMG_1.heic"')
    (expected,) = read_capture(tmp_path, decode).cameras
    np.testing.assert_allclose(found.matrix, expected.matrix, atol=1e-12)
    assert (found.width, found.height, found.centre) == (expected.width, expected.height, expected.centre)


def test_half_a_turn_of_a_heic_file_is_refused_of_colmap_and_doubted_of_others(tmp_path):
    heic_scan(tmp_path, 3, 64, 48)
    with pytest.raises(CaptureError, match="HEIC file has the EXIF orientation 3, and COLMAP may not"):
        read_capture(tmp_path)
    metashape(tmp_path / "a.xml")
    listed(tmp_path, "IMG_1.heic", "a.xml", 'camera = "IMG_0001"')
    (warning,) = read_capture(tmp_path).warnings
    assert "Metashape may not have applied it; it is read as if it had" in warning


def test_a_raw_file_is_turned_as_its_camera_stored_it(tmp_path, monkeypatch):
    monkeypatch.setattr(image, "raw_header", lambda path: RawHeader(64, 48, 3))
    (tmp_path / "IMG_1.CR3").write_bytes(b"\0\0\0\x18ftypcrx ")
    assert image.ImageStore().turn(image.ImageRef(tmp_path / "IMG_1.CR3")) == (3, 3)
