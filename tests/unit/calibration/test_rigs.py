"""A rig, saved once and applied to other photographs, against a scene that is known; PNG read without Blender."""

import json
import shutil
import tomllib

import numpy as np
import pytest
from PIL import Image

from irpso_addon.calibration.developing import corrections_file
from irpso_addon.calibration.rigs.match import matched
from irpso_addon.calibration.rigs.rig import read_rig
from irpso_addon.capture import Picture, read_capture
from irpso_addon.capture.images.exr import write_exr
from irpso_addon.capture.read import read_spec
from irpso_addon.commands import develop, rig
from irpso_addon.core.errors import InputError
from tests.builders.captures import LIGHTS, chunk, decode_png, shade, sphere, write_png
from tests.builders.command_line import listing, run_cli
from tests.builders.exif import exif

SIZE = 40
TINT = np.array([0.9, 0.6, 0.4])
OFFSET = 0.02
Y, X = np.meshgrid(np.linspace(-1, 1, SIZE), np.linspace(-1, 1, SIZE), indexing="ij")
VIGNETTE = 1 - 0.3 * (X**2 + Y**2)
SCENE = shade(sphere(SIZE)[0])
SCENE[:, 2:8, 3:9] = 0.18  # a grey card
OTHER = 0.5 * SCENE[:, ::-1, ::-1]  # what is photographed later
TIME, FOCAL = (1, 60), 52


@pytest.fixture(autouse=True)
def png_without_blender(monkeypatch):
    for module in (develop, rig):
        monkeypatch.setattr(module, "decode", decode_png)


def photograph(path, light, seconds=TIME, focal=FOCAL, orientation=1):
    """Write what the camera makes of light (H, W), row 0 at the bottom: tinted, vignetted, with an offset."""
    seen = light[..., None] * TINT * VIGNETTE[..., None] * (seconds[0] / seconds[1] * 60) / 2 + OFFSET
    codes = np.rint(np.clip(seen, 0, 1) * 65535).astype(int)
    write_png(path, codes[::-1], 16, chunk(b"eXIf", exif(seconds, focal_35mm=focal, orientation=orientation)))


@pytest.fixture
def capture(tmp_path):
    """A capture of five lamps, a dark frame and a flat field."""
    folder = tmp_path / "first"
    (folder / "frames").mkdir(parents=True)
    for k, frame in enumerate(SCENE):
        photograph(folder / f"lamp_{k + 1}.png", frame)
    photograph(folder / "frames" / "dark.png", np.zeros((SIZE, SIZE)))
    photograph(folder / "frames" / "flat.png", np.ones((SIZE, SIZE)))
    (folder / "filenames.txt").write_text("".join(f"lamp_{k + 1}.png\n" for k in range(5)))
    np.savetxt(folder / "light_directions.txt", LIGHTS)
    np.savetxt(folder / "light_intensities.txt", np.linspace(0.8, 1.2, 5)[:, None] * np.ones(3))
    return folder


@pytest.fixture
def later(tmp_path):
    """Photographs of something else under the same lamps, without lists."""
    folder = tmp_path / "later"
    folder.mkdir()
    for k, frame in enumerate(OTHER):
        photograph(folder / f"lamp_{k + 1}.png", frame)
    return folder


@pytest.fixture
def developed_rig(capture, tmp_path):
    """The rig of the capture with dark frame, flat field and a grey card."""
    frames = capture / "frames"
    command = "develop", capture, "-o", tmp_path / "linear", "--dark", frames / "dark.png", "--flat"
    patch = f"3,{SIZE - 8},6,6=0.18"
    assert run_cli(*command, frames / "flat.png", "--white", patch, "--quiet")[0] == 0
    assert run_cli("rig", "save", tmp_path / "linear", "-o", tmp_path / "rig", "--quiet")[0] == 0
    return tmp_path / "rig"


@pytest.fixture
def plain_rig(capture, tmp_path):
    """The rig of the capture without corrections."""
    assert run_cli("rig", "save", capture, "-o", tmp_path / "rig", "--quiet")[0] == 0
    return tmp_path / "rig"


