"""UDIM tiles: which a triangle lies in, where it comes to lie, and which files belong to them; slots by name."""

import numpy as np
import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.core.udim import tile_files, tile_number, tile_place, tile_stem
from irpso_addon.geometry.surface.slots import overlapping_slots, slots_of_text
from irpso_addon.geometry.surface.udim import lay_out, layout_size
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import Maps, split_maps

CORNER = np.float32([(0, 0), (1, 0), (0, 1)])
NAMES = ("Skin", "Eyes, left", "slot 2", "Skin")


def triangles(*places, size=1.0):
    """Return right-angled triangles (T, 3, 2) whose right angles lie at these places."""
    return np.float32([CORNER * np.float32(size) + np.float32(place) for place in places])


def test_numbers_are_those_of_mari_and_blender():
    assert [tile_number(*place) for place in ((0, 0), (1, 0), (9, 0), (0, 1), (3, 2), (9, 99))] == [
        1001, 1002, 1010, 1011, 1024, 2000,
    ]  # fmt: skip
    assert [tile_place(number) for number in (1001, 1010, 1011, 2000)] == [(0, 0), (9, 0), (0, 1), (9, 99)]


def test_tiles_stand_side_by_side_in_the_order_of_their_numbers():
    tiles, uvs = lay_out("map", triangles((0, 2), (4, 0), (0.25, 0.5), size=0.5))
    assert tiles == (1001, 1005, 1021)
    half = CORNER * 0.5
    expected = [(half + (2, 0)) / (3, 1), (half + (1, 0)) / (3, 1), (half + (0.25, 0.5)) / (3, 1)]
    np.testing.assert_allclose(uvs, expected, atol=1e-7)


def test_the_unit_square_alone_is_unchanged_and_another_tile_moves_to_it():
    uvs = np.random.default_rng(0).random((50, 3, 2)).astype(np.float32)
    tiles, same = lay_out("map", uvs)
    assert tiles == (1001,) and same is uvs
    tiles, moved = lay_out("map", triangles((2, 1)))
    assert tiles == (1013,)
    np.testing.assert_array_equal(moved, triangles((0, 0)))


def test_a_coordinate_on_a_border_belongs_to_the_tile_of_the_rest_of_its_triangle():
    whole = np.float32([(0, 0), (1, 0), (1, 1)])
    tiles, uvs = lay_out("map", np.stack([whole, whole + (1, 0), whole + np.float32([1, 1])]).astype(np.float32))
    assert tiles == (1001, 1002, 1012)
    np.testing.assert_allclose(uvs * (3, 1), np.stack([whole, whole + (1, 0), whole + (2, 0)]), atol=1e-6)


def test_rounding_past_a_border_and_triangles_without_area_make_no_tile():
    sliver = np.float32([(1, 0), (1.000005, 0), (1, 1)])
    collapsed = np.full((3, 2), 1.5, np.float32)
    tiles, uvs = lay_out("map", np.stack([triangles((0, 0))[0], sliver, collapsed]))
    assert tiles == (1001,)
    assert lay_out("map", np.stack([triangles((0, 0))[0], collapsed - 3]))[0] == (1001,)
    tiles, uvs = lay_out("map", np.stack([triangles((0, 0))[0], triangles((1, 0))[0], collapsed + 3]))
    assert tiles == (1001, 1002) and not np.ptp(uvs[2], axis=0).any() and uvs.min() >= 0 and uvs.max() <= 1


@pytest.mark.parametrize(
    ("places", "said"),
    [
        ([(0.5, 0), (0, 0), (1, 0.25)], "2 of 3 triangles do not lie in one UDIM tile .* 2 cross a border"),
        ([(-1, 0), (0, 0)], r"1 of 2 triangles do not lie .*\(u -1 to 1, v 0 to 1; 0 cross"),
        ([(0, -0.5)], "1 of 1 triangles"),
        ([(10, 0), (0, 100), (9, 99)], "2 of 3 triangles .* 0 cross"),
    ],
)
def test_triangles_across_or_outside_tiles_are_counted_and_refused(places, said):
    with pytest.raises(InputError, match=f"UV map: {said}.*or pack all into the unit square"):
        lay_out("UV map", triangles(*places))


