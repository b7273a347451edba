"""What is stored of a recovery that nobody has kept, and going on from it: settings, state, and what may be wrong."""

import bpy
import numpy as np
import pytest

from irpso_addon.core.errors import InputError
from tests.builders import command_line as cli_maker

pytestmark = pytest.mark.usefixtures("registered")
LIGHTS = cli_maker.dome_lights(12, widest=70)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of what is stored; none of the user's is touched."""
    from irpso_addon.ui.session import stored_recoveries

    monkeypatch.setattr(stored_recoveries, "folder", lambda: tmp_path / "unkept")
    stored_recoveries.refresh()
    yield tmp_path / "unkept"
    monkeypatch.undo()
    stored_recoveries.refresh()


@pytest.fixture
def plane(tmp_path):
    """Settings for the recovery of one slot of a mesh, roughness given by an image."""
    bpy.ops.wm.read_homefile(use_empty=True)
    values = cli_maker.smooth_maps((10, 10), {"roughness": (0.25, 0.6), "specular": (0.3, 0.8)}, seed=3)
    capture = cli_maker.write_card(tmp_path / "leaf", cli_maker.render_oracle("principled", values, LIGHTS), LIGHTS)
    bpy.ops.mesh.primitive_plane_add(size=2, location=(0, 0, -1))
    for name in ("skin", "cloth"):
        bpy.context.object.data.materials.append(bpy.data.materials.new(name))
    settings = bpy.context.scene.irpso
    settings.capture_path, settings.subject, settings.resolution, settings.seed = str(capture), "MESH", 8, 11
    settings.slots, settings.shadows = "ACTIVE", False
    settings.schedule.preset = "swarm"
    settings.schedule.iterations, settings.schedule.delta = 6, 0.043
    given = settings.parameters["roughness"]
    given.recover, given.image = False, bpy.data.images.new("gloss", 8, 8, float_buffer=True)
    given.image.pixels.foreach_set(np.linspace(0.2, 0.9, 8 * 8 * 4, dtype=np.float32))
    return settings


@pytest.fixture
def stored(plane, folder):
    """A recovery of which 3 of 6 iterations are made, stored as when its file closes."""
    from irpso_addon.ui.session import session, stored_recoveries
    from irpso_addon.ui.session.scene_job import make_job

    running = session.begin(make_job(bpy.context))
    while running.recovery is None:
        running.tick(0.05)
    running.recovery.step(3)
    running.history[:] = [(1, 0.5), (3, 0.25)]
    fraction = running.fraction
    assert 0 < fraction < 1
    session.reset()
    assert session.current() is None
    (found,) = stored_recoveries.listed()
    assert (found.name, found.fraction) == ("Plane skin", fraction)
    return found


def forget_settings(settings):
    for setting in settings.bl_rna.properties:
        if not setting.is_readonly:
            settings.property_unset(setting.identifier)
    settings.schedule.preset, settings.parameters["roughness"].recover = "standard", True


def test_a_stored_recovery_resumes_with_its_settings_to_the_same_maps(stored, plane, tmp_path):
    from irpso_addon.ui.session import session
    from irpso_addon.ui.session.scene_job import make_job

    bpy.context.object.active_material_index = 1
    forget_settings(plane)
    assert bpy.ops.irpso.restore(path=str(stored.path)) == {"FINISHED"}
    running = session.current()
    while running.active:
        running.tick(0.05)
    assert (running.failure, running.state, running.progress.iteration_in_all) == ("", "paused", 3)
    assert running.history[:2] == [(1, 0.5), (3, 0.25)] and not running.kept
    assert (plane.seed, plane.slots, plane.slot_list, plane.shadows) == (11, "NAMED", "0", False)
    assert bpy.ops.irpso.resume() == {"FINISHED"}
    running.run()
    values = running.maps().values
    assert stored.path.exists()
    assert bpy.ops.irpso.keep() == {"FINISHED"} and stored.path.exists()  # until the file with the maps is saved
    bpy.ops.irpso.cancel()
    assert stored.path.exists()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "kept.blend"))
    assert not stored.path.exists()
    running = session.begin(make_job(bpy.context))
    running.run()
    for name, whole in running.maps().values.items():
        np.testing.assert_array_equal(values[name], whole)
    session.end()


