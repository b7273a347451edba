"""What the panels show in every state."""

import functools
import sys
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

import irpso_addon
from irpso_addon.core.encode import srgb_from_linear
from irpso_addon.results.maps import Cause
from irpso_addon.solver.views.display import Shown
from tests.builders import command_line as cli_maker
from tests.builders.captures import chunk, write_png
from tests.builders.drawn_panels import drawn, labels

LIGHTS = cli_maker.dome_lights(12, widest=70)
OPENED: list[str] | None = None  # files, while they are watched


def _watch(event, arguments):
    if event == "open" and OPENED is not None:
        OPENED.append(str(arguments[0]))


sys.addaudithook(_watch)


@pytest.fixture(scope="module")
def card(tmp_path_factory):
    values = cli_maker.smooth_maps((10, 12), {"roughness": (0.25, 0.6), "specular": (0.3, 0.8)}, seed=3)
    folder = tmp_path_factory.mktemp("capture") / "leaf"
    return cli_maker.write_card(folder, cli_maker.render_oracle("principled", values, LIGHTS), LIGHTS)


@pytest.fixture(autouse=True)
def settings(monkeypatch):
    """The settings of a fresh file."""
    bpy.ops.wm.read_homefile(use_empty=True)
    irpso_addon.register()
    from irpso_addon.ui.common import drawing

    monkeypatch.setattr(drawing, "_characters", lambda *_: 200)
    yield bpy.context.scene.irpso
    irpso_addon.unregister()


@pytest.fixture
def chosen(settings):
    """The same, with a capture."""
    settings.capture_path = "/somewhere"
    return settings


@pytest.mark.bpy_only
def test_a_fresh_scene_asks_for_a_capture_and_shows_nothing_that_needs_one(settings):
    found = drawn()
    assert labels() == ["Capture", "Recover"] and found.props == ["source"]
    ways = ["irpso.import_capture", "irpso.choose_photographs", "irpso.open_sample"]
    assert set(ways) <= set(found.operators) and "irpso.create_scene" not in found.operators
    assert found.operators[-1] == "irpso.recover"  # grey: its tooltip and the first panel say how to begin
    assert any("Without any: Open Sample" in text for text in found.texts)
    assert drawn("IMAGE_EDITOR").operators == []


@pytest.mark.bpy_only
def test_settings_of_a_mesh_are_not_shown_for_a_card(chosen):
    found = drawn()
    assert labels()[:5] == ["Capture", "Colors and Lights", "Subject", "Maps", "Recover"]
    of_meshes = {"resolution", "shadows", "occluders"}
    assert not of_meshes & set(found.props)  # of a card it is the images', and it shades nothing
    chosen.subject = "MESH"
    assert of_meshes <= set(drawn().props)


@pytest.mark.bpy_only
def test_a_fresh_scene_and_a_new_one_have_the_parameters_of_their_model(settings):
    from irpso_addon.ui.properties import upkeep

    names = ["base_color", "normal", "roughness", "metallic", "specular"]
    assert [item.name for item in settings.parameters] == names
    other = bpy.data.scenes.new("other")
    assert len(other.irpso.parameters) == 0
    upkeep.fill_lists()
    assert [item.name for item in other.irpso.parameters] == names


@pytest.mark.bpy_only
def test_the_view_keeps_its_map_in_another_model_or_shows_the_first(settings):
    for first, name, second, found in [
        ("metallic_roughness", "specular", "lambert", "base_color"),
        ("metallic_roughness", "roughness", "clear_coat", "roughness"),
        ("lambert", "normal", "principled", "normal"),
    ]:
        settings.model = first
        settings.view.parameter = name
        settings.model = second
        assert settings.view.parameter == found


@pytest.mark.bpy_only
def test_a_file_keeps_its_model_when_there_are_more(settings, monkeypatch):
    from irpso_addon.ui.properties import model_items

    names = "anisotropic clear_coat cook_torrance_two_lobe lambert metallic_roughness principled principled_metallic"
    stored = {name: number for number, name in enumerate([*names.split(), "principled_two_lobe", "CUSTOM"])}  # 0.1.0
    numbers = {item.identifier: item.value for item in settings.bl_rna.properties["model"].enum_items}
    assert {name: numbers[name] for name in stored} == stored and len(set(numbers.values())) == len(numbers)
    monkeypatch.setattr(model_items, "load_model", lambda name: SimpleNamespace(title="a model"))
    assert model_items._model_item("an_added_one")[3] == 1611394408
    assert model_items._model_item("principled")[3] == stored["principled"]


