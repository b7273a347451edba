"""The extension comes and goes in a living window, and files come and go under it, without a trace left."""

import pytest

from tests.gui.traces import SNAPSHOT, changes, switch


@pytest.fixture(scope="module")
def counted(window):
    """The window, able to tell what there is; the extension enabled."""
    window.run(SNAPSHOT)
    switch(window, "disable")
    switch(window, "enable")
    return window


def test_enabling_and_disabling_five_times_leaves_nothing_behind(counted):
    enabled, disabled = [], []
    for _ in range(5):  # what is left each time, or each other time, shows
        disabled.append(switch(counted, "disable"))
        enabled.append(switch(counted, "enable"))
    assert changes(disabled[0], disabled[-1]) == changes(enabled[0], enabled[-1]) == {}
    assert "types" in changes(disabled[0], enabled[0])


def test_disabling_leaves_no_name_of_the_extension(counted):
    after = switch(counted, "disable")
    switch(counted, "enable")
    assert [name for name in (*after["types"], *after["properties"]) if "irpso" in name.lower()] == []
    assert (after["timers"], after["drawn into Blender's menus"], after["draw handlers"]) == ([], [], 0)


def test_another_file_can_be_loaded_and_the_extension_is_there_in_it(counted, tmp_path):
    path = tmp_path / "other.blend"
    counted.run(f"bpy.data.objects['Cube'].name = 'Other'\nbpy.ops.wm.save_as_mainfile(filepath={str(path)!r})")
    counted.run("bpy.ops.wm.read_homefile()", area="")
    before = counted.run("snapshot()")
    assert counted.run("'Other' not in bpy.data.objects")
    counted.run(f"bpy.ops.wm.open_mainfile(filepath={str(path)!r})", area="")
    counted.run("redrawn()", area="")
    assert counted.run("'Other' in bpy.data.objects")
    after = counted.run("snapshot()")
    assert set(changes(before, after)) <= {"data"}
