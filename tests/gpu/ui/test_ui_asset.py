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
