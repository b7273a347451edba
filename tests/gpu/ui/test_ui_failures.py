"""The panel reports failures of timers, draw handlers and modal operators, in words and once."""

import logging
from dataclasses import replace
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.pipeline.job import Job, LightOptions
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.ui.common import failures
from irpso_addon.ui.operators import capture_import, recover
from irpso_addon.ui.overlay import handlers, probes
from irpso_addon.ui.panels import sidebar as panels
from irpso_addon.ui.properties import upkeep
from irpso_addon.ui.session import session
from tests.builders.captures import write_diligent
from tests.builders.near_card import near_card

pytestmark = [pytest.mark.bpy_only, pytest.mark.usefixtures("registered")]


@pytest.fixture(autouse=True)
def scene(registered):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    failures.clear()
    yield bpy.context.scene
    failures.clear()


def broken(*_, **__):
    raise IndexError("index -1 is out of bounds")


def test_a_failed_check_ends_and_is_reported_in_the_panel(scene, tmp_path, monkeypatch):
    write_diligent(tmp_path)
    scene.irpso.capture_path = str(tmp_path)

    def steps():
        yield "Checking images: 1 of 5"
        broken()

    monkeypatch.setattr(capture_import, "_running",
                        [capture_import._Check(scene.session_uid, scene.irpso.capture_path, steps())])  # fmt: skip
    assert capture_import._tick() is None and not capture_import._running
    assert failures.messages() == ("The check has ended: index -1 is out of bounds",)
    assert panels.IRPSO_PT_failures.poll(bpy.context)


@pytest.mark.parametrize("name", ["_idle", "draw", "_follow"])
def test_a_repeated_drawing_failure_is_reported_once(monkeypatch, caplog, name):
    running = SimpleNamespace(closed=False, active=False, failure="")
    fails = dict.fromkeys(("update", "wants_redraw", "close", "draw_view"), broken)
    overlay = SimpleNamespace(running=running, is_due=lambda: True, **fails)
    monkeypatch.setattr(handlers, "_overlay", overlay)
    monkeypatch.setattr(handlers.context_guard, "active", object)
    monkeypatch.setattr(handlers, "_failed", None)
    monkeypatch.setattr(session, "_current", running)
    monkeypatch.setattr(handlers.bpy, "app", SimpleNamespace(background=False, timers=bpy.app.timers))
    with caplog.at_level(logging.ERROR):
        for _ in range(3):
            getattr(handlers, name)(*["draw_view"] * (name == "draw"))
            if name == "draw":
                monkeypatch.setattr(handlers, "_failed", None)  # even so
    assert failures.messages() == ("The overlay has ended: index -1 is out of bounds",)
    assert len([one for one in caplog.records if one.exc_info]) == 1
    assert running.failure == ""  # the recovery itself is well


@pytest.mark.parametrize("operator", [recover.IRPSO_OT_run, probes.IRPSO_OT_probe])
def test_a_failed_modal_operator_ends_and_is_reported(monkeypatch, operator):
    left = []
    one = SimpleNamespace(_handle=broken, _leave=lambda context: left.append(True) or {"FINISHED"},
                          _session=SimpleNamespace(pause=lambda: left.append("paused")))  # fmt: skip
    assert operator.modal(one, bpy.context, SimpleNamespace(type="TIMER", value="NOTHING")) == {"FINISHED"}
    assert left[-1] is True and failures.messages()[0].endswith("has ended: index -1 is out of bounds")


def test_a_list_that_cannot_be_filled_is_reported_and_not_raised(monkeypatch):
    monkeypatch.setattr(upkeep, "lacks_parameters", broken)
    assert upkeep.fill_lists() is None and len(failures.messages()) == 1


def test_an_expected_error_keeps_its_text_with_blenders_setting_names():
    with failures.reported("The check"):
        raise InputError("--memory 1K: is too little")
    assert failures.messages() == ("Memory Budget 1K: is too little",)


def test_options_of_the_command_line_become_words_of_the_panel():
    said = {
        "is of another version of the program; finish it there, or leave out --resume": "there, or delete it",
        "check the mesh's place and unit, --object and the cameras": "the chosen Object and the cameras",
        'search fewer, set linear = "solve", fix some (--fixed), or': "fix some, under Maps, or",
        "no relief that throws light; recover with --set interreflection_rounds=0": "light; switch Interreflection off",
        "choose fewer photographs, or a smaller --scale or --resolution": "or a smaller Scale or Resolution",
        "which the page does not show; choose gltf (--format gltf)": "show; choose the format glTF",
    }
    for text, words in said.items():
        found = failures.message_of(InputError(text))
        assert words in found and "--" not in found


@pytest.mark.parametrize("refused", ["lights", "fixed"])
def test_what_a_job_refuses_is_said_in_the_windows_words(refused, tmp_path):
    capture, _ = near_card()
    beams = [replace(shot, light=replace(shot.light, axis=(0, 0, -1), cosine=1.0)) for shot in capture.observations]
    options = {
        "lights": {"lights": LightOptions(degrees=2.0), "capture": replace(capture, observations=tuple(beams))},
        "fixed": {"fixed": {"slant": np.float32([0.5])}, "capture": capture, "mesh": SimpleNamespace()},
    }[refused]
    with pytest.raises(InputError) as caught:
        Job(name="x", model=load_model("anisotropic"), schedule=load_schedule("standard"), seed=0, size=(24, 16),
            scratch=tmp_path, **options)  # fmt: skip
    said = failures.message_of(caught.value)
    assert "--" not in said and said.startswith("Refine Lights: " if refused == "lights" else "Maps: slant is")


def test_a_remedy_that_the_window_lacks_is_named_as_one_of_the_command_line():
    found = failures.message_of(InputError("2 of the frames are shifted; irpso develop --register can correct that"))
    assert found.endswith("; the command line (irpso develop --register) can correct that")


def test_messages_are_dismissed_by_the_button_or_another_file():
    for dismiss in (bpy.ops.irpso.dismiss_failures, lambda: bpy.ops.wm.read_factory_settings(use_empty=True)):
        with failures.reported("The check"):
            broken()
        assert failures.messages()
        dismiss()
        assert failures.messages() == () and not panels.IRPSO_PT_failures.poll(bpy.context)