def test_a_set_too_wide_for_the_random_numbers_is_refused_with_the_remedy():
    assert layout_size((1001, 1002), 32, 8) == (64, 8)
    assert layout_size(tuple(range(1001, 1016)), 4096, 4096) == (61440, 4096)
    with pytest.raises(InputError, match="16 UDIM tiles of 4096 texels are 65536 side by side; the limit is 65535"):
        layout_size(tuple(range(1001, 1017)), 4096, 4096)


def test_maps_are_split_into_their_tiles_and_numbers_stay_numbers():
    values = {"base_color": np.arange(2 * 6 * 3).reshape(2, 6, 3).astype(np.float32), "normal": np.float32((0, 0, 1))}
    covered = np.arange(12).reshape(2, 6) % 2 == 0
    maps = Maps(
        load_model("lambert"), values, covered, covered * 1.0, {"base_color": values["base_color"]}, (1001, 1004),
        alternatives={"roughness": values["base_color"][..., :1]}, two_modes={"roughness": covered},
    )  # fmt: skip
    (one, left), (two, right) = split_maps(maps)
    assert (one, two) == (1001, 1004) and left.tiles == (1001,)
    for part, columns in ((left, slice(0, 3)), (right, slice(3, 6))):
        np.testing.assert_array_equal(part.values["base_color"], values["base_color"][:, columns])
        np.testing.assert_array_equal(part.solved, covered[:, columns])
        np.testing.assert_array_equal(part.residual, covered[:, columns])
        np.testing.assert_array_equal(part.confidence["base_color"], values["base_color"][:, columns])
        np.testing.assert_array_equal(part.alternatives["roughness"], values["base_color"][:, columns, :1])
        np.testing.assert_array_equal(part.two_modes["roughness"], covered[:, columns])
        assert part.values["normal"].shape == (3,)


def test_files_are_found_by_their_pattern_or_by_one_of_their_numbers(tmp_path):
    for number in (1001, 1002, 1011):
        (tmp_path / f"a.{number}.exr").touch()
    wanted = [tmp_path / "a.1001.exr", tmp_path / "a.1011.exr"]
    assert tile_files(tmp_path / "a.<UDIM>.exr", (1001, 1011)) == wanted
    assert tile_files(tmp_path / "a.1002.exr", (1001, 1011)) == wanted
    assert tile_files(tmp_path / "plain.exr", (1001,)) == [tmp_path / "plain.exr"]
    assert tile_files(tmp_path / "a.1002.exr", (1001,)) == [tmp_path / "a.1002.exr"]
    with pytest.raises(InputError, match=r"plain.exr: is one picture, .* tiles 1001, 1002; .* plain.<UDIM>.exr"):
        tile_files(tmp_path / "plain.exr", (1001, 1002))
    with pytest.raises(InputError, match=r"no file for UDIM tile 1003 \(1 of 2 are missing\)"):
        tile_files(tmp_path / "a.<UDIM>.exr", (1002, 1003))
    assert tile_stem("normal", 1001, (1001,)) == "normal"
    assert tile_stem("normal", 1002, (1002,)) == "normal.1002"


def test_slots_are_named_by_name_number_or_both():
    assert slots_of_text("Eyes, left", NAMES) == (1,)
    assert slots_of_text(" 2 ,0", NAMES) == (0, 2)
    assert slots_of_text("Skin", NAMES) == (0, 3)
    with pytest.raises(
        InputError, match="--slots 1,Hair: there is no slot 'Hair'; the slots are 0 'Skin', 1 'Eyes, left'"
    ):
        slots_of_text("1,Hair", NAMES)
    for text in ("4", "-1", ""):
        with pytest.raises(InputError, match="there is no slot"):
            slots_of_text(text, NAMES)
    with pytest.raises(InputError, match="has no material slots: leave --slots out"):
        slots_of_text("0", ())


def test_an_overlap_counts_as_between_slots_by_majority():
    materials = np.array([0, 0, 2])
    first, last = np.array([[1, 1, 0, 2]]), np.array([[3, 3, 0, 2]])
    assert overlapping_slots(materials, first, last) == (0, 2)
    assert overlapping_slots(materials, first, np.array([[2, 2, 0, 2]])) == ()
