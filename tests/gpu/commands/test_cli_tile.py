"""``irpso tile``: a card's result becomes one that repeats, which the other commands read."""

import json

import numpy as np
import pytest

from irpso_addon.capture.images.exr import read_exr
from irpso_addon.exports.result import read_result
from tests.builders.command_line import run_cli, write_card

LIGHTS = [(0.4, 0, 0.9), (-0.3, 0.3, 0.9), (0, -0.4, 0.9), (0.2, 0.3, 0.93)]


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """A result of a card of 48 × 40 texels, with its relief."""
    folder = tmp_path_factory.mktemp("tile")
    random = np.random.default_rng(0)
    images = np.repeat(random.uniform(0.2, 0.4, (1, 40, 48, 3)), len(LIGHTS), axis=0)
    card = write_card(folder / "leaf", images, LIGHTS)
    code, _, err = run_cli("recover", card, "-o", folder / "out", "--model", "lambert", "--preset", "swarm",
                           "--iterations", 1, "--height", "--quiet")  # fmt: skip
    assert code == 0, err
    return folder / "out"


def test_all_maps_and_the_relief_repeat_and_are_a_result(result, tmp_path):
    code, out, err = run_cli("tile", result, "-o", tmp_path / "tiled", "--size", 32, "--json")
    assert code == 0, err
    reply = json.loads(out)
    assert reply["square"][2] == 40 and reply["seam"] < reply["seam_of_plain_repetition"] * 1.5
    found = read_result(tmp_path / "tiled")
    assert found.maps.solved.shape == (32, 32) and found.height is not None
    assert (tmp_path / "tiled" / "repeated.png").is_file() and (tmp_path / "tiled" / "material.blend").is_file()
    (height,) = read_exr(tmp_path / "tiled" / "height.exr").values()
    assert abs(next(iter(height.values())).mean()) < 1e-4
    code, _, err = run_cli("export", tmp_path / "tiled", "--format", "textures", "-o", tmp_path / "textures", "--quiet")
    assert code == 0, err


def test_the_relief_of_a_card_is_exported_as_a_body(result, tmp_path):
    code, out, err = run_cli(
        "export", result, "--format", "relief", "-o", tmp_path / "leaf.stl", "--width", 60, "--json"
    )
    assert code == 0, err
    assert json.loads(out)["width"] == 60 and (tmp_path / "leaf.stl").stat().st_size > 84


def test_what_cannot_repeat_is_refused_and_nothing_is_written(result, tmp_path):
    def refused(*options):
        code, _, err = run_cli("tile", *options)
        assert code == 2 and err.count("irpso: ") == 1 and not (tmp_path / "tiled").exists()
        return err

    out = ("-o", tmp_path / "tiled")
    assert "is the result itself" in refused(result, "-o", result)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "material.blend").write_bytes(b"mine")
    assert "material.blend: would be replaced, but no recovery wrote it" in refused(result, "-o", tmp_path / "mine")
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["material.blend"]
    assert "--size 5" in refused(result, *out, "--size", 5)
    assert "--overlap 0.9" in refused(result, *out, "--overlap", 0.9)
    mesh = tmp_path / "mesh"
    mesh.mkdir()
    for path in result.iterdir():
        (mesh / path.name).write_bytes(path.read_bytes())
    report = json.loads((result / "report.json").read_text())
    report["settings"]["blend"] = "head.blend"
    (mesh / "report.json").write_text(json.dumps(report))
    assert "those of a mesh, which cannot repeat" in refused(mesh, *out)
