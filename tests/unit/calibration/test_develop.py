"""``develop`` and ``response`` through the command line, against a scene that is known; PNG read without Blender."""

import json

import numpy as np
import pytest

from irpso_addon.calibration.developing.corrections_file import read_corrections
from irpso_addon.capture import read_capture, read_exr
from irpso_addon.capture.read import read_spec
from tests.builders.captures import LIGHTS, chunk, decode_png, shade, write_png
from tests.builders.command_line import dome_lights, listing, run_cli
from tests.builders.exposures import BRIGHT, NORMALS, OFFSET, SCENE, SIZE, TIMES, TINT, VIGNETTE, everything, write

pytestmark = pytest.mark.usefixtures("png_without_blender")


def test_brackets_with_all_corrections_come_out_as_the_scene(photographs, tmp_path):
    before = listing(photographs)
    code, out, err = run_cli("develop", photographs, "-o", tmp_path / "out", *everything(photographs), "--json")
    assert (code, err) == (0, "")
    assert listing(photographs) == before
    capture = read_capture(tmp_path / "out")
    np.testing.assert_allclose([o.light.vector for o in capture.observations], LIGHTS)
    for observation, truth in zip(capture.observations, SCENE, strict=True):
        rgba = observation.read()
        assert (rgba[..., 3] == 1).all()
        np.testing.assert_allclose(rgba[..., :3], truth[..., None] * np.ones(3), atol=4e-4)
    result = json.loads(out)
    assert result["images"] == 5 and result["warnings"] == []
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["images"][1]["files"] == ["03.png", "04.png", "05.png"]
    assert report["images"][1]["exposures"] == [1, 4, 16]
    # The flat's own mean goes with the scale: gain × tint × what the vignette has at the card.
    ratio = np.array(report["white_gains"]) * TINT
    np.testing.assert_allclose(ratio, ratio[0], rtol=2e-3)


@pytest.mark.parametrize(
    "keys",
    [
        "crop = [2, 3, 20, 10]\nscale = 0.5\ncard_width = 120",
        "corners = [[1, 2], [30, 3], [31, 40], [2, 39]]",
        'corners = "auto"\ncard_distance = 4',
    ],
)
def test_a_capture_stays_framed(photographs, tmp_path, keys):
    rows = "".join(f'[[observation]]\nimage = "{k:02d}.png"\nlight_direction = [0, 0, 1]\n' for k in (1, 4))
    (photographs / "capture.toml").write_text(f"format = 1\n{keys}\n[[camera]]\nfov_degrees = 40\n{rows}")
    assert run_cli("develop", photographs / "capture.toml", "-o", tmp_path / "out")[0] == 0
    before, after = (read_spec(folder / "capture.toml") for folder in (photographs, tmp_path / "out"))
    assert (after.framing, after.card_distance) == (before.framing, before.card_distance)


def test_half_floats_and_a_plain_folder(photographs, tmp_path):
    for name in ("filenames.txt", "light_directions.txt"):
        (photographs / name).unlink()
    code, _, err = run_cli(
        "develop", photographs, "-o", tmp_path / "out", "--half", "--quiet", *everything(photographs)
    )
    assert (code, err) == (0, "")
    assert (tmp_path / "out" / "filenames.txt").read_text().split() == [f"{3 * k:02d}.exr" for k in range(5)]
    channels = read_exr(tmp_path / "out" / "06.exr")[""]
    assert set(channels) == set("RGB") and channels["R"].dtype == np.float16
    np.testing.assert_allclose(channels["G"].astype(float), SCENE[2], atol=1e-3)


def test_pixels_clipped_in_every_exposure_have_weight_0(photographs, tmp_path):
    light = SCENE[0][..., None] * np.ones(3)
    light[20:24, 20:24] = 9
    for i, (_, below) in enumerate(TIMES):
        write(photographs / f"{i:02d}.png", light * (240 / below) / BRIGHT, TIMES[i])
    code, _, err = run_cli("develop", photographs, "-o", tmp_path / "out", "--brackets", "exif", "--quiet")
    assert (code, err) == (0, "")
    weight = read_capture(tmp_path / "out").observations[0].read()[..., 3]
    expected = np.ones((SIZE, SIZE))
    expected[20:24, 20:24] = 0
    np.testing.assert_array_equal(weight, expected)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["images"][0]["without_weight"] == pytest.approx(16 / SIZE**2, abs=1e-6)