@pytest.mark.bpy_only
def test_fixed_maps_have_value_fields(chosen):
    items = chosen.parameters
    items["base_color"].recover = items["roughness"].recover = items["normal"].recover = False
    found = drawn()
    assert found.props.count("recover") == 5 and found.props.count("image") == 3
    assert found.props.count("color") == 1 and found.props.count("value") == 1
    items["roughness"].image = bpy.data.images.new("given", 4, 4)
    assert drawn().props.count("value") == 0
    items["metallic"].recover = items["specular"].recover = False
    assert any("Nothing to recover" in text for text in drawn().texts)


@pytest.mark.bpy_only
def test_every_setting_of_the_search_is_somewhere_in_the_panels(chosen):
    from irpso_addon.solver.settings.schedule import SETTINGS

    chosen.schedule.levels = 2
    assert set(SETTINGS) <= set(drawn().props)


@pytest.mark.bpy_only
def test_settings_that_do_nothing_are_not_shown(chosen):
    chosen.schedule.preset = "paper"
    found = drawn().props
    assert "refinement_iterations" in found and "refinement_rounds" not in found
    assert "prior_rounds" in found and "prior_scales" not in found
    assert "loss" in found and "delta" not in found
    assert "level_iterations" not in found and "start_fraction" not in found


@pytest.mark.bpy_only
def test_errors_stand_above_and_warnings_in_details(settings):
    settings.capture_path = settings.checked_path = "/somewhere"
    settings.summary = "kind: table\nimages: 12\nenough for: normals\nlights: 12"
    for number in range(12):
        item = settings.findings.add()
        item.severity, item.message = ("error" if number == 9 else "warning"), f"number {number} is wrong"
    texts = drawn().texts
    shown = [text for text in texts if text.startswith("number") and "is wrong" in text]
    assert shown[0] == "number 9 is wrong" and len(shown) == 12
    assert texts.index(shown[0]) < texts.index("and 11 more, in Details") < texts.index(shown[1])
    assert "This capture cannot be used: number 9 is wrong. Then check again" in " ".join(texts)  # below the button
    assert "Images" in texts and "Details" in labels()
    settings.checked_path = "/another"
    assert not any("is wrong" in text for text in drawn().texts)


@pytest.mark.bpy_only
def test_a_light_of_the_scene_is_given_its_photograph(settings):
    settings.source = "SCENE"
    assert any("Select a light" in text for text in drawn().texts)
    light = bpy.data.objects.new("Key", bpy.data.lights.new("Key", "SUN"))
    bpy.context.scene.collection.objects.link(light)
    bpy.context.view_layer.objects.active = light
    found = drawn()
    assert "Key" in found.texts and "camera" in found.props


def test_the_observation_can_be_chosen_wherever_there_are_lights_of_a_capture(settings, card, tmp_path):
    from irpso_addon.ui.session import session
    from irpso_addon.ui.session.scene_job import make_job

    settings.capture_path = str(card)
    assert "observation" not in drawn().props
    bpy.ops.irpso.create_scene()
    assert drawn().props.count("observation") == 1 and "of 12" in drawn().texts
    session.begin(make_job(bpy.context))
    assert drawn().props.count("observation") == 1  # during a recovery, whatever is shown
    bpy.ops.irpso.cancel()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "lights.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "lights.blend"))
    assert drawn().props.count("observation") == 1


def test_the_panels_show_the_next_steps_from_loading_to_kept(settings, card):
    from irpso_addon.ui.session import session
    from irpso_addon.ui.session.scene_job import make_job

    settings.capture_path = str(card)
    running = session.begin(make_job(bpy.context))
    found = drawn()
    assert "Capture" not in labels() and "Search Settings" not in labels() and "View" not in labels()
    assert "irpso.cancel" in found.operators and "irpso.pause" not in found.operators
    while running.state != "running" or running.recovery.progress.iteration < 1:
        running.tick(0.01)
    found = drawn()
    assert {"irpso.pause", "irpso.stop", "irpso.cancel"} <= set(found.operators)
    assert "irpso.recover" not in found.operators and "View" in labels()
    progress = running.progress
    assert f"{progress.iteration_in_all} / {progress.iterations_in_all}" in found.texts
    bpy.ops.irpso.pause()
    found = drawn()
    assert "irpso.resume" in found.operators and "Search Settings" in labels() and "Capture" not in labels()
    assert set(drawn("IMAGE_EDITOR").operators) >= {"irpso.resume", "irpso.stop", "irpso.cancel"}
    bpy.ops.irpso.stop()
    found = drawn()
    assert "leaf: Stopped Early, Kept" in found.texts and {"irpso.resume", "irpso.recover"} <= set(found.operators)
    assert f"{running.progress.iteration_in_all} / {progress.iterations_in_all}" in found.texts
    running.resume()
    running.run()
    found = drawn()
    assert "leaf: Done" in found.texts and "irpso.resume" not in found.operators
    assert "irpso.keep" in found.operators and "irpso.recover" in found.operators
    assert "Search Settings" in labels() and "View" in labels() and "Capture" not in labels()
    bpy.context.scene.view_settings.view_transform = "Filmic"
    assert "irpso.standard_view" not in drawn().operators
    bpy.ops.irpso.keep()
    found = drawn()
    assert {"irpso.keep", "irpso.export", "irpso.cancel", "irpso.standard_view"} <= set(found.operators)
    bpy.ops.irpso.cancel()
    assert "View" not in labels() and "Capture" in labels() and "irpso.keep" not in drawn().operators


