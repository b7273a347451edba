"""Photographs held out by the window: the same figures as the command line's, and nothing else where it is off."""

import json
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from irpso_addon.core.errors import InputError
from tests.builders import command_line as cli_maker
from tests.builders.drawn_panels import drawn

SHAPE = (18, 24)
LIGHTS = cli_maker.dome_lights(20, widest=60)
HELD_OUT = ("light 4", "light 12")  # of 20
ITERATIONS = 30
pytestmark = pytest.mark.usefixtures("registered")


def write_capture(folder, lights):
    values = cli_maker.smooth_maps(SHAPE, {"roughness": (0.25, 0.6), "specular": (0.3, 0.8)}, seed=3)
    return cli_maker.write_card(folder, cli_maker.render_oracle("principled", values, lights), lights)


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_capture(tmp_path_factory.mktemp("capture") / "leaf", LIGHTS)


@pytest.fixture(scope="module")
def of_cli(capture, tmp_path_factory):
    """Return the folder and the report of the command line, lights estimated."""
    out = tmp_path_factory.mktemp("cli") / "out"
    code, _, said = cli_maker.run_cli(
        "recover", capture, "--model", "principled", "--hold-out", "auto", "--iterations", ITERATIONS,
        "--intensities", "estimate", "-o", out, "--quiet",
    )  # fmt: skip
    assert code == 0, said
    return out, json.loads((out / "report.json").read_text())


@pytest.fixture
def settings(capture, monkeypatch):
    """The settings of the command line's run, in a fresh file."""
    from irpso_addon.ui.common import drawing
    from irpso_addon.ui.session import session

    session.end()
    bpy.ops.wm.read_homefile(use_empty=True)
    monkeypatch.setattr(drawing, "_characters", lambda *_: 200)
    settings = bpy.context.scene.irpso
    settings.capture_path, settings.hold_out, settings.light_strengths = str(capture), "AUTO", "ESTIMATE"
    settings.model = "principled"
    settings.schedule.iterations = ITERATIONS
    yield settings
    session.end()


def begin():
    from irpso_addon.ui.session import session
    from irpso_addon.ui.session.scene_job import make_job

    return session.begin(make_job(bpy.context))


def exported(folder):
    assert bpy.ops.irpso.export(filepath=str(folder)) == {"FINISHED"}
    return json.loads((folder / "report.json").read_text())


def relighting(report):
    return {key: value for key, value in report.items() if key.startswith("relighting")}


def test_window_and_command_line_hold_out_the_same(settings, of_cli, tmp_path, monkeypatch):
    from irpso_addon.ui.common import words
    from irpso_addon.ui.translations.register import words as registered_words

    running = begin()
    while running.active:
        running.tick(0.05)
    assert (running.failure, running.state, running.title) == ("", "done", "Done")
    folder, wanted = of_cli
    report = exported(tmp_path / "out")
    assert tuple(report["relighting_psnr_db"]) == HELD_OUT
    assert report["settings"]["hold_out"] == wanted["settings"]["hold_out"] == "auto"
    assert set(relighting(report)) == set(relighting(wanted))
    for key in ("relighting_psnr_db", "relighting_highlights_psnr_db"):
        assert report[key] == pytest.approx(wanted[key], abs=1e-6)
    mean, bright = wanted["relighting_mean_psnr_db"], wanted["relighting_highlights_mean_psnr_db"]
    assert mean == pytest.approx(np.mean(list(wanted["relighting_psnr_db"].values())), abs=1e-3)
    plain, lit = (f"{10 ** (-psnr / 20):.1%} ({psnr:.1f} dB)" for psnr in (mean, bright))
    assert running.held_out_line == f"Unseen photographs: RMS error {plain}, in highlights {lit}"
    assert running.held_out_line in " ".join(drawn().texts)  # wrapped
    german = registered_words()["de"]
    in_german = SimpleNamespace(pgettext_iface=lambda text: german["*", text])
    monkeypatch.setattr(words, "translations", in_german)  # bpy has no languages
    assert running.held_out_line == f"Zurückgehaltene Fotos: RMS-Fehler {plain}, in Glanzlichtern {lit}"
    assert report["relighting_highlights_factor"] == wanted["relighting_highlights_factor"] == 1.5
    assert (tmp_path / "out" / "relit.png").read_bytes() == (folder / "relit.png").read_bytes()
    assert (tmp_path / "out" / "normal.exr").read_bytes() == (folder / "normal.exr").read_bytes()
    # Lights in the order of the files, though the stack has those held out last.
    assert report["lights"] == wanted["lights"]


