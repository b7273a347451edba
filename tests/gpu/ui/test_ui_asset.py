"""*Save to Asset Library* in Blender's background: the kept material goes into the user's library."""

import bpy
import pytest

from tests.gpu.ui.test_ui_keep import refusal

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def library(tmp_path):
    """The user's only asset library."""
    libraries = bpy.context.preferences.filepaths.asset_libraries
    while libraries:
        bpy.ops.preferences.asset_library_remove(index=0)
    (tmp_path / "shelf").mkdir()
    bpy.ops.preferences.asset_library_add(directory=str(tmp_path / "shelf"))
    return libraries[0]


def test_a_kept_material_goes_into_the_library_once(session_of_card, library, tmp_path):
    bpy.data.batch_remove([*bpy.data.materials, *bpy.data.objects])
    assert "Keep a material first" in refusal(bpy.ops.irpso.save_asset)
    bpy.ops.irpso.keep()
    words = {"library": library.name, "asset_name": "Leaf", "catalog": "Leaves", "tags": "green, leaf"}
    assert bpy.ops.irpso.save_asset(**words) == {"FINISHED"}
    with bpy.data.libraries.load(str(tmp_path / "shelf" / "Leaf.blend"), assets_only=True) as (there, _):
        assert there.materials == ["Leaf"]
    assert "give another Name" in refusal(bpy.ops.irpso.save_asset, **words)
    assert "single slashes" in refusal(bpy.ops.irpso.save_asset, library=library.name, catalog="a//b")


def test_an_asset_may_have_any_name_that_a_material_has(session_of_card, library, tmp_path):
    bpy.data.batch_remove([*bpy.data.materials, *bpy.data.objects])
    bpy.ops.irpso.keep()
    bpy.data.materials.new("IRPSO").use_fake_user = True
    for name, file in (("IRPSO leaf", "IRPSO_leaf"), ("IRPSO", "IRPSO")):
        assert bpy.ops.irpso.save_asset(library=library.name, asset_name=name) == {"FINISHED"}
        with bpy.data.libraries.load(str(tmp_path / "shelf" / f"{file}.blend"), assets_only=True) as (there, _):
            assert there.materials == [name]
    assert sorted(bpy.data.materials.keys()) == ["IRPSO", "IRPSO leaf"]


def test_a_linked_material_of_the_assets_name_is_no_hindrance(session_of_card, library, tmp_path):
    bpy.data.batch_remove([*bpy.data.materials, *bpy.data.objects])
    bpy.ops.irpso.keep()
    assert bpy.ops.irpso.save_asset(library=library.name, asset_name="Leaf") == {"FINISHED"}
    with bpy.data.libraries.load(str(tmp_path / "shelf" / "Leaf.blend"), link=True) as (_, wanted):
        wanted.materials = ["Leaf"]
    (tmp_path / "shelf" / "Leaf.blend").rename(tmp_path / "moved.blend")
    assert bpy.ops.irpso.save_asset(library=library.name, asset_name="Leaf") == {"FINISHED"}
    assert wanted.materials[0].name == "Leaf" and wanted.materials[0].library is not None
    with bpy.data.libraries.load(str(tmp_path / "shelf" / "Leaf.blend"), assets_only=True) as (there, _):
        assert there.materials == ["Leaf"]


def test_a_library_without_a_folder_is_refused(session_of_card, library, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bpy.data.batch_remove([*bpy.data.materials, *bpy.data.objects])
    bpy.ops.irpso.keep()
    library.path = ""
    assert "has no folder" in refusal(bpy.ops.irpso.save_asset, library=library.name, asset_name="Leaf")
    assert [path.name for path in tmp_path.iterdir()] == ["shelf"]


def test_a_material_whose_maps_are_linked_is_refused(session_of_card, library, tmp_path):
    bpy.data.batch_remove([*bpy.data.materials, *bpy.data.objects])
    bpy.ops.irpso.keep()
    obj = bpy.context.object
    bpy.data.libraries.write(str(tmp_path / "lib.blend"), {obj.active_material}, fake_user=True)
    with bpy.data.libraries.load(str(tmp_path / "lib.blend"), link=True) as (_, wanted):
        wanted.materials = [obj.active_material.name]
    obj.active_material = wanted.materials[0]
    said = refusal(bpy.ops.irpso.save_asset, library=library.name, asset_name="Linked")
    assert "lib.blend" in said and "make the material local first" in said
    assert not (tmp_path / "shelf" / "Linked.blend").exists()
