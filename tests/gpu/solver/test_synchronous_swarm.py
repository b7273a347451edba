"""Swarms that move as a whole: one generation on the GPU against the float64 oracle, and the two entries."""

import dataclasses

import numpy as np
import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.reflectance.model import load_model
from tests.builders.domains import SHORT, make_domain, recoveries, subject
from tests.builders.synchronous_swarm import Case, benches
from tests.oracles import synchronous_swarm as oracle

PLACE_TOLERANCE = 1e-6  # places are in [0, 1] and speeds below 1, in float32
TURNED_TOLERANCE = 5e-5  # a normal turned into another frame goes through square roots that lose digits
bench = pytest.fixture(benches)
recover = pytest.fixture(recoveries)

FEW = {"particles": 6, "particles_per_dimension": 0.0}
MESH = {"card": False}
LENS = {"perspective": True, "near": True, "colored": True}
TWO_LOBES = "cook_torrance_two_lobe"
CASES = [
    Case("albedo-solved-robust", settings=FEW | {"c3": 0.3}),
    Case("albedo-solved-l2-H5", settings=FEW | {"loss": "l2", "neighbourhood": 5, "c3": 0.3, "walls": "reflect"}),
    Case("albedo-solved-l1-on-a-mesh", domain=MESH | LENS, settings=FEW | {"loss": "l1", "c3": 0.1}),
    Case("cartesian-normals-with-neighbours-bests-on-a-mesh", domain=MESH,
         settings=FEW | {"normal": "cartesian", "neighbour_interval": 1, "c3": 0.3}),
    Case("twelve-particles-with-neighbours-bests-on-a-card", model="principled", domain={"observations": 12},
         settings={"neighbour_interval": 2}),
    Case("principled-on-a-mesh", model="principled", domain=MESH | {"colored": True},
         settings=FEW | {"walls": "clamp", "constriction": 0.7298}),
    Case("two-lobes-solved-with-their-weight", model=TWO_LOBES, domain={"observations": 12},
         settings=FEW | {"c3": 0.3, "neighbour_interval": 2}),
    Case("two-lobes-that-hold-the-base", search=("specular",), model=TWO_LOBES, domain={"observations": 12},
         settings=FEW),
    Case("every-number-searched", settings=FEW | {"linear": "search", "c3": 0.3}),
    Case("eight-dimensions-searched-on-a-mesh", model=TWO_LOBES, domain=MESH | {"observations": 12},
         settings=FEW | {"linear": "search", "neighbour_interval": 1, "c3": 0.1, "loss": "l1"}),
    Case("no-dimension-at-all", fixed=frozenset({"normal"}), settings=FEW),
    Case("nothing-but-the-normal", search=("normal",), settings=FEW | {"loss": "l1"}),
    Case("a-threshold-stops-swarms", settings=FEW | {"threshold": 0.1, "loss": "l1"}),
    Case("one-row", shape=(1, 7), domain=MESH, settings=FEW | {"neighbourhood": 5, "c3": 0.3, "neighbour_interval": 1}),
    *(Case(f"{m}-particles", shape=(3, 4), settings={"particles": m, "particles_per_dimension": 0.0,
                                                     "neighbour_interval": 1}, iterations=2)
      for m in (1, 3, 4, 5, 8, 13, 16)),
]  # fmt: skip
BY_NAME = {case.name: case for case in CASES}


def assert_close_fitness(found, wanted):
    """Errors are differences of radiances near 1, and δ makes units of them."""
    difference = np.where(wanted >= 1e29, np.abs(found / 1e30 - 1), np.abs(found - wanted))
    assert (difference <= np.where(wanted >= 1e29, 1e-6, rounding(wanted))).all(), np.nanmax(difference)


def rounding(fitness):
    """What float32 may lose of a fitness."""
    return 1e-5 * (1 + np.minimum(fitness, 100))


