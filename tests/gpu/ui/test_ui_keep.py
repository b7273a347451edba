"""Keeping what was found as a material, and exporting it as files, in background."""

import json
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from irpso_addon.capture.images.exr import read_exr
from irpso_addon.core.errors import InputError
from irpso_addon.core.paths import MODELS
from irpso_addon.exports.result import read_result
from irpso_addon.reflectance.model import digest_of_own_model, load_model
from tests.gpu.ui.conftest import SHAPE

pytestmark = pytest.mark.usefixtures("registered")
MAPS = ("base_color", "metallic", "normal", "roughness", "specular")


@pytest.fixture
def recovered(session_of_card):
    """The session, in a file that holds nothing yet."""
    bpy.data.batch_remove([*bpy.data.materials, *bpy.data.images, *bpy.data.objects, *bpy.data.libraries])
    session_of_card.history.clear()
    session_of_card.probes.clear()
    session_of_card.files.clear()
    return session_of_card


def refusal(call, **values):
    with pytest.raises(RuntimeError) as caught:
        call(**values)
    return str(caught.value).strip()


def image_values(name):
    """Return (H, W, 4) of a map's image, row 0 at the bottom."""
    image = bpy.data.images[f"IRPSO leaf {name}"]
    values = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(values)
    width, height = image.size
    return values.reshape(height, width, -1)


def test_without_a_recovery_every_button_names_the_next_step():
    for operator in (bpy.ops.irpso.keep, bpy.ops.irpso.export):
        assert "press Recover" in refusal(operator)


def test_errors_of_keep_and_export_use_blenders_setting_names(recovered, monkeypatch, tmp_path):
    from irpso_addon.ui.operators import export
    from irpso_addon.ui.session import keep

    def fail(*_):
        raise InputError("--memory 1K: is too little")

    monkeypatch.setattr(keep, "current_maps", fail)
    monkeypatch.setattr(export, "current_maps", fail)
    for said in (refusal(bpy.ops.irpso.keep), refusal(bpy.ops.irpso.export, filepath=str(tmp_path / "out"))):
        assert said == "Error: Memory Budget 1K: is too little"


def test_keep_puts_the_maps_on_a_visible_card(recovered):
    assert bpy.ops.irpso.keep() == {"FINISHED"}
    (obj,) = bpy.context.scene.objects
    assert obj.visible_get() and not obj.hide_render
    assert bpy.context.view_layer.objects.active == obj and obj.select_get()
    assert obj.data.materials[:] == [bpy.data.materials["IRPSO leaf"]]
    assert recovered.kept and recovered.subject() == obj
    assert all(bpy.data.images[f"IRPSO leaf {name}"].packed_file is not None for name in MAPS)


def test_the_kept_images_hold_the_maps_in_16_bits(recovered):
    bpy.ops.irpso.keep()
    found = recovered.maps().values
    normal = image_values("normal")[..., :3] * 2 - 1
    assert np.abs(normal - found["normal"]).max() < 4 / 65535
    assert np.abs(image_values("roughness")[..., 0] - found["roughness"][..., 0]).max() < 2 / 65535