def test_a_collection_that_an_empty_shows_is_among_the_occluders(plane):
    from irpso_addon.ui.session.scene_job import make_job

    around, hidden = bpy.data.collections.new("Around"), bpy.data.collections.new("Hidden")
    bpy.context.scene.collection.children.link(around)
    bpy.ops.mesh.primitive_cube_add(location=(9, 0, 0))
    cube, empty = bpy.context.object, bpy.data.objects.new("Shows", None)
    bpy.context.scene.collection.objects.unlink(cube)
    hidden.objects.link(cube), around.objects.link(empty)
    empty.instance_type, empty.instance_collection = "COLLECTION", hidden
    plane.occluders, plane.object = around, bpy.data.objects["Plane"]
    assert make_job(bpy.context).mesh.occluders.shape == (12, 3, 3)
    hidden.objects.unlink(cube)
    hidden.objects.link(bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT")))
    assert not len(make_job(bpy.context).mesh.occluders)  # a lighting kit hides nothing


@pytest.mark.parametrize("how", ["object", "collection", "parent", "excluded", "removed"])
def test_a_hidden_occluder_is_refused_although_its_setting_keeps_it_evaluated(plane, how):
    from irpso_addon.ui.session.scene_job import make_job

    plane.object = bpy.context.object
    around, inner = bpy.data.collections.new("Around"), bpy.data.collections.new("Inner")
    top = bpy.context.scene.collection
    top.children.link(around), around.children.link(inner)
    bpy.ops.mesh.primitive_cube_add(location=(9, 0, 0))
    cube = bpy.context.object
    top.objects.unlink(cube)
    inner.objects.link(cube)
    plane.occluders = around
    assert len(make_job(bpy.context).mesh.occluders) == 12
    cube.hide_viewport, inner.hide_viewport = how == "object", how == "collection"
    around.hide_viewport = how == "parent"
    bpy.context.view_layer.layer_collection.children["Around"].exclude = how == "excluded"
    if how == "removed":
        top.children.unlink(around)
    bpy.context.view_layer.update()
    with pytest.raises(InputError, match="occluder 'Cube' is not in the active view layer or is hidden"):
        make_job(bpy.context)


def test_occluders_come_back_with_their_recovery(plane, folder):
    from irpso_addon.ui.session import session, stored_recoveries
    from irpso_addon.ui.session.scene_job import make_job

    subject = bpy.context.object
    group = bpy.data.collections.new("Around")
    bpy.context.scene.collection.children.link(group)
    bpy.ops.mesh.primitive_cube_add(location=(9, 0, 0))
    bpy.ops.object.light_add()
    for obj in (subject, bpy.data.objects["Cube"], bpy.data.objects["Point"]):
        group.objects.link(obj)
    plane.object, plane.slots, plane.occluders = subject, "ALL", group
    job = make_job(bpy.context)
    assert job.mesh.occluders.shape == (12, 3, 3) and job.mesh.occluders[..., 0].min() == 8
    running = session.begin(job)
    while running.recovery is None:
        running.tick(0.05)
    running.recovery.step(3)
    session.reset()
    (found,) = stored_recoveries.listed()
    plane.occluders = None
    assert make_job(bpy.context).source != job.source
    assert bpy.ops.irpso.restore(path=str(found.path)) == {"FINISHED"}
    assert plane.occluders == group and session.current().job.source == job.source
    session.end()
    bpy.data.collections.remove(group)
    with pytest.raises(RuntimeError, match="no collection 'Around' of occluders"):
        bpy.ops.irpso.restore(path=str(found.path))


def test_a_stored_recovery_outlives_a_keep_that_was_undone_before_saving(stored, plane, tmp_path):
    from irpso_addon.ui.session import session

    assert bpy.ops.irpso.restore(path=str(stored.path)) == {"FINISHED"}
    session.current().run()
    assert bpy.ops.irpso.keep() == {"FINISHED"}
    for material in list(bpy.data.materials):
        bpy.data.materials.remove(material)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "undone.blend"))
    assert stored.path.exists()
    session.end()


def test_a_stored_recovery_outlives_a_kept_material_that_was_taken_off(stored, plane, tmp_path):
    from irpso_addon.ui.session import session

    bpy.ops.irpso.restore(path=str(stored.path))
    session.current().run()
    assert bpy.ops.irpso.keep() == {"FINISHED"}
    bpy.context.object.material_slots[0].material = None
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "off.blend"))  # without the material
    assert stored.path.exists()
    session.end()


def test_kept_or_discarded_recoveries_are_not_stored(plane, folder):
    from irpso_addon.ui.session import session, stored_recoveries
    from irpso_addon.ui.session.scene_job import make_job

    session.begin(make_job(bpy.context)).run()
    bpy.ops.irpso.keep()
    session.reset()
    session.begin(make_job(bpy.context)).run()
    bpy.ops.irpso.cancel()
    session.reset()
    assert stored_recoveries.listed() == [] and not folder.exists()