def assert_equal_iterations(b, step, places):
    """Compare all that a swarm remembers; bests only where rounding could not have decided the comparison."""
    found, wanted, moved = b.read(), step.state, step.moved
    clear = step.margin > 2 * rounding(step.fitness)
    leads = step.lead > 2 * rounding(np.min(step.fitness, axis=0))
    compared = moved & ~step.edge
    # Particles that came to a neighbour's best, or search nothing, tie with where they have been before.
    ties = b.schedule.swarm.neighbour_interval == 1 or b.problem.dimensions == 0
    assert compared[:, moved].mean() > 0.8 and clear[compared].mean() > (0.4 if ties else 0.9)
    assert_close_fitness(b.found_fitness()[compared], step.fitness[compared])
    np.testing.assert_allclose(found.x, wanted.x, atol=places, rtol=0)
    np.testing.assert_allclose(found.v, wanted.v, atol=places, rtol=0)
    np.testing.assert_allclose(found.p[clear], wanted.p[clear], atol=places, rtol=0)
    assert_close_fitness(found.p_fitness[clear], wanted.p_fitness[clear])
    if b.problem.dimensions == 0:  # no particle differs from another, and none comes first
        leads = ~step.edge.any(axis=0)
    else:
        np.testing.assert_allclose(found.g[leads], wanted.g[leads], atol=places, rtol=0)
    assert leads[moved].sum() >= (1 if ties else 0.25 * moved.sum())
    assert_close_fitness(found.g_fitness[leads], wanted.g_fitness[leads])
    np.testing.assert_allclose(found.w[leads], wanted.w[leads], atol=2e-3, rtol=1e-3)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_generation_matches_the_oracle(case, bench):
    b = bench(case)
    b.stage.iteration = 0
    b.randomise()
    turned = not b.domain.card and "normal" in b.stage.stage.title
    for iteration in range(case.iterations):
        before = b.read()
        b.advance()
        step = oracle.generation(b.problem, before, iteration)
        assert_equal_iterations(b, step, TURNED_TOLERANCE if turned else PLACE_TOLERANCE)


@pytest.mark.parametrize("start", ["random", "lambert"])
@pytest.mark.parametrize(
    "name", ["principled-on-a-mesh", "eight-dimensions-searched-on-a-mesh", "no-dimension-at-all", "16-particles"]
)
def test_a_swarm_is_placed_where_the_oracle_places_it(name, start, bench):
    case = BY_NAME[name]
    case = dataclasses.replace(
        case, settings=case.settings | {"start": start, "start_fraction": 0.4, "start_spread": 0.2}
    )
    b = bench(case)
    before = b.read()
    assert b.stage.iteration == -1
    b.advance()
    step = oracle.placed(b.problem, before)
    assert b.stage.iteration == 0
    assert_equal_iterations(b, step, PLACE_TOLERANCE)


@pytest.mark.parametrize(
    "name", ["albedo-solved-l1-on-a-mesh", "two-lobes-solved-with-their-weight", "eight-dimensions-searched-on-a-mesh"]
)
def test_fragment_and_compute_make_the_same_generation(name, bench):
    fragment, compute = bench(BY_NAME[name], "fragment"), bench(BY_NAME[name], "compute")
    for b in (fragment, compute):
        b.advance()
    fragment.randomise()
    for _ in range(3):
        compute.give(fragment.read())
        fragment.advance()
        compute.advance()
        one, other = fragment.stage.state(), compute.stage.state()
        for key in one:
            np.testing.assert_array_max_ulp(one[key], other[key], maxulp=8)


def test_the_bests_are_what_is_resolved(bench):
    b = bench(BY_NAME["two-lobes-solved-with-their-weight"])
    b.stage.iteration = 0
    b.randomise()
    state = b.read()
    b.stage.write_estimates_at_once()
    found = {name: b.packing.unpack(value) for name, value in b.estimates.values().items()}
    wanted = b.problem.material(state.g, state.w)
    seen = b.domain.solvable
    for name, value in found.items():
        np.testing.assert_allclose(value[seen], wanted[name][seen], atol=2e-6)


def test_seventeen_particles_are_refused_and_sixteen_are_not(recover):
    domain, _ = subject(5, 4)
    settings = SHORT.replaced(update="all", linear="solve", particles=16)
    assert recover(domain, schedule=settings).step().done
    with pytest.raises(InputError, match="^particles: .* at most 16 together, not 17; lower particles or") as caught:
        recover(domain, schedule=settings.replaced(particles=17))
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="not 24"):
        lobes = load_model(TWO_LOBES)
        recover(domain, lobes, settings.replaced(linear="search", particles_per_dimension=3.0))


def test_a_swarm_has_a_best_without_any_fitness(bench):
    case = BY_NAME["two-lobes-solved-with-their-weight"]
    domain = make_domain(4, 5, observations=6, holes=False)
    domain.stack.values[2, 1, 3, 0] = np.nan
    b = bench(case, domain=domain)
    b.advance()
    state = b.read()
    assert (state.p_fitness[:, 1, 3] >= 1e29).all() and state.g_fitness[1, 3] >= 1e29
    np.testing.assert_array_equal(state.g[1, 3], state.x[0, 1, 3])
    assert (state.g_fitness < 1e29).sum() == 19


def test_an_iteration_costs_every_particle_and_twice_where_weights_are_solved(recover):
    domain = make_domain(5, 4, holes=False)
    for linear, cost in (("search", 1), ("solve", 2)):
        schedule = SHORT.replaced(update="all", linear=linear, iterations=3)
        # Placing is a generation too.
        assert recover(domain, schedule=schedule).step().evaluations == 4 * 6 * cost * 20
