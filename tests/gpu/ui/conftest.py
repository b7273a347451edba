"""A card's session for the tests of what follows a recovery."""

import pytest

from tests.builders import command_line as cli_maker

SHAPE = (18, 24)
LIGHTS = cli_maker.dome_lights(16, widest=70)


@pytest.fixture(scope="module")
def card(tmp_path_factory):
    """A capture of a card."""
    values = cli_maker.smooth_maps(SHAPE, {"roughness": (0.25, 0.6), "specular": (0.3, 0.8)}, seed=3)
    folder = tmp_path_factory.mktemp("capture") / "leaf"
    return cli_maker.write_card(folder, cli_maker.render_oracle("principled", values, LIGHTS), LIGHTS)


@pytest.fixture(scope="module")
def session_of_card(registered, card):
    """The card's session, run to its end once."""
    import bpy

    from irpso_addon.ui.session import session
    from irpso_addon.ui.session.scene_job import make_job

    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.context.scene.irpso.capture_path = str(card)
    running = session.begin(make_job(bpy.context))
    running.run()
    yield running
    session.end()
