"""The refinement: its steps against float64, its optima against scipy, bounds, neighbours, and what never changes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize

from irpso_addon.capture.bounds import bounded
from irpso_addon.geometry.domain import with_samples
from irpso_addon.gpu import context
from irpso_addon.gpu.bands import Bands
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.kernels.refinement import SPREAD_REACH
from irpso_addon.solver.phases.refinement import RefinementPhase
from irpso_addon.solver.settings.groups import Refinement
from irpso_addon.solver.settings.resolve import ResolvedRefinement
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state.packing import Packing
from irpso_addon.solver.state.textures import DomainTextures, Estimates
from tests.builders.domains import bits_of, make_domain, pack_layers, recoveries, run_tiled, unit
from tests.oracles import confidence as confidence_oracle
from tests.oracles.refinement import Texel
from tests.oracles.swarm import direction_to, frames, turned

MODELS = Path(__file__).parents[1] / "models"
WARD = str(MODELS / "ward.toml")
SETTINGS = Refinement(iterations=1, starts=False, rounds=0, central=True)
DELTA = 0.05
recover = pytest.fixture(recoveries)


def schedule_of(loss="robust", **settings):
    """A schedule that is a refinement and nothing else."""
    refinement = replace(SETTINGS, **settings)
    return load_schedule("swarm").replaced(iterations=0, loss=loss, delta=DELTA, shadow=0.0, refinement=refinement)


class Bench:
    """A refinement of a domain from given values, on the GPU. scale: of every texel."""

    def __init__(self, model, domain, values, schedule, starts=(), entry="fragment", scale=1.0):
        context.ensure()
        self.model, self.domain = model, domain
        self.pack = pack = Packing(domain.solvable)
        scales = pack.pack(np.full(domain.shape, scale, np.float32))
        uploaded = DomainTextures(domain, pack, pack_layers(pack, domain.stack.values), scales)
        self.estimates = Estimates(model, {name: pack.pack(np.float32(v)) for name, v in values.items()})
        resolved = ResolvedRefinement(model.parameters, schedule.refinement, starts)
        self.refinement = RefinementPhase(resolved, model, schedule, uploaded, self.estimates, entry)
        self.bands = Bands()

    def run(self, iterations=None):
        """Make some iterations, or all; return what was found, name → (H, W, components)."""
        while not self.refinement.done and (iterations is None or self.refinement.iteration < iterations):
            for _ in self.refinement.advance(self.bands, 0.25):
                pass
        self.refinement.resolve()
        values = self.estimates.values()
        return {name: self.pack.unpack(v, np.nan).astype(np.float64) for name, v in values.items()}

    def close(self):
        self.refinement.close()


@pytest.fixture
def refinement():
    """Return what a refinement of values ends at."""
    made = []

    def make(*arguments, **settings):
        made.append(Bench(*arguments, **settings))
        return made[-1]

    yield make
    for bench in made:
        bench.close()


def materials(model, shape, seed=0):
    """Materials well inside the ranges, of normals within 30° of z, lobes in order and apart; float32."""
    rng, values = np.random.default_rng(seed), {}
    for p in model.parameters:
        low, width = p.range[0], p.range[1] - p.range[0]
        value = low + width * rng.uniform(0.25, 0.75, (*shape, p.components))
        values[p.name] = unit(rng.normal(size=(*shape, 3)) * 0.25 + (0, 0, 1)) if p.is_normal else value
    if model.ordered:
        first, second = model.ordered
        low, width = model.parameter(first).range[0], np.ptp(model.parameter(first).range)
        values[first] = low + width * rng.uniform(0.15, 0.35, (*shape, 1))
        values[second] = low + width * rng.uniform(0.45, 0.75, (*shape, 1))
    return {name: v.astype(np.float32).astype(np.float64) for name, v in values.items()}


def near(model, values, by, seed=5):
    """Values that are off by up to ``by`` of every range."""
    rng, off = np.random.default_rng(seed), {}
    for p in model.parameters:
        change = by * rng.uniform(-1, 1, values[p.name].shape)
        if p.is_normal:
            off[p.name] = unit(values[p.name] + change)
        else:
            off[p.name] = np.clip(values[p.name] + change * (p.range[1] - p.range[0]), *p.range)
    return {name: v.astype(np.float32).astype(np.float64) for name, v in off.items()}


def observed(model, values, shape, observations=40, noise=0.0, shadow=0.0, bounds=0.0, seed=2, **domain):
    """A domain in which these materials are seen, with noise, fractions of its samples in shadow, or lower bounds."""
    rng = np.random.default_rng(seed)
    made = make_domain(*shape, observations=observations, holes=False, **domain)
    stack = made.stack.values.copy()
    stack[..., :3] = confidence_oracle.radiance(made, model.name, values)
    stack[..., :3] += noise * rng.normal(size=stack[..., :3].shape)
    stack[..., :3] *= np.where(rng.random(stack.shape[:3]) < shadow, 0.1, 1.0)[..., None]
    stack[..., 3] = rng.random(stack.shape[:3]) < 0.9
    clipped = rng.random((*stack.shape[:3], 3)) < 0.05 * bounds
    stack[..., :3] *= np.where(clipped, rng.uniform(0.3, 1.2, clipped.shape), 1.0)
    stack[..., 3] = bounded(stack[..., 3], clipped)
    return with_samples(made, stack.astype(np.float32))


def at(values, row, column):
    """The material of one texel."""
    return {name: v[row, column] for name, v in values.items()}


# ---- against float64 and scipy -----------------------------------------------------------------------------------


NAMES = ["lambert", "principled", "metallic_roughness", "cook_torrance_two_lobe", WARD]
# Each is a shader of its own, of seconds to compile: a loss knows nothing of the model.
STEPS = [(name, "robust", central) for name in NAMES for central in (True, False)]
STEPS += [("principled", "l2", True), ("cook_torrance_two_lobe", "l2", False), (WARD, "l1", True)]
STEPS += [("lambert", "l1", False)]


@pytest.mark.parametrize(("name", "loss", "central"), STEPS)
def test_a_step_is_that_of_float64(refinement, name, loss, central):
    model, shape = load_model(name), (5, 7)
    truth = materials(model, shape)
    start = near(model, truth, 0.02)
    domain = observed(model, truth, shape, noise=0.005, shadow=0.0 if loss == "l2" else 0.1, bounds=1.0, colored=True)
    damping = 0.1
    schedule = schedule_of(loss, damping=damping, central=central, ftol=0.0)  # the optimum's own shaders
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
    found = refinement(model, domain, start, schedule_of(iterations=60, central=central, ftol=0.0)).run()
    for row, column in np.ndindex(shape):
        texel = Texel(model, domain, row, column, "robust", DELTA, 1.0)
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


# ---- what costs nothing, what helps ------------------------------------------------------------------------------


def test_a_converged_texel_costs_nothing(refinement):
    model, shape = load_model("lambert"), (5, 6)
    truth = materials(model, shape)
    bench = refinement(model, observed(model, truth, shape), truth, schedule_of("l2", iterations=20))
    assert bench.refinement.evaluations == 1 + 2 * 2 + 1 + 3
    bench.run()
    spent = bench.refinement.read("result")[..., 3].mean()
    assert 2 * bench.refinement.evaluations <= spent <= 5 * bench.refinement.evaluations


def test_starts_free_a_texel_from_a_wrong_optimum(refinement):
    model, shape = load_model("cook_torrance_two_lobe"), (6, 6)
    truth = materials(model, shape)
    # One lobe of two widths: the second may be anything where the first has all the weight.
    start = {**truth, "r1": truth["r1"] * 0 + 0.05, "r2": truth["r2"] * 0 + 0.8, "w": truth["w"] * 0 + 1}
    domain = observed(model, truth, shape, observations=60)
    right = []
    for starts in ((), model.starts):
        schedule = schedule_of(iterations=25, starts=True, start_iterations=6)
        found = refinement(model, domain, start, schedule, starts=starts).run()
        right.append(np.mean([np.abs(found[n] - truth[n]).max(axis=-1) < 0.01 for n in ("r1", "r2", "w")]))
    assert right[1] > 0.95 and right[1] > right[0] + 0.1, right


def gold(shape):
    """A smooth metal at every texel, normals within 30° of z."""
    rng = np.random.default_rng(3)
    values = {"base_color": (0.9, 0.7, 0.3), "roughness": 0.3, "metallic": 1.0, "specular": 0.5}
    truth = {
        name: np.broadcast_to(np.float32(v).reshape(-1), (*shape, np.size(v))).copy() for name, v in values.items()
    }
    return truth | {"normal": unit(rng.normal(size=(*shape, 3)) * 0.25 + (0, 0, 1)).astype(np.float32)}


@pytest.mark.parametrize("entry", ["fragment", "compute"])
@pytest.mark.parametrize("card", [True, False])
def test_a_start_uses_the_mirror_direction_of_the_brightest_sample(refinement, card, entry):
    model, shape = load_model("metallic_roughness"), (3, 4)
    truth = gold(shape)
    domain = observed(model, truth, shape, observations=30, **({} if card else {"card": False, "near": True}))
    domain.stack.values[..., 3] = np.abs(domain.stack.values[..., 3])
    schedule = schedule_of(starts=True, start_iterations=1)
    bench = refinement(model, domain, truth, schedule, starts=((("normal", ()),),), entry=entry)
    bench.run(1)  # the track from the given estimates
    for _ in bench.refinement.advance(bench.bands, 0.25):
        if bench.refinement.work is not bench.refinement.best:
            break  # before the first step from the start
    state, at = bench.refinement.state(), model.offset("normal")
    packed = np.concatenate([state[f"work_{i}"] for i in range(bench.estimates.count)], axis=-1)
    found = bench.pack.unpack(packed[..., at : at + 3], np.nan)
    position, frame = domain.bake.position.astype(np.float64), frames(domain.bake)
    irradiance, halves = [], []
    for light, view, intensity in zip(domain.lights, domain.views, domain.intensities, strict=True):
        (toward, squared), (eye, _) = direction_to(light, position), direction_to(view, position)
        irradiance.append(intensity / squared)
        halves.append(unit(turned(frame, toward) + turned(frame, eye)))
    brightness = np.where(
        domain.stack.values[..., 3] > 0, (domain.stack.values[..., :3] / irradiance).mean(axis=-1), -1
    )
    brightness = np.where(np.array(halves)[..., 2] > 0, brightness, -1)
    wanted = np.take_along_axis(np.array(halves), brightness.argmax(axis=0)[None, ..., None], axis=0)[0]
    np.testing.assert_allclose(found, wanted, atol=1e-5)


def test_the_mirror_start_and_a_wide_delta_recover_a_metal_with_a_wrong_normal(refinement):
    model, shape = load_model("metallic_roughness"), (8, 8)
    truth = gold(shape)
    domain = observed(model, truth, shape, observations=24, noise=0.003)
    # As a fit of matt surfaces leaves them: dark dielectrics, normals some 20° off.
    start = {name: v.copy() for name, v in truth.items()}
    start["normal"] = unit(truth["normal"] + np.random.default_rng(8).normal(size=(*shape, 3)) * 0.3).astype(np.float32)
    start["normal"][..., 2] = np.abs(start["normal"][..., 2])
    start["metallic"][:], start["base_color"][:] = 0, 0.1
    right = []
    for starts, widening in (((), 1.0), (model.starts, 1.0), (model.starts, 30.0)):
        schedule = schedule_of(iterations=10, starts=True, start_iterations=5, widening=widening, central=False)
        found = refinement(model, domain, start, schedule, starts=starts, scale=0.1).run()
        right.append(float((found["metallic"] > 0.9).mean()))
    assert right[0] < 0.1 < right[1] < right[2] - 0.05 and right[2] > 0.8, right


@pytest.mark.parametrize("card", [True, False])
@pytest.mark.parametrize("entry", ["fragment", "compute"])
def test_a_texel_takes_a_neighbours_better_material(refinement, card, entry):
    model, shape = load_model("lambert"), (4, 5)
    truth = {
        name: np.broadcast_to(v[:1, :1], (*shape, v.shape[-1])).copy() for name, v in materials(model, shape).items()
    }
    options = {} if card else {"card": False}
    made = make_domain(*shape, observations=30, holes=False, **options)
    if not card:
        # One world normal, told in frames that differ from texel to texel.
        frame = confidence_oracle.frames(made.bake)
        world = unit(frame[2, 2, 2] + 0.1)
        truth["normal"] = np.einsum("hwij,j->hwi", frame, world)
    lit = truth["normal"][..., 2] > 0.1
    stack = made.stack.values.copy()
    stack[..., :3], stack[..., 3] = confidence_oracle.radiance(made, "lambert", truth), 1
    domain = with_samples(made, stack.astype(np.float32))
    # Where the first texel looks now, all is black whatever it does.
    start = {name: v.copy() for name, v in truth.items()}
    start["normal"][1, 1], start["base_color"][1, 1] = (-0.6, -0.8, 0.0), 0
    alone, helped = (
        refinement(
            model, domain, start, schedule_of("l2", iterations=3, rounds=rounds, round_iterations=6), entry=entry
        ).run()
        for rounds in (0, 1)
    )
    assert lit[1, 1] and not np.allclose(alone["base_color"][1, 1], truth["base_color"][1, 1], atol=0.05)
    np.testing.assert_allclose(helped["normal"][1, 1], truth["normal"][1, 1], atol=1e-4)
    np.testing.assert_allclose(helped["base_color"][1, 1], truth["base_color"][1, 1], atol=1e-4)


def uniform(shape, **changed):
    """A principled material at every texel; float32, as all that is uploaded."""
    values = {
        "base_color": (0.4, 0.3, 0.2),
        "normal": unit(np.array([0.1, -0.1, 1])),
        "roughness": 0.3,
        "specular": 0.5,
    }
    return {
        name: np.broadcast_to(np.float32(v).reshape(-1), (*shape, np.size(v))).copy()
        for name, v in (values | changed).items()
    }


def voted(refinement, truth, start, votes, entry="fragment", unseen=None):
    """Refinement a start with votes of the neighbours, under 40 lights with noise.

    unseen: (row, column) of a texel that no light near its highlight reaches.
    """
    model, shape = load_model("principled"), truth["roughness"].shape[:2]
    domain = observed(model, truth, shape, noise=0.003)
    if unseen:
        half = unit(domain.lights[:, :3] + (0, 0, 1))
        domain.stack.values[half @ truth["normal"][unseen] > 0.9, *unseen, 3] = 0
    schedule = schedule_of(iterations=4, rounds=3, round_iterations=4, votes=votes)
    return refinement(model, domain, start, schedule, entry=entry).run()


@pytest.mark.parametrize("entry", ["fragment", "compute"])
def test_a_lone_undecided_texel_is_outvoted(refinement, entry):
    truth = uniform((7, 7))
    start = {name: v.copy() for name, v in truth.items()}
    start["roughness"][3, 3], start["specular"][3, 3] = 0.9, 0.0
    alone, crowd = (voted(refinement, truth, start, votes, entry, (3, 3)) for votes in (0.0, 6.0))
    for name, value in (("roughness", 0.3), ("specular", 0.5)):
        assert abs(alone[name][3, 3, 0] - value) > 0.2 > 2 * abs(crowd[name][3, 3, 0] - value)


def test_a_texel_of_its_own_material_is_not_outvoted(refinement):
    truth = uniform((7, 7))
    truth["roughness"][3, 3], truth["specular"][3, 3] = 0.7, 1.0
    found = voted(refinement, truth, truth, 6.0)
    assert found["roughness"][3, 3, 0] == pytest.approx(0.7, abs=0.05)
    assert np.abs(found["roughness"] - truth["roughness"]).max() < 0.05


def test_a_line_and_a_checker_one_texel_wide_survive_the_votes(refinement):
    rows, columns = np.indices((8, 8))
    for other in (rows == 3, (rows + columns) % 2 == 0):
        truth = uniform((8, 8))
        truth["roughness"][other] = 0.6
        found = voted(refinement, truth, truth, 6.0)
        assert np.abs(found["roughness"] - truth["roughness"]).max() < 0.06


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


WHOLE = {"iterations": 4, "starts": True, "start_iterations": 2, "rounds": 2, "round_iterations": 2,
         "candidate_ratio": 1.5, "votes": 1.0}  # fmt: skip


def lobes():
    """A domain of 17×13 with holes and noise, of two-lobe materials on a mesh."""
    model = load_model("cook_torrance_two_lobe")
    domain = make_domain(13, 17, observations=12, card=False)
    stack = domain.stack.values.copy()
    truth = materials(model, domain.shape)
    stack[..., :3] = np.where(stack[..., 3:] > 0, confidence_oracle.radiance(domain, model.name, truth), np.nan)
    return model, with_samples(domain, stack)


@pytest.mark.parametrize(("entry", "breaks"), [("fragment", (4, 9, 14, 18)), ("compute", (10,))])
def test_slices_and_checkpoints_change_nothing(recover, tmp_path, entry, breaks):
    model, domain = lobes()
    schedule = load_schedule("swarm").replaced(
        iterations=3, particles=4, seed="random", refinement=replace(SETTINGS, **WHOLE)
    )
    whole = recover(domain, model, schedule, entry=entry)
    assert whole.step().iterations_in_all == 3 + 5 * 2 + 4 + 2 * 2
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
        iterations=3, particles=4, seed="random", refinement=replace(SETTINGS, **WHOLE)
    )
    whole = recover(domain, model, schedule, entry=entry)
    whole.step()
    assert run_tiled(domain, model, schedule, SPREAD_REACH, entry) == bits_of(whole.maps())


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
