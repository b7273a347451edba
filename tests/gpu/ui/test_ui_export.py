"""What Export writes, in background."""

import json
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from irpso_addon.core.paths import DEFAULT_MODEL
from irpso_addon.exports.result import read_result
from irpso_addon.results import seamless
from tests.builders.drawn_panels import Drawn
from tests.builders.exports import read_glb
from tests.gpu.ui.conftest import SHAPE

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def settings(session_of_card):
    """The scene's settings, in a file that holds nothing yet."""
    bpy.data.batch_remove([*bpy.data.materials, *bpy.data.images, *bpy.data.objects])
    settings = bpy.context.scene.irpso
    settings.displacement = False
    return settings


def refusal(**values):
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.irpso.export(**values)
    return str(caught.value).strip()


def test_chosen_exports_lie_beside_the_maps_and_read_back(settings, tmp_path):
    wanted = {"normal_object": True, "normal_directx": True, "height": True}
    assert bpy.ops.irpso.export(filepath=str(tmp_path / "out"), **wanted) == {"FINISHED"}
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"normal_object.exr", "normal_directx.png", "height.png", "height.exr"} <= files
    assert not {"normal_world.exr", "normal_directx.exr"} & files
    described = json.loads((tmp_path / "out" / "report.json").read_text())
    assert described["height"]["unit"] == "texels" and described["settings"]["model"] == DEFAULT_MODEL
    assert read_result(tmp_path / "out").maps.solved.shape == SHAPE


def test_keep_displaces_the_card_only_if_chosen(settings):
    settings.displacement = True
    assert bpy.ops.irpso.keep() == {"FINISHED"}
    material = bpy.data.materials["IRPSO leaf"]
    node = material.node_tree.nodes["IRPSO displacement"]
    assert (node.space, node.inputs["Midlevel"].default_value) == ("OBJECT", 0)
    assert np.isclose(node.inputs["Scale"].default_value, 1 / SHAPE[1])
    assert material.displacement_method == "BOTH"
    settings.displacement = False
    bpy.ops.irpso.keep()
    assert "IRPSO displacement" not in material.node_tree.nodes


@pytest.mark.parametrize(
    ("kind", "place", "files"),
    [
        ("textures", "set", {f"T_leaf_{n}.png" for n in ("BC", "N", "ORM", "S")}),
        ("openlime", "layer", {"kd.png", "ks.png", "normals.png", "gloss.png", "info.json"}),
        ("ptm", "leaf.ptm", None),
    ],
)
def test_the_button_writes_the_chosen_format(kind, place, files, settings, tmp_path):
    done = bpy.ops.irpso.export(filepath=str(tmp_path / place), format=kind, convention="unreal", height=False)
    assert done == {"FINISHED"}
    if files is None:
        assert (tmp_path / place).read_bytes().startswith(b"PTM_1.2\n")
    else:
        assert {path.name for path in (tmp_path / place).iterdir()} == files


def test_a_card_is_written_as_a_web_page_with_its_photographs(settings, session_of_card, tmp_path):
    wanted = {"filepath": str(tmp_path / "page"), "format": "web", "photographs": 3}
    assert bpy.ops.irpso.export(**wanted) == {"FINISHED"}
    text = (tmp_path / "page" / "result.js").read_text().removeprefix("relight.result = ").rstrip(";\n")
    found, observations = json.loads(text), session_of_card.job.capture.observations
    assert found["size"] == [SHAPE[1], SHAPE[0]] and found["uncertaintyPlanes"] > 0
    assert len(found["photographs"]) == 3
    assert {one["name"] for one in found["photographs"]} <= {shot.name for shot in observations}


def test_a_card_is_written_as_maps_that_repeat_if_it_is_large_enough(settings, monkeypatch, tmp_path):
    wanted = {"filepath": str(tmp_path / "out"), "format": "maps", "seamless": True, "height": True}
    assert "largest square without holes" in refusal(**wanted) and not (tmp_path / "out").exists()
    monkeypatch.setattr(seamless, "_MIN_SIDE", 4)
    assert bpy.ops.irpso.export(**wanted) == {"FINISHED"}
    found = read_result(tmp_path / "out")
    rows, columns = found.maps.solved.shape
    assert rows == columns and found.height is not None and (tmp_path / "out" / "repeated.png").is_file()


def test_gltf_needs_a_kept_card_and_does_not_change_the_file(settings, tmp_path):
    wanted = {"filepath": str(tmp_path / "leaf.glb"), "format": "gltf"}
    assert "press Keep first" in refusal(**wanted)
    bpy.ops.irpso.keep()
    before = [len(getattr(bpy.data, kind)) for kind in ("objects", "meshes", "materials", "images")]
    assert bpy.ops.irpso.export(**wanted) == {"FINISHED"}
    assert (tmp_path / "leaf.glb").read_bytes()[:4] == b"glTF"
    assert before == [len(getattr(bpy.data, kind)) for kind in ("objects", "meshes", "materials", "images")]
    assert bpy.context.view_layer.objects.active.name == "IRPSO leaf"