def test_frames_of_different_exposures_are_scaled_to_the_shortest(photographs, tmp_path):
    for k in range(5):
        for i in (0, 2) if k % 2 else (1, 2):
            (photographs / f"{3 * k + i:02d}.png").unlink()
    names = [p.name for p in sorted(photographs.glob("*.png"))]
    (photographs / "filenames.txt").write_text("".join(f"{name}\n" for name in names))
    dark = photographs / "dark"
    code, _, err = run_cli(
        "develop", photographs, "-o", tmp_path / "out", "--exposure", "exif", "--dark", dark, "--quiet"
    )
    assert (code, err) == (0, "")
    for observation, truth in zip(read_capture(tmp_path / "out").observations, SCENE, strict=True):
        expected = truth[..., None] * TINT * VIGNETTE[..., None] / BRIGHT
        np.testing.assert_allclose(observation.read()[..., :3], expected, atol=2e-5)


def test_a_response_curve_of_brackets_makes_8_bit_files_linear(photographs, tmp_path):
    def curve(light):  # a picture profile that is not sRGB's
        return light**0.6 * (1.3 - 0.3 * light)

    (tmp_path / "wedge").mkdir()
    wedge = np.exp(np.linspace(np.log(0.01), np.log(20), SIZE**2)).reshape(SIZE, SIZE, 1) * np.ones(3)
    for i in range(6):
        write(tmp_path / "wedge" / f"{i}.png", wedge * 2.0 ** (i - 5), (1, 2 ** (5 - i)), 8, curve)
    write(tmp_path / "wedge" / "mask.png", np.ones((SIZE, SIZE, 3)), None)  # no photograph
    code, out, _ = run_cli("response", tmp_path / "wedge", "-o", tmp_path / "camera.toml", "--json")
    assert code == 0 and json.loads(out)["residual"] < 0.02
    for k, frame in enumerate(SCENE):
        write(photographs / f"{3 * k + 1:02d}.png", frame[..., None] * np.ones(3), TIMES[1], 8, curve)
    run = "develop", photographs, "-o", tmp_path / "out", "--response", tmp_path / "camera.toml", "--quiet"
    assert run_cli(*run)[0] == 0
    found = np.stack([o.read()[..., 1] for o in read_capture(tmp_path / "out").observations])
    lit = SCENE > 0.05
    ratio = found[lit] / SCENE[lit]
    assert np.abs(ratio / np.median(ratio) - 1).mean() < 0.01


def test_grey_patches_give_develop_the_curve(photographs, tmp_path):
    chart = np.zeros((SIZE, SIZE, 3))
    reflectances = (0.04, 0.18, 0.5, 0.9)
    for n, r in enumerate(reflectances):
        chart[30:40, 10 * n : 10 * n + 9] = r
    write(photographs / "chart.png", chart, TIMES[1], 8, lambda v: v ** (1 / 1.8))
    for k, frame in enumerate(SCENE):
        write(
            photographs / f"{3 * k + 1:02d}.png", frame[..., None] * np.ones(3), TIMES[1], 8, lambda v: v ** (1 / 1.8)
        )
    patches = [f"{10 * n},{SIZE - 40},9,10={r}" for n, r in enumerate(reflectances)]
    options = [word for patch in patches for word in ("--grey-card", patch)]
    code, _, err = run_cli(
        "develop", photographs, "-o", tmp_path / "out", "--chart", photographs / "chart.png", *options
    )
    assert code == 0, err
    found = np.stack([o.read()[..., 1] for o in read_capture(tmp_path / "out").observations])
    np.testing.assert_allclose(found, SCENE, atol=0.01)
    code, _, err = run_cli("response", photographs / "chart.png", "-o", tmp_path / "camera.toml", *options)
    assert code == 0 and (tmp_path / "camera.toml").exists()


def test_shifted_frames_are_moved_onto_the_reference(tmp_path):
    rng = np.random.default_rng(5)
    folder = tmp_path / "capture"
    folder.mkdir()
    texture = 0.3 + 0.5 * np.kron(rng.random((20, 20)), np.ones((8, 8)))
    moves = [(0, 0), (2, -1), (0, 3), (-1, 0), (0, 0)]
    for k, (right, up) in enumerate(moves):
        part = texture[16 - up : 112 - up, 16 - right : 112 - right]
        write(folder / f"{k}.png", part[..., None] * np.ones(3) * LIGHTS[k][2], TIMES[1])
    (folder / "filenames.txt").write_text("".join(f"{k}.png\n" for k in range(5)))
    np.savetxt(folder / "light_directions.txt", LIGHTS)
    code, _, _ = run_cli("develop", folder, "-o", tmp_path / "out", "--register", "--reference", "3.png", "--quiet")
    assert code == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    found = np.array([image["shift"] for image in report["images"]])
    np.testing.assert_allclose(found, np.array(moves) - moves[3], atol=0.03)
    frames = [o.read() for o in read_capture(tmp_path / "out").observations]
    expected = texture[16:112, 17:113]
    for k, frame in enumerate(frames):
        inside = frame[4:-4, 4:-4]
        assert (inside[..., 3] == 1).all()
        assert np.abs(inside[..., 0] - LIGHTS[k][2] * expected[4:-4, 4:-4]).mean() < 0.01