def test_saving_a_rig_tells_its_lamps_and_cameras(capture, tmp_path):
    out = run_cli("rig", "save", capture, "-o", tmp_path / "rig")[1]
    assert out == f"5 lamps, 1 camera, without corrections: {tmp_path / 'rig'}\n"


def test_new_photographs_come_out_as_the_scene_under_the_rigs_lamps(developed_rig, later, tmp_path):
    before = listing(later)
    code, _, err = run_cli("rig", "apply", developed_rig, later, "-o", tmp_path / "out", "--quiet")
    assert (code, err) == (0, "") and listing(later) == before
    found = read_capture(tmp_path / "out")
    np.testing.assert_allclose([o.light.vector for o in found.observations], LIGHTS, atol=1e-6)
    np.testing.assert_allclose([o.light.intensity[1] for o in found.observations], np.linspace(0.8, 1.2, 5))
    for observation, truth in zip(found.observations, OTHER, strict=True):
        np.testing.assert_allclose(observation.read()[..., :3], truth[..., None] * np.ones(3), atol=5e-4)


def test_a_rig_needs_nothing_of_the_capture_that_it_came_from(developed_rig, capture, later, tmp_path):
    for folder in (capture, tmp_path / "linear"):
        folder.rename(folder.with_name(f"gone_{folder.name}"))
    assert run_cli("rig", "apply", developed_rig, later, "-o", tmp_path / "out", "--quiet")[0] == 0


def test_without_corrections_the_capture_points_at_the_photographs(plain_rig, later, tmp_path):
    write_png(later / "Mask.PNG", np.where(X[..., None] > 0, 255, 0).astype(int), 8)
    code, out, _ = run_cli("rig", "apply", plain_rig, later, "-o", tmp_path / "out", "--json")
    assert code == 0 and json.loads(out)["developed"] is False
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"capture.toml", "report.json"}
    table = tomllib.loads((tmp_path / "out" / "capture.toml").read_text())
    assert table["observation"][2]["image"] == "../later/lamp_3.png"
    code, out, _ = run_cli("rig", "apply", plain_rig, later, "-o", tmp_path / "again here")
    assert code == 0 and out.splitlines()[-1].endswith(f"next: irpso inspect '{tmp_path / 'again here'}'")
    found = read_capture(tmp_path / "out", decode_png)
    np.testing.assert_allclose([o.light.vector for o in found.observations], LIGHTS, atol=1e-6)
    np.testing.assert_array_equal(found.masks[0], X > 0)


def test_equal_file_names_of_two_cameras_are_separated_by_names_of_their_own_or_refused(tmp_path):
    def write(folder, order, named):
        rows = []
        for camera, lamp in order:
            image = folder / f"cam{camera}" / f"{lamp}.exr"
            image.parent.mkdir(parents=True, exist_ok=True)
            write_exr(image, {"": {channel: np.full((SIZE, SIZE), 0.4, np.float32) for channel in "RGB"}})
            name = f'name = "cam{camera} {lamp}"\n' if named else ""
            rows.append(
                f'[[observation]]\n{name}image = "cam{camera}/{lamp}.exr"\ncamera = "c{camera}"\n'
                f"light_direction = [{camera}, {lamp}, 2]\n"
            )
        cameras = '[[camera]]\nname = "c1"\n[[camera]]\nname = "c2"\n'
        (folder / "capture.toml").write_text(f"format = 1\n{cameras}{''.join(rows)}")
        return folder

    order = [(camera, lamp) for camera in (1, 2) for lamp in range(3)]
    for named in (True, False):
        first, second = (tmp_path / f"{kind} {named}" for kind in ("first", "second"))
        write(first, order, named), write(second, order[3:] + order[:3], named)
        assert run_cli("rig", "save", first, "-o", tmp_path / f"rig {named}", "--quiet")[0] == 0
        command = "rig", "apply", tmp_path / f"rig {named}", second, "-o", tmp_path / f"out {named}", "--quiet"
        code, _, err = run_cli(*command, "--match", "order")
        if not named:
            assert code == 2 and "several photographs are called 0.exr" in err
            continue
        assert (code, err) == (0, "")
        report = json.loads((tmp_path / "out True" / "report.json").read_text())
        assert report["lamps"] == {f"cam{c}/{n}.exr": f"cam{c} {n}" for c, n in order}
        for shot in read_spec(tmp_path / "out True").observations:
            camera, lamp = (int(part.removeprefix("cam")) for part in shot.image.path.with_suffix("").parts[-2:])
            assert shot.camera == camera - 1
            np.testing.assert_allclose(np.array(shot.vector) / shot.vector[2] * 2, [camera, lamp, 2], atol=1e-6)


