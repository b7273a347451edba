"""The live maps as pictures, against numpy."""

from types import SimpleNamespace

import numpy as np
import pytest

from irpso_addon.core.encode import encode_normal, srgb_from_linear
from irpso_addon.core.errors import InputError
from irpso_addon.geometry.domain import with_samples
from irpso_addon.gpu import textures
from irpso_addon.gpu.passes import Pass
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.false_color import COLORS, false_color
from irpso_addon.solver.engine.coarse_to_fine import Pyramid
from irpso_addon.solver.engine.engine import Capabilities
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state.packing import Packing
from irpso_addon.solver.views import display as display_module
from irpso_addon.solver.views.display import Display, Shown
from tests.builders.domains import SHORT, makers, recoveries, subject
from tests.builders.rounds import SINGLE, matt_bowl, rounds_of
from tests.oracles.swarm import MODELS, direction_to, frames, turned

TWO_LOBES = load_model("cook_torrance_two_lobe")
HALF = 6e-4  # of RGBA16F just under 1, and a little for the curves' float32
recover = pytest.fixture(recoveries)


@pytest.fixture(params=[True, False], ids=["card", "mesh"])
def running(request, recover):
    """A recovery of 17 × 13 texels with holes in its domain, five iterations old."""
    domain, _ = subject(
        model=TWO_LOBES.name, card=request.param, colored=True, perspective=not request.param, near=not request.param
    )
    recovery = recover(domain, TWO_LOBES)
    recovery.step(iterations=5)
    return recovery


@pytest.fixture
def show():
    """A maker of displays, which are closed at the end."""
    yield from makers(Display)


def seen(display, *shown, **options):
    """(H, W, 4) of a picture."""
    return textures.download(display.picture(Shown(*shown, **options)))


def radiance_of(recovery, observation):
    """(H, W, 3) render of a recovery's maps under an observation's light, in float64 by the oracle."""
    domain, values = recovery.domain, recovery.maps(confidence=False).values
    values = {name: v.astype(np.float64) for name, v in values.items()}
    frame, position = frames(domain.bake), domain.bake.position.astype(np.float64)
    light, squared = direction_to(domain.lights[observation], position)
    view, _ = direction_to(domain.views[observation], position)
    render = MODELS[recovery.model.name](values, turned(frame, light), turned(frame, view))
    return render * domain.intensities[observation] / squared


# ---- what the pictures show --------------------------------------------------------------------------------------


def test_alpha_is_one_at_solved_texels_and_zero_elsewhere(running, show):
    display, solved = show(running), running.domain.solvable
    assert 0 < solved.sum() < solved.size
    for shown in (("parameter", "normal"), ("error",), ("render",), ("confidence", "r1")):
        picture = seen(display, *shown)
        assert picture.shape == (13, 17, 4)
        np.testing.assert_array_equal(picture[..., 3], solved)
        assert not picture[~solved].any()


def test_colours_are_srgb_normals_are_encoded_and_numbers_are_fractions_of_their_range(running, show):
    display, maps = show(running), running.maps(confidence=False)
    for p in TWO_LOBES.parameters:
        value = maps.values[p.name]
        wanted = np.repeat((value - p.range[0]) / (p.range[1] - p.range[0]), 3, axis=-1) if p.components == 1 else None
        if p.is_normal:
            wanted = encode_normal(value)
        elif p.color_space == "sRGB":
            wanted = srgb_from_linear(value)
        picture = seen(display, "parameter", p.name)
        np.testing.assert_allclose(picture[maps.solved, :3], np.clip(wanted, 0, 1)[maps.solved], atol=HALF)


@pytest.mark.parametrize("limit", [0.05, 0.4])
def test_the_error_is_the_mean_residual_in_false_colours(running, show, limit):
    maps = running.maps(confidence=False)
    picture = seen(show(running), "error", limit=limit)
    wanted = false_color(maps.residual, limit)
    np.testing.assert_allclose(picture[maps.solved, :3], wanted[maps.solved], atol=2 * HALF)


