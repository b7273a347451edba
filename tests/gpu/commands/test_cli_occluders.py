"""``recover --occluder``: what stands before the mesh is not taken for it, and a resumed run has the same there."""

import json

import pytest

from tests.builders import command_line as cli_maker
from tests.builders.command_line import add_mesh, run_cli, save_scene

SQUARE = [(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1)]
POST = [(-1, -1, -0.5), (0, -1, -0.5), (0, 1, -0.5), (-1, 1, -0.5)]  # before the left half
UNIT = [(0, 0), (1, 0), (1, 1), (0, 1)]
LIGHTS = cli_maker.dome_lights(8)
TEXELS = 16


def scene(bpy):
    add_mesh(bpy, "square", SQUARE, [(0, 1, 2, 3)], UNIT)
    add_mesh(bpy, "post", POST, [(0, 1, 2, 3)])


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The folder of a capture of a card, as if it showed a square, and of a scene with something before it."""
    folder = tmp_path_factory.mktemp("occluders")
    images = cli_maker.render_oracle("lambert", cli_maker.smooth_maps((24, 24), {}), LIGHTS)
    cli_maker.write_card(folder / "card", images, LIGHTS)
    save_scene(folder / "scene.blend", scene)
    return folder


def recover(files, out, *more):
    code, printed, _ = run_cli(
        "recover", files / "card", "--model", "lambert", "--preset", "swarm", "--iterations", 3, "--resolution",
        TEXELS, "--blend", files / "scene.blend", "--object", "square", "-o", out, "--json", *more,
    )  # fmt: skip
    return code, json.loads(printed.splitlines()[-1])


def test_texels_behind_an_occluder_are_in_no_photograph(files, tmp_path):
    code, free = recover(files, tmp_path / "free")
    rim = free["unseen_texels"]  # the image ends half a pixel before the square does
    assert code == 0 and rim <= 4 * TEXELS
    code, hidden = recover(files, tmp_path / "hidden", "--occluder", "post")
    assert code == 0 and abs(hidden["unseen_texels"] - rim - (TEXELS**2 - rim) / 2) <= TEXELS


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("pole", "--occluder pole: there is no such object in scene 'Scene'"),
        ("square", "--occluder square: is the mesh that is recovered"),
    ],
)
def test_a_name_that_is_no_occluder_is_refused(files, tmp_path, name, said):
    code, printed = recover(files, tmp_path / "out", "--occluder", "post", "--occluder", name)
    assert code == 2 and said in printed["error"]
    assert not (tmp_path / "out").exists()


def test_an_occluder_of_a_card_is_refused(files, tmp_path):
    code, printed, _ = run_cli("recover", files / "card", "--occluder", "post", "-o", tmp_path / "out", "--json")
    assert code == 2 and "--occluder is for meshes" in json.loads(printed.splitlines()[-1])["error"]
