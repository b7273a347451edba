"""The material in .blend files: linked libraries, saving, packed pictures and pictures beside the file."""

import os
import tempfile
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from irpso_addon.blender.materials.material import apply_material, build_material, card_object
from irpso_addon.blender.materials.result_blend import save_blend
from irpso_addon.blender.materials.textures import mark_saved, remove_superseded, superseded
from irpso_addon.core.errors import InputError
from irpso_addon.reflectance.model import load_model
from tests.gpu.blender.test_material import SHAPE, counts, pixels, random_maps

pytestmark = pytest.mark.bpy_only


@pytest.fixture(autouse=True)
def empty_file():
    bpy.ops.wm.read_factory_settings(use_empty=True)


@pytest.fixture
def library(tmp_path):
    """A .blend with the material "icon" on a card, linked into an empty file."""
    apply_material(card_object("icon", *SHAPE), build_material(random_maps(load_model("lambert")), "icon"))
    path = save_blend(tmp_path / "library.blend")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(path), link=True) as (source, target):
        target.objects = list(source.objects)
    return path


def test_a_local_object_with_a_linked_mesh_gets_the_material_in_a_slot_of_its_own(library):
    mesh = bpy.data.objects[0].data
    theirs = mesh.materials[0]
    material = bpy.data.materials.new("found")
    for slots in ((0,), ()):
        mine = bpy.data.objects.new("mine", mesh)
        apply_material(mine, material, slots)
        assert mine.material_slots[0].link == "OBJECT" and mine.material_slots[0].material == material
        assert mesh.library is not None and mesh.materials[:] == [theirs]


def test_a_linked_mesh_without_a_slot_is_refused_with_what_to_do(library, tmp_path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.data.meshes.new("bare").use_fake_user = True
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "bare.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "bare.blend"), link=True) as (_, target):
        target.meshes = ["bare"]
    mine = bpy.data.objects.new("mine", bpy.data.meshes[0])
    with pytest.raises(InputError, match="mesh of object 'mine' is linked from .*bare.blend and has no material slot"):
        apply_material(mine, bpy.data.materials.new("found"))


def test_linked_materials_and_objects_are_refused_by_name(library):
    before = counts()
    with pytest.raises(InputError, match="material 'IRPSO icon' is linked.*library.blend"):
        build_material(random_maps(load_model("lambert"), 1), "icon")
    assert counts() == before
    with pytest.raises(InputError, match="object 'IRPSO icon' is linked.*library.blend"):
        apply_material(bpy.data.objects[0], bpy.data.materials.new("mine"))


def test_a_saved_file_holds_packed_images_and_the_session_keeps_its_name(tmp_path):
    maps = random_maps(load_model("cook_torrance_two_lobe"))
    apply_material(card_object("icon", *SHAPE), build_material(maps, "icon"))
    path = save_blend(tmp_path / "icon.blend")
    assert bpy.data.filepath == ""
    assert os.listdir(tmp_path) == ["icon.blend"]
    bpy.ops.wm.open_mainfile(filepath=str(path))
    lobes = np.concatenate([maps.values[name] for name in ("r1", "r2", "w")], axis=-1)
    np.testing.assert_allclose(pixels(bpy.data.images["IRPSO icon roughness_lobes"]), lobes, atol=1e-5)
    build_material(maps, "icon")
    assert len(bpy.data.materials) == 1


def test_pictures_beside_the_file_have_relative_paths_and_move_with_it(tmp_path):
    maps = random_maps(load_model("lambert"))
    apply_material(card_object("icon", *SHAPE), build_material(maps, "icon", tmp_path / "a" / "textures"))
    save_blend(tmp_path / "a" / "icon.blend")
    for image in bpy.data.images:
        assert Path(image.filepath).parent == tmp_path / "a" / "textures"
    (tmp_path / "a").rename(tmp_path / "b")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "b" / "icon.blend"))
    image = bpy.data.images["IRPSO icon base_color"]
    assert image.filepath.replace("\\", "/") == "//textures/IRPSO_icon_base_color.png"
    assert image.packed_file is None
    np.testing.assert_allclose(pixels(image), maps.values["base_color"], atol=4e-5)


