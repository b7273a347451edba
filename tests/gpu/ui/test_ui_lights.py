"""Lights that are not known well, in the window's session and panels."""

import bpy
import numpy as np
import pytest

from irpso_addon.solver.lights.refine import Lights
from tests.builders import command_line as cli_maker
from tests.builders.drawn_panels import Drawn
from tests.builders.lights import gains, off

LIGHTS = cli_maker.dome_lights(12)
FACTORS = gains(12, np.random.default_rng(1))


pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture(scope="module")
def truth():
    return cli_maker.smooth_maps((20, 24), {}, tilt=35)


@pytest.fixture(scope="module")
def settings(tmp_path_factory, truth):
    """The settings of a scene with a capture of a matte card under lights of unequal strength."""
    images = cli_maker.render_oracle("lambert", truth, LIGHTS) * FACTORS[:, None, None]
    folder = cli_maker.write_card(tmp_path_factory.mktemp("unequal") / "card", images, LIGHTS)
    bpy.ops.wm.read_homefile(use_empty=True)
    settings = bpy.context.scene.irpso
    settings.capture_path, settings.subject, settings.model = str(folder), "CARD", "lambert"
    return settings


def begun():
    from irpso_addon.ui.session import session
    from irpso_addon.ui.session.scene_job import make_job

    return session.begin(make_job(bpy.context))


def test_lights_are_refined_on_request_or_automatically(settings):
    from irpso_addon.pipeline.job import LightOptions
    from irpso_addon.ui.session.scene_job import make_job

    assert make_job(bpy.context).lights == LightOptions("auto", 0.0)
    settings.refine_directions = np.radians(2.5)
    settings.light_strengths = "ESTIMATE"
    assert make_job(bpy.context).lights == LightOptions("estimate", 2.5)
    settings.refine_directions = 0


def test_strengths_are_estimated_in_slices_and_reported(settings, truth, monkeypatch):
    from irpso_addon.ui.panels import recovery as panels
    from irpso_addon.ui.session import keep, session

    settings.light_strengths = "ESTIMATE"
    running = begun()
    titles, fractions = set(), []
    while running.active and running.recovery is None:
        running.tick(0.01)
        titles.add(running.title)
        fractions.append(running.fraction)
    assert not running.failure
    assert "Finding the lights" in titles
    assert len([part for part in fractions if 0 < part < 1]) > 10
    while running.active:
        running.tick(0.5)
    assert off(running.lights.intensities, FACTORS).max() < 0.02
    np.testing.assert_array_equal(running.recovery.domain.intensities, running.lights.intensities)
    found = keep.current_maps(running, True)
    assert np.median(cli_maker.angle(found.in_solver_frames.values["normal"], truth["normal"])) < 0.5
    assert keep.report_of(running, found)["lights"] == running.lights.report()
    drawn = Drawn()
    monkeypatch.setattr(
        panels.drawing, "fact", lambda layout, context, name, value, **_: drawn.notes["texts"].append(value)
    )
    panels.draw_result(drawn, bpy.context, running)
    assert running.lights.summary() in drawn.notes["texts"]
    found = running.lights
    again = begun()  # what was found for the same photographs and settings need not be found again
    while again.active and again.recovery is None:
        again.tick(0.05)
    assert again.lights is found
    session.end()


def test_the_panel_offers_both_settings(settings):
    from irpso_addon.ui.panels import capture as panels

    drawn = Drawn()
    panels.IRPSO_PT_capture_reading.draw(type("Panel", (), {"layout": drawn})(), bpy.context)
    assert {"light_strengths", "refine_directions"} <= set(drawn.notes["props"])


@pytest.mark.parametrize(
    ("factors", "turned", "text"),
    [(1.0, 0.0, "as given"), (2.0, 0.0, "2 to 2 × as given"), (1.0, 1.25, "turned by 1.2°")],
)
def test_a_summary_says_how_far_lights_are_from_those_given(factors, turned, text):
    one = np.ones((4, 3))
    lights = Lights(np.ones((4, 4)), one, factors * one, 0 * one, np.full(4, turned), 1.0, 3, 0.0, np.zeros((3, 3)))
    assert lights.summary() == text


@pytest.mark.parametrize(
    ("factors", "determined", "change", "words"),
    [(1.0, 1.0, 0.0, []), (1.0, 0.001, 0.0, []), (2.0, 0.001, 0.0, ["nearly flat"]), (1.0, 1.0, 0.5, ["not converge"])],
)
def test_warnings_are_of_what_was_estimated(factors, determined, change, words):
    one = np.ones((4, 3))
    lights = Lights(np.ones((4, 4)), one, factors * one, 0 * one, np.zeros(4), determined, 3, change, np.zeros((3, 3)))
    warnings = lights.warnings()
    assert len(warnings) == len(words) and all(word in text for word, text in zip(words, warnings, strict=True))
