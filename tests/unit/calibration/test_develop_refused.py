"""What ``develop`` and ``response`` refuse: in one line, and without a file."""

import numpy as np
import pytest

from tests.builders.captures import chunk, decode_png, write_png
from tests.builders.command_line import listing, run_cli
from tests.builders.exif import exif
from tests.builders.exposures import SIZE, TIMES, write

pytestmark = pytest.mark.usefixtures("png_without_blender")
BROKEN = [
    (["--dark", "no.png"], "--dark no.png: is not there"),
    (["--dark", "capture/bright.png"], "is no brighter than the dark frame"),
    (["--dark", "capture/small.png"], "is 5×4 pixels instead of 48×48"),
    (["--flat", "capture/white.png"], "100% of the flat field is clipped"),
    (["--white", "1,2"], "write X,Y,W,H"),
    (["--white", "-1,0,5,5"], "write X,Y,W,H"),
    (["--white", "0,0,nan,5"], "write X,Y,W,H"),
    (["--white", "0,0,500,5"], "not inside its 48×48 pixels"),
    (["--white", "3,40,6,6=1.8"], "a reflectance is above 0 and at most 1"),
    (["--white", "1,0,1"], "gains are above 0"),
    (["--white", "40,0,4,4", "--dark", "capture/dark"], "the white patch is black in a channel"),
    (["--grey-card", "3,40,6,6=0.18"], "one grey patch gives a scale, not a curve"),
    (["--grey-card", "3,40,6,6"], "give each patch's reflectance"),
    (["--response", "no.toml"], "no.toml: cannot be read"),
    (["--response", "a.toml", "--grey-card", "3,40,6,6=0.18"], "give one of them"),
    (["--brackets", "names"], "its name has no exposure"),
    (["--brackets", "exif", "--exposure", "exif"], "give one of them"),
    (["--brackets", "exif", "--exposures", "1,2"], "add --brackets names"),
    (["--brackets", "names", "--exposures", "1,0"], "give exposures above 0"),
    (["--reference", "01.png"], "add --register"),
    (["--register", "--reference", "nobody"], "there is no such image"),
    (["--scale-dark"], "there are no dark frames to scale; give --dark"),
    (["--chart", "bright.png"], "--chart: names where patches are; say which"),
    (["--saturated", "2"], "above 0 and at most 1"),
]


@pytest.mark.parametrize(("options", "words"), BROKEN, ids=[" ".join(options) for options, _ in BROKEN])
def test_bad_input_is_one_line_and_leaves_nothing(photographs, tmp_path, monkeypatch, options, words):
    monkeypatch.chdir(tmp_path)
    write(photographs / "bright.png", np.full((SIZE, SIZE, 3), 0.9), None)
    write(photographs / "white.png", np.ones((SIZE, SIZE, 3)), None)
    write(photographs / "small.png", np.zeros((4, 5, 3)), None)
    before = listing(tmp_path)
    code, out, err = run_cli("develop", "capture", "-o", "out", "--quiet", *_joined(options))
    assert (code, out) == (2, "") and words in err and err.count("\n") == 1
    assert listing(tmp_path) == before


@pytest.fixture
def two_sizes(tmp_path):
    """A capture of two cameras, of 12 × 10 and 10 × 12 pixels."""
    folder, rng = tmp_path / "sizes", np.random.default_rng(0)
    folder.mkdir()
    rows = ""
    for k, name in enumerate("aaabbb"):
        write(folder / f"{k}.png", rng.uniform(0.2, 0.8, (10, 12, 3) if name == "a" else (12, 10, 3)), None)
        rows += f'[[observation]]\nimage = "{k}.png"\ncamera = "{name}"\nlight_direction = [0.{k}, 0, 1]\n'
    cameras = "".join(f'[[camera]]\nname = "{name}"\nfov_degrees = 40\n' for name in "ab")
    (folder / "capture.toml").write_text(f"format = 1\n{cameras}{rows}")
    write(folder / "even.png", np.full((10, 12, 3), 0.1), None)
    return folder


@pytest.mark.parametrize("option", ["--dark", "--flat"])
def test_a_dark_frame_of_one_camera_is_refused_for_cameras_of_other_sizes(two_sizes, tmp_path, option):
    run = "develop", two_sizes / "capture.toml", "-o", tmp_path / "out"
    code, out, err = run_cli(*run, option, two_sizes / "even.png", "--quiet")
    assert (code, out) == (2, "") and err.count("\n") == 1
    assert option in err and "0.png is 12×10" in err and "3.png is 10×12" in err
    assert not (tmp_path / "out").exists()