def test_keeping_again_updates_the_material_and_keeps_the_users_nodes(recovered):
    bpy.ops.irpso.keep()
    material = bpy.data.materials["IRPSO leaf"]
    mine = material.node_tree.nodes.new("ShaderNodeHueSaturation")
    principled = next(n for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeBsdfPrincipled")
    material.node_tree.links.new(mine.outputs["Color"], principled.inputs["Base Color"])
    counts = len(bpy.data.materials), len(bpy.data.images), len(bpy.data.objects), len(material.node_tree.nodes)
    (obj,) = bpy.context.scene.objects
    obj.hide_viewport = True
    bpy.ops.irpso.keep()
    assert counts == (
        len(bpy.data.materials), len(bpy.data.images), len(bpy.data.objects), len(material.node_tree.nodes),
    )  # fmt: skip
    assert principled.inputs["Base Color"].links[0].from_node == mine
    assert obj.visible_get()


def test_keep_in_another_scene_makes_the_card_in_the_recoverys_scene(recovered):
    home, other = bpy.context.scene, bpy.data.scenes.new("Other")
    other.irpso.displacement = True
    try:
        with bpy.context.temp_override(scene=other, view_layer=other.view_layers[0]):
            for _ in range(2):
                assert bpy.ops.irpso.keep() == {"FINISHED"}
        (card,) = home.objects
        assert not other.objects[:] and card.visible_get() and bpy.context.view_layer.objects.active == card
        assert not card.modifiers and bpy.context.scene == home
        home.irpso.displacement = True
        with bpy.context.temp_override(scene=other, view_layer=other.view_layers[0]):
            bpy.ops.irpso.keep()
        assert not other.objects[:] and card.modifiers
    finally:
        home.irpso.displacement = False
        bpy.data.scenes.remove(other)


def test_a_card_removed_from_the_scene_is_linked_again(recovered):
    bpy.ops.irpso.keep()
    (obj,) = bpy.context.scene.objects
    bpy.context.scene.collection.objects.unlink(obj)
    bpy.ops.irpso.keep()
    assert bpy.context.scene.objects[:] == [obj]


def test_maps_go_into_the_folder_of_the_preferences(recovered, tmp_path, monkeypatch):
    from irpso_addon.ui.properties import preferences

    wanted = preferences.PreferenceValues(output_folder=str(tmp_path / "maps"))
    monkeypatch.setattr(preferences, "current", lambda context: wanted)
    bpy.ops.irpso.keep()
    assert sorted(path.name for path in (tmp_path / "maps").iterdir()) == [f"IRPSO_leaf_{name}.png" for name in MAPS]
    assert all(bpy.data.images[f"IRPSO leaf {name}"].packed_file is None for name in MAPS)


def test_keep_after_an_undone_keep_replaces_its_files_and_no_others(recovered, tmp_path, monkeypatch):
    from irpso_addon.ui.properties import preferences

    folder = tmp_path / "maps"
    wanted = preferences.PreferenceValues(output_folder=str(folder))
    monkeypatch.setattr(preferences, "current", lambda context: wanted)
    own = {f"IRPSO_leaf_{name}.png" for name in MAPS}
    bpy.ops.irpso.keep()
    bpy.data.batch_remove([*bpy.data.materials, *bpy.data.images, *bpy.data.objects])  # as an undo does
    bpy.ops.irpso.keep()
    assert {path.name for path in folder.iterdir()} == own

    bpy.data.batch_remove([*bpy.data.materials, *bpy.data.images, *bpy.data.objects])
    shown = bpy.data.images.load(str(folder / "IRPSO_leaf_normal.png"))  # the user's image shows this one
    (folder / "IRPSO_leaf_normal.png").write_bytes(b"shown")
    bpy.ops.irpso.keep()
    assert {path.name for path in folder.iterdir()} == own | {"IRPSO_leaf_normal_1.png"}
    assert Path(shown.filepath).read_bytes() == b"shown"

    bpy.data.batch_remove([*bpy.data.materials, *bpy.data.images, *bpy.data.objects])
    recovered.files.clear()  # another recovery
    former = {path: path.read_bytes() for path in folder.iterdir()}
    bpy.ops.irpso.keep()
    assert {path: path.read_bytes() for path in former} == former


def test_maps_of_the_saved_file_stay_when_keep_is_pressed_again_or_was_undone(recovered, tmp_path, monkeypatch):
    from irpso_addon.ui.properties import preferences

    folder = tmp_path / "maps"
    monkeypatch.setattr(preferences, "current", lambda context: preferences.PreferenceValues(output_folder=str(folder)))
    bpy.ops.irpso.keep()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "leaf.blend"), copy=True)
    shown = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    bpy.ops.irpso.keep()
    assert len(list(folder.iterdir())) == 2 * len(MAPS)
    bpy.data.batch_remove([*bpy.data.materials, *bpy.data.images, *bpy.data.objects])  # as an undo of both does
    recovered.files |= shown.keys()
    bpy.ops.irpso.keep()
    assert {path: path.stat().st_mtime_ns for path in shown} == shown
    assert len(list(folder.iterdir())) == 2 * len(MAPS)


def test_a_material_that_nothing_uses_is_not_kept(recovered):
    bpy.ops.irpso.keep()
    assert recovered.kept
    (obj,) = bpy.context.scene.objects
    material = obj.material_slots[0].material
    obj.material_slots[0].material = None
    assert not recovered.kept  # Blender would not save it
    material.use_fake_user = True
    assert recovered.kept
    obj.material_slots[0].material, material.use_fake_user = material, False
    assert recovered.kept
    bpy.ops.object.delete()  # its mesh stays, with the material, until the file is closed
    assert not bpy.data.objects and not recovered.kept


