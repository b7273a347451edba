"""One damaged image of a capture: refused, or left out in one process, in a batch, over a resume and over ranks."""

import json
import shutil

import numpy as np
import pytest

from irpso_addon.capture.images.exr import read_exr
from tests.builders import command_line as cli_maker
from tests.builders import mpi as mpi_maker
from tests.builders.command_line import run_cli

SHAPE, COUNT, GONE = (11, 13), 9, 3
LIGHTS = cli_maker.dome_lights(COUNT, widest=60)
OPTIONS = ["--model", "lambert", "--preset", "swarm", "--iterations", 12, "--seed", 3, "--entry", "fragment"]


@pytest.fixture(scope="module")
def card(tmp_path_factory):
    """A capture whose fourth image is cut short."""
    images = cli_maker.render_oracle("lambert", cli_maker.smooth_maps(SHAPE, {}, seed=1), LIGHTS)
    folder = cli_maker.write_card(tmp_path_factory.mktemp("damaged") / "card", images, LIGHTS)
    path = folder / f"{GONE:03d}.exr"
    path.write_bytes(path.read_bytes()[:-40])
    return folder


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    """The maps of a capture that never had that image; observation 5 is held out, which is the 6th of the first."""
    folder = tmp_path_factory.mktemp("whole")
    images = cli_maker.render_oracle("lambert", cli_maker.smooth_maps(SHAPE, {}, seed=1), LIGHTS)
    keep = np.arange(COUNT) != GONE
    cli_maker.write_card(folder / "card", images[keep], LIGHTS[keep])
    assert run_cli("recover", folder / "card", *OPTIONS, "--hold-out", "5", "-o", folder / "out", "--quiet")[0] == 0
    return maps_of(folder / "out")


def maps_of(folder):
    return {name: np.stack(list(part.values())) for name, part in read_exr(folder / "maps.exr").items()}


def assert_same(folder, expected):
    found = maps_of(folder)
    assert set(found) == set(expected)
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values)


def test_a_damaged_image_is_refused_in_one_line_that_names_the_option(card, tmp_path):
    code, _, err = run_cli("recover", card, *OPTIONS, "-o", tmp_path / "out")
    assert code == 2 and not (tmp_path / "out").exists() and len(err.strip().splitlines()) == 1
    assert "003.exr: is cut short or damaged" in err and "--skip-damaged" in err
    code, out, _ = run_cli("inspect", card)
    assert code == 2 and "hint: --skip-damaged" in out
    code, out, _ = run_cli("inspect", card, "--skip-damaged")
    assert code == 0 and "8, 1 more left out" in out and "003.exr: is cut short" in out


def test_left_out_images_are_named_and_do_not_affect_the_maps(card, expected, tmp_path):
    out = tmp_path / "out"
    code, said, _ = run_cli("recover", card, *OPTIONS, "--hold-out", "6", "--skip-damaged", "-o", out)
    assert code == 0 and "warning: left out: " in said and "003.exr: is cut short" in said
    assert_same(out, expected)
    (one,) = json.loads((out / "report.json").read_text())["left_out"]
    assert (one["index"], one["image"]) == (GONE, str(card / "003.exr")) and "cut short" in one["why"]
    assert list(json.loads((out / "report.json").read_text())["relighting_psnr_db"]) == ["light 6"]
    assert run_cli("export", out, "--format", "textures", "-o", tmp_path / "textures")[0] == 0


def test_a_held_out_image_that_is_damaged_is_left_out_like_any_other(card, tmp_path):
    code, said, _ = run_cli("recover", card, *OPTIONS, "--hold-out", f"{GONE}", "--skip-damaged", "-o", tmp_path / "o")
    assert code == 0 and "003.exr" in said and "dB" not in said


def test_too_few_remaining_images_are_refused(card, tmp_path):
    shutil.copytree(card, tmp_path / "card")
    for k in range(2, COUNT):
        (tmp_path / "card" / f"{k:03d}.exr").unlink(missing_ok=True)
    code, _, err = run_cli("recover", tmp_path / "card", *OPTIONS, "--skip-damaged", "-o", tmp_path / "out")
    assert code == 2 and "has 2 lights; a normal needs at least three" in err and not (tmp_path / "out").exists()


def test_a_batch_leaves_damaged_images_out(card, expected, tmp_path):
    words = 'model = "lambert"\npreset = "swarm"\niterations = 12\nseed = 3\nentry = "fragment"\n'
    (tmp_path / "list.toml").write_text(
        f'[defaults]\n{words}skip_damaged = true\nhold_out = "6"\n'
        f'[[job]]\nname = "one"\ncapture = "{card.as_posix()}"\n'
    )
    code, said, _ = run_cli("batch", tmp_path / "list.toml", "-o", tmp_path / "out", "--json")
    assert code == 0, said
    assert_same(tmp_path / "out" / "one", expected)
    assert "left out" in str(json.loads(said)["jobs"][0]["result"]["warnings"])


def test_a_resumed_run_leaves_the_same_image_out(card, expected, tmp_path, monkeypatch):
    from irpso_addon.solver.engine.recovery import Recovery

    step, out = Recovery.step, tmp_path / "out"

    def interrupted(self, *arguments, **options):
        if self.progress.iteration >= 3:
            raise KeyboardInterrupt
        return step(self, *arguments, **options)

    words = ["recover", card, *OPTIONS, "--hold-out", "6", "--skip-damaged", "--checkpoint-every", 0, "-o", out]
    with monkeypatch.context() as patched:
        patched.setattr(Recovery, "step", interrupted)
        assert run_cli(*words, "--quiet")[0] == 130
    assert (out / "checkpoint.npz").is_file()
    assert run_cli(*words, "--quiet", "--resume")[0] == 0
    assert_same(out, expected)


@mpi_maker.needs_mpi()
def test_ranks_leave_out_the_same_image(card, expected, tmp_path):
    words = ["recover", card, *OPTIONS, "--hold-out", "6", "-o", tmp_path / "out", "--json"]
    code, report, err = mpi_maker.run(2, *words)
    assert code == 2 and err.count("--skip-damaged") == 1
    code, report, err = mpi_maker.run(2, *words, "--skip-damaged")
    assert code == 0, err
    assert [one["index"] for one in report["left_out"]] == [GONE]
    assert_same(tmp_path / "out", expected)


@pytest.mark.parametrize("count", [1, 2])
def test_one_or_two_lights_are_enough_where_the_normal_is_given(tmp_path, count):
    values = cli_maker.smooth_maps(SHAPE, {}, seed=1, tilt=0.0)
    images = cli_maker.render_oracle("lambert", values, LIGHTS[:count])
    card = cli_maker.write_card(tmp_path / "card", images, LIGHTS[:count])
    words = ["recover", card, *OPTIONS, "-o", tmp_path / "out", "--quiet"]
    code, _, err = run_cli(*words)
    assert code == 2 and f"has {count} light{'s' * (count > 1)}; a normal needs at least three; or give" in err
    assert run_cli(*words, "--fixed", "normal=0,0,1")[0] == 0
    found = cli_maker.read_map(tmp_path / "out" / "base_color.exr")
    np.testing.assert_allclose(found, values["base_color"], atol=2e-3)