def test_a_warning_of_the_light_strengths_brings_their_setting_beside_recover_again(settings, card):
    from irpso_addon.ui.session import session
    from irpso_addon.ui.session.scene_job import make_job

    settings.capture_path, settings.model = str(card), "lambert"
    running = session.begin(make_job(bpy.context))
    running.run()
    running.warnings = ()
    assert "light_strengths" not in drawn().props
    running.warnings = ("the images contradict the lights' intensities; estimate them with --intensities estimate",)
    assert "light_strengths" in drawn().props and "hold_out" in drawn().props
    running.close()


def test_a_result_of_photographs_that_state_srgb_opens_none_of_them_to_be_drawn(settings, tmp_path, monkeypatch):
    from irpso_addon.ui.session import session
    from irpso_addon.ui.session.scene_job import make_job

    values = cli_maker.smooth_maps((10, 12), {}, seed=3)
    radiance = cli_maker.render_oracle("lambert", values, LIGHTS)
    lines = [str(len(LIGHTS))]
    for number, (image, light) in enumerate(zip(radiance, LIGHTS, strict=True)):
        codes = np.rint(255 * np.clip(srgb_from_linear(image[::-1]), 0, 1)).astype(int)
        write_png(tmp_path / f"{number}.png", codes, extra=chunk(b"sRGB", b"\0"))
        lines.append(f"{number}.png {light[0]:.6f} {light[1]:.6f} {light[2]:.6f}")
    (tmp_path / "lights.lp").write_text("\n".join(lines) + "\n")
    settings.capture_path, settings.model = str(tmp_path), "lambert"
    running = session.begin(make_job(bpy.context))
    running.run()
    assert running.job.capture.encoding.known_by == "file" and not running.job.capture.encoding.is_tested
    assert "irpso.keep" in drawn().operators
    monkeypatch.setattr(sys.modules[__name__], "OPENED", [])
    drawn()
    assert OPENED == [] and not running.job.capture.encoding.is_tested
    running.close()


@pytest.mark.bpy_only
def test_below_recover_stands_how_long_the_search_will_take(settings, card, monkeypatch):
    from irpso_addon.gpu import probe
    from irpso_addon.ui.session.forecast import search_time

    def times():
        return [text for text in drawn().texts if "minutes" in text or "hours" in text]

    def probed():
        return {"renderer": "llvmpipe", "fragment_seconds": 0.06 * 10_000, "compute_seconds": 0.06}

    bpy.ops.irpso.import_capture(filepath=str(card))
    assert (settings.checked_images, settings.checked_texels) == (12, 120)
    probe.measured.cache_clear()
    assert times() == []  # the device has not been measured
    monkeypatch.setattr(probe, "measured", functools.cache(probed))
    probe.measured()
    whole = times()
    assert len(whole) == 1
    settings.framing, settings.crop = "CROP", (0, 0, 1, 1)
    assert times() != whole
    settings.framing, settings.corners = "CORNERS", (0, 0, 12, 0, 12, 10, 0, 10)
    assert times() == whole
    settings.subject = "MESH"
    with_rounds = search_time(bpy.context)
    for impossible in ({"shadows": False}, {"levels": 2}):  # matte rounds do not run then, and are not counted
        for name, value in impossible.items():
            setattr(settings if name == "shadows" else settings.schedule, name, value)
        found = search_time(bpy.context)
        settings.schedule.interreflection_matte_rounds = 0
        assert found == search_time(bpy.context) != with_rounds
        settings.schedule.preset, settings.shadows = "standard", True
        assert search_time(bpy.context) == with_rounds
    settings.capture_path = ""
    assert times() == []


