"""The refinement's starts, its neighbours' materials and their weight, and the cost of a converged texel."""

import numpy as np
import pytest

from irpso_addon.geometry.domain import with_samples
from irpso_addon.gpu import textures
from irpso_addon.reflectance.model import load_model
from tests.builders.domains import make_domain, unit
from tests.builders.refinement import materials, observed, refinements, schedule_of
from tests.oracles import confidence as confidence_oracle
from tests.oracles.swarm import direction_to, frames, turned

refinement = pytest.fixture(refinements)


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


def dark_dielectric(truth):
    """A material as a fit of matt surfaces leaves it where the truth is a metal: dark, normals some 20° off."""
    start = {name: v.copy() for name, v in truth.items()}
    turned_off = np.random.default_rng(8).normal(size=truth["normal"].shape) * 0.3
    start["normal"] = unit(truth["normal"] + turned_off).astype(np.float32)
    start["normal"][..., 2] = np.abs(start["normal"][..., 2])
    start["metallic"][:], start["base_color"][:] = 0, 0.1
    return start


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
    right = []
    for starts, delta_factor in (((), 1.0), (model.starts, 1.0), (model.starts, 30.0)):
        schedule = schedule_of(
            iterations=10, starts=True, start_iterations=5, delta_factor=delta_factor, central_differences=False
        )
        found = refinement(model, domain, dark_dielectric(truth), schedule, starts=starts, scale=0.1).run()
        right.append(float((found["metallic"] > 0.9).mean()))
    assert right[0] < 0.1 < right[1] < right[2] - 0.05 and right[2] > 0.8, right


@pytest.mark.parametrize("entry", ["fragment", "compute"])
def test_a_start_that_is_close_behind_goes_on_until_it_wins(refinement, entry):
    model, shape = load_model("metallic_roughness"), (8, 8)
    truth = gold(shape)
    domain = observed(model, truth, shape, observations=8, noise=0.003)
    right = []
    for race in (0, 8):
        schedule = schedule_of(
            iterations=4,
            starts=True,
            start_iterations=2,
            race_iterations=race,
            delta_factor=30.0,
            central_differences=False,
        )
        bench = refinement(model, domain, dark_dielectric(truth), schedule, starts=model.starts, scale=0.1, entry=entry)
        right.append(float((bench.run()["metallic"] > 0.9).mean()))
    assert right[1] > right[0] + 0.1, right


def test_a_start_that_is_far_behind_stops(refinement):
    model, shape = load_model("metallic_roughness"), (6, 6)
    truth = gold(shape)
    domain = observed(model, truth, shape, observations=24, noise=0.003)
    spent = []
    for race in (0, 6):
        # One step from a matt dielectric is far from gold.
        schedule = schedule_of(
            iterations=1, starts=True, start_iterations=1, race_iterations=race, central_differences=False
        )
        starts = ((("roughness", (1.0,)), ("metallic", (0.0,))),)
        bench = refinement(model, domain, truth, schedule, starts=starts, scale=0.1)
        bench.run()
        spent.append(bench.refinement.read("result")[..., 3])
    assert spent[0].min() > 0 and np.mean(spent[1] == spent[0]) > 0.9


@pytest.mark.parametrize("source", ["shown", "result"])
def test_a_start_with_a_wide_delta_gives_no_worse_material(refinement, source):
    model, shape = load_model("metallic_roughness"), (6, 6)
    truth = materials(model, shape)
    domain = observed(model, truth, shape, observations=24)
    schedule = schedule_of(iterations=4, starts=True, start_iterations=5, delta_factor=30.0)
    bench = refinement(model, domain, truth, schedule, starts=model.starts, scale=0.1)
    errors = []
    while not bench.refinement.done:
        found = bench.run(bench.refinement.iteration + 1)
        if source == "shown":
            bench.refinement.preview(bench.estimates.shown)
            shown = bench.pack.unpack(np.concatenate([textures.download(t) for t in bench.estimates.shown], axis=-1))
            parts = np.split(shown, np.cumsum([p.components for p in model.parameters]), axis=-1)
            found = {p.name: part.astype(np.float64) for p, part in zip(model.parameters, parts, strict=False)}
        render = confidence_oracle.radiance(domain, model.name, found)
        errors.append(np.abs(render - domain.stack.values[..., :3]).mean())
    assert max(errors) < 2 * errors[0], errors


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


def weighted(refinement, truth, start, weight, entry="fragment", unseen=None, noise=0.003):
    """Refine a start with this weight of the neighbours, under 40 lights with noise.

    unseen: (row, column) of a texel that no light near its highlight reaches.
    """
    model, shape = load_model("principled"), truth["roughness"].shape[:2]
    domain = observed(model, truth, shape, noise=noise)
    if unseen:
        half = unit(domain.lights[:, :3] + (0, 0, 1))
        domain.stack.values[half @ truth["normal"][unseen] > 0.9, *unseen, 3] = 0
    schedule = schedule_of(iterations=4, rounds=3, round_iterations=4, neighbour_weight=weight)
    return refinement(model, domain, start, schedule, entry=entry).run()


@pytest.mark.parametrize("entry", ["fragment", "compute"])
def test_a_lone_undecided_texel_takes_its_neighbours_material(refinement, entry):
    truth = uniform((7, 7))
    start = {name: v.copy() for name, v in truth.items()}
    start["roughness"][3, 3], start["specular"][3, 3] = 0.9, 0.0
    alone, crowd = (weighted(refinement, truth, start, weight, entry, (3, 3)) for weight in (0.0, 6.0))
    for name, value in (("roughness", 0.3), ("specular", 0.5)):
        assert abs(alone[name][3, 3, 0] - value) > 0.2 > 2 * abs(crowd[name][3, 3, 0] - value)


def test_a_fit_better_than_any_photograph_allows_does_not_outweigh_the_neighbours(refinement):
    truth = uniform((7, 7))
    truth["roughness"][3, 3] = 0.7
    found = weighted(refinement, truth, truth, 6.0, unseen=(3, 3), noise=0.0)
    assert found["roughness"][3, 3, 0] == pytest.approx(0.3, abs=0.15)


def test_a_texel_of_its_own_material_keeps_it(refinement):
    truth = uniform((7, 7))
    truth["roughness"][3, 3], truth["specular"][3, 3] = 0.7, 1.0
    found = weighted(refinement, truth, truth, 6.0)
    assert found["roughness"][3, 3, 0] == pytest.approx(0.7, abs=0.05)
    assert np.abs(found["roughness"] - truth["roughness"]).max() < 0.05


def test_a_line_and_a_checker_one_texel_wide_survive_the_weight_of_neighbours(refinement):
    rows, columns = np.indices((8, 8))
    for other in (rows == 3, (rows + columns) % 2 == 0):
        truth = uniform((8, 8))
        truth["roughness"][other] = 0.6
        found = weighted(refinement, truth, truth, 6.0)
        assert np.abs(found["roughness"] - truth["roughness"]).max() < 0.06