def test_discard_and_forget_delete_a_stored_recovery(stored, folder):
    from irpso_addon.ui.session import session, stored_recoveries

    mine = folder / "mine.npz"
    mine.write_bytes(b"no checkpoint")
    bpy.ops.irpso.restore(path=str(stored.path))
    while session.current().active:
        session.current().tick(0.05)
    bpy.ops.irpso.cancel()
    assert list(folder.iterdir()) == [mine] and session.current() is None
    with pytest.raises(RuntimeError, match="no longer stored"):
        bpy.ops.irpso.restore(path=str(stored.path))
    with pytest.raises(RuntimeError, match="no longer stored"):
        bpy.ops.irpso.forget(path=str(mine))
    assert stored_recoveries.listed() == [] and mine.exists()


def test_settings_changed_while_a_stored_recovery_loads_take_effect_when_it_goes_on(stored, plane):
    from irpso_addon.ui.session import session

    bpy.ops.irpso.restore(path=str(stored.path))
    running = session.current()
    running.pause()
    plane.schedule.delta = 0.0625
    assert bpy.ops.irpso.resume() == {"FINISHED"}
    while running.active:
        running.tick(0.05)
    assert (running.failure, running.state, running.progress.iteration_in_all) == ("", "paused", 3)
    assert bpy.ops.irpso.resume() == {"FINISHED"}
    assert running.job.schedule.fitness.delta == running.job.recipe["schedule"]["delta"] == 0.0625
    session.end()


def test_cancel_while_a_stored_recovery_loads_keeps_it(stored):
    from irpso_addon.ui.session import session

    bpy.ops.irpso.restore(path=str(stored.path))
    session.current().pause()
    assert bpy.ops.irpso.cancel() == {"FINISHED"}
    assert session.current() is None and stored.path.exists()


def test_missing_objects_are_reported_and_nothing_is_changed(stored, plane):
    plane.seed = 99
    bpy.data.objects.remove(bpy.data.objects["Plane"])
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.irpso.restore(path=str(stored.path))
    assert "this file has no object 'Plane'" in str(caught.value) and plane.seed == 99
    assert stored.path.exists()


def test_a_deleted_mesh_is_missed_although_its_setting_keeps_it_in_the_file(plane):
    from irpso_addon.ui.session.scene_job import make_job, subject_object

    plane.object = bpy.context.object
    assert subject_object(bpy.context) == plane.object
    bpy.ops.object.delete()
    bpy.ops.mesh.primitive_plane_add()
    assert plane.object is not None and subject_object(bpy.context) is None
    with pytest.raises(InputError, match="'Plane' has been deleted: undo that"):
        make_job(bpy.context)


def test_a_linked_object_of_the_meshs_name_does_not_stand_for_it(plane, tmp_path):
    from irpso_addon.ui.session.scene_job import subject_object

    mine = plane.object = bpy.context.object
    bpy.data.libraries.write(str(tmp_path / "lib.blend"), {mine})
    with bpy.data.libraries.load(str(tmp_path / "lib.blend"), link=True) as (_, wanted):
        wanted.objects = [mine.name]
    bpy.context.scene.collection.objects.link(wanted.objects[0])
    for obj in (mine, wanted.objects[0]):
        plane.object = obj
        assert subject_object(bpy.context) == obj


def test_without_its_photographs_a_stored_recovery_changes_no_setting(stored, plane, tmp_path):
    (tmp_path / "leaf").rename(tmp_path / "moved")
    forget_settings(plane)
    plane.capture_path, plane.framing, plane.crop = "//elsewhere", "CROP", (1, 2, 3, 4)
    plane.slots, plane.slot_list, plane.seed, plane.schedule.delta = "NAMED", "cloth", 99, 0.125
    plane.parameters["roughness"].recover, plane.parameters["specular"].value = True, 0.375
    with pytest.raises(RuntimeError, match="leaf"):
        bpy.ops.irpso.restore(path=str(stored.path))
    assert (plane.capture_path, plane.framing, tuple(plane.crop)) == ("//elsewhere", "CROP", (1, 2, 3, 4))
    assert (plane.slots, plane.slot_list, plane.seed, plane.schedule.delta) == ("NAMED", "cloth", 99, 0.125)
    assert plane.parameters["roughness"].recover and plane.parameters["specular"].value == 0.375


def test_changed_photographs_are_reported_in_the_panels_words(stored, plane):
    from irpso_addon.ui.session import session

    plane.parameters["roughness"].image.pixels.foreach_set(np.full(8 * 8 * 4, 0.5, np.float32))
    bpy.ops.irpso.restore(path=str(stored.path))
    running = session.current()
    while running.active:
        running.tick(0.05)
    assert "is of another recovery: fixed differs; delete it, and recover anew" in running.failure
    assert "--" not in running.failure and stored.path.exists()


