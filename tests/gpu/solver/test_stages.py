"""Stages: what is known is held, what is unseen is left alone, thresholds stop, lobes keep their order."""

import dataclasses

import numpy as np
import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.geometry.domain import tile, with_samples
from irpso_addon.gpu.textures import CHANNELS
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.phases.phase import TexturePhase
from irpso_addon.solver.planning.cost import recovery_cost
from irpso_addon.solver.settings.resolve import resolve
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state.prepare import prepare
from tests.builders.domains import SHORT, bits_of, recoveries, subject
from tests.oracles import random_numbers as numbers
from tests.oracles import swarm as oracle

LAMBERT = load_model("lambert")
TWO_LOBES = load_model("cook_torrance_two_lobe")
recover = pytest.fixture(recoveries)


# ---- what is not there -------------------------------------------------------------------------------------------


def test_samples_of_weight_0_may_be_nan(recover):
    domain, _ = subject()
    dark = domain.stack.values[..., 3] == 0
    assert np.isnan(domain.stack.values[dark, :3]).all() and dark.any()
    clean = domain.stack.values.copy()
    clean[dark] = 0
    found = []
    for stack in (domain.stack.values, clean):
        recovery = recover(with_samples(domain, stack), schedule=SHORT.replaced(start="lambert"))
        recovery.step()
        maps = recovery.maps()
        assert all(np.isfinite(value).all() for value in (*maps.values.values(), maps.residual))
        found.append(bits_of(maps))
    assert found[0] == found[1]


def test_the_unit_of_the_lights_does_not_matter(recover):
    domain, _ = subject()
    # A power of two, so that float32 has nothing to round.
    brighter = dataclasses.replace(
        with_samples(domain, domain.stack.values * np.float32([4, 4, 4, 1])),
        intensities=domain.intensities * np.float32(4),
    )
    found = []
    for given in (domain, brighter):
        recovery = recover(given, schedule=SHORT.replaced(iterations=200, loss="cauchy"))
        recovery.step()
        found.append(recovery.maps(confidence=False).values)
    for name in found[0]:
        np.testing.assert_array_equal(found[0][name], found[1][name])


def test_an_unobserved_texel_stays_at_the_default(recover):
    domain, _ = subject()
    unseen = ~domain.solvable
    assert (unseen & domain.bake.coverage).any() and (~domain.bake.coverage).any()
    recovery = recover(domain)
    recovery.step()
    maps = recovery.maps()
    np.testing.assert_array_equal(maps.solved, ~unseen)
    for p in LAMBERT.parameters:
        np.testing.assert_array_equal(
            maps.values[p.name][unseen], np.broadcast_to(p.default, (unseen.sum(), p.components))
        )
    assert not maps.residual[unseen].any()


@pytest.mark.parametrize("update", [{}, {"update": "all", "linear": "solve"}], ids=["sequential", "synchronous"])
@pytest.mark.parametrize("loss", ["l1", "l2", "cauchy"])
def test_a_fitness_that_is_not_a_number_never_becomes_a_best(recover, loss, update):
    domain, _ = subject(holes=False)
    domain.stack.values[2, 4, 5, 0] = np.nan  # weighted: no render of this texel has a fitness
    domain.stack.values[3, 6, 7, 1] = np.inf
    recovery = recover(domain, schedule=SHORT.replaced(loss=loss, shadow=0.0, c3_fade=0.0, **update))
    recovery.step(iterations=8)
    fitness = recovery.phase.fitness()
    bad = np.zeros(domain.shape, bool)
    bad[4, 5] = bad[6, 7] = True
    assert (fitness[bad] >= 1e29).all() and (fitness[~bad] < 1e29).all()
    assert all(np.isfinite(array).all() for array in recovery.phase.state().values())
    recovery.step()
    assert all(np.isfinite(value).all() for value in recovery.maps().values.values())


def test_a_domain_where_nothing_is_to_be_solved_ends_with_the_defaults(recover):
    domain, _ = subject(5, 4)
    domain.stack.values[..., 3] = 0
    domain = with_samples(domain, domain.stack.values)
    recovery = recover(domain)
    assert recovery.step().evaluations == 0
    maps = recovery.maps()
    assert not maps.solved.any() and (maps.values["normal"] == (0, 0, 1)).all()


# ---- textures ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("preset", ["paper", "standard"])
def test_every_phase_takes_the_planned_bytes(recover, preset):
    schedule = load_schedule(preset).replaced(
        iterations=1, cycles=1, prefit_iterations=0, refinement_iterations=1, refinement_start_iterations=1
    )
    domain, _ = subject(9, 11, TWO_LOBES.name, holes=False, observations=12)
    recovery = recover(domain, TWO_LOBES, schedule)
    for cost in recovery_cost(TWO_LOBES, schedule, (), 12).phases:
        phase = recovery.phase
        phase.textures.ensure()
        sets = [*phase.textures.current.values(), *phase.textures.spare.values()]
        taken = sum(t.width * t.height * 4 * CHANNELS[t.format] for held in sets for t in held)
        kept = sum(array.nbytes for array in phase.state().values())
        geometry = 64 if phase.title == "shared materials" else 0  # made for the texels of a sample, and freed
        assert (taken, kept) == (99 * (cost.textures - geometry), 99 * cost.kept), phase.title
        while recovery.phase is phase:
            recovery.step(iterations=1)
    assert recovery.progress.done