def test_wide_steps_give_a_warning(tmp_path):
    (tmp_path / "brackets").mkdir()
    wedge = np.exp(np.linspace(np.log(0.01), np.log(20), 400)).reshape(20, 20, 1) * np.ones(3)
    for i in range(3):
        write(tmp_path / "brackets" / f"{i}.png", wedge * 8.0 ** (i - 2), (1, 8 ** (2 - i)))
    code, _, err = run_cli("response", tmp_path / "brackets", "-o", tmp_path / "a.toml", "--quiet")
    assert code == 0 and "exposures are 3.0 stops apart" in err


def test_dark_flat_and_chart_have_the_encoding_that_the_capture_states(photographs, tmp_path):
    for path in photographs.rglob("*.png"):  # 8-bit files of linear values, as no file states
        codes = np.rint(decode_png(path).values[::-1] * 255).astype(int)
        write_png(path, codes, 8)
    row = '[[observation]]\nimage = "{:02d}.png"\nlight_direction = [0, 0, 1]\n'
    rows = "[[camera]]\nfov_degrees = 40\n" + "".join(row.format(3 * k + 1) for k in range(len(LIGHTS)))
    table = photographs / "capture.toml"
    table.write_text(f'format = 1\ncolour_space = "linear"\n{rows}')
    frames = "--dark", photographs / "dark" / "1.png", "--flat", photographs / "flat", "--quiet"
    assert run_cli("develop", table, "-o", tmp_path / "out", *frames)[::2] == (0, "")
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["dark"]["mean"] == [pytest.approx(round(OFFSET * 255) / 255, abs=1e-6)]
    assert read_corrections(tmp_path / "out" / "corrections")[0].colour_space == "linear"
    found = [observation.read() for observation in read_capture(tmp_path / "out").observations]
    np.testing.assert_allclose(found[0][..., 1] / TINT[1] / VIGNETTE.mean(), SCENE[0], atol=0.02)
    table.write_text(f'format = 1\n{rows}colour_space = "linear"\n')
    code, _, err = run_cli("develop", table, "-o", tmp_path / "mixed", *frames)
    assert code == 2 and err.count("\n") == 1 and 'has colour_space "linear" where' in err
    assert run_cli("develop", table, "-o", tmp_path / "mixed", "--quiet")[0] == 0  # each in its own encoding


def test_8_bit_png_files_that_state_to_be_linear_are(tmp_path):
    (tmp_path / "in").mkdir()
    write_png(tmp_path / "in" / "a.png", np.full((4, 6, 3), 102), 8, chunk(b"gAMA", (100_000).to_bytes(4, "big")))
    assert run_cli("develop", tmp_path / "in", "-o", tmp_path / "out", "--quiet")[0] == 0
    np.testing.assert_allclose(read_exr(tmp_path / "out" / "a.exr")[""]["G"], 102 / 255, atol=1e-6)


@pytest.mark.parametrize("first", [0, 1])
def test_dark_frames_of_numbered_exposures_go_with_their_own(tmp_path, first):
    folder, offsets = tmp_path / "in", (0.01, 0.03, 0.12)
    (folder / "dark").mkdir(parents=True)
    for i, offset in enumerate(offsets):
        for name, light in (("a", SCENE[0]), ("b", SCENE[1])):
            write(folder / f"{name}_{i + first}.png", light[..., None] * np.ones(3) * 4**i / 20 + offset, None)
        write(folder / "dark" / f"dark_{i + first}.png", np.full((SIZE, SIZE, 3), offset), None)
    options = "--brackets", "names", "--exposures", "1,4,16", "--quiet", "--dark"
    assert run_cli("develop", folder, "-o", tmp_path / "out", *options, folder / "dark")[0] == 0
    found = read_exr(tmp_path / "out" / "b.exr")[""]["G"]
    np.testing.assert_allclose(found, SCENE[1] / 20, atol=2e-5)
    write(folder / "dark" / "dark.png", np.full((SIZE, SIZE, 3), 0.01), None)
    code, _, err = run_cli("develop", folder, "-o", tmp_path / "none", *options, folder / "dark")
    assert code == 2 and err.count("\n") == 1 and "dark.png: its name does not tell which of the --exposures" in err
    # One alone, without a number, is that of all exposures.
    assert run_cli("develop", folder, "-o", tmp_path / "one", *options, folder / "dark" / "dark.png")[0] == 0