def test_a_folder_beside_a_file_that_is_not_saved_is_refused_and_nothing_is_made(recovered, tmp_path, monkeypatch):
    from irpso_addon.ui.properties import preferences
    from irpso_addon.ui.session.scene_job import make_job

    wanted = preferences.PreferenceValues(output_folder="//irpso test maps/")
    monkeypatch.setattr(preferences, "current", lambda context: wanted)
    assert "Output Folder: //irpso test maps/ lies beside the .blend file, which is not saved" in refusal(
        bpy.ops.irpso.keep
    )
    assert not bpy.data.materials and not Path("/irpso test maps").exists()
    with pytest.raises(InputError, match="not saved yet"):  # before an hour of work, too
        make_job(bpy.context)
    assert "Export: //out lies beside" in refusal(bpy.ops.irpso.export, filepath="//out")


def test_a_material_of_a_library_is_refused_with_what_to_do_and_nothing_is_made(recovered, tmp_path):
    bpy.ops.irpso.keep()
    bpy.data.materials["IRPSO leaf"].use_fake_user = True
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"), copy=True)
    bpy.data.batch_remove([*bpy.data.materials, *bpy.data.images, *bpy.data.objects])
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (there, here):
        here.materials = ["IRPSO leaf"]
    said = refusal(bpy.ops.irpso.keep)
    assert "make it local" in said and len(said.splitlines()) == 1
    assert len(bpy.data.materials) == 1 and not bpy.data.objects


def test_a_mesh_that_was_deleted_is_missed(recovered, monkeypatch):
    monkeypatch.setattr(recovered.job_run, "job", replace(recovered.job, mesh=object(), object_uid=-1))
    assert "has been deleted" in refusal(bpy.ops.irpso.keep)
    assert not bpy.data.materials


