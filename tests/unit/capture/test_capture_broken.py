"""Broken captures: each gives one line that names the file and a remedy."""

import os

import numpy as np
import pytest

from irpso_addon.capture import read_capture, write_exr
from irpso_addon.capture.inspect.report import inspect_capture
from irpso_addon.core.errors import InputError
from tests.builders.captures import LIGHTS, decode_png, write_diligent, write_png

FRAMES = np.random.default_rng(5).random((5, 6, 8)).astype(np.float32)
TABLE = """
[[camera]]
name = "front"
fov_degrees = 40
[[observation]]
image = "000.exr"
light_direction = [0, 0, 1]
"""


def replace(name, old, new):
    def breaks(folder):
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return breaks


def write(name, content):
    return lambda folder: (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)


def cut(name, share):
    def breaks(folder):
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: int(len(data) * share)])

    return breaks


def remove(name):
    return lambda folder: (folder / name).unlink()


def exr(name, shape, value=1.0, channel="Y"):
    return lambda folder: write_exr(folder / name, {"": {channel: np.full(shape, value, np.float32)}})


def png_cut(folder):
    write_png(folder / "000.png", np.zeros((6, 8, 3)))
    replace("filenames.txt", "000.exr", "000.png")(folder)
    cut("000.png", 0.8)(folder)


def lights(change):
    def breaks(folder):
        np.savetxt(folder / "light_directions.txt", change(LIGHTS.copy()))

    return breaks


# What breaks a sound DiLiGenT folder, the file that the message names, and a word of it.
DILIGENT = {
    "a missing image": (remove("002.exr"), "002.exr", "not there; .*name in .*filenames.txt: line 3"),
    "a name of no file": (
        replace("filenames.txt", "002", "oops"), "oops.exr", "not there; .*name in .*filenames.txt: line 3"),
    "no filenames": (remove("filenames.txt"), "filenames.txt", "not there"),
    "no directions": (remove("light_directions.txt"), "light_directions.txt", "not there"),
    "empty filenames": (write("filenames.txt", "\n# none\n\n"), "filenames.txt", "empty"),
    "empty directions": (write("light_directions.txt", ""), "light_directions.txt", "empty"),
    "one light too few": (lights(lambda a: a[:4]), "light_directions.txt", "has 4 lights.*5 images"),
    "one name too many": (write("filenames.txt", "000.exr\n" * 6), "light_directions.txt", "5 lights.*6 images"),
    "an intensity too many": (write("light_intensities.txt", "1\n" * 6), "light_intensities.txt", "6 lights"),
    "a NaN light": (lights(lambda a: a * [[1], [np.nan], [1], [1], [1]]), "light_directions.txt: line 2", "number"),
    "an infinite light": (
        replace("light_directions.txt", "1.00000000", "inf"), "light_directions.txt: line 1", "number; write three"),
    "a zero light": (lights(lambda a: a * [[1], [1], [0], [1], [1]]), "light_directions.txt: line 3", "zero"),
    "text for a number": (replace("light_directions.txt", "0.6", "x6"), "light_directions.txt: line 2", "'x600"),
    "two numbers in a line": (write("light_directions.txt", "0 0 1\n" * 4 + "0 1\n"), "line 5", "three"),
    "a table on its side": (lights(lambda a: a.T), "light_directions.txt", "3×5.*transpose"),
    "binary directions": (write("light_directions.txt", b"\x93NUMPY\xff\0"), "light_directions.txt", "text"),
    "zeros in the text": (write("filenames.txt", b"a\0b\n"), "filenames.txt", "text"),
    "a zero intensity": (write("light_intensities.txt", "1\n1\n0\n1\n1\n"), "intensities.txt: line 3", "zero"),
    "a negative intensity": (
        write("light_intensities.txt", "1 1 1\n1 -2 1\n1 1 1\n1 1 1\n1 1 1\n"), "intensities.txt: line 2", "negative"),
    "a NaN intensity": (write("light_intensities.txt", "nan\n1\n1\n1\n1\n"), "intensities.txt: line 1", "number"),
    "two intensities a line": (write("light_intensities.txt", "1 1\n" * 5), "intensities.txt: line 1", "r g b"),
    "a cut EXR": (cut("001.exr", 0.9), "001.exr", "cut short"),
    "a cut PNG": (png_cut, "000.png", "cut short"),
    "an empty image": (write("001.exr", b""), "001.exr", "empty"),
    "junk for an image": (write("001.exr", bytes(range(256))), "001.exr", "no PNG, JPEG"),
    "text for an image": (write("001.exr", "hello"), "001.exr", "no PNG, JPEG"),
    "an image of another size": (exr("001.exr", (6, 9)), "001.exr", "9×6.*8×6"),
    "a folder for an image": (lambda f: (remove("001.exr")(f), (f / "001.exr").mkdir()), "001.exr", "cannot be read"),
    "an image without colour": (
        lambda f: write_exr(f / "001.exr", {"": {"u": FRAMES[0], "v": FRAMES[0]}}), "001.exr", "no channels R"),
    "several parts and none named": (
        lambda f: write_exr(f / "001.exr", {"a": {"Y": FRAMES[0]}, "b": {"Y": FRAMES[0]}}),
        "001.exr", "several parts.*'a', 'b'"),
    "a mask of another size": (exr("mask.exr", (6, 9)), "mask.exr", "9×6.*8×6"),
    "an empty mask": (exr("mask.exr", (6, 8), 0.0), "mask.exr", "empty"),
    "a mask that is junk": (write("mask.png", b"junk"), "mask.png", "no PNG"),
    "a misspelt camera key": (write("camera.toml", "fov = 40"), "camera.toml", "unknown key 'fov'"),
    "a camera that is not TOML": (write("camera.toml", "fov_degrees == 40"), "camera.toml", "not valid TOML"),
    "a camera that is binary": (write("camera.toml", b"\xff\xfe\0"), "camera.toml", "not valid TOML"),
    "a field of view of 400 digits": (write("camera.toml", f"fov_degrees = {'4' * 400}"), "camera.toml", "above 0"),
    "a field of view of text": (write("camera.toml", "fov_degrees = '40'"), "camera.toml", "above 0"),
    "a field of view of 180": (write("camera.toml", "fov_degrees = 180"), "camera.toml", "below 180"),
    "a negative focal length": (write("camera.toml", "focal_length_px = [1, -1]"), "camera.toml", "above 0"),
    "a height without a width": (write("camera.toml", "world_height = 2"), "camera.toml", "needs world_width"),
    "an angle and a height": (write("camera.toml", "fov_degrees = 9\nworld_height = 2"), "camera.toml", "needs world"),
    "a height of 0": (write("camera.toml", "world_width = 2\nworld_height = 0"), "camera.toml", "world_height must be"),
    "two kinds of camera": (write("camera.toml", "fov_degrees = 9\nworld_width = 2"), "camera.toml", "one of"),
    "perspective without an angle": (write("camera.toml", "orthographic = false"), "camera.toml", "needs fov"),
    "orthographic said in words": (write("camera.toml", "orthographic = 'yes'"), "camera.toml", "true or false"),
    "a principal point of one": (write("camera.toml", "principal_point = [1]"), "camera.toml", "list of 2"),
}  # fmt: skip