def test_the_view_panel_shows_only_settings_of_the_chosen_view(settings, card):
    from irpso_addon.ui.overlay.session_overlay import SessionOverlay
    from irpso_addon.ui.session import session
    from irpso_addon.ui.session.scene_job import make_job

    settings.capture_path = str(card)
    running = session.begin(make_job(bpy.context))
    while running.state != "running":
        running.tick(0.01)
    view = settings.view
    for shown, expected in {
        "PARAMETER": {"parameter"},
        "ERROR": {"red_error"},
        "CONFIDENCE": {"parameter", "red_deviation"},
        "RENDER": {"observation", "exposure"},
        "REFERENCE": {"observation", "exposure", "mark_unused"},
        "SPLIT": {"observation", "exposure", "mark_unused", "split"},
        "INDIRECT": set(),
    }.items():
        view.shown = shown
        found = set(drawn("IMAGE_EDITOR").props) & {
            "parameter", "red_error", "red_angle", "red_deviation", "observation", "exposure", "mark_unused", "split",
        }  # fmt: skip
        assert found == expected, shown
    assert any("Interreflection on" in text for text in drawn().texts)  # the view of the indirect light is empty
    view.shown, view.parameter = "CONFIDENCE", "normal"
    assert {"red_angle"} == set(drawn().props) & {"red_error", "red_angle", "red_deviation"}
    view.shown = "SPLIT"
    view.observation = 900
    assert view.observation == len(LIGHTS)
    assert f"of {len(LIGHTS)}" in drawn().texts
    running.probes.add(3, 4)
    running.probes[0].curve.append((1, 0.0123))
    found = drawn()
    assert "1:  4, 3   1.23 %" in found.texts and "irpso.probe_remove" in found.operators
    overlay, (probed,) = SessionOverlay(running, 0), running.probes
    assert not overlay._judge_probes()
    probed.unknown, view.parameter = {"normal": Cause.MOSTLY_INDIRECT}, "normal"
    why = "Unknown: light is mostly indirect"
    assert why not in drawn().texts  # it still changes
    running.pause()
    assert why in drawn().texts
    view.parameter = "base_color"
    assert why not in drawn().texts
    assert not overlay._judge_probes() and probed.judged is None and probed.unknown == {}
    running.display.picture(Shown("confidence", "normal"))
    assert overlay._judge_probes() and probed.judged == running.progress
    assert probed.unknown == running.display.unknown_at(3, 4) and not overlay._judge_probes()
    running.resume()
    view.show = False
    assert "shown" not in drawn().props


def test_the_panels_show_rounds_of_interreflection_and_what_they_found(settings, card):
    from irpso_addon.ui.session import session
    from irpso_addon.ui.session.scene_job import make_job

    settings.capture_path, settings.view.shown = str(card), "INDIRECT"
    settings.model, settings.schedule.interreflection = "lambert", True
    settings.schedule.interreflection_rounds = 1
    assert drawn().props.count("interreflection") == 1
    running = session.begin(make_job(bpy.context))
    while running.state != "running":
        running.tick(0.01)
    assert any("first round" in text for text in drawn().texts)
    while running.recovery.indirect_share is None:
        running.tick(0.01)
    assert not any("first round" in text for text in drawn().texts)
    running.run()
    running.warnings = ("they are explained worse than before",)
    texts = drawn().texts
    found = running.recovery.findings["interreflection"]
    assert texts[texts.index("Rounds") + 1] == "1" and "They are explained worse than before" in texts
    assert texts[texts.index("Strength") + 1] == f"{found['strength'][-1]:.2f}"
    assert texts[texts.index("Indirect Light") + 1].endswith("% of all") and "Left Unknown" not in texts
    bpy.ops.irpso.cancel()


@pytest.mark.bpy_only
@pytest.mark.parametrize("preset", ["standard", "paper", "/somewhere/own.toml"])
def test_drawing_the_panels_opens_no_file(settings, preset, monkeypatch):
    settings.schedule.preset = preset
    settings.capture_path = "/somewhere"
    settings.schedule.delta = 0.07
    drawn()  # Python reads modules and Blender its own files once
    monkeypatch.setattr(sys.modules[__name__], "OPENED", [])
    drawn()
    assert OPENED == []


@pytest.mark.bpy_only
def test_a_path_may_be_relative_to_the_file(settings, recwarn):
    settings.capture_path = "//capture"
    settings.model_path = "//own.toml"
    assert [str(warning.message) for warning in recwarn if "relative" in str(warning.message)] == []


@pytest.mark.bpy_only
def test_numbers_are_formatted_readably():
    from irpso_addon.ui.common import drawing

    assert [drawing.clock(s) for s in (0.4, 35, 723.2, 3723)] == ["0:00", "0:35", "12:03", "1:02:03"]
    assert [drawing.rate(e) for e in (940.0, 12345.0, 2.314e6)] == ["0.9 k/s", "12.3 k/s", "2.31 M/s"]
    assert [drawing.percent(e) for e in (0.01234, 0.5, 1.2e-6)] == ["1.23 %", "50 %", "< 0.001 %"]
