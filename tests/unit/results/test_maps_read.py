"""Maps read from EXR files of one part, which name their map by the part or by the file."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from irpso_addon.capture.images.exr import write_exr
from irpso_addon.core.errors import InputError
from irpso_addon.reflectance.model import Parameter, ReflectanceModel, load_model
from irpso_addon.results.map_tables import MapTable
from irpso_addon.results.read import read_maps, read_parameter

MODEL = ReflectanceModel(
    "coated", "Coated", Path("coated.glsl"),
    (Parameter("coat", map="coat"), Parameter("coat_roughness", map="coat_roughness")),
)  # fmt: skip


@pytest.mark.parametrize(
    ("stem", "part", "found"),
    [
        ("coat_roughness_truth", "", "coat_roughness"),
        ("coat_truth", "", "coat"),
        ("coat_roughness", "coat_roughness", "coat_roughness"),
        ("coat_roughness_former", "coat", "coat"),
    ],
)
def test_a_file_of_one_part_is_one_map_though_two_names_begin_its_own(stem, part, found, tmp_path):
    write_exr(tmp_path / f"{stem}.exr", {part: {"Y": np.full((4, 4), 0.3, np.float32)}})
    values = read_maps(tmp_path / f"{stem}.exr", MODEL)
    assert set(values) == {found}
    np.testing.assert_array_equal(values[found], np.full((4, 4, 1), 0.3, np.float32))


def test_a_file_of_one_part_that_names_no_map_is_refused(tmp_path):
    write_exr(tmp_path / "truth.exr", {"": {"Y": np.zeros((4, 4), np.float32)}})
    with pytest.raises(InputError, match="holds no map of model coated"):
        read_maps(tmp_path / "truth.exr", MODEL)


@pytest.mark.parametrize("space", ["world", "object"])
def test_normals_of_another_space_are_not_those_of_the_tangent_space(space, tmp_path):
    turned = {axis: np.full((4, 4), value, np.float32) for axis, value in zip("RGB", (0.6, 0.0, 0.8), strict=True)}
    write_exr(tmp_path / f"normal_{space}.exr", {f"normal_{space}": turned})
    with pytest.raises(InputError, match=rf"normal_{space}\.exr: holds no map of model lambert"):
        read_maps(tmp_path / f"normal_{space}.exr", load_model("lambert"))


@pytest.mark.parametrize("names", ["rgb", ("red", "green", "blue"), ("Combined.R", "Combined.G", "Combined.B")])
def test_channels_of_other_names_are_refused_and_not_taken_in_their_alphabets_order(names, tmp_path):
    colour = dict(zip(names, np.float32([0.8, 0.4, 0.1])[:, None, None] * np.ones((4, 4), np.float32), strict=True))
    write_exr(tmp_path / "colour.exr", {"": colour})
    with pytest.raises(InputError, match=r"colour.exr: has the channels .*; save it as R, G, B"):
        read_parameter(tmp_path / "colour.exr", load_model("lambert"), "base_color")


def test_a_grey_picture_with_a_coloured_margin_is_one_number(tmp_path):
    grey = np.random.default_rng(0).uniform(0.2, 0.8, (10, 10)).astype(np.float32)
    padded = {channel: np.where(np.arange(10) < 3, channel != "G", grey).astype(np.float32) for channel in "RGB"}
    write_exr(tmp_path / "roughness.exr", {"": padded})
    found = read_parameter(tmp_path / "roughness.exr", load_model("principled"), "roughness")
    np.testing.assert_array_equal(found[..., 0], padded["R"])


def test_a_grey_picture_is_the_fourth_number_of_a_map_and_its_alpha_is_none():
    colour = Parameter("paint", components=3, map="paint")
    table = MapTable("paint", (colour, Parameter("wear", map="paint")))
    grey = np.full((2, 2, 4), 0.3, np.float32)
    grey[..., 3] = 1
    np.testing.assert_array_equal(table.channels_of("wear", grey, "grey"), np.full((2, 2, 1), 0.3, np.float32))
    own = grey * np.float32([1, 1, 1, 0.6])
    np.testing.assert_array_equal(table.channels_of("wear", own, "own"), np.full((2, 2, 1), 0.6, np.float32))


# ACEScg (Academy S-2014-004) to linear sRGB, of the Academy's OpenColorIO configuration.
ACES_CG = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
MATRIX = np.array([(1.70505, -0.62179, -0.08326), (-0.13026, 1.14080, -0.01055), (-0.02400, -0.12897, 1.15297)])


@pytest.mark.parametrize("stated", [{"chromaticities": ACES_CG}, {"colorInteropID": "lin_ap1_scene"}])
def test_colours_of_stated_primaries_become_rec_709_and_other_maps_stay(stated, tmp_path):
    values = np.random.default_rng(4).uniform(0.2, 0.9, (4, 6, 3)).astype(np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **stated}
    for name in ("base_color", "normal"):
        OpenEXR.File(header, {"RGB": np.ascontiguousarray(values[::-1])}).write(str(tmp_path / f"{name}.exr"))
    model, path = load_model("lambert"), tmp_path / "base_color.exr"
    for found in (read_maps(path, model)["base_color"], read_parameter(path, model, "base_color")):
        np.testing.assert_allclose(found, values @ MATRIX.T, atol=3e-5)
        assert found.dtype == np.float32
    np.testing.assert_array_equal(read_maps(tmp_path / "normal.exr", model)["normal"], values)