MIRROR = "matrix = [-1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]"
# What is put into a sound capture.toml (old text, new text), and a word of the message.
TABLES = {
    "not TOML": ("[[camera]]", "[[camera]", "not valid TOML"),
    "an unknown key at the top": ("[[camera]]", "colour = 1\n[[camera]]", "unknown key 'colour'"),
    "an unknown key of a camera": ("fov_degrees", "fovdegrees", "front: unknown key 'fovdegrees'"),
    "an unknown key of an observation": ("light_d", "lightd", "unknown key"),
    "no camera": ('[[camera]]\nname = "front"\nfov_degrees = 40\n', "", r"no \[\[camera\]\]"),
    "a camera that is a number": ('[[camera]]\nname = "front"\nfov_degrees = 40', "camera = 3", r"no \[\[camera\]\]"),
    "no observation": (
        '[[observation]]\nimage = "000.exr"\nlight_direction = [0, 0, 1]',
        "",
        r"no \[\[observation\]\]",
    ),
    "an unknown camera": ("[[observation]]", '[[observation]]\ncamera = "back"', "no camera 'back'.*front"),
    "two cameras of one name": ("[[obs", '[[camera]]\nname = "front"\n[[obs', "same name"),
    "a camera that nothing uses": ("[[obs", '[[camera]]\nname = "b"\n[[obs', "no observation uses"),
    "a flat matrix": ("fov_d", "matrix = [0,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]\nfov_d", "no inverse"),
    "a mirroring matrix": ("fov_d", f"{MIRROR}\nfov_d", "mirrors"),
    "a scaling matrix": ("fov_d", "matrix = [2,0,0,0, 0,2,0,0, 0,0,2,0, 0,0,0,1]\nfov_d", "scales"),
    "a matrix of columns": ("fov_d", "matrix = [1,0,0,0, 0,1,0,0, 0,0,1,0, 1,2,3,1]\nfov_d", "row by row"),
    "a short matrix": ("fov_d", "matrix = [1, 2, 3]\nfov_d", "16 numbers"),
    "a NaN matrix": ("fov_d", "matrix = [nan,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]\nfov_d", "matrix"),
    "half a size": ("fov_d", "width = 8\nfov_d", "width and height"),
    "a wrong size": ("fov_d", "width = 9\nheight = 6\nfov_d", "8×6.*9×6"),
    "no image": ('image = "000.exr"', "", "names no image"),
    "an image that is missing": (
        "000.exr",
        "999.exr",
        r"999.exr: this image is not there; put it there, or correct 'image' in .*toml: observation 1",
    ),
    "no light": ("light_direction = [0, 0, 1]", "", "light_direction and light_position"),
    "two lights": ("light_d", "light_position = [1, 2, 3]\nlight_d", "light_direction and light_position"),
    "a light of two numbers": ("[0, 0, 1]", "[0, 1]", "list of 3"),
    "a light of zeros": ("[0, 0, 1]", "[0, 0, 0]", "zero"),
    "a NaN light": ("[0, 0, 1]", "[0, nan, 1]", "not a number"),
    "an intensity of text": ("light_d", "light_intensity = 'bright'\nlight_d", "light_intensity must be a number"),
    "a zero intensity": ("light_d", "light_intensity = 0\nlight_d", "zero"),
    "a negative intensity": ("light_d", "light_intensity = [1, 1, -1]\nlight_d", "negative"),
    "an unknown colour space": ("light_d", "colour_space = 'aces'\nlight_d", "one of auto, srgb, linear"),
    "a part of a file without it": ("light_d", "part = 'x'\nlight_d", "no part 'x'"),
    "a part that is a fraction": ("light_d", "part = 1.5\nlight_d", "name or the number"),
    "a layer that is not there": ("light_d", "layer = 'x'\nlight_d", "no image layer 'x'"),
    "a later format": ("\n[[camera]]", "format = 2\n[[camera]]", "format = 1"),
    "a mask that is missing": ("fov_d", "mask = 'no.exr'\nfov_d", "no.exr: .*correct 'mask' in .*toml: camera front"),
}