@pytest.mark.parametrize("exposure", [1.0, 0.25, 3.0])
def test_the_render_is_the_radiance_times_the_exposure(running, show, exposure):
    solved = running.domain.solvable
    for observation in (0, 6):
        picture = seen(show(running), "render", observation=observation, exposure=exposure)
        wanted = np.clip(srgb_from_linear(exposure * radiance_of(running, observation)), 0, 1)
        np.testing.assert_allclose(picture[solved, :3], wanted[solved], atol=2 * HALF)


@pytest.mark.parametrize("card", [True, False])
def test_the_reference_is_the_photograph_and_half_transparent_where_it_has_no_weight(recover, show, card):
    domain, _ = subject(card=card)
    domain.stack.values[:, 4, 5] = 0  # of a mesh: nothing was photographed there
    domain = with_samples(domain, domain.stack.values)
    recovery = recover(domain, schedule=SHORT.replaced(shadow=0.0))
    solved = domain.solvable
    for observation in (0, 3):
        layer = domain.stack.values[observation]
        weighs = solved & (layer[..., 3] > 0)
        photographed = solved & (card | (layer != 0).any(axis=-1))
        assert 0 < weighs.sum() < photographed.sum() <= solved.sum()
        picture = seen(show(recovery), "reference", observation=observation, exposure=0.5)
        np.testing.assert_array_equal(picture[..., 3], np.where(weighs, 1.0, 0.5 * photographed))
        wanted = srgb_from_linear(0.5 * np.nan_to_num(layer[..., :3]))
        np.testing.assert_allclose(picture[photographed, :3], wanted[photographed], atol=HALF)


def test_the_confidence_is_the_deviation_of_the_largest_component_in_false_colours(running, show):
    maps = running.maps()
    for name in ("normal", "r2", "base_color", "w"):
        picture = seen(show(running), "confidence", name, limit=0.2)
        wanted = false_color(maps.confidence[name].max(axis=-1), 0.2)
        np.testing.assert_allclose(picture[maps.solved, :3], wanted[maps.solved], atol=2 * HALF)


def test_unknown_numbers_are_half_transparent_on_request(running, show):
    maps = running.maps()
    sigma = maps.confidence["r2"][..., 0]
    limit = float(np.median(sigma[maps.solved]))
    picture, plain = seen(show(running), "parameter", "r2", unknown=limit), seen(show(running), "parameter", "r2")
    expected = np.where(maps.solved, np.where(sigma > limit, 0.5, 1.0), 0.0)
    close = np.abs(sigma - limit) < 1e-3 * limit
    np.testing.assert_array_equal(picture[~close, 3], expected[~close])
    np.testing.assert_array_equal(picture[..., :3], plain[..., :3])
    np.testing.assert_array_equal(plain[..., 3], maps.solved)


def test_known_parameters_have_no_deviation(recover, show):
    domain, truth = subject(model=TWO_LOBES.name)
    recovery = recover(domain, TWO_LOBES, fixed={"normal": truth["normal"]})
    maps = recovery.maps()
    display = show(recovery)
    picture = seen(display, "confidence", "r1", limit=0.5)
    wanted = false_color(maps.confidence["r1"][..., 0], 0.5)
    np.testing.assert_allclose(picture[maps.solved, :3], wanted[maps.solved], atol=2 * HALF)
    picture = seen(display, "confidence", "normal")
    lowest = np.broadcast_to(COLORS[0], (maps.solved.sum(), 3))
    np.testing.assert_allclose(picture[maps.solved, :3], lowest, atol=HALF)


# ---- when they are drawn -----------------------------------------------------------------------------------------


def test_a_picture_follows_the_recovery(running, show):
    display = show(running)
    before = seen(display, "parameter", "base_color")
    running.step(iterations=3)
    after = seen(display, "parameter", "base_color")
    assert not np.array_equal(before, after)
    covered = running.domain.solvable
    wanted = srgb_from_linear(running.maps(confidence=False).values["base_color"])[covered]
    np.testing.assert_allclose(after[covered, :3], wanted, atol=HALF)