@pytest.mark.parametrize("tiles", [(1001,), tuple(range(1001, 1008))])
def test_a_folder_beside_the_file_moves_with_it(tiles, tmp_path):
    maps, (rows, columns) = replace(random_maps(load_model("lambert")), tiles=tiles), SHAPE
    project = tmp_path / "a"
    project.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "icon.blend"))
    for _ in range(2):
        material = build_material(maps, "icon", "//maps/")
    remove_superseded(superseded())
    material.use_fake_user = True
    number = "_1" if len(tiles) == 1 else "_1.<UDIM>"
    found = {image.filepath.replace("\\", "/") for image in bpy.data.images}
    assert found == {f"//maps/IRPSO_icon_{name}{number}.png" for name in ("base_color", "normal")}
    assert len(list((project / "maps").iterdir())) == 2 * len(tiles)
    bpy.ops.wm.save_mainfile()
    project.rename(tmp_path / "b")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "b" / "icon.blend"))
    image = bpy.data.images["IRPSO icon base_color"]
    width = columns // len(tiles)
    assert tuple(image.size) == (width, rows) and len(image.tiles) == len(tiles)
    np.testing.assert_allclose(pixels(image), maps.values["base_color"][:, :width], atol=4e-5)


def test_packed_images_can_be_moved_to_a_folder_and_back(tmp_path):
    model = load_model("lambert")
    build_material(random_maps(model, 0), "icon")
    second, third = random_maps(model, 1), random_maps(model, 2)
    build_material(second, "icon", tmp_path)
    image = bpy.data.images["IRPSO icon base_color"]
    assert image.packed_file is None
    np.testing.assert_allclose(pixels(image), second.values["base_color"], atol=4e-5)
    build_material(third, "icon", tmp_path)
    np.testing.assert_allclose(pixels(image), third.values["base_color"], atol=4e-5)
    build_material(second, "icon")
    assert image.packed_file is not None
    np.testing.assert_allclose(pixels(image), second.values["base_color"], atol=4e-5)
    build_material(third, "icon")
    np.testing.assert_allclose(pixels(image), third.values["base_color"], atol=4e-5)


def test_maps_in_a_folder_are_written_beside_others(tmp_path):
    first, second, third = (random_maps(load_model("lambert"), seed) for seed in range(3))
    build_material(first, "Wall.001", tmp_path)
    build_material(second, "Wall_001", tmp_path)
    images = bpy.data.images
    for _ in range(2):
        build_material(third, "Wall_001", tmp_path)
    assert len(list(tmp_path.iterdir())) == 8 and len(images) == 4
    np.testing.assert_allclose(pixels(images["IRPSO Wall.001 base_color"]), first.values["base_color"], atol=4e-5)
    np.testing.assert_allclose(pixels(images["IRPSO Wall_001 base_color"]), third.values["base_color"], atol=4e-5)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    bpy.ops.wm.read_factory_settings(use_empty=True)  # another .blend with the same Output Folder
    build_material(second, "Wall.001", tmp_path)
    assert Path(bpy.data.images["IRPSO Wall.001 base_color"].filepath).name == "IRPSO_Wall_001_base_color_4.png"
    assert {path: path.read_bytes() for path in before} == before


def test_tiles_in_a_folder_are_written_beside_others(tmp_path):
    maps = replace(random_maps(load_model("lambert")), tiles=(1001, 1002, 1011, 1012, 1021, 1022, 1031))
    for subject in ("Wall.001", "Wall_001", "Wall.001"):
        build_material(maps, subject, tmp_path)
    remove_superseded(superseded())
    assert len(list(tmp_path.iterdir())) == 2 * 2 * 7
    assert (tmp_path / "IRPSO_Wall_001_normal_2.1031.png").exists()