def test_off_fits_all_photographs_and_reports_no_unseen_ones(settings, of_cli, tmp_path):
    settings.hold_out = "OFF"
    assert settings.bl_rna.properties["hold_out"].default == "OFF"
    running = begin()
    assert running.job.held_out == () and running.job.numbers == list(range(20))
    running.run()
    assert running.fitted is running.domain and running.recovery.domain.observations == 20
    assert running.held_out_line == "" and not any("nseen" in text for text in drawn().texts)
    assert relighting(exported(tmp_path / "out")) == {} and not (tmp_path / "out" / "relit.png").exists()
    code, *_ = cli_maker.run_cli(
        "recover", settings.capture_path, "--model", "principled", "--iterations", ITERATIONS,
        "--intensities", "estimate", "-o", tmp_path / "cli", "--quiet",
    )  # fmt: skip
    assert code == 0
    assert (tmp_path / "out" / "normal.exr").read_bytes() == (tmp_path / "cli" / "normal.exr").read_bytes()


def test_a_stopped_run_is_relit_again_after_resuming(settings):
    running = begin()
    while running.progress is None or running.progress.iteration_in_all < 3:
        running.tick(0.01)
    assert running.held_out_line == ""
    assert bpy.ops.irpso.stop() == {"FINISHED"}
    early = running.held_out_line
    assert running.stopped and running.kept and early.startswith("Unseen photographs: ")
    assert early in drawn().texts
    assert bpy.ops.irpso.resume() == {"FINISHED"}
    stamp = running.stamp
    while running.stamp == stamp:
        running.tick(0.01)
    assert running.held_out_line == ""  # it was of other maps
    running.run()
    assert running.held_out_line.startswith("Unseen photographs: ") and running.held_out_line != early


def test_a_run_stopped_in_a_stage_that_renders_nothing_is_kept_and_relit_anew_after_resuming(settings):
    running = begin()
    while running.progress is None or running.progress.title != "surface" or running.progress.iteration < 2:
        running.tick(0.0001)
    assert bpy.ops.irpso.stop() == {"FINISHED"}
    assert running.stopped and running.kept
    evaluations, normals = running.progress.evaluations, running.maps().values["normal"]
    (early,) = running.job_run.relit[1:]
    assert bpy.ops.irpso.resume() == {"FINISHED"}
    running.run()
    assert running.progress.evaluations == evaluations and (running.maps().values["normal"] != normals).any()
    assert not running.kept and running.job_run.relit[1] != early


def test_the_panel_shows_relighting_and_the_search_time_stops(settings):
    running = begin()
    while not running.relighting:
        running.tick(0.05)
    seconds, history = running.seconds, len(running.history)
    assert running.active and running.progress.done and not running.stopped
    assert "Relighting unseen photographs" in drawn().texts
    while running.relighting:
        running.tick(1e-6)
    assert running.seconds == seconds and len(running.history) <= history + 1
    assert running.state == "done" and running.held_out_line


def test_a_second_stop_does_not_wait_for_relighting_and_leaving_it_leaves_no_thread(settings, monkeypatch):
    from irpso_addon.ui.session import recovery

    monkeypatch.setattr(recovery, "maps_warnings", lambda run, maps: ["of these maps"])
    running = begin()
    while not running.relighting:
        running.tick(0.05)
    running.tick(1e-6)
    running.finish()
    assert (running.state, running.held_out_line, running._worker.busy) == ("done", "", False)
    assert running.warnings == ("of these maps",)
    running.close()
    assert running.fitted is None