def test_an_unchanged_picture_is_not_redrawn(running, show, monkeypatch):
    display = show(running)
    asked = [Shown("parameter", "normal"), Shown("error"), Shown("confidence", "w"), Shown("reference", observation=2)]
    pictures = [display.picture(shown) for shown in asked]

    def refuse(*_, **__):
        raise AssertionError("drawn again")

    with monkeypatch.context() as patch:
        patch.setattr(Pass, "run", refuse)
        assert [display.picture(shown) for shown in asked] == pictures
    assert not any(display.pending(shown) for shown in asked)
    running.step(iterations=1)
    assert all(display.pending(shown) for shown in asked)


def test_no_picture_is_read_back(running, show, monkeypatch):
    def refuse(*_):
        raise AssertionError("read back")

    monkeypatch.setattr(textures, "download", refuse)
    display = show(running)
    for shown in (("parameter", "normal"), ("error",), ("render",), ("reference",), ("confidence", "r1")):
        assert display.picture(Shown(*shown)) is not None


def test_pictures_of_more_kinds_than_are_kept_are_right_again(running, show):
    display, covered = show(running), running.domain.solvable
    shown = [Shown("reference", observation=k) for k in range(7)]
    first = [textures.download(display.picture(one)) for one in shown]
    again = [textures.download(display.picture(one)) for one in shown]
    for one, (a, b) in enumerate(zip(first, again, strict=True)):
        np.testing.assert_array_equal(a, b, err_msg=f"observation {one}")
    assert not np.array_equal(first[0][covered], first[1][covered])


# ---- slices ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shown", [Shown("error", limit=0.3), Shown("confidence", "normal", limit=0.5)])
def test_a_measure_in_slices_ends_as_the_whole_does(running, show, shown):
    display, whole = show(running), textures.download(show(running).picture(shown))
    shares = []
    while display.pending(shown):
        picture = textures.download(display.picture(shown, time_budget_s=1e-9))
        shares.append(int(picture[..., 3].sum()))
        shows = picture[..., 3] > 0
        np.testing.assert_array_equal(picture[shows], whole[shows])
    assert len(shares) > 3 and shares == sorted(shares) and shares[0] < shares[-1]
    np.testing.assert_array_equal(picture, whole)


def test_the_last_whole_measure_is_shown_while_a_newer_one_is_drawn(running, show):
    shown = Shown("error", limit=0.3)
    display = show(running)
    old = textures.download(display.picture(shown))
    running.step()
    assert running.progress.done
    wanted = textures.download(show(running).picture(shown))
    assert not np.array_equal(old, wanted)
    found = []
    while display.pending(shown):
        found.append(textures.download(display.picture(shown, time_budget_s=1e-9)))
    assert len(found) > 3
    for picture in found[:-1]:
        np.testing.assert_array_equal(picture, old)
    np.testing.assert_array_equal(found[-1], wanted)


def test_another_limit_recolours_at_once(running, show):
    display = show(running)
    display.picture(Shown("error", limit=0.3))
    running.step(iterations=1)
    residual = running.maps(confidence=False).residual
    display.picture(Shown("error", limit=0.3))
    picture = seen(display, "error", limit=0.1)
    covered = running.domain.solvable
    np.testing.assert_allclose(picture[covered, :3], false_color(residual, 0.1)[covered], atol=2 * HALF)


# ---- other recoveries, and what is refused -----------------------------------------------------------------------


def test_a_coarse_level_is_shown_at_its_size(show):
    domain, _ = subject(20, 23, holes=False)
    schedule = load_schedule("swarm").replaced(iterations=3, levels=2, particles=4, particles_per_dimension=0.0)
    with Pyramid(domain, load_model("lambert"), schedule, entry="fragment") as pyramid:
        display = show(pyramid)
        shown = Shown("parameter", "base_color")
        pyramid.step(iterations=1)
        assert textures.download(display.picture(shown)).shape == (10, 12, 4)
        assert textures.download(display.picture(Shown("error"))).shape == (10, 12, 4)
        pyramid.step()
        picture, error = textures.download(display.picture(shown)), textures.download(display.picture(Shown("error")))
        maps = pyramid.maps(confidence=False)
        np.testing.assert_allclose(picture[..., :3], srgb_from_linear(maps.values["base_color"]), atol=HALF)
        np.testing.assert_allclose(error[..., :3], false_color(maps.residual, 0.1), atol=2 * HALF)
        display.close()