def test_a_folder_for_each_lamp_of_one_camera_keeps_its_order(tmp_path):
    rows = []
    for lamp in range(3):
        image = tmp_path / "lamps" / f"lamp{lamp}" / "shot.exr"
        image.parent.mkdir(parents=True)
        write_exr(image, {"": {channel: np.full((SIZE, SIZE), 0.4, np.float32) for channel in "RGB"}})
        rows.append(f'[[observation]]\nimage = "lamp{lamp}/shot.exr"\nlight_direction = [{lamp}, 0, 2]\n')
    (tmp_path / "lamps" / "capture.toml").write_text(f"format = 1\n[[camera]]\n{''.join(rows)}")
    assert run_cli("rig", "save", tmp_path / "lamps", "-o", tmp_path / "rig", "--quiet")[0] == 0
    command = (
        "rig",
        "apply",
        tmp_path / "rig",
        tmp_path / "lamps",
        "-o",
        tmp_path / "out",
        "--match",
        "order",
        "--quiet",
    )
    assert run_cli(*command)[::2] == (0, "")
    for lamp, shot in enumerate(read_spec(tmp_path / "out").observations):
        assert shot.image.path.parent.name == f"lamp{lamp}"
        np.testing.assert_allclose(np.array(shot.vector) / shot.vector[2] * 2, [lamp, 0, 2], atol=1e-6)


def test_photographs_keep_their_own_colour_space(plain_rig, later, tmp_path):
    rows = "".join(
        f'[[observation]]\nimage = "lamp_{k + 1}.png"\nlight_direction = [0, 0, 1]\n'
        + ('colour_space = "linear"\n' if k == 1 else "")
        for k in range(5)
    )
    (later / "capture.toml").write_text(f'format = 1\ncolour_space = "srgb"\n[[camera]]\n{rows}')
    assert run_cli("rig", "apply", plain_rig, later, "-o", tmp_path / "out", "--quiet")[0] == 0
    spaces = [observation.image.colour_space for observation in read_spec(tmp_path / "out").observations]
    assert spaces == ["srgb", "linear", "srgb", "srgb", "srgb"]


def test_parts_and_layers_of_an_exr_stay_apart(capture, tmp_path):
    parts = {
        f"lamp_{k + 1}": {"R": dark, "G": dark, "B": dark} | {f"diffuse.{c}": frame.astype(np.float32) for c in "RGB"}
        for k, frame in enumerate(OTHER)
        for dark in [np.zeros((SIZE, SIZE), np.float32)]
    }
    folder = tmp_path / "parts"
    folder.mkdir()
    write_exr(folder / "all.exr", parts)
    rows = [f'[[observation]]\nname = "lamp_{k + 1}"\npart = "lamp_{k + 1}"\nlayer = "diffuse"\n' for k in range(5)]
    lights = [f"light_direction = {light.tolist()}\n" for light in LIGHTS]
    table = "".join(row + light for row, light in zip(rows, lights, strict=True))
    (folder / "capture.toml").write_text(f'format = 1\nimage = "all.exr"\n[[camera]]\n{table}')
    assert run_cli("rig", "save", folder, "-o", tmp_path / "rig", "--quiet")[0] == 0
    code, out, _ = run_cli("rig", "apply", tmp_path / "rig", folder, "-o", tmp_path / "out", "--json")
    assert code == 0 and len(json.loads(out)["lamps"]) == 5
    for observation, frame in zip(read_capture(tmp_path / "out").observations, OTHER, strict=True):
        np.testing.assert_allclose(observation.read()[..., 1], frame, rtol=1e-6)


