"""A material in an asset library, as Blender's own loader and the catalog file's format find it."""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from irpso_addon.blender.materials import asset
from irpso_addon.blender.materials.asset import recovered_slot
from irpso_addon.blender.materials.material import TAG, apply_material, build_material, card_object
from irpso_addon.blender.materials.pictures import icon
from irpso_addon.blender.materials.result_blend import save_blend
from irpso_addon.core.errors import InputError
from irpso_addon.exports import turntable
from irpso_addon.exports.asset import Shelf, write_to_shelf
from irpso_addon.exports.catalog import CATALOGS
from irpso_addon.exports.result import read_result, slots_of_result
from irpso_addon.exports.turntable import write_turntable
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import Maps
from irpso_addon.results.write import write_maps
from tests.builders.captures import read_png
from tests.builders.command_line import run_cli, write_card
from tests.builders.exports import on_a_sheet

RED = (0.6, 0.05, 0.05)


def red_card(folder=None, lower=RED):
    """A red, matt card, wider than high, in the open file. folder: of its images, None packs them."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    values = {
        "normal": np.tile(np.float32([0, 0, 1]), (12, 20, 1)),
        "base_color": np.tile(np.float32(RED), (12, 20, 1)),
    }
    values["base_color"][:6] = lower
    maps = Maps(load_model("lambert"), values, np.ones((12, 20), bool))
    obj = card_object("leaf", 12, 20)
    apply_material(obj, build_material(maps, "leaf", folder))
    return obj


@pytest.fixture
def card():
    """A red card with packed images."""
    return red_card()


def counts():
    kinds = ("objects", "meshes", "materials", "images", "scenes", "cameras", "lights", "worlds", "node_groups")
    return {kind: len(getattr(bpy.data, kind)) for kind in kinds} | {
        "names": sorted(m.name for m in bpy.data.materials)
    }


def loaded(path):
    """Return the one asset of a file."""
    with bpy.data.libraries.load(str(path), assets_only=True) as (there, wanted):
        wanted.materials = there.materials
    (material,) = wanted.materials
    return material


def test_the_library_has_the_material_with_maps_preview_and_words_and_the_open_file_is_as_before(card, tmp_path):
    before = counts()
    shelf = Shelf(tmp_path / "library", "Leaves / Red", "A. Author", "CC-BY-4.0", ("autumn",))
    path = write_to_shelf(shelf, card, "Red leaf")
    after = counts()
    assert {**after, "images": 0} == {**before, "images": 0} and card.material_slots[0].material.asset_data is None
    found = loaded(path)
    words = found.asset_data
    assert (found.name, words.author, words.license) == ("Red leaf", "A. Author", "CC-BY-4.0")
    assert {"autumn", "photographed"} == {tag.name for tag in words.tags}
    catalogs = [line.split(":") for line in (tmp_path / "library" / CATALOGS).read_text().splitlines() if ":" in line]
    assert [words.catalog_id, "Leaves/Red", "Leaves-Red"] in catalogs
    images = [node.image for node in found.node_tree.nodes if node.type == "TEX_IMAGE"]
    assert images and all(image.packed_file for image in images)
    picture = np.array(found.preview.image_pixels_float[:]).reshape(256, 256, 4)
    assert picture[128, 128, 3] == 1 and picture[3, 3, 3] == 0
    rows, columns = np.nonzero(picture[..., 3] > 0.5)
    assert 225 < np.ptp(columns) < 256 and np.ptp(rows) < 0.7 * np.ptp(columns)
    red, green, blue = picture[128, 128, :3]
    linear = ((picture[128, 128, :3] + 0.055) / 1.055) ** 2.4
    assert red > 0.5 and green == pytest.approx(blue, abs=0.02)
    assert linear[1] / linear[0] == pytest.approx(RED[1] / RED[0], abs=0.03)


def test_empty_tags_are_left_out(card, tmp_path, monkeypatch):
    monkeypatch.setattr(asset, "icon", lambda obj, side: np.zeros((side, side, 4)))
    path = write_to_shelf(Shelf(tmp_path, tags=("", " red ", " ")), card, "leaf")
    assert {tag.name for tag in loaded(path).asset_data.tags} == {"red", "photographed"}


def test_words_that_are_not_utf8_are_refused_before_anything_is_written(tmp_path):
    latin = b"caf\xe9".decode("utf-8", "surrogateescape")  # as Python has bytes of a command line (PEP 383)
    for option, words in [("catalog", {"catalog": latin}), ("author", {"author": latin}),
                          ("license", {"license": latin}), ("tag", {"tags": ("red", latin)})]:  # fmt: skip
        with pytest.raises(InputError, match=rf"--{option}: 'caf\\udce9' is not UTF-8; give another one"):
            Shelf(tmp_path, **words)
    with pytest.raises(InputError, match=r"--asset-name: 'caf\\udce9' is not UTF-8; give another one"):
        Shelf(tmp_path).path(latin)


def test_a_catalog_file_that_is_damaged_is_refused_beforehand(tmp_path):
    (tmp_path / CATALOGS).write_bytes(b"\xff")
    assert Shelf(tmp_path).path("leaf") == tmp_path / "leaf.blend"
    with pytest.raises(InputError, match=f"{CATALOGS}: cannot be read"):
        Shelf(tmp_path, "Leaves").path("leaf")


def test_an_object_that_others_move_is_in_the_picture_and_keeps_its_place(card, tmp_path):
    anchor = bpy.data.objects.new("anchor", None)
    bpy.context.collection.objects.link(anchor)
    anchor.location = (5, 6, 7)
    follow = card.constraints.new("COPY_LOCATION")
    follow.target, follow.use_offset = anchor, True
    card.location, card.rotation_euler, card.scale = (0, 0, 3), (0, 0, 7), (-1, 1, 1)
    bpy.context.view_layer.update()
    before = tuple(np.array(values) for values in (card.location, card.rotation_euler, card.scale, card.matrix_world))
    assert before[3][:3, 3].tolist() == [5, 6, 10]
    path = write_to_shelf(Shelf(tmp_path), card, "leaf")
    bpy.context.view_layer.update()
    after = (card.location, card.rotation_euler, card.scale, card.matrix_world)
    for old, new in zip(before, after, strict=True):
        np.testing.assert_array_equal(new, old)
    alpha = np.array(loaded(path).preview.image_pixels_float[:]).reshape(256, 256, 4)[..., 3]
    assert alpha[128, 128] == 1 and np.ptp(np.nonzero(alpha > 0.5)[1]) > 225


def test_an_object_that_is_hidden_in_renders_is_in_its_picture(card):
    card.hide_render = True
    bpy.context.view_layer.update()
    assert icon(card, 16)[8, 8, 3] == 1 and card.hide_render


def test_pictures_in_files_stay_files(tmp_path):
    obj = red_card(tmp_path)
    pictures = {path: path.read_bytes() for path in tmp_path.glob("*.*")}
    before = {image.name: image.filepath for image in bpy.data.images}
    write_to_shelf(Shelf(tmp_path / "library"), obj, "leaf")
    assert pictures == {path: path.read_bytes() for path in tmp_path.glob("*.*")}
    for name, path in before.items():
        assert not bpy.data.images[name].packed_files and bpy.data.images[name].filepath == path
    nodes = loaded(tmp_path / "library" / "leaf.blend").node_tree.nodes
    assert all(node.image.packed_file for node in nodes if node.type == "TEX_IMAGE")


def test_a_painted_image_that_is_not_saved_stays_painted_and_is_refused(tmp_path):
    obj = red_card(tmp_path)
    image = bpy.data.images["IRPSO leaf base_color"]
    image.pixels[:4] = (0, 1, 0, 1)
    with pytest.raises(InputError, match="image 'IRPSO leaf base_color' has unsaved changes; save it"):
        write_to_shelf(Shelf(tmp_path / "library"), obj, "leaf")
    assert image.is_dirty and tuple(image.pixels[:4]) == (0, 1, 0, 1)


def test_an_image_whose_file_is_gone_is_named_and_the_others_stay_files(tmp_path):
    obj = red_card(tmp_path)
    (tmp_path / "IRPSO_leaf_normal.png").unlink()
    before = counts()
    with pytest.raises(InputError, match=r"image 'IRPSO leaf normal': .*IRPSO_leaf_normal\.png cannot be packed; find"):
        write_to_shelf(Shelf(tmp_path / "library"), obj, "leaf")
    assert counts() == before and not any(image.packed_files for image in bpy.data.images)
    assert not list((tmp_path / "library").glob("*"))


def test_what_the_library_has_already_is_refused_and_kept(card, tmp_path):
    path = write_to_shelf(Shelf(tmp_path), card, "leaf")
    kept = path.read_bytes()
    with pytest.raises(InputError, match=r"leaf\.blend: the library has this file already; give another --asset-name"):
        write_to_shelf(Shelf(tmp_path), card, "leaf")
    assert path.read_bytes() == kept


def test_an_asset_that_another_process_writes_meanwhile_is_refused_and_kept(card, tmp_path, monkeypatch):
    before = counts()

    def slow(*words):
        (tmp_path / "leaf.blend").write_bytes(b"theirs")
        return icon(*words)

    monkeypatch.setattr(asset, "icon", slow)
    with pytest.raises(InputError, match=r"leaf\.blend: the library has this file already; give another --asset-name"):
        write_to_shelf(Shelf(tmp_path), card, "leaf")
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("leaf.blend", b"theirs")]
    assert counts() == before


def test_the_material_of_the_active_slot_is_saved_if_it_was_recovered(card):
    first = card.material_slots[0].material
    second, mine = first.copy(), bpy.data.materials.new("mine")
    for material in (second, mine):
        card.data.materials.append(material)
    found = []
    for card.active_material_index in range(3):
        found.append(recovered_slot(card))
    assert found == [first, second, first]
    card.active_material_index = 0
    assert recovered_slot(card, (1,)) == second


def test_the_asset_of_a_slot_that_was_chosen_by_name_is_its_own(tmp_path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    result, obj = on_a_sheet("lambert", texels=16)
    obj.data.materials.append(build_material(result.maps, "eyes"))
    obj.data.polygons.foreach_set("material_index", (np.arange(len(obj.data.polygons)) % 2).astype(np.int32))
    report = {"model": "lambert", "settings": {"object": "sheet", "slots": "Eyes"}, "solved_slots": [1]}
    write_maps(result.maps, tmp_path / "Eyes", report)
    save_blend(tmp_path / "Eyes" / "material.blend")
    assert slots_of_result(read_result(tmp_path / "Eyes"), obj) == (1,)
    code, _, err = run_cli("export", tmp_path / "Eyes", "--format", "asset", "-o", tmp_path / "library", "--quiet")
    assert code == 0, err
    assert loaded(tmp_path / "library" / "Eyes.blend")[TAG] == "eyes"


def test_recover_and_export_write_assets(tmp_path):
    lights = [(0.4, 0, 0.9), (-0.3, 0.3, 0.9), (0, -0.4, 0.9), (0.2, 0.3, 0.93)]
    folder = write_card(tmp_path / "leaf", np.full((4, 6, 8, 3), 0.3), lights)
    solver = ["--model", "lambert", "--preset", "swarm", "--iterations", 2, "--json"]
    shelf = ["--asset", tmp_path / "library", "--catalog", "Leaves"]
    code, out, err = run_cli("recover", folder, "-o", tmp_path / "out", *solver, *shelf)
    assert code == 0, err
    code, out, err = run_cli("recover", folder, "-o", tmp_path / "more", *solver, *shelf)
    assert code == 2 and "has this file already" in out and not (tmp_path / "more").exists()
    code, out, err = run_cli("recover", folder, "-o", tmp_path / "more", *solver, "--asset", tmp_path / "more",
                             "--asset-name", "material")  # fmt: skip
    assert code == 2 and "is the result's own file" in out and not (tmp_path / "more").exists()
    code, out, err = run_cli("export", tmp_path / "out", "--format", "asset", "-o", tmp_path / "library",
                             "--asset-name", "Another", "--catalog", "Leaves", "--json")  # fmt: skip
    assert code == 0, err
    ids = {loaded(tmp_path / "library" / name).asset_data.catalog_id for name in ("leaf.blend", "Another.blend")}
    assert len(ids) == 1


def test_a_turntable_tilts_the_card_to_all_sides_and_leaves_it_as_it_was(tmp_path, monkeypatch):
    monkeypatch.setattr(turntable, "_SIDE", 200)
    card = red_card(lower=RED[::-1])
    result = SimpleNamespace(name="red leaf")
    before, place = counts(), card.matrix_world.copy()
    found = write_turntable(result, tmp_path / "new", lambda: card)
    assert found["output"] == str(tmp_path / "new" / "red_leaf_turntable.png")
    assert {**counts(), "images": 0} == {**before, "images": 0} and card.matrix_world == place
    picture = read_png(found["output"])[0].astype(float) / 255
    stills = [still for row in np.split(picture, 2) for still in np.split(row, 4, axis=1)]  # row 0 is at the top
    shown = [(np.abs(still - picture[0, 0]) > 0.1).any(axis=-1) for still in stills]
    # The card is 20 wide and 12 high; tilted by 0.26 toward a side, cos 0.26 of its size along that side shows.
    corners = np.array([[x, y] for x in (-10, 10) for y in (-6, 6)])
    for number, (still, mask) in enumerate(zip(stills, shown, strict=True)):
        rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
        side = np.array([np.cos(np.pi / 4 * number), np.sin(np.pi / 4 * number)])
        wide, high = np.ptp(corners + (np.cos(0.26) - 1) * (corners @ side)[:, None] * side, axis=0)
        assert np.ptp(rows) / np.ptp(columns) == pytest.approx(high / wide, rel=0.02)
        upper, lower = (still[rows[len(rows) // 2] + away, columns[len(columns) // 2]] for away in (-25, 25))
        assert upper[0] > 2 * upper[1:].max() and lower[2] > 2 * lower[:2].max()