def test_only_phases_that_lower_the_fitness_reach_a_threshold(recover):
    schedule = load_schedule("standard").replaced(
        iterations=1, cycles=1, prefit_iterations=0, refinement_iterations=1, refinement_start_iterations=1
    )
    domain, _ = subject(9, 11, holes=False, observations=12)
    recovery, shapes = recover(domain, LAMBERT, schedule), {}
    while not recovery.progress.done:
        phase = recovery.phase
        if isinstance(phase, TexturePhase):
            fitness = phase.fitness()
            shapes[phase.title] = None if fitness is None else fitness.shape
            assert phase.reached(np.inf) == (fitness is not None), phase.title
        recovery.step(iterations=1)
    assert set(shapes.values()) == {None, domain.shape}, shapes


# ---- stages ------------------------------------------------------------------------------------------------------


def test_fixed_maps_are_exact_and_the_rest_is_recovered(recover):
    domain, truth = subject(observations=12)
    schedule = load_schedule("swarm").replaced(iterations=700, start="random")
    recovery = recover(domain, schedule=schedule, fixed={"normal": truth["normal"]})
    assert recovery.progress.title == "base_color"
    recovery.step()
    maps = recovery.maps()
    seen = maps.solved
    np.testing.assert_array_equal(maps.values["normal"][seen], truth["normal"][seen])
    error = np.abs(maps.values["base_color"] - truth["base_color"])[seen]
    assert np.median(error) < 1e-3
    np.testing.assert_array_equal(recover(domain, fixed={"normal": truth["normal"]}).maps().values["normal"][seen],
                                  truth["normal"][seen])  # fmt: skip


def test_fixed_normals_that_resampling_has_shortened_get_the_length_1(recover):
    domain, truth = subject()
    short = truth["normal"] * np.linspace(0.94, 1, domain.shape[1])[:, None]
    found = []
    for normals in (truth["normal"], short):
        recovery = recover(domain, fixed={"normal": normals})
        recovery.step()
        found.append(recovery.maps().values)
    for name, atol in (("normal", 1e-6), ("base_color", 1e-4)):
        np.testing.assert_allclose(found[1][name], found[0][name], atol=atol)


def test_a_known_value_may_be_one_for_all_texels(recover):
    domain, _ = subject()
    recovery = recover(domain, fixed={"base_color": np.array([0.1, 0.2, 0.3])})
    recovery.step()
    maps = recovery.maps()
    assert (maps.values["base_color"][maps.solved] == np.float32([0.1, 0.2, 0.3])).all()


@pytest.mark.parametrize(
    ("fixed", "word"),
    [
        ({"normal": np.zeros((3, 3, 3))}, "resample"),
        ({"normal": np.zeros(2)}, "resample"),
        ({"base_color": np.full((13, 17, 3), np.nan)}, "not finite"),
        ({"roughness": np.zeros(1)}, "no parameter 'roughness'"),
        ({"normal": np.zeros(3)}, "texels of the subject hold the vector 0, 0, 0"),
        ({"normal": np.array([0, 0, 2.0])}, "have the length 2; give unit vectors"),
        ({"normal": np.array([0.5, 0.5, 1.0])}, "have the length 1.22; give unit vectors"),
        ({"normal": np.array([0, 0, 1.0]), "base_color": np.zeros(3)}, "every searched parameter is fixed"),
    ],
)
def test_known_maps_that_do_not_fit_are_refused(recover, fixed, word):
    with pytest.raises(InputError, match=word) as caught:
        recover(subject()[0], fixed=fixed)
    assert "\n" not in str(caught.value)


def test_an_entry_that_there_is_not_is_refused():
    with pytest.raises(InputError, match="entry is 'wurst'; choose fragment, compute or auto"):
        Recovery(subject()[0], LAMBERT, SHORT, entry="wurst")


def test_cycles_of_stages_improve_on_the_estimates_of_the_one_before(recover):
    domain, _ = subject(observations=12)
    residuals = []
    for cycles in (1, 3):
        recovery = recover(domain, schedule=load_schedule("paper").replaced(iterations=150, cycles=cycles))
        recovery.step()
        maps = recovery.maps()
        residuals.append(maps.residual[maps.solved])
    # A stage starts from what is known: its first particle stands there, so that no texel gets worse.
    assert (residuals[1] <= residuals[0] + 1e-5).all()
    assert residuals[1].mean() < 0.5 * residuals[0].mean()