def test_the_header_of_each_photograph_is_read_once(plain_rig, later, tmp_path, monkeypatch):
    read = []
    real = corrections_file.read_bytes
    monkeypatch.setattr(corrections_file, "read_bytes", lambda path: read.append(path.name) or real(path))
    assert run_cli("rig", "apply", plain_rig, later, "-o", tmp_path / "out", "--quiet")[0] == 0
    assert sorted(read) == sorted(path.name for path in later.iterdir())


def test_a_lamp_that_failed_is_named_and_left_out(developed_rig, later, tmp_path):
    photograph(later / "lamp_2.png", np.zeros((SIZE, SIZE)))
    photograph(later / "lamp_4.png", 0.005 * OTHER[3])
    code, out, err = run_cli("rig", "apply", developed_rig, later, "-o", tmp_path / "out", "--json")
    assert code == 0 and err.count("\n") == err.count("irpso: warning: ") == 2
    assert "lamp_2.png: is black, the lamp of lamp_2.png failed" in err
    assert list(json.loads(out)["lamps"].values()) == ["lamp_1.png", "lamp_3.png", "lamp_5.png"]
    lights = [o.light.vector for o in read_capture(tmp_path / "out").observations]
    np.testing.assert_allclose(lights, LIGHTS[[0, 2, 4]], atol=1e-6)


def test_photographs_of_another_exposure_are_scaled_if_that_is_wanted(plain_rig, later, tmp_path):
    photograph(later / "lamp_3.png", OTHER[2] - OFFSET, (1, 30))  # whose offset doubles with all else, to be exact
    command = "rig", "apply", plain_rig, later, "-o", tmp_path / "out", "--quiet"
    code, _, err = run_cli(*command)
    assert code == 2 and "lamp_3.png: is exposed 1.0 stops more" in err and "--exposure exif" in err
    assert run_cli(*command, "--exposure", "exif")[0] == 0
    (one,) = [o for o in read_capture(tmp_path / "out").observations if o.name == "lamp_3.png"]
    seen = ((OTHER[2] - OFFSET)[..., None] * TINT * VIGNETTE[..., None] + OFFSET).clip(0, 1) / 2
    inside = seen.max(axis=-1) < 0.49
    np.testing.assert_allclose(one.read()[..., :3][inside], seen[inside], atol=1e-4)


def cropped(folder):
    write_png(folder / "lamp_2.png", np.full((SIZE, SIZE - 2, 3), 9000), 16)


def another_lens(folder):
    photograph(folder / "lamp_2.png", OTHER[1], focal=35)


def missing(folder):
    (folder / "lamp_2.png").unlink()


def another_kind(folder):
    for path in sorted(folder.iterdir()):
        path.rename(path.with_suffix(".tif"))


def all_black(folder):
    for k in range(5):
        photograph(folder / f"lamp_{k + 1}.png", np.zeros((SIZE, SIZE)))


WRONG = [
    (cropped, (), "lamp_2.png: is 38×40 pixels, the rig's photographs 40×40"),
    (another_lens, (), "lamp_2.png: was taken with focal length 35mm 35 mm, the rig's photographs with 52 mm"),
    (missing, (), "has 4 photographs, the rig"),
    (another_kind, (), "lamp_1.tif: is a .tif file, and the rig's corrections are for .png files"),
    (all_black, (), "most of its photographs are black"),
    (lambda folder: None, ("--exposure", "exif"), "the rig's dark frame is of one exposure"),
]