def test_the_current_folder_is_an_output(photographs, tmp_path, monkeypatch):
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    place = here.stat().st_ino
    assert run_cli("develop", photographs, "-o", ".", "--quiet", *everything(photographs))[::2] == (0, "")
    assert here.stat().st_ino == place and len(read_capture(here).observations) == 5
    assert not list(tmp_path.glob(".*"))


def linear_ball(folder):
    """Write 24 linear 8-bit photographs of a matt ball, which state no encoding, and their lights."""
    folder.mkdir()
    lights = dome_lights(24, 65)
    names = [f"{k:02d}.png" for k in range(len(lights))]
    for name, frame in zip(names, shade(NORMALS, lights), strict=True):
        write_png(folder / name, np.rint(255 * np.repeat(frame[::-1, :, None], 3, axis=2)).astype(int))
    (folder / "filenames.txt").write_text("\n".join(names))
    np.savetxt(folder / "light_directions.txt", lights)
    return folder


def test_files_without_a_stated_encoding_come_out_as_a_recovery_reads_them(tmp_path):
    folder, out = linear_ball(tmp_path / "capture"), tmp_path / "out"
    code, _, err = run_cli("develop", folder, "-o", out)
    assert code == 0 and "read as linear values" in err and "set --colour-space srgb" in err
    for one, other in zip(read_capture(folder, decode_png).observations, read_capture(out).observations, strict=True):
        np.testing.assert_allclose(other.read(), one.read(), atol=1e-6)
    assert 'colour_space = "linear"' in (out / "corrections" / "corrections.toml").read_text()


def test_a_response_curve_reads_files_in_place_of_the_encodings_test(tmp_path):
    linear_ball(tmp_path / "capture")
    curve = tmp_path / "curve.csv"
    curve.write_text("0 0\n1 1\n")
    code, _, err = run_cli("develop", tmp_path / "capture", "-o", tmp_path / "out", "--response", curve)
    assert code == 0 and "linear values" not in err


def test_the_list_camera_and_mask_of_a_plain_folder_go_along(photographs, tmp_path):
    (photographs / "light_directions.txt").unlink()
    (photographs / "filenames.txt").write_text("07.png\n01.png\n")
    (photographs / "camera.toml").write_text("fov_degrees = 30\n")
    write_png(photographs / "Mask.png", np.full((SIZE, SIZE, 1), 255))
    out = tmp_path / "out"
    assert run_cli("develop", photographs, "-o", out, "--quiet")[::2] == (0, "")
    assert (out / "filenames.txt").read_text().split() == ["07.exr", "01.exr"]
    for name in ("camera.toml", "Mask.png"):
        assert (out / name).read_bytes() == (photographs / name).read_bytes()
    merged = tmp_path / "merged"
    assert run_cli("develop", photographs, "-o", merged, "--brackets", "exif", "--quiet")[::2] == (0, "")
    report = json.loads((merged / "report.json").read_text())
    assert [image["files"] for image in report["images"]] == [
        [f"{k}.png" for k in row] for row in (("06", "07", "08"), ("00", "01", "02"))
    ]  # in the list's order, which is that of the lights


def test_a_flat_field_of_another_kind_of_file_has_its_own_encoding(photographs, tmp_path):
    linear = tmp_path / "linear"  # a capture of EXRs, which states that they are linear
    assert run_cli("develop", photographs, "-o", linear, "--quiet")[0] == 0
    encoded = np.where(VIGNETTE > 0.0031308, 1.055 * VIGNETTE ** (1 / 2.4) - 0.055, 12.92 * VIGNETTE)
    write_png(tmp_path / "flat.png", np.rint(255 * np.repeat(encoded[::-1, :, None], 3, axis=2)).astype(int))
    assert run_cli("develop", linear, "-o", tmp_path / "out", "--flat", tmp_path / "flat.png", "--quiet")[0] == 0
    before, after = (read_capture(folder).observations[2].read()[..., 1] for folder in (linear, tmp_path / "out"))
    ratio = (before / after / VIGNETTE)[before > 0.1]
    low, high = np.percentile(ratio, [5, 95])  # clipped pixels stay as they are
    assert high < 1.02 * low