LP = {
    "a wrong count": ("4\na.exr 0 0 1\n", "says 4 images and lists 1"),
    "no count": ("a.exr 0 0 1\na.exr 0 0 1\n", "'a.exr 0 0 1' is not a number of images"),
    "a raised figure as count": ("²\na.exr 0 0 1\n", "'²' is not a number of images"),
    "a count of too many figures": ("9" * 5000 + "\na.exr 0 0 1\n", "'9*' is not a number of images"),
    "a missing column": ("1\na.exr 0 1\n", "line 2: is not 'name x y z'"),
    "text in a column": ("1\nmy a.exr 0 up 1\n", "line 2: 'up' is not a number"),
    "a zero light": ("1\na.exr 0 0 0\n", "line 2: the light direction is zero"),
    "lights of almost no length": ("3\n" + "a.exr 1e-200 0 1e-200\n" * 3, "line 2: the light direction is zero"),
    "lights of endless length": ("3\n" + "a.exr 1e200 0 1e200\n" * 3, "line 2: the light is out of range"),
    "a NaN light": ("1\na.exr 0 nan 0\n", "line 2: the light is not a number"),
    "a missing image": ("1\nb.exr 0 0 1\n", "b.exr: this image is not there; .*its name in .*: line 2"),
    "no lines": ("0\n", "lists no images"),
    "nothing": ("", "is empty"),
    "junk": (b"\xfe\xff\x80\0", "is no text file"),
}


def refused(path, names, word):
    with pytest.raises(InputError, match=f"(?s).*{word}") as caught:
        capture = read_capture(path, decode_png)
        for observation in capture.observations:
            observation.read()
    message = str(caught.value)
    assert "\n" not in message and names in message, message
    assert any(word in message for word in ("; ", " must ", " needs ", ": give one of ")), message  # the remedy
    report = inspect_capture(path, decode_png)
    assert not report.usable and report.findings[0].severity == "error"