def test_maps_of_a_users_model_are_not_exported_by_a_changed_one(recovered, monkeypatch, tmp_path):
    for suffix in (".toml", ".glsl"):
        text = (MODELS / f"{recovered.job.model.name}{suffix}").read_text(encoding="utf-8")
        (tmp_path / f"mine{suffix}").write_text(text, encoding="utf-8")
    mine = tmp_path / "mine.toml"
    job = replace(recovered.job, model=load_model(mine), model_source=str(mine), model_digest=digest_of_own_model(mine))
    monkeypatch.setattr(recovered.job_run, "job", job)
    bpy.ops.irpso.export(filepath=str(tmp_path / "out"))
    report = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    assert report["settings"]["model"] == str(mine)  # though its name is that of the shipped one
    read_result(tmp_path / "out")
    mine.write_text(mine.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    with pytest.raises(InputError, match="has changed since this recovery"):
        read_result(tmp_path / "out")


def test_export_writes_the_files_that_the_command_line_writes(recovered, tmp_path):
    recovered.history[:] = [(1, 0.1), (2, 0.05), (4, 0.02)]
    bpy.ops.irpso.export(filepath=str(tmp_path / "out"))
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {
        *(f"{name}.{kind}" for name in MAPS for kind in ("png", "exr")),
        "maps.exr", "residual.exr", "confidence.exr", "confidence.png", "report.json", "preview.png",
        "convergence.png",
    }  # fmt: skip
    found = recovered.maps()
    written = read_exr(tmp_path / "out" / "roughness.exr")["roughness"]["Y"]
    np.testing.assert_array_equal(written, found.values["roughness"][..., 0])
    report = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    assert report["settings"]["preset"]["swarm"]["particles"] == 8
    assert report["texels"] == SHAPE[0] * SHAPE[1] and report["seed"] == 0
    assert set(report["priors_decided"]) == {"roughness", "metallic", "specular"}
    assert set(report["two_modes"]) == {"roughness", "metallic"}
    assert report["residual"]["mean"] == pytest.approx(found.residual.mean(), rel=1e-5)


def test_the_curves_of_an_export_are_at_the_iterations_they_were_taken(recovered):
    from irpso_addon.ui.session.keep import _curve

    curves = _curve("x", [[(1, 0.1), (3, 0.05)], [(2, 0.2), (3, 0.1)]])
    assert curves.iterations.tolist() == [1, 2, 3]
    np.testing.assert_allclose(curves.errors, [[10, np.nan], [np.nan, 20], [5, 10]])


def test_probes_are_marked_in_the_picture_of_the_convergence(recovered):
    from irpso_addon.ui.session.keep import current_maps, pictures_of

    found = current_maps(recovered, True)
    assert set(pictures_of(recovered, found)) == {"preview", "confidence"}
    recovered.probes.add(3, 5)
    recovered.probes[0].curve[:] = [(1, 0.1), (2, 0.05)]
    assert set(pictures_of(recovered, found)) == {"preview", "confidence", "convergence"}


def test_a_fifth_probe_replaces_the_oldest_with_a_message(recovered, capfd):
    for column in range(4):
        bpy.ops.irpso.probe(row=2, column=column)
    assert "moved" not in capfd.readouterr().out
    bpy.ops.irpso.probe(row=3, column=7)
    assert "Probe 1 has moved here from texel 0, 2: there are four at most" in capfd.readouterr().out
    assert [(probe.number, probe.column) for probe in recovered.probes] == [(2, 1), (3, 2), (4, 3), (1, 7)]
    assert recovered.probes.numbered(1).column == 7 and recovered.probes.numbered(3).column == 2
    bpy.ops.irpso.probe_remove(index=0)
    assert recovered.probes.numbered(2) == recovered.probes[0]
    bpy.ops.irpso.probe_clear()
    assert recovered.probes.numbered(1) is None


def test_image_nodes_are_called_as_the_sockets_that_they_drive(recovered):
    bpy.ops.irpso.keep()
    nodes = bpy.data.materials["IRPSO leaf"].node_tree.nodes
    labels = {node.label for node in nodes if node.bl_idname == "ShaderNodeTexImage"}
    assert labels == {"Base Color", "Normal", "Roughness", "Metallic", "Specular IOR Level"}


def test_the_standard_view_is_set_only_when_asked_for(recovered):
    view = bpy.context.scene.view_settings
    view.view_transform = "Filmic"
    view.look = "None"
    bpy.ops.irpso.keep()
    assert view.view_transform == "Filmic"
    bpy.ops.irpso.standard_view()
    assert view.view_transform == "Standard"
    assert "has the Standard view" in refusal(bpy.ops.irpso.standard_view)


CHANGES = {"look": "High Contrast", "exposure": 3.0, "gamma": 2.0, "use_curve_mapping": True, "use_white_balance": True}


@pytest.mark.parametrize("name", CHANGES)
def test_the_standard_view_is_one_without_other_changes_of_colors(registered, name):
    from irpso_addon.ui.session import keep

    view = bpy.context.scene.view_settings
    view.view_transform, view.look = "Standard", "None"
    if not hasattr(view, name):
        pytest.skip("Blender before 4.3 has no white balance")
    assert keep.is_standard_view(bpy.context.scene)
    neutral = getattr(view, name)
    setattr(view, name, CHANGES[name])
    assert not keep.is_standard_view(bpy.context.scene)
    assert bpy.ops.irpso.standard_view() == {"FINISHED"}
    assert keep.is_standard_view(bpy.context.scene) and getattr(view, name) == neutral


def test_a_configuration_without_the_standard_view_is_reported(registered, monkeypatch):
    from irpso_addon.ui.session import keep

    view = bpy.context.scene.view_settings
    view.view_transform = "Raw"
    monkeypatch.setattr(keep, "_STANDARD", "Un-tone-mapped")
    assert "has no view transform Standard: choose one" in refusal(bpy.ops.irpso.standard_view)
    assert view.view_transform == "Raw"


def test_a_folder_beside_the_saved_file_gives_the_images_relative_paths(recovered, tmp_path, monkeypatch):
    from irpso_addon.ui.properties import preferences

    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "leaf.blend"))
    monkeypatch.setattr(preferences, "current", lambda context: preferences.PreferenceValues(output_folder="//maps/"))
    bpy.ops.irpso.keep()
    assert {image.filepath for image in bpy.data.images if "irpso_map" in image} == {
        f"//maps/IRPSO_leaf_{name}.png" for name in MAPS
    }
