"""What the export panel writes, in background."""

import json
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

import irpso_addon
from irpso_addon.exports.result import read_result
from tests import cli_maker
from tests.gpu.test_ui_panels import Drawn

SHAPE = (18, 24)
LIGHTS = cli_maker.dome_lights(16, widest=70)


@pytest.fixture(scope="module", autouse=True)
def registered():
    bpy.ops.wm.read_homefile(use_empty=True)
    irpso_addon.register()
    yield
    irpso_addon.unregister()


@pytest.fixture(scope="module")
def session_of_card(registered, tmp_path_factory):
    """A card's session, run to its end once."""
    from irpso_addon.ui import session
    from irpso_addon.ui.job import make_job

    values = cli_maker.smooth_maps(SHAPE, {"roughness": (0.25, 0.6), "specular": (0.3, 0.8)}, seed=3)
    folder = tmp_path_factory.mktemp("capture") / "leaf"
    cli_maker.write_card(folder, cli_maker.render_oracle("principled", values, LIGHTS), LIGHTS)
    bpy.context.scene.irpso.capture_path = str(folder)
    running = session.begin(make_job(bpy.context))
    running.run()
    yield running
    session.end()


@pytest.fixture
def settings(session_of_card):
    """The export's settings, as they come; in a file that holds nothing yet."""
    bpy.data.batch_remove([*bpy.data.materials, *bpy.data.images, *bpy.data.objects])
    settings = bpy.context.scene.irpso.export
    for setting in settings.bl_rna.properties:
        if not setting.is_readonly and setting.identifier != "name":
            settings.property_unset(setting.identifier)
    return settings


def refusal(**values):
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.irpso.export_as(**values)
    return str(caught.value).strip()


def test_what_is_ticked_lies_beside_the_maps_and_can_be_read_back(settings, tmp_path):
    settings.normal_object = settings.normal_directx = settings.height = True
    assert bpy.ops.irpso.export_maps(directory=str(tmp_path), filename="out") == {"FINISHED"}
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"normal_object.exr", "normal_directx.png", "height.png", "height.exr"} <= files
    assert not {"normal_world.exr", "normal_directx.exr"} & files
    described = json.loads((tmp_path / "out" / "report.json").read_text())
    assert described["height"]["unit"] == "texels" and described["settings"]["model"] == "principled"
    assert read_result(tmp_path / "out").maps.covered.shape == SHAPE


def test_keep_displaces_the_card_where_that_is_ticked_and_no_more_where_it_is_not(settings):
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
    settings.format, settings.convention = kind, "unreal"
    assert bpy.ops.irpso.export_as(filepath=str(tmp_path / place)) == {"FINISHED"}
    if files is None:
        assert (tmp_path / place).read_bytes().startswith(b"PTM_1.2\n")
    else:
        assert {path.name for path in (tmp_path / place).iterdir()} == files


def test_gltf_wants_the_card_to_be_kept_first_and_leaves_the_file_as_it_was(settings, tmp_path):
    settings.format = "gltf"
    assert "press Keep first" in refusal(filepath=str(tmp_path / "leaf.glb"))
    bpy.ops.irpso.keep()
    before = [len(getattr(bpy.data, kind)) for kind in ("objects", "meshes", "materials", "images")]
    assert bpy.ops.irpso.export_as(filepath=str(tmp_path / "leaf.glb")) == {"FINISHED"}
    assert (tmp_path / "leaf.glb").read_bytes()[:4] == b"glTF"
    assert before == [len(getattr(bpy.data, kind)) for kind in ("objects", "meshes", "materials", "images")]
    assert bpy.context.view_layer.objects.active.name == "IRPSO leaf"


def test_a_place_that_cannot_be_written_is_told_in_one_line(settings, tmp_path):
    (tmp_path / "file").write_text("in the way")
    assert "is a file" in refusal(filepath=str(tmp_path / "file" / "set"))
    assert "No place" in refusal(filepath="")


def test_the_panel_shows_when_something_has_been_found(settings):
    from irpso_addon.ui import export, session

    assert export.IRPSO_PT_export.poll(bpy.context)
    settings.format = "textures"
    drawn = Drawn()
    export.IRPSO_PT_export.draw(SimpleNamespace(layout=drawn), bpy.context)
    assert drawn.notes["props"][:5] == ["normal_object", "normal_world", "normal_directx", "height", "displacement"]
    assert drawn.notes["props"][5:] == ["format", "convention"]
    current, session._current = session._current, None
    try:
        assert not export.IRPSO_PT_export.poll(bpy.context)
    finally:
        session._current = current