@pytest.mark.parametrize("case", DILIGENT)
def test_a_broken_folder_is_refused_in_one_line(tmp_path, case, capfd):
    breaks, names, word = DILIGENT[case]
    breaks(write_diligent(tmp_path, FRAMES))
    refused(tmp_path, names, word)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("case", TABLES)
def test_a_broken_table_is_refused_in_one_line(tmp_path, case):
    old, new, word = TABLES[case]
    write_exr(tmp_path / "000.exr", {"": {"Y": FRAMES[0]}})
    assert old in TABLE
    (tmp_path / "capture.toml").write_text(TABLE)
    assert len(read_capture(tmp_path).observations) == 1
    (tmp_path / "capture.toml").write_text(TABLE.replace(old, new, 1))
    refused(tmp_path, str(tmp_path), word)


@pytest.mark.parametrize("case", LP)
def test_a_broken_lp_file_is_refused_in_one_line(tmp_path, case):
    content, word = LP[case]
    write_exr(tmp_path / "a.exr", {"": {"Y": FRAMES[0]}})
    write("x.lp", content)(tmp_path)
    refused(tmp_path, str(tmp_path), word)


def test_another_path_than_a_capture_is_refused_in_one_line(tmp_path):
    (tmp_path / "empty").mkdir()
    refused(tmp_path / "empty", "empty", "holds no capture")
    refused(tmp_path / "nowhere", "nowhere", "is not there")
    (tmp_path / "film.mp4").write_bytes(bytes(50))
    refused(tmp_path / "film.mp4", "film.mp4", "is no capture")
    (tmp_path / "two").mkdir()
    for name in ("a.lp", "b.LP"):
        (tmp_path / "two" / name).write_text("0\n")
    refused(tmp_path / "two", "two", "2 .lp files")
    with pytest.raises(InputError, match="colour space 'log' is unknown; choose"):
        read_capture(tmp_path, colour_space="log")


def test_sizes_that_differ_are_refused_before_any_image_is_decoded(tmp_path):
    exr("003.exr", (6, 9))(write_diligent(tmp_path, FRAMES))
    with pytest.raises(InputError, match="003.exr: is 9×6 pixels where its camera has 8×6"):
        read_capture(tmp_path)


def test_inspect_reports_undecodable_images(tmp_path):
    def decoder(path):
        raise InputError(f"{path}: is of a rare kind; save it again")

    write_diligent(tmp_path, FRAMES)
    write_png(tmp_path / "000.png", np.zeros((6, 8, 3)))
    replace("filenames.txt", "000.exr", "000.png")(tmp_path)
    assert [f.message for f in inspect_capture(tmp_path, decoder).findings if f.severity == "error"] == [
        f"{tmp_path / '000.png'}: is of a rare kind; save it again"
    ]
    write_png(tmp_path / "mask.png", np.full((6, 8, 1), 255))
    assert "mask.png: is of a rare kind" in inspect_capture(tmp_path, decoder).findings[0].message


def test_all_broken_images_are_reported(tmp_path):
    write_diligent(tmp_path, FRAMES)
    for name in ("001.exr", "003.exr", "004.exr"):
        cut(name, 0.5)(tmp_path)
    with pytest.raises(InputError, match=r"001.exr: .*\(and 2 more"):
        read_capture(tmp_path)
    messages = [finding.message for finding in inspect_capture(tmp_path).findings if finding.severity == "error"]
    assert [m.split(": ")[0].rsplit(os.sep, 1)[1] for m in messages] == ["001.exr", "003.exr", "004.exr"]


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="this account may read every file")
@pytest.mark.parametrize("name", ["000.exr", "filenames.txt", "light_directions.txt"])
def test_a_file_that_may_not_be_read_is_named(tmp_path, name):
    write_diligent(tmp_path, FRAMES)
    (tmp_path / name).chmod(0)
    refused(tmp_path, name, "cannot be read")


def test_a_file_that_shrinks_after_its_header_was_read_is_refused(tmp_path):
    write_diligent(tmp_path, FRAMES)
    capture = read_capture(tmp_path)
    exr("001.exr", (6, 8))(tmp_path)
    with pytest.raises(InputError, match="001.exr: has changed since"):
        capture.observations[1].read()
    write_exr(tmp_path / "002.exr", {"": {c: np.ones((3, 3), np.float32) for c in "RGB"}})
    with pytest.raises(InputError, match="002.exr: is 3×3 pixels"):
        capture.observations[2].read()
    cut("003.exr", 0.7)(tmp_path)
    with pytest.raises(InputError, match="003.exr"):
        capture.observations[3].read()