def test_a_texel_whose_deviations_are_not_measured_costs_no_pass_over_the_domain(running, show, monkeypatch):
    display, texel = show(running), np.argwhere(running.domain.solvable)[0]
    built = []
    monkeypatch.setattr(display_module, "Packing", lambda *given: built.append(given) or Packing(*given))
    assert display.unknown_at(*texel) is None and not built
    display.picture(Shown("confidence", "normal"))
    built.clear()
    assert display.unknown_at(*texel) is not None and built
    running.step(iterations=1)  # older deviations say nothing of it
    built.clear()
    assert display.unknown_at(*texel) is None and not built


def test_at_a_coarse_level_no_texel_of_the_domain_has_deviations(show, monkeypatch):
    domain, _ = subject(20, 23, holes=False)
    schedule = load_schedule("swarm").replaced(iterations=3, levels=2, particles=4, particles_per_dimension=0.0)
    with Pyramid(domain, load_model("lambert"), schedule, entry="fragment") as pyramid:
        pyramid.step(iterations=1)
        display = show(pyramid)
        display.picture(Shown("confidence", "normal"))
        monkeypatch.setattr(display_module, "Packing", None)
        assert display.unknown_at(*np.argwhere(domain.solvable)[0]) is None
        display.close()


def test_a_confidence_shown_in_a_round_follows_to_the_next(show):
    schedule = SINGLE.replaced(interreflection_matte_rounds=1, interreflection_rounds=0)
    with rounds_of(matt_bowl(), schedule) as recovery:
        display, parameter = show(recovery), Shown("confidence", "normal", limit=0.05)
        recovery.step(1)
        held = textures.download(display.picture(parameter))
        recovery.step()
        found, afresh = (textures.download(each.picture(parameter)) for each in (display, show(recovery)))
        covered = recovery.domain.solvable
    np.testing.assert_array_equal(found, afresh)
    np.testing.assert_allclose(held[covered][:, :3], np.broadcast_to(COLORS[-1], (covered.sum(), 3)), atol=HALF)
    assert (found[covered] != held[covered]).any(axis=-1).mean() > 0.9
    np.testing.assert_array_equal(held[~covered], found[~covered])


def test_missing_pictures_are_refused_in_a_line(running, show):
    display = show(running)
    with pytest.raises(InputError, match="no parameter 'shine'; it has: "):
        display.picture(Shown("parameter", "shine"))
    for observation in (-1, running.domain.observations):
        with pytest.raises(InputError, match=f"observation {observation}: there are 8, from 0"):
            display.picture(Shown("render", observation=observation))


def test_a_display_that_was_closed_draws_again(running, show):
    display = show(running)
    first = seen(display, "error")
    display.close()
    np.testing.assert_array_equal(seen(display, "error"), first)


def test_pictures_do_not_change_the_maps(recover, show):
    domain, _ = subject()
    runs = [recover(domain), recover(domain)]
    display = show(runs[0])
    while not runs[0].step(time_budget_s=1e-6).done:
        display.picture(Shown("error"), time_budget_s=1e-6)
        display.picture(Shown("parameter", "normal"))
    runs[1].step()
    for name, value in runs[0].maps(confidence=False).values.items():
        np.testing.assert_array_equal(value, runs[1].maps(confidence=False).values[name])


def test_a_recovery_without_a_picture_of_the_whole_is_refused():
    with pytest.raises(InputError, match="lower the resolution"):
        Display(SimpleNamespace(capabilities=Capabilities("tiles", reconfigure=False)))