def test_a_comparison_that_fails_loses_no_maps(settings, monkeypatch):
    from irpso_addon.pipeline import run
    from irpso_addon.ui.common import failures

    def fail(*_):
        raise MemoryError

    monkeypatch.setattr(run, "relit_steps", fail)
    running = begin()
    while running.active:
        running.tick(0.05)
    assert (running.state, running.closed, running.held_out_line) == ("done", False, "")
    assert failures.messages() and running.maps().solved.any()


def test_a_paused_run_exports_what_its_maps_relight(settings, tmp_path):
    running = begin()
    while running.progress is None or running.progress.iteration_in_all < 3:
        running.tick(0.01)
    running.pause()
    assert tuple(exported(tmp_path / "out")["relighting_psnr_db"]) == HELD_OUT
    assert (tmp_path / "out" / "relit.png").is_file() and running.state == "paused"


def test_too_few_photographs_are_refused_before_any_is_read(settings, tmp_path, monkeypatch):
    from irpso_addon.ui.session import scene_capture

    settings.capture_path = str(write_capture(tmp_path / "few", cli_maker.dome_lights(4, widest=60)))
    monkeypatch.setattr(scene_capture, "decode", lambda *_: pytest.fail("an image was read"))
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.irpso.recover()
    said = str(caught.value).strip()
    assert said == "Error: Hold Out: of 4 photographs none can be spared; set it to Off, or add some, to 5 or more"


def test_lights_that_are_too_few_without_those_held_out_are_refused(settings, tmp_path):
    from irpso_addon.ui.session.scene_job import make_job

    # Of five the last is held out, and the first four lie in one plane.
    angles = np.radians((-40, -15, 15, 40))
    lights = np.array([*((np.sin(a), 0.0, np.cos(a)) for a in angles), (0.0, 0.6, 0.8)])
    settings.capture_path = str(write_capture(tmp_path / "plane", lights))
    with pytest.raises(
        InputError, match="Hold Out: what is left to fit gives no normal: all .*in one plane.*; or set it to Off"
    ):
        make_job(bpy.context)
    settings.hold_out = "OFF"
    make_job(bpy.context)


def test_the_view_shows_a_fitted_photograph_by_the_number_that_it_has_in_the_files(settings):
    running = begin()
    while running.display is None:
        running.tick(0.05)
    view = settings.view
    view.shown = "REFERENCE"
    for chosen, shown in ((1, 0), (5, 5), (6, 5), (13, 13), (20, 19)):
        view.observation = chosen
        index = running.observation(view)
        assert running.job.capture.observations[index].name == f"light {shown}" and index in running.job.fitted
        assert running.job.numbers[index] == shown
        notice = f"Photograph {chosen} is held out: {shown + 1} is shown"
        assert (notice in drawn().texts) == (chosen in (5, 13))
        np.testing.assert_allclose(running.domain.lights[index, :3], LIGHTS[shown], atol=1e-6)
    assert "of 20" in drawn().texts
    np.testing.assert_array_equal(running.recovery.domain.lights, running.domain.lights[:18])
    assert np.shares_memory(
        running.fitted.stack.values, running.domain.stack.values
    )  # a stack on a disk is not read into memory


def test_held_out_photographs_are_part_of_the_recipe_and_of_the_domain(settings):
    from irpso_addon.ui.properties.recipe import apply_recipe
    from irpso_addon.ui.session.scene_job import make_job

    job = make_job(bpy.context)
    settings.hold_out = "OFF"
    assert make_job(bpy.context).source != job.source
    apply_recipe(settings, job.recipe)
    assert settings.hold_out == "AUTO" and make_job(bpy.context).source == job.source


def test_the_panel_has_the_setting(settings):
    assert "hold_out" in drawn().props
