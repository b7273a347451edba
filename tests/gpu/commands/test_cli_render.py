"""``render``: which maps it takes, refuses and warns of, on a square that fills its UV square and the picture."""

import json

import numpy as np
import pytest

from irpso_addon.capture.images.exr import write_exr
from tests.builders import command_line as cli_maker
from tests.builders.command_line import read_map, run_cli

SIDE = 8
CORNERS = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
BASE = np.full((SIDE, SIDE, 3), 0.5, np.float32)
NORMAL = np.broadcast_to(np.float32([0, 0, 1]), (SIDE, SIDE, 3))


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene")
    np.savetxt(folder / "lights.txt", [(0.5, 0.2, 1)])

    def square(bpy):
        cli_maker.add_mesh(bpy, "Square", CORNERS, [(0, 1, 2, 3)], [(0, 0), (1, 0), (1, 1), (0, 1)])
        cli_maker.add_camera(bpy, type="ORTHO", ortho_scale=2.0)

    cli_maker.save_scene(folder / "scene.blend", square)
    return folder


def write_parts(path, parts):
    """Write name → (H, W, C) as parts of an EXR; return its path."""
    channels = {name: "Y" if value.shape[-1] == 1 else "RGB" for name, value in parts.items()}
    split = {n: {c: np.float32(parts[n][..., i]) for i, c in enumerate(names)} for n, names in channels.items()}
    write_exr(path, split)
    return path


def render(scene, maps, out, *words):
    """Return exit code and standard error of ``render`` under one light."""
    code, _, err = run_cli(
        "render", maps, "--blend", scene / "scene.blend", "--lights", scene / "lights.txt",
        "--size", f"{SIDE}x{SIDE}", "-o", out, "--quiet", *words,
    )  # fmt: skip
    return code, err


def grain(value):
    """A third channel, of zeros, as a result's maps of two numbers have."""
    return np.broadcast_to(np.float32([*value, 0]), (SIDE, SIDE, 3))


def test_a_file_of_a_result_is_rendered_with_the_result_s_model(scene, tmp_path):
    result = tmp_path / "result"
    result.mkdir()
    parts = {"base_color": BASE, "normal": NORMAL, "anisotropy": grain((0.2, 0.6)), "coverage": BASE[..., :1]}
    write_parts(result / "maps.exr", parts)
    (result / "report.json").write_text(json.dumps({"model": "anisotropic", "files": ["maps.exr"]}), encoding="utf-8")
    pictures = []
    for maps, name in ((result, "a"), (result / "maps.exr", "b")):
        assert render(scene, maps, tmp_path / name) == (0, "")
        pictures.append(read_map(tmp_path / name / "000.exr"))
    np.testing.assert_array_equal(*pictures)


def test_maps_that_the_default_model_lacks_are_warned_of(scene, tmp_path):
    parts = {"base_color": BASE, "normal": NORMAL, "anisotropy": grain((0.2, 0.6)), "coverage": BASE[..., :1]}
    maps = write_parts(tmp_path / "other.exr", parts)
    code, err = render(scene, maps, tmp_path / "out")
    said = "irpso: warning: {}: anisotropy: model metallic_roughness has no such maps; give theirs by --model\n"
    assert (code, err) == (0, said.format(maps))
    assert render(scene, maps, tmp_path / "stated", "--model", "lambert") == (0, "")


TILTED = np.broadcast_to(np.float32([0.3, 0.2, 0.87**0.5]), (SIDE, SIDE, 3))
FIRST = np.arange(SIDE)[:, None, None] < SIDE // 2  # rows


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("normal", 0.5 * TILTED + 0.5, "normal: its vectors have the length 1."),
        ("roughness", np.full((SIDE, SIDE, 1), 102), "roughness: its values reach from 102 to 102; scale or clip them"),
        ("roughness", np.full((SIDE, SIDE, 1), -0.3), "roughness: its values reach from -0.3 to -0.3; scale or clip"),
        ("base_color", 256 * BASE, "base_color: its values reach from 128 to 128; scale or clip them to between 0 and"),
        ("base_color", np.where(FIRST, np.nan, BASE), "base_color: it holds values that are not finite; fill them"),
    ],
)
def test_maps_of_no_such_values_are_refused_with_nothing_written(name, values, said, scene, tmp_path):
    maps = write_parts(tmp_path / f"{name}_map.exr", {"": values})
    code, err = render(scene, maps, tmp_path / "out")
    assert code == 2 and err.startswith(f"irpso: {maps}: {said}") and err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_materials_that_no_search_finds_are_rendered_as_they_are(scene, tmp_path):
    pictures = []
    for value in (0.0, 0.22):  # the range of a search begins at 0.22
        lobes = np.broadcast_to(np.float32([value, 0.4, 0.5]), (SIDE, SIDE, 3))
        maps = write_parts(tmp_path / f"{value}.exr", {"normal": NORMAL, "roughness_lobes": lobes})
        assert render(scene, maps, tmp_path / f"{value}", "--model", "principled_two_lobe") == (0, "")
        pictures.append(read_map(tmp_path / f"{value}" / "000.exr"))
    assert np.isfinite(pictures).all() and np.abs(pictures[0] - pictures[1]).max() > 1e-4


@pytest.mark.parametrize(("solved", "warned"), [(SIDE, None), (SIDE - 1, None), (SIDE // 2, "25.0%")])
def test_filled_texels_that_show_are_warned_of(solved, warned, scene, tmp_path):
    coverage = np.broadcast_to(np.arange(SIDE)[:, None, None] < solved, (SIDE, SIDE, 1))
    maps = write_parts(tmp_path / "maps.exr", {"base_color": BASE, "normal": NORMAL, "coverage": coverage})
    code, err = render(scene, maps, tmp_path / "out", "--model", "lambert")
    said = "irpso: warning: the maps have no recovered value at {} of what shows, which is filled from other texels\n"
    assert (code, err) == (0, said.format(warned) if warned else "")
    picture = read_map(tmp_path / "out" / "000.exr")
    np.testing.assert_allclose(picture[..., :3], 0.5 / np.hypot(1, np.hypot(0.5, 0.2)), atol=1e-5)