def test_a_folder_that_cannot_be_written_keeps_no_file_from_being_closed(plane, folder, caplog):
    from irpso_addon.ui.common import failures
    from irpso_addon.ui.session import session, stored_recoveries
    from irpso_addon.ui.session.scene_job import make_job

    folder.write_text("in the way")
    session.begin(make_job(bpy.context)).run()
    bpy.ops.wm.read_homefile(use_empty=True)
    assert session.current() is None and stored_recoveries.listed() == []
    assert folder.read_text() == "in the way" and "Plane skin could not be stored" in caplog.text
    assert failures.messages()[0].startswith("the recovery of 'Plane skin' could not be stored and is lost")


def test_another_recovery_replaces_one_that_is_less_far_and_none_that_cannot_be_stored(plane, folder):
    from irpso_addon.ui.session import session, stored_recoveries
    from irpso_addon.ui.session.scene_job import make_job

    def begun(steps):
        running = session.begin(make_job(bpy.context))
        while running.recovery is None:
            running.tick(0.05)
        running.recovery.step(steps)
        return running

    fractions = [begun(steps).fraction for steps in (3, 6, 2, 1)]  # each stores the one before
    assert fractions[0] < fractions[1] == 1
    assert [one.fraction for one in stored_recoveries.listed()] == [fractions[2], 1.0]
    for path in folder.iterdir():
        path.unlink()
    folder.rmdir()
    folder.touch()  # a file, where the folder should be
    running = session.current()
    with pytest.raises(InputError, match="could not be stored .* keep or close it"):
        session.begin(make_job(bpy.context))
    assert session.current() is running and not running.closed
    session.end()


def test_recoveries_of_other_captures_and_models_do_not_replace_each_other(plane, folder, tmp_path):
    from irpso_addon.ui.session import session, stored_recoveries
    from irpso_addon.ui.session.scene_job import make_job

    (tmp_path / "other").mkdir()
    other = cli_maker.write_card(tmp_path / "other" / "bark", np.full((12, 10, 10, 3), 0.3, np.float32), LIGHTS)
    for path, model in ((plane.capture_path, plane.model), (other, plane.model), (other, "metallic_roughness")):
        plane.capture_path, plane.model = str(path), model
        running = session.begin(make_job(bpy.context))
        while running.recovery is None:
            running.tick(0.05)
        running.recovery.step(3)
        session.reset()
    found = stored_recoveries.listed()
    assert len(found) == 3 and {one.name for one in found} == {"Plane skin"}


def test_a_stored_recovery_with_former_names_of_settings_is_restored(stored, plane):
    from irpso_addon.ui.properties import recipe

    schedule = dict(stored.recipe["schedule"])
    for old, now, value in (("seed", "start", "random"), ("refinement_votes", "refinement_neighbour_weight", 2.5)):
        del schedule[now]
        schedule[old] = value
    recipe.apply_recipe(plane, stored.recipe | {"schedule": schedule | {"loss": "robust"}})
    found = plane.schedule
    assert (found.start, found.refinement_neighbour_weight, found.loss) == ("random", 2.5, "cauchy")


def test_a_stored_recovery_of_an_earlier_version_is_listed_and_can_be_deleted(stored):
    from irpso_addon.ui.session import stored_recoveries

    with np.load(stored.path) as file:
        arrays = {name.replace("extra_", "note_"): file[name] for name in file.files}
    with stored.path.open("wb") as file:
        np.savez(file, **arrays)
    stored_recoveries.refresh()
    (found,) = stored_recoveries.listed()
    assert found.name == stored.name
    stored_recoveries.delete(found.path)
    assert not stored.path.exists() and stored_recoveries.listed() == []


def test_a_given_image_that_is_not_in_the_file_is_named(stored):
    from irpso_addon.ui.properties import recipe

    gone = {**stored.recipe, "parameters": {"roughness": {**stored.recipe["parameters"]["roughness"], "image": "lost"}}}
    with pytest.raises(InputError, match="no image 'lost', given for roughness"):
        recipe.apply_recipe(bpy.context.scene.irpso, gone)


def test_settings_of_another_version_are_refused_and_the_scenes_stay(stored, plane):
    from irpso_addon.ui.session import stored_recoveries

    forget_settings(plane)
    plane.capture_path, plane.model = "/mine", "clear_coat"
    kept = stored.recipe
    for settings in ({"model": "of_tomorrow"}, {"seed": "many"}):
        other = {**kept, "settings": kept["settings"] | settings}
        stored_recoveries.listed()[0].recipe.update(other)
        with pytest.raises(
            RuntimeError, match="its settings are of another version of the program .*; finish it there"
        ):
            bpy.ops.irpso.restore(path=str(stored.path))
        assert (plane.capture_path, plane.model) == ("/mine", "clear_coat")