def test_a_cards_occlusion_is_that_of_its_relief(settings, tmp_path):
    bpy.ops.irpso.keep()
    wanted = {"filepath": str(tmp_path / "leaf.glb"), "format": "gltf", "occlusion": True}
    assert bpy.ops.irpso.export(**wanted) == {"FINISHED"}
    (material,) = read_glb(tmp_path / "leaf.glb")[0]["materials"]
    assert "occlusionTexture" in material


@pytest.mark.parametrize("occlusion", [False, True])
def test_a_cards_height_is_written_without_occlusion_unless_asked(occlusion, settings, tmp_path):
    wanted = {"filepath": str(tmp_path / "set"), "format": "textures", "height": True, "occlusion": occlusion}
    assert bpy.ops.irpso.export(**wanted, convention="blender") == {"FINISHED"}
    files = {path.name for path in (tmp_path / "set").iterdir()}
    assert "leaf_Height.png" in files and ("leaf_AO.png" in files) == occlusion


def test_an_unwritable_path_is_reported_in_one_line(settings, tmp_path):
    (tmp_path / "file").write_text("in the way")
    for kind in ("maps", "textures"):
        said = refusal(filepath=str(tmp_path / "file" / "set"), format=kind)
        assert "is a file" in said and "with -o" not in said and len(said.splitlines()) == 1
    assert (tmp_path / "file").read_text() == "in the way"
    assert "choose a file or folder" in refusal(filepath="")


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("maps", ["normal_object", "normal_world", "normal_directx", "height", "seamless"]),
        ("textures", ["convention", "height", "occlusion"]),
        ("gltf", ["occlusion"]), ("openlime", []), ("ptm", []), ("web", ["photographs"]),
    ],
)  # fmt: skip
def test_the_file_browser_has_the_options_of_the_chosen_format(kind, options):
    from irpso_addon.ui.operators.export import IRPSO_OT_export

    drawn = Drawn()
    fixed = bpy.ops.irpso.export.get_rna_type()
    IRPSO_OT_export.draw(SimpleNamespace(layout=drawn, format=kind, bl_rna=fixed), bpy.context)
    assert drawn.notes["props"] == ["format", *options]


def test_another_format_changes_a_proposed_name_and_leaves_a_chosen_one(session_of_card):
    from irpso_addon.ui.operators.export import IRPSO_OT_export

    asked = SimpleNamespace(filepath="/out/leaf maps", format="gltf")
    assert IRPSO_OT_export.check(asked, bpy.context) and asked.filepath == "/out/leaf.glb"
    asked.format = "textures"
    assert IRPSO_OT_export.check(asked, bpy.context) and asked.filepath == "/out/leaf textures"
    assert not IRPSO_OT_export.check(asked, bpy.context)
    asked.filepath, asked.format = "/out/mine", "ptm"
    assert not IRPSO_OT_export.check(asked, bpy.context) and asked.filepath == "/out/mine"


def test_the_proposed_name_has_no_slash_of_the_subjects():
    from irpso_addon.ui.operators.export import _proposed_name

    running = SimpleNamespace(job=SimpleNamespace(name="wall/left"))
    assert _proposed_name(running, "gltf") == "wall_left.glb"
    assert _proposed_name(running, "textures") == "wall_left textures"


def test_the_proposed_folder_is_never_that_of_the_photographs(session_of_card, monkeypatch):
    from irpso_addon.ui.operators import export

    folder = Path(bpy.context.scene.irpso.capture_path)
    assert export.proposed_folder(session_of_card) == folder.parent
    for blend, wanted in ((folder / "a.blend", folder.parent), (folder.parent / "work" / "a.blend", None)):
        monkeypatch.setattr(export, "bpy", SimpleNamespace(data=SimpleNamespace(filepath=str(blend))))
        assert export.proposed_folder(session_of_card) == (wanted or blend.parent)


def test_file_export_lists_every_format_while_the_extension_is_there(session_of_card):
    from irpso_addon.ui.operators.export import IRPSO_MT_export

    drawn = Drawn()
    IRPSO_MT_export.draw(SimpleNamespace(layout=drawn), bpy.context)
    assert drawn.notes["operators"] == ["irpso.export"] * 6
    modules = [draw.__module__ for draw in bpy.types.TOPBAR_MT_file_export._dyn_ui_initialize()]
    assert modules.count("irpso_addon.ui.operators.export") == 1
