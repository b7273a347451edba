"""The add-on's preferences: what holds without them, what they say, and the report on the machine."""

import bpy
import pytest

from irpso_addon.core.errors import GpuUnavailableError
from irpso_addon.core.paths import BASE_PACKAGE
from irpso_addon.ui.properties import preferences
from tests.builders.command_line import run_cli

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def enabled():
    """The add-on as Blender has it once it is enabled: with preferences."""
    addon = bpy.context.preferences.addons.new()
    addon.module = BASE_PACKAGE
    yield addon.preferences
    bpy.context.preferences.addons.remove(addon)


@pytest.fixture
def found():
    return {
        "renderer": "Card X", "vendor": "Maker", "version": "4.6", "backend": "VULKAN", "max_texture_size": 4096,
        "max_texture_layers": 7, "fragment_seconds": 3.0, "compute_seconds": 1.0,
    }  # fmt: skip


@pytest.mark.bpy_only
def test_without_preferences_there_are_defaults():
    assert preferences.current(bpy.context) == preferences.PreferenceValues(None, "auto", 10, "")


@pytest.mark.bpy_only
def test_preferences_start_with_defaults_and_keep_changes(enabled, tmp_path):
    assert preferences.current(bpy.context) == preferences.PreferenceValues()
    enabled.memory, enabled.entry, enabled.display_rate = " device=4G,host=8G ", "compute", 99
    enabled.output_folder = str(tmp_path)
    assert preferences.current(bpy.context) == preferences.PreferenceValues(
        "device=4G,host=8G", "compute", 60, str(tmp_path)
    )


@pytest.mark.bpy_only
@pytest.mark.parametrize(("text", "fault"), [("", ""), (" ", ""), ("4G", ""), ("device=2G", ""), ("much", "write an")])
def test_an_unreadable_budget_is_reported(text, fault):
    assert preferences.memory_fault(text)[:8] == fault
    assert "--memory" not in preferences.memory_fault(text)


@pytest.mark.bpy_only
def test_the_report_can_be_copied_after_doctor(monkeypatch, found):
    assert preferences.report() == "" and not bpy.ops.irpso.copy_report.poll()
    monkeypatch.setattr(preferences.probe, "probe", lambda: found)
    assert bpy.ops.irpso.doctor() == {"FINISHED"}
    facts = dict(line.split("  ", 1) for line in preferences.report().splitlines())
    facts = {name.strip(): value.strip() for name, value in facts.items()}
    assert facts["GPU"] == "Card X" and facts["largest texture"] == "4096 texels, 7 layers"
    assert facts["passes used"] == "compute" and "3.00 times" in facts["probe"]
    assert facts["version of blender"] == bpy.app.version_string
    assert bpy.ops.irpso.copy_report() == {"FINISHED"}


@pytest.mark.bpy_only
def test_a_machine_without_a_gpu_is_reported(monkeypatch, found):
    monkeypatch.setattr(preferences.probe, "probe", lambda: found)
    bpy.ops.irpso.doctor()

    def refuse():
        raise GpuUnavailableError("no GPU context could be made; install a driver")

    monkeypatch.setattr(preferences.probe, "probe", refuse)
    with pytest.raises(RuntimeError, match="no GPU context"):
        bpy.ops.irpso.doctor()
    assert "no GPU context could be made" in preferences.report() and "VULKAN" not in preferences.report()


def test_the_window_and_the_command_line_report_the_same_machine(monkeypatch):
    found = preferences.probe.probe()  # its timing differs from one probe to the next
    monkeypatch.setattr(preferences.probe, "probe", lambda: found)
    bpy.ops.irpso.doctor()
    code, out, _ = run_cli("doctor")
    assert code == 0 and preferences.report() in out