def test_swarms_stop_at_the_threshold_and_then_the_run(recover):
    domain, _ = subject(holes=False)
    schedule = SHORT.replaced(iterations=1000, loss="l1", threshold=0.08, search=["diffuse"])
    recovery = recover(domain, schedule=schedule, fixed={"normal": np.array([0, 0, 1.0])})
    recovery.step(iterations=60)
    before = recovery.phase.fitness(), recovery.phase.halo()
    reached = before[0] <= 0.08
    assert 0 < reached.sum() < reached.size
    recovery.step(iterations=20)
    np.testing.assert_array_equal(recovery.phase.fitness()[reached], before[0][reached])
    np.testing.assert_array_equal(recovery.phase.halo()[reached], before[1][reached])
    easy = recover(domain, schedule=schedule.replaced(threshold=0.5))
    progress = easy.step()
    assert progress.done and progress.evaluations < 200 * domain.solvable.sum()


def test_a_tile_stops_at_the_threshold_too(recover):
    domain, _ = subject(holes=False)
    part = tile(domain, 3, 3, 6, 6, halo=2)
    recovery = recover(part, schedule=SHORT.replaced(iterations=1000, loss="l1", threshold=0.5))
    assert recovery.step().evaluations < 200 * 36


@pytest.mark.parametrize(
    "search", [["normal"], ["diffuse"], ["normal", "base_color"], ["r1", "w"], ["specular", "normal"]]
)
def test_any_choice_of_parameters_is_searched_and_no_other_moves(recover, search):
    domain, _ = subject(7, 5, "cook_torrance_two_lobe", observations=12)
    recovery = recover(domain, TWO_LOBES, SHORT.replaced(search=search))
    guess = prepare(domain, TWO_LOBES, recovery.schedule).guess
    before = recover(domain, TWO_LOBES, SHORT).maps()
    recovery.step()
    maps = recovery.maps()
    seen = maps.solved
    for p in TWO_LOBES.parameters:
        same = (maps.values[p.name][seen] == guess[p.name][seen]).all()
        assert same != (p.name in search or p.stage in search), p.name
    assert before.values.keys() == maps.values.keys()


def test_the_residual_is_the_mean_absolute_error_of_the_render(recover):
    domain, _ = subject(card=False, near=True, perspective=True, colored=True)
    recovery = recover(domain, schedule=SHORT.replaced(shadow=0.0))
    recovery.step(iterations=5)
    maps = recovery.maps()
    shape = domain.shape
    schedule = dataclasses.replace(SHORT, fitness=dataclasses.replace(SHORT.fitness, loss="l1"))
    stage = resolve(SHORT, LAMBERT, set())[0]
    problem = oracle.Problem(domain, LAMBERT, stage, schedule, maps.values, np.ones(shape), 1)
    error = oracle.fitness(dataclasses.replace(problem, stage=dataclasses.replace(stage, parameters=())), np.zeros(1))
    np.testing.assert_allclose(maps.residual[maps.solved], error[maps.solved], rtol=1e-5, atol=1e-6)


def test_reading_maps_often_keeps_no_memory(recover):
    recovery = recover(subject()[0], entry="compute")
    for _ in range(5):
        recovery.step(iterations=1)
        recovery.maps()
        recovery.phase.halo()
    assert len(recovery._diagnostics._residual._framebuffers) == 1
    assert len(recovery.phase.reader._copy._framebuffers) <= 2


# ---- interchangeable lobes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("search", [["specular"], ["all"]])
def test_lobes_are_in_rising_order_in_every_particle_at_any_time(recover, search):
    domain, _ = subject(7, 5, "cook_torrance_two_lobe", observations=12)
    recovery = recover(domain, TWO_LOBES, SHORT.replaced(search=search, iterations=60, walls="reflect", v_max=1.0))
    at = recovery.phase.encoding.defines
    for steps in (0, 1, 1, 5, 40):
        recovery.step(iterations=steps)
        stage = recovery.phase
        tiles = stage.state()
        sizes = (stage.particles, stage.height, stage.width)
        for name in ("position", "best"):
            x = numbers.from_atlas(tiles[name], *sizes, 4 * stage.encoding.blocks)
            assert (x[..., at["LOBE_FIRST"]] <= x[..., at["LOBE_SECOND"]]).all()
            assert x.min() >= 0 and x.max() <= 1
    maps = recovery.maps()
    assert (maps.values["r1"] <= maps.values["r2"])[maps.solved].all()


def test_exchanging_the_lobes_keeps_the_render(recover):
    domain, truth = subject(7, 5, "cook_torrance_two_lobe", observations=12, rng_seed=8)
    noise = {**truth, "base_color": truth["base_color"] * 0.8}
    exchanged = {**noise, "r1": noise["r2"], "r2": noise["r1"], "w": 1 - noise["w"]}
    residuals = []
    for values in (noise, exchanged):
        fixed = {name: value for name, value in values.items() if name != "normal"}
        residuals.append(recover(domain, TWO_LOBES, SHORT, fixed=fixed | {"r1": values["r1"]}).maps().residual)
    np.testing.assert_allclose(*residuals, rtol=1e-5, atol=1e-6)
    assert residuals[0][domain.solvable].min() > 1e-3
