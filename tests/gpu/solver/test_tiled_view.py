"""Pictures and single texels of recoveries in tiles, against those of the whole."""

from contextlib import closing

import numpy as np
import pytest

from irpso_addon.gpu import context, textures
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import UNKNOWN, Cause
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.engine.tiled import TiledRecovery
from irpso_addon.solver.views import tiled_view
from irpso_addon.solver.views.display import Display, Shown
from irpso_addon.solver.views.texel_probe import TexelProbe
from irpso_addon.solver.views.tiled_view import display_of, texel_probe_of
from tests.builders.domains import SHORT, subject

LAMBERT = load_model("lambert")
BOXES = [(0, 0, 7, 5), (7, 0, 10, 5), (0, 5, 17, 8)]
COLOR, ERROR = Shown("parameter", "base_color"), Shown("error")


@pytest.fixture(scope="module")
def domain():
    """A mesh of 17 × 13 texels, some of them empty."""
    context.ensure()
    return subject(card=False)[0]


@pytest.fixture(scope="module")
def whole(domain):
    """A recovery of it as a whole, at its end."""
    with Recovery(domain, LAMBERT, SHORT, 1, entry="fragment") as recovery:
        recovery.step()
        yield recovery


def tiled(domain, on_device=None):
    """Return a recovery of it in tiles."""
    options = {"boxes": BOXES, "halo": SHORT.swarm.neighbourhood // 2, "on_device": on_device}
    return TiledRecovery(domain, LAMBERT, SHORT, 1, entry="fragment", **options)


def picture_of(display, shown):
    return textures.download(display.picture(shown)).copy()


@pytest.fixture(scope="module")
def wanted(whole):
    """What is shown of the whole: Shown → (H, W, 4)."""
    with closing(Display(whole)) as display:
        return {shown: picture_of(display, shown) for shown in (COLOR, ERROR)}


@pytest.mark.parametrize("shown", [COLOR, ERROR], ids=["parameter", "error"])
def test_tiles_make_up_the_picture_of_the_whole(domain, wanted, shown):
    with tiled(domain) as recovery:
        recovery.step()
        with closing(display_of(recovery)) as display:
            assert display.pending(shown)
            np.testing.assert_array_equal(picture_of(display, shown), wanted[shown])
            assert not display.pending(shown)


def test_texels_that_the_whole_calls_unknown_are_marked_in_their_tiles(domain, monkeypatch):
    mask = np.random.default_rng(0).random(domain.shape) < 0.3
    causes = {"normal": {Cause.MOSTLY_INDIRECT: mask}}
    monkeypatch.setattr(TiledRecovery, "unknown_texels", lambda self, name: causes.get(name, {}))
    shown = Shown("parameter", "normal", unknown=UNKNOWN * np.pi / 2)
    with tiled(domain) as recovery, closing(display_of(recovery)) as display:
        recovery.step()
        assert display.unknown_at(*np.argwhere(domain.solvable)[0]) is None  # nothing is measured yet
        alpha = picture_of(display, shown)[..., 3]
        for row, column in np.argwhere(domain.solvable):
            cause = display.unknown_at(row, column).get("normal")
            assert (cause is Cause.MOSTLY_INDIRECT) == mask[row, column]
            assert (0 < alpha[row, column] < 1) == (cause is not None)


def test_a_side_longer_than_a_picture_shows_fewer_texels(domain, wanted, monkeypatch):
    monkeypatch.setattr(tiled_view, "_SIDE", 8)
    with tiled(domain) as recovery:
        recovery.step()
        with closing(display_of(recovery)) as display:
            found = picture_of(display, COLOR)
    assert found.shape == (8, 8, 4)
    rows, columns = ((np.arange(8) + 0.5) * np.array([[13], [17]]) / 8).astype(int)
    np.testing.assert_array_equal(found, wanted[COLOR][rows][:, columns])


def test_swapped_tiles_show_their_last_state(domain, wanted):
    with tiled(domain, on_device=1) as recovery, closing(display_of(recovery)) as display:
        steps = 0
        while not recovery.step(time_budget_s=1e-6).done:
            steps += 1
            if steps % 5 == 0:
                display.picture(COLOR)
        found = picture_of(display, COLOR)
    np.testing.assert_array_equal(found[..., 3], wanted[COLOR][..., 3])  # every tile was there once
    same = (found == wanted[COLOR]).all(axis=-1)
    assert any(same[y : y + h, x : x + w].all() for x, y, w, h in BOXES)  # the tile on the device is up to date


def test_a_texel_is_read_from_a_resident_tile(domain, whole):
    with tiled(domain) as recovery:
        recovery.step()
        with closing(texel_probe_of(recovery)) as probe, closing(TexelProbe(whole)) as other:
            for row, column in np.argwhere(domain.solvable)[::17].tolist():
                found, state = probe.read(row, column), other.read(row, column)
                assert found.error == state.error
                np.testing.assert_array_equal(found.values["base_color"], state.values["base_color"])
    with tiled(domain, on_device=1) as recovery, closing(texel_probe_of(recovery)) as probe:
        recovery.step(iterations=2)
        there = [probe.read(row, column) is not None for row, column in np.argwhere(domain.solvable).tolist()]
        assert 0 < sum(there) < len(there)


def test_the_mean_error_of_swapped_tiles_counts_all(domain, whole):
    with tiled(domain, on_device=1) as recovery:
        recovery.step()
        for number in range(len(BOXES)):
            recovery._pool.recovery(number)
            found = recovery.mean_error()
        assert found == pytest.approx(whole.mean_error(), rel=1e-5)