def test_a_chart_that_another_camera_took_has_that_cameras_size(two_sizes, tmp_path):
    run = "develop", two_sizes / "capture.toml", "-o", tmp_path / "out"
    code, _, err = run_cli(*run, "--white", "2,2,4,4=0.18", "--chart", two_sizes / "4.png", "--quiet")
    assert (code, err) == (0, "")


def _joined(options):
    """Return options with a value that starts with a minus written as one word, as a person must."""
    joined = []
    for option in options:
        if joined and option.startswith("-") and option[1:2].isdigit():
            joined[-1] += f"={option}"
        else:
            joined.append(option)
    return joined


def test_an_existing_output_stays_unchanged(photographs, tmp_path):
    before = listing(tmp_path)
    code, _, err = run_cli("develop", photographs, "-o", photographs)
    assert code == 2 and "not empty" in err and listing(tmp_path) == before


def test_a_bracket_that_clips_everywhere_is_named(photographs, tmp_path):
    for i in range(3):
        write(photographs / f"{6 + i:02d}.png", np.ones((SIZE, SIZE, 3)), TIMES[i])
    code, _, err = run_cli("develop", photographs, "-o", tmp_path / "out", "--brackets", "exif", "--quiet")
    assert code == 2 and "06.png: all pixels are clipped" in err and not (tmp_path / "out").exists()


def test_photographs_with_the_same_name_are_refused(photographs, tmp_path):
    for name in ("filenames.txt", "light_directions.txt"):
        (photographs / name).unlink()
    (photographs / "00.tif").write_bytes((photographs / "00.png").read_bytes())
    code, _, err = run_cli("develop", photographs, "-o", tmp_path / "out", "--quiet")
    assert code == 2 and "00.tif: another photograph has this name" in err


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ([(0.5, (1, 60)), (0.5, (1, 60))], "no two photographs make a bracket"),
        ([(0.5, (1, 60)), (0.5, None)], "has no exposure time"),
        ([(0.0, (1, 60)), (0.0, (1, 15))], "pixels are neither black nor clipped"),
        ([(1.0, (1, 60)), (1.0, (1, 15))], "pixels are neither black nor clipped"),
        ([], "no two photographs"),
    ],
)
def test_brackets_without_a_curve_in_them_are_refused(tmp_path, files, words):
    (tmp_path / "brackets").mkdir()
    for n, (value, seconds) in enumerate(files):
        write(tmp_path / "brackets" / f"{n}.png", np.full((20, 20, 3), value), seconds)
    code, _, err = run_cli("response", tmp_path / "brackets", "-o", tmp_path / "a.toml", "--quiet")
    assert code == 2 and words in err and not (tmp_path / "a.toml").exists()


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("a.csv", (), "the curve is a .toml file; name it a.toml"),
        ("there.toml", (), "is there already"),
        ("a.toml", ("--exposures", "1/60,1/15"), "add --brackets names"),
        ("a.toml", ("--grey-card", "auto", "--brackets", "exif"), "give one of them"),
    ],
)
def test_a_curve_replaces_no_file_and_its_options_agree(tmp_path, name, options, words):
    (tmp_path / "brackets").mkdir()
    (tmp_path / "there.toml").write_text("mine")
    code, _, err = run_cli("response", tmp_path / "brackets", "-o", tmp_path / name, *options)
    assert code == 2 and words in err
    assert (tmp_path / "there.toml").read_text() == "mine" and not (tmp_path / "a.toml").exists()


@pytest.mark.parametrize("name", ["00.png", "dark/1.png", "flat/a.png"])
def test_a_file_that_the_camera_turned_by_chance_is_refused(photographs, tmp_path, name):
    for listed in ("filenames.txt", "light_directions.txt"):
        (photographs / listed).unlink()
    codes = np.rint(decode_png(photographs / name).values[::-1] * 65535).astype(int)
    write_png(photographs / name, codes, 16, chunk(b"eXIf", exif(TIMES[0], orientation=3)))
    frames = "--dark", photographs / "dark", "--flat", photographs / "flat", "--quiet"
    code, _, err = run_cli("develop", photographs, "-o", tmp_path / "out", *frames)
    assert code == 2 and err.count("\n") == 1 and f"{name}: its EXIF orientation is 3 where" in err