def test_a_file_that_cannot_be_saved_is_refused_and_nothing_is_left(tmp_path):
    with pytest.raises(InputError, match="its folder does not exist"):
        save_blend(tmp_path / "none" / "x.blend")
    with pytest.raises(InputError, match="is a folder"):
        save_blend(tmp_path)
    assert not os.listdir(tmp_path)


def test_an_old_file_survives_when_saving_fails(tmp_path, monkeypatch):
    target = tmp_path / "x.blend"
    target.write_bytes(b"old")

    def no_space(source, destination):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", no_space)
    with pytest.raises(InputError, match="No space left"):
        save_blend(target)
    assert target.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["x.blend"]


def test_only_files_are_removed_that_no_blend_shows(tmp_path):
    first, second, third = (random_maps(load_model("lambert"), seed) for seed in range(3))
    path = str(tmp_path / "a.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    build_material(first, "icon", "//maps").use_fake_user = True
    bpy.ops.wm.save_mainfile()
    mark_saved()  # by the extension's handler
    for number, found in enumerate((second, third), 1):
        build_material(found, "icon", "//maps")
        assert {image.filepath for image in bpy.data.images} == {
            f"//maps/IRPSO_icon_{name}_{number}.png" for name in ("base_color", "normal")
        }
        np.testing.assert_allclose(
            pixels(bpy.data.images["IRPSO icon base_color"]), found.values["base_color"], atol=4e-5
        )
    remove_superseded(superseded())  # by the handler, before another file is loaded
    kept = {f"IRPSO_icon_{name}{number}.png" for name in ("base_color", "normal") for number in ("", "_2")}
    assert {path.name for path in (tmp_path / "maps").iterdir()} == kept
    bpy.ops.wm.open_mainfile(filepath=path)
    np.testing.assert_allclose(pixels(bpy.data.images["IRPSO icon base_color"]), first.values["base_color"], atol=4e-5)


@pytest.mark.parametrize("subject", ["x" * 250, "\u58c1" * 100, "x" * 200 + "/y"], ids=["long", "wide", "path"])
def test_the_files_of_a_long_name_have_a_shorter_one(subject, tmp_path):
    maps = replace(random_maps(load_model("lambert")), tiles=tuple(range(1001, 1008)))
    build_material(maps, subject, tmp_path)
    names = [path.name for path in tmp_path.iterdir()]
    assert len(names) == 14 and max(len(name.encode()) for name in names) < 200
    assert all(name.startswith(f"IRPSO_{subject[:50]}") for name in names)
    assert sum("base_color.10" in name for name in names) == 7


def test_maps_that_cannot_be_written_are_refused_and_leave_no_material(tmp_path, monkeypatch):
    def no_space(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", no_space)
    with pytest.raises(InputError, match="cannot be written .No space left on device.; choose another folder"):
        build_material(random_maps(load_model("lambert")), "icon", tmp_path)
    assert not bpy.data.materials and not list(tmp_path.iterdir())


@pytest.mark.parametrize("tiles", [(1001,), (1001, 1002)], ids=["square", "udim"])
@pytest.mark.parametrize(("place", "remedy"), [("more", "choose another folder"), (None, "free space there")])
def test_maps_that_cannot_all_be_written_leave_all_as_it_was(tmp_path, monkeypatch, place, remedy, tiles):
    def tree():
        links = [(one.from_node.name, one.to_node.name, one.to_socket.name) for one in material.node_tree.links]
        nodes = [(one.name, one.bl_idname, getattr(one, "image", None)) for one in material.node_tree.nodes]
        return nodes, links, [pixels(one[2]).tolist() for one in nodes if one[2]]

    def full(path, data):
        written.append(write_bytes(path, data[: len(data) // 2]))
        if len(written) == last:
            raise OSError(28, "No space left on device")

    material, written = build_material(random_maps(load_model("principled")), "icon", tmp_path / "maps"), []
    before, write_bytes, last = tree(), Path.write_bytes, 2 + len(tiles)  # of two tiles: the second map's second
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    monkeypatch.setattr(Path, "write_bytes", full)
    for name in ("principled", "cook_torrance_two_lobe"):
        written.clear()
        with pytest.raises(InputError, match=f"cannot be written .No space left on device.; {remedy}") as refused:
            maps = replace(random_maps(load_model(name), seed=1), tiles=tiles)
            build_material(maps, "icon", place and tmp_path / place)
        named = tmp_path / place if place else temporary
        assert str(refused.value).startswith(f"{named}: ") and tree() == before and len(written) == last
    assert not list(tmp_path.glob("more/*")) and not list(temporary.iterdir())


def test_an_image_with_unsaved_paint_is_refused_and_stays_painted(tmp_path):
    build_material(random_maps(load_model("lambert")), "icon", tmp_path)
    image = bpy.data.images["IRPSO icon base_color"]
    image.pixels[:4] = (0, 1, 0, 1)
    with pytest.raises(InputError, match="image 'IRPSO icon base_color' has unsaved changes; save it"):
        build_material(random_maps(load_model("lambert"), seed=1), "icon", tmp_path)
    assert image.is_dirty and tuple(image.pixels[:4]) == (0, 1, 0, 1) and len(list(tmp_path.iterdir())) == 2
    image.save()
    build_material(random_maps(load_model("lambert"), seed=1), "icon", tmp_path)


def test_a_copy_in_another_folder_finds_the_users_images_and_libraries(tmp_path):
    (tmp_path / "tex").mkdir()
    (tmp_path / "out").mkdir()
    bpy.data.objects.new("prop", None).use_fake_user = True
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True, relative=True) as (_, target):
        target.objects = ["prop"]
    bpy.context.scene.collection.objects.link(target.objects[0])
    image = bpy.data.images.new("wood", 4, 4)
    image.filepath_raw, image.file_format = str(tmp_path / "tex" / "wood.png"), "PNG"
    image.save()
    image.filepath, image.use_fake_user = "//tex/wood.png", True
    build_material(random_maps(load_model("lambert")), "icon", tmp_path / "tex").use_fake_user = True
    build_material(random_maps(load_model("lambert")), "packed").use_fake_user = True
    tiled = replace(random_maps(load_model("lambert")), tiles=tuple(range(1001, 1008)))
    build_material(tiled, "tiled").use_fake_user = True
    path = save_blend(tmp_path / "out" / "result.blend")
    assert bpy.data.images["IRPSO packed normal"].filepath == "//textures/IRPSO_packed_normal.png"
    assert image.filepath == "//tex/wood.png" and bpy.data.filepath == str(tmp_path / "scene.blend")
    bpy.ops.wm.open_mainfile(filepath=str(path))
    files = {image.name: image.filepath.replace("\\", "/") for image in bpy.data.images}
    assert files["wood"] == "//../tex/wood.png"
    assert files["IRPSO icon normal"] == "//../tex/IRPSO_icon_normal.png"
    assert files["IRPSO packed normal"] == "//textures/IRPSO_packed_normal.png"
    assert files["IRPSO tiled normal"] == "//textures/IRPSO_tiled_normal.<UDIM>.png"
    assert Path(bpy.path.abspath(bpy.data.libraries[0].filepath)).resolve() == tmp_path / "library.blend"
    assert not bpy.data.objects["prop"].is_missing


def test_a_file_is_saved_though_its_maps_lie_on_another_drive(tmp_path, monkeypatch):
    build_material(random_maps(load_model("lambert")), "icon", tmp_path / "maps").use_fake_user = True

    def other_drive(*_, **__):
        raise ValueError("path is on mount 'D:', start on mount 'C:'")

    monkeypatch.setattr(bpy.path, "relpath", other_drive)
    path = save_blend(tmp_path / "result.blend")
    monkeypatch.undo()
    bpy.ops.wm.open_mainfile(filepath=str(path))
    file = Path(bpy.path.abspath(bpy.data.images["IRPSO icon normal"].filepath))
    assert file == tmp_path / "maps" / "IRPSO_icon_normal.png"