@pytest.mark.parametrize(("spoil", "options", "words"), WRONG, ids=[w[0].__name__ for w in WRONG])
def test_what_does_not_fit_the_rig_is_one_line_and_leaves_nothing(
    developed_rig, later, tmp_path, spoil, options, words
):
    spoil(later)
    before = listing(tmp_path)
    code, out, err = run_cli("rig", "apply", developed_rig, later, "-o", tmp_path / "out", "--quiet", *options)
    assert (code, out) == (2, "") and words in err and err.count("\n") == 1
    assert listing(tmp_path) == before


@pytest.mark.parametrize("kind", ["developed_rig", "plain_rig"])
def test_photographs_that_the_camera_turned_against_the_rigs_are_refused(kind, later, tmp_path, request):
    folder = request.getfixturevalue(kind)
    for k, frame in enumerate(OTHER):
        photograph(later / f"lamp_{k + 1}.png", frame, orientation=3)
    code, _, err = run_cli("rig", "apply", folder, later, "-o", tmp_path / "out", "--quiet")
    assert code == 2 and "lamp_1.png: its EXIF orientation is 3, that of the rig's photographs 1" in err
    for table in folder.rglob("*.toml"):  # a rig of an older version does not tell
        table.write_text("\n".join(line for line in table.read_text().splitlines() if "orientation" not in line))
    assert run_cli("rig", "apply", folder, later, "-o", tmp_path / "out", "--quiet")[0] == 0


def test_the_width_of_a_part_is_a_distance_for_whole_photographs(capture, later, tmp_path):
    rows = "".join(f'[[observation]]\nimage = "lamp_{k + 1}.png"\nlight_position = [{k}, 0, 40]\n' for k in range(5))
    keys = "crop = [4, 6, 20, 16]\nscale = 0.5\ncard_width = 10.0\n[[camera]]\nfov_degrees = 40\n"
    (capture / "capture.toml").write_text(f"format = 1\n{keys}{rows}")
    assert run_cli("rig", "save", capture, "-o", tmp_path / "rig", "--quiet")[0] == 0
    assert run_cli("rig", "apply", tmp_path / "rig", later, "-o", tmp_path / "out", "--quiet")[::2] == (0, "")
    # 20 of 40 pixels are 10 wide, so all are 20 wide.
    assert read_capture(tmp_path / "out", decode_png).card_distance == pytest.approx(10 / np.tan(np.radians(20)))


def test_the_part_that_a_list_of_photographs_states_is_not_left_out_silently(plain_rig, later, tmp_path):
    rows = "".join(f'[[observation]]\nimage = "lamp_{k + 1}.png"\nlight_direction = [0, 0, 1]\n' for k in range(5))
    (later / "capture.toml").write_text(f"format = 1\ncrop = [4, 6, 20, 16]\n[[camera]]\n{rows}")
    code, _, err = run_cli("rig", "apply", plain_rig, later, "-o", tmp_path / "out", "--quiet")
    assert code == 0, err
    assert f"{later}: its crop, corners or scale are left out; give them again with the new capture" in err
    camera = read_capture(tmp_path / "out", decode_png).cameras[0]
    assert (camera.width, camera.height) == (SIZE, SIZE)


def test_fewer_photographs_are_matched_by_names_or_numbers(plain_rig, later, tmp_path):
    (later / "lamp_2.png").unlink()
    for match in ("names", "numbers"):
        code, _, err = run_cli("rig", "apply", plain_rig, later, "-o", tmp_path / match, "--match", match, "--quiet")
        assert code == 0 and err == "irpso: warning: lamp_2.png: its lamp has no photograph\n"
        lights = [o.light.vector for o in read_capture(tmp_path / match, decode_png).observations]
        np.testing.assert_allclose(lights, LIGHTS[[0, 2, 3, 4]], atol=1e-6)


ORDERS = [
    (("IMG_12", "IMG_13", "IMG_9", "IMG_11", "IMG_10"), "auto", [3, 4, 0, 2, 1]),
    (("lamp_5", "lamp_4", "lamp_3", "lamp_2", "lamp_1"), "auto", [4, 3, 2, 1, 0]),
    (("tile 03", "tile 01"), "numbers", [2, 0]),
    (("tile 03", "tile"), "numbers", "tile has no number in its name"),
    (("tile 03", "b3"), "numbers", "b3 and tile 03 are the same by --match numbers"),
    (("lamp_1", "lamp_7"), "names", "lamp_7 matches no lamp of the rig"),
]


