"""The user's copies of recovered materials, cards and objects: a recovery changes none but its own."""

import bpy
import numpy as np
import pytest

from irpso_addon.blender.materials.material import apply_material, build_material, card_object, find_card
from irpso_addon.blender.materials.textures import image_files
from irpso_addon.reflectance.model import load_model
from tests.gpu.blender.test_material import SHAPE, counts, pixels, random_maps

pytestmark = pytest.mark.bpy_only


@pytest.fixture(autouse=True)
def empty_file():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def maps(seed):
    return random_maps(load_model("lambert"), seed)


def shown_color(material):
    return pixels(material.node_tree.nodes["IRPSO map base_color"].image)


def plane(name, mesh=None):
    if mesh is None:
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata([(0, 0, 0), (1, 0, 0), (1, 1, 0)], [], [(0, 1, 2)])
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    return obj


@pytest.mark.parametrize("in_folder", [False, True])
def test_a_backup_copy_of_a_material_keeps_its_maps(in_folder, tmp_path):
    folder = tmp_path if in_folder else None
    subject, first, second, third = plane("a"), *(maps(seed) for seed in range(3))
    material = build_material(first, "a", folder)
    apply_material(subject, material)
    backup = material.copy()
    backup.name = "A backup"  # before "IRPSO a" in the alphabet
    for found in (second, third):
        assert build_material(found, "a", folder, obj=subject) == material
        np.testing.assert_allclose(shown_color(material), found.values["base_color"], atol=4e-5)
        np.testing.assert_allclose(shown_color(backup), first.values["base_color"], atol=4e-5)
    assert len(bpy.data.images) == 4


def test_the_copy_that_an_object_shows_is_the_one_to_update():
    subject, first, second = plane("a"), maps(0), maps(1)
    former = build_material(first, "a")
    copy = former.copy()
    apply_material(subject, copy)
    assert build_material(second, "a", obj=subject) == copy
    np.testing.assert_allclose(shown_color(copy), second.values["base_color"], atol=4e-5)
    np.testing.assert_allclose(shown_color(former), first.values["base_color"], atol=4e-5)


@pytest.mark.parametrize("subject", ["a", "x" * 300], ids=["short", "cut"])
def test_without_an_object_the_material_of_the_original_name_is_updated(subject):
    material = build_material(maps(0), subject)
    material.copy().name = "A backup"
    material.copy()
    assert build_material(maps(1), subject) == material


def test_a_material_of_the_user_that_shows_a_map_follows_it():
    build_material(maps(0), "a")
    image = bpy.data.images["IRPSO a base_color"]
    mine = bpy.data.materials.new("mine")
    mine.use_nodes = True
    mine.node_tree.nodes.new("ShaderNodeTexImage").image = image
    before = counts()
    found = maps(1)
    build_material(found, "a")
    np.testing.assert_allclose(pixels(image), found.values["base_color"], atol=4e-5)
    assert counts() == before


def test_a_renamed_duplicate_is_not_the_card():
    card = card_object("a", *SHAPE)
    duplicate = card.copy()
    duplicate.name = "A duplicate"
    bpy.context.scene.collection.objects.link(duplicate)
    assert find_card("a") == card
    card.name = "Wall"
    assert find_card("a") in (card, duplicate)


def test_files_of_a_subject_are_not_those_of_one_whose_name_begins_alike(tmp_path):
    build_material(maps(0), "a", tmp_path)
    build_material(maps(1), "a/b", tmp_path)
    assert sorted(path.name for path in image_files("a")) == ["IRPSO_a_base_color.png", "IRPSO_a_normal.png"]
    assert len(image_files("a/b")) == 2


@pytest.mark.parametrize("slots", [(), (0,)])
def test_a_linked_duplicate_keeps_its_recovered_material(slots):
    first, mine, second = plane("a"), bpy.data.materials.new("mine"), None
    first.data.materials.append(mine)
    second = plane("b", first.data)
    for obj, seed in ((first, 0), (second, 1), (second, 2), (first, 3)):
        apply_material(obj, build_material(maps(seed), obj.name, obj=obj), slots)
    assert [slot.material.name for obj in (first, second) for slot in obj.material_slots] == ["IRPSO a", "IRPSO b"]


def test_linked_duplicates_without_recovered_materials_share_a_new_one():
    first = plane("a")
    second = plane("b", first.data)
    material = build_material(maps(0), "a")
    apply_material(first, material)
    assert [slot.material for slot in second.material_slots] == [material]
