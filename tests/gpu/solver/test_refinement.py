"""The refinement: its steps against float64, its optima against scipy, bounds, and what never changes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize

from irpso_addon.geometry.domain import with_samples
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.kernels.refinement import PROPAGATION_RADIUS
from irpso_addon.solver.settings.schedule import load_schedule
from tests.builders.domains import bits_of, make_domain, recoveries, run_tiled
from tests.builders.refinement import DELTA, SETTINGS, materials, near, observed, refinements, schedule_of
from tests.oracles import confidence as confidence_oracle
from tests.oracles.refinement import Texel

MODELS = Path(__file__).parents[1] / "models"
WARD = str(MODELS / "ward.toml")
recover = pytest.fixture(recoveries)
refinement = pytest.fixture(refinements)


def at(values, row, column):
    """The material of one texel."""
    return {name: v[row, column] for name, v in values.items()}


# ---- against float64 and scipy -----------------------------------------------------------------------------------


@pytest.mark.parametrize("loss", ["l1", "l2", "cauchy"])
def test_maps_do_not_depend_on_the_unit_of_radiance(recover, loss):
    """Photographs and intensities times a power of two are the same numbers in float32, but for their exponents."""
    model, shape = load_model("lambert"), (6, 9)
    domain = observed(model, materials(model, shape), shape, noise=0.005, shadow=0.1, colored=True)
    schedule = load_schedule("standard").replaced(loss=loss)
    maps = []
    for factor in (1.0, 2.0**-10):
        samples = np.stack([*domain.stack.layers()]) * np.float32([factor, factor, factor, 1])
        scaled = replace(with_samples(domain, samples), intensities=domain.intensities * np.float32(factor))
        recovery = recover(scaled, model, schedule)
        recovery.step()
        maps.append(recovery.maps())
    for name, value in maps[0].values.items():
        np.testing.assert_allclose(maps[1].values[name], value, atol=1e-6, err_msg=name)
        np.testing.assert_allclose(maps[1].confidence[name], maps[0].confidence[name], rtol=1e-3, err_msg=name)


NAMES = ["lambert", "principled", "metallic_roughness", "cook_torrance_two_lobe", WARD]
# Each is a shader of its own, of seconds to compile: a loss knows nothing of the model.
STEPS = [(name, "cauchy", central) for name in NAMES for central in (True, False)]
STEPS += [("principled", "l2", True), ("cook_torrance_two_lobe", "l2", False), (WARD, "l1", True)]
STEPS += [("lambert", "l1", False)]


@pytest.mark.parametrize(("name", "loss", "central"), STEPS)
def test_a_step_is_that_of_float64(refinement, name, loss, central):
    model, shape = load_model(name), (5, 7)
    truth = materials(model, shape)
    start = near(model, truth, 0.02)
    domain = observed(model, truth, shape, noise=0.005, shadow=0.0 if loss == "l2" else 0.1, bounds=1.0, colored=True)
    damping = 0.1
    schedule = schedule_of(loss, damping=damping, central_differences=central, ftol=0.0)  # the optimum's own shaders
    found = refinement(model, domain, start, schedule, scale=0.7).run()
    wrong = []
    for row, column in np.ndindex(shape):
        texel = Texel(model, domain, row, column, loss, DELTA, 0.7)
        before = at(start, row, column)
        steps = [texel.step(before, damping * factor) for factor in (1 / 8, 1, 8)]
        costs = [texel.cost(texel.moved(before, step)) for step in steps]
        best = int(np.argmin(costs))
        # Others are cut off at their ranges, or float32 may choose another of two that are equally good.
        if not all(texel.inside(before, s) for s in steps) or sorted(costs)[1] < 1.001 * costs[best]:
            continue
        if costs[best] >= texel.cost(before):
            continue
        wanted = texel.moved(before, steps[best])
        if model.ordered and wanted[model.ordered[0]] > wanted[model.ordered[1]]:
            continue
        # In what it changes of the render: where unknowns trade for each other, the way between them is rounding's.
        off = texel.between(wanted, at(found, row, column))
        matrix = texel.equations(before)[0]
        wrong.append(np.sqrt(off @ matrix @ off / (steps[best] @ matrix @ steps[best])))
    assert len(wrong) > 8
    # One-sided differences are off by half a step times the curvature. The worst texel has a light on its horizon,
    # where the radiance has a kink that a step goes over.
    assert np.median(wrong) < (3e-4 if central else 5e-3) and max(wrong) < (0.02 if central else 0.06)


@pytest.mark.parametrize(("name", "central"), [*((name, True) for name in NAMES), ("cook_torrance_two_lobe", False)])
def test_the_optimum_is_that_of_scipy(refinement, name, central):
    model, shape = load_model(name), (2, 5)
    truth = materials(model, shape, seed=4)
    start = near(model, truth, 0.05)
    domain = observed(model, truth, shape, noise=0.01, shadow=0.15, bounds=1.0)
    found = refinement(model, domain, start, schedule_of(iterations=60, central_differences=central, ftol=0.0)).run()
    for row, column in np.ndindex(shape):
        texel = Texel(model, domain, row, column, "cauchy", DELTA, 1.0)
        origin = at(start, row, column)
        seen = texel.weight[:, 0] > 0
        widths = [0.5 if p.is_normal else p.range[1] - p.range[0] for p, _ in texel.unknowns]
        low = [-1.0 if p.is_normal else (p.range[0] - origin[p.name][i]) / w
               for (p, i), w in zip(texel.unknowns, widths, strict=True)]  # fmt: skip
        high = [1.0 if p.is_normal else (p.range[1] - origin[p.name][i]) / w
                for (p, i), w in zip(texel.unknowns, widths, strict=True)]  # fmt: skip
        if any(p.prior for p in model.parameters):
            fit = minimize(
                lambda x, t=texel, origin=origin: t.cost(t.moved(origin, x)), np.zeros(len(widths)), method="L-BFGS-B",
                bounds=list(zip(low, high, strict=True)), options={"ftol": 1e-14, "gtol": 1e-10, "maxfun": 20000},
            )  # fmt: skip
            wanted = fit.fun
        else:
            fit = least_squares(
                lambda x, t=texel, origin=origin, seen=seen: t.residuals(t.moved(origin, x))[seen].ravel(),
                np.zeros(len(widths)), loss="cauchy", bounds=(low, high), xtol=1e-12, ftol=1e-12, gtol=1e-12,
                max_nfev=400,
            )  # fmt: skip
            wanted = 2 * fit.cost / (3 * seen.sum())
        assert texel.cost(at(found, row, column)) < 1.001 * wanted


def test_values_stay_in_range_and_the_bounded_optimum_is_scipys(refinement):
    model, shape = load_model("principled"), (4, 6)
    truth = materials(model, shape, seed=4)
    start = near(model, truth, 0.1)
    outside = {**truth, "specular": truth["specular"] * 0 + 1.1}
    outside["base_color"] = np.maximum(truth["base_color"], (1.1, 0, 0))
    domain = observed(model, outside, shape, noise=0.003)
    found = refinement(model, domain, start, schedule_of("l2", iterations=60)).run()
    ends = 0
    for p in model.parameters:
        assert (found[p.name] >= np.float32(p.range[0])).all() and (found[p.name] <= np.float32(p.range[1])).all()
        ends += (found[p.name] == p.range[1]).sum()
    assert ends > 24
    np.testing.assert_allclose(np.linalg.norm(found["normal"], axis=-1), 1, atol=1e-6)
    for row, column in np.ndindex(2, 6):
        texel = Texel(model, domain, row, column, "l2", DELTA, 1.0)
        origin = at(start, row, column)
        low, high = [], []
        for p, i in texel.unknowns:
            width = p.range[1] - p.range[0]
            low.append(-0.6 if p.is_normal else (p.range[0] - origin[p.name][i]) / width - 1e-12)
            high.append(0.6 if p.is_normal else (p.range[1] - origin[p.name][i]) / width + 1e-12)
        fit = least_squares(
            lambda x, texel=texel, origin=origin: (texel.weight * texel.error(texel.moved(origin, x))).ravel(),
            np.zeros(len(low)), bounds=(low, high), xtol=1e-12, ftol=1e-12,
        )  # fmt: skip
        wanted = 2 * fit.cost / (3 * texel.weight.sum())
        assert texel.cost(at(found, row, column)) < 1.001 * wanted


def test_lobes_end_in_rising_order_with_their_weight(refinement):
    model, shape = load_model("cook_torrance_two_lobe"), (3, 5)
    truth = materials(model, shape)
    start = near(model, truth, 0.02)
    swapped = {**start, "r1": start["r2"], "r2": start["r1"], "w": 1 - start["w"]}
    domain = observed(model, truth, shape, observations=60)
    found = refinement(model, domain, swapped, schedule_of("l2", iterations=30)).run()
    assert (found["r1"] <= found["r2"]).all()
    for p in model.parameters:
        np.testing.assert_allclose(found[p.name], truth[p.name], atol=0.01 * (p.range[1] - p.range[0]))


# ---- what never changes ------------------------------------------------------------------------------------------


def test_fragment_and_compute_make_the_same_step(refinement):
    model, shape = load_model("principled"), (5, 7)
    truth = materials(model, shape)
    domain = observed(model, truth, shape, noise=0.01)
    start = near(model, truth, 0.03)
    one, other = (
        refinement(model, domain, start, schedule_of(damping=0.1), entry=e).run() for e in ("fragment", "compute")
    )
    for name in one:
        np.testing.assert_allclose(one[name], other[name], rtol=1e-4, atol=1e-5)


WHOLE = {"iterations": 4, "starts": True, "start_iterations": 2, "race_iterations": 2, "rounds": 2,
         "round_iterations": 2, "candidate_ratio": 1.5, "neighbour_weight": 1.0}  # fmt: skip


def lobes():
    """A domain of 17×13 with holes and noise, of two-lobe materials on a mesh."""
    model = load_model("cook_torrance_two_lobe")
    domain = make_domain(13, 17, observations=12, card=False)
    stack = domain.stack.values.copy()
    truth = materials(model, domain.shape)
    stack[..., :3] = np.where(stack[..., 3:] > 0, confidence_oracle.radiance(domain, model.name, truth), np.nan)
    return model, with_samples(domain, stack)


@pytest.mark.parametrize(("entry", "breaks"), [("fragment", (4, 9, 14, 22, 26)), ("compute", (10,))])
def test_slices_and_checkpoints_change_nothing(recover, tmp_path, entry, breaks):
    model, domain = lobes()
    schedule = load_schedule("swarm").replaced(
        iterations=3, particles=4, start="random", refinement=replace(SETTINGS, **WHOLE)
    )
    whole = recover(domain, model, schedule, entry=entry)
    assert whole.step().iterations_in_all == 3 + 5 * 2 + 4 * 2 + 4 + 2 * 2
    wanted = bits_of(whole.maps())
    sliced = recover(domain, model, schedule, entry=entry)
    while not sliced.step(time_budget_s=1e-4).done:
        sliced.maps(confidence=False)
    assert bits_of(sliced.maps()) == wanted
    for iterations in breaks:
        first = recover(domain, model, schedule, entry=entry)
        first.step(iterations=iterations)
        first.save(tmp_path / "run")
        second = recover(domain, model, schedule, entry=entry)
        second.load(tmp_path / "run")
        second.step()
        assert bits_of(second.maps()) == wanted


@pytest.mark.parametrize("entry", ["fragment", "compute"])
def test_tiles_that_exchange_results_equal_the_whole_bit_for_bit(recover, entry):
    model, domain = lobes()
    schedule = load_schedule("swarm").replaced(
        iterations=3, particles=4, start="random", refinement=replace(SETTINGS, **WHOLE)
    )
    whole = recover(domain, model, schedule, entry=entry)
    whole.step()
    assert run_tiled(domain, model, schedule, PROPAGATION_RADIUS, entry) == bits_of(whole.maps())


def test_fixed_and_unsearched_parameters_stay(recover):
    model, domain = lobes()
    fixed = {"base_color": np.float32([0.4, 0.5, 0.6])}
    schedule = load_schedule("swarm").replaced(search=["normal", "diffuse"], iterations=0, refinement=SETTINGS)
    recovery = recover(domain, model, schedule, fixed=fixed)
    recovery.step()
    found = recovery.maps().values
    assert (found["base_color"][domain.solvable] == fixed["base_color"]).all()
    for name in ("r1", "r2", "w"):
        assert (found[name] == np.float32(model.parameter(name).default)).all()
    assert not (found["normal"][domain.solvable] == (0, 0, 1)).all(axis=-1).any()