@pytest.mark.parametrize(("names", "way", "expected"), ORDERS)
def test_lamps_go_by_names_numbers_or_order(plain_rig, names, way, expected):
    if isinstance(expected, list):
        assert matched(read_rig(plain_rig), names, way, "later") == expected
        return
    with pytest.raises(InputError, match=expected):
        matched(read_rig(plain_rig), names, way, "later")


def test_a_folder_that_is_no_rig_or_of_another_version_is_refused(plain_rig, later, tmp_path):
    code, _, err = run_cli("rig", "apply", later, later, "-o", tmp_path / "out")
    assert code == 2 and "is no rig, a folder with rig.toml" in err
    table = plain_rig / "rig.toml"
    table.write_text(table.read_text().replace("rig = 1", "rig = 2"))
    code, _, err = run_cli("rig", "apply", plain_rig, later, "-o", tmp_path / "out")
    assert code == 2 and "is no rig of version 1" in err
    code, _, err = run_cli("rig", "apply", plain_rig, "-o", tmp_path / "out")
    assert code == 2 and "write irpso rig apply RIG PHOTOGRAPHS -o CAPTURE" in err


def test_a_rig_of_linear_pngs_leaves_a_cameras_jpegs_their_encoding(capture, tmp_path, monkeypatch):
    rows = "".join(
        f'[[observation]]\nimage = "lamp_{k + 1}.png"\nlight_direction = {LIGHTS[k].tolist()}\n' for k in range(5)
    )
    for name in ("filenames.txt", "light_directions.txt", "light_intensities.txt"):
        (capture / name).unlink()
    (capture / "capture.toml").write_text(f'format = 1\ncolour_space = "linear"\n[[camera]]\n{rows}')
    assert run_cli("rig", "save", capture, "-o", tmp_path / "rig", "--quiet")[0] == 0
    jpegs = tmp_path / "jpegs"
    jpegs.mkdir()
    for k in range(5):
        picture = Image.new("RGB", (SIZE, SIZE), (100 + k, 100, 100))
        picture.save(jpegs / f"lamp_{k + 1}.jpg", exif=b"Exif\0\0" + exif(TIME, focal_35mm=FOCAL))
    monkeypatch.setattr(rig, "decode", lambda path: Picture(np.asarray(Image.open(path), np.float32)[::-1] / 255, 8))
    for folder, space in ((capture, "linear"), (jpegs, "auto")):
        out = tmp_path / f"out {space}"
        code, _, err = run_cli("rig", "apply", tmp_path / "rig", folder, "-o", out, "--quiet")
        assert (code, err) == (0, "") and read_spec(out).observations[0].image.colour_space == space


def test_a_rig_of_linear_exrs_leaves_other_photographs_their_encoding(capture, tmp_path):
    linear, photographs, out = (tmp_path / name for name in ("linear", "photographs", "out"))
    assert run_cli("develop", capture, "-o", linear, "--quiet")[0] == 0
    shutil.rmtree(linear / "corrections")
    assert run_cli("rig", "save", linear, "-o", tmp_path / "rig", "--quiet")[0] == 0
    photographs.mkdir()
    for k in range(5):
        codes = np.full((SIZE, SIZE, 3), 100 + k)
        srgb = chunk(b"sRGB", b"\0")
        write_png(photographs / f"lamp_{k + 1}.png", codes, 8, srgb + chunk(b"eXIf", exif(TIME, focal_35mm=FOCAL)))
    code, _, err = run_cli("rig", "apply", tmp_path / "rig", photographs, "-o", out, "--quiet")
    assert (code, err) == (0, "")
    found = read_capture(out, decode_png).observations[0].read()
    np.testing.assert_allclose(found[..., :3], ((100 / 255 + 0.055) / 1.055) ** 2.4, atol=1e-5)
