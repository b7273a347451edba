"""One texel of a running recovery, read back on its own, against its maps and its swarms' textures decoded in numpy."""

import numpy as np
import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.gpu import textures
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.coarse_to_fine import Pyramid
from irpso_addon.solver.settings.resolve import prefit_model, resolve
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state.packing import Packing
from irpso_addon.solver.state.prepare import prepare
from irpso_addon.solver.views import texel_probe
from irpso_addon.solver.views.texel_probe import TexelProbe
from tests.builders.domains import SHORT, makers, recoveries, subject
from tests.oracles import random_numbers as numbers
from tests.oracles.synchronous_swarm import SynchronousSwarm

TWO_LOBES = load_model("cook_torrance_two_lobe")
PRINCIPLED = load_model("principled")
STANDARD = load_schedule("standard")
recover = pytest.fixture(recoveries)


@pytest.fixture
def probe():
    """A maker of probes, which are closed at the end."""
    yield from makers(TexelProbe)


def some_texels(domain, count=6):
    """(row, column) of solved texels, spread over the domain."""
    places = np.argwhere(domain.solvable)
    return [tuple(int(i) for i in place) for place in places[:: max(1, len(places) // count)]]


def decoded(recovery, stage, model, estimates):
    """(positions, bests (m, H, W, n), fitness (m, H, W), global best (H, W, n)) of a checkpoint's arrays, in numpy."""
    domain, schedule, arrays = recovery.domain, recovery.schedule, recovery.snapshot().arrays
    packing, scale = Packing(domain.solvable), prepare(domain, recovery.model, schedule).scale
    height, width = packing.height, packing.width
    phase, _ = texel_probe.running_swarm(recovery)
    problem = SynchronousSwarm(domain, model, stage, schedule, estimates, scale, phase.particles)

    def place(name):
        found = numbers.from_atlas(arrays[f"phase_{name}"], phase.particles, height, width, problem.columns)
        return [packing.unpack(one) for one in found]

    def of(x):
        s = problem.decode(x)
        return np.concatenate([np.broadcast_to(s[p.name], (*domain.shape, p.components)) for p in stage.parameters], -1)

    blocks = range(problem.columns // 4)
    best = np.concatenate([packing.unpack(arrays[f"phase_global_best_{b}"]) for b in blocks], axis=-1)
    fitness = numbers.from_atlas(arrays["phase_fitness"], phase.particles, height, width, 1)[..., 0]
    return (
        np.stack([of(x) for x in place("position")]),
        np.stack([of(x) for x in place("best")]),
        np.stack([packing.unpack(one) for one in fitness]),
        of(best),
    )


@pytest.mark.parametrize("card", [True, False], ids=["card", "mesh"])
@pytest.mark.parametrize(
    ("model", "schedule", "search"),
    [
        (TWO_LOBES, SHORT, "all"),
        (TWO_LOBES, SHORT.replaced(search=["specular", "normal"], normal="cartesian"), "some"),
        (PRINCIPLED, SHORT.replaced(update="all", linear="solve"), "solved"),
    ],
    ids=["one at a time", "cartesian", "generations"],
)
def test_the_particles_are_those_of_the_swarms_textures(recover, probe, model, schedule, search, card):
    domain, _ = subject(model=model.name, card=card) if model is TWO_LOBES else subject(card=card)
    recovery = recover(domain, model, schedule)
    recovery.step(iterations=4)
    stage = resolve(schedule, model, set(), domain.observations)[0]
    guess = prepare(domain, model, schedule).guess
    positions, bests, fitness, best = decoded(recovery, stage, model, guess)
    reader = probe(recovery)
    for row, column in some_texels(domain):
        found = reader.read(row, column).particles
        assert len(found.names) == positions.shape[-1] == sum(p.components for p in stage.parameters)
        np.testing.assert_allclose(found.positions, positions[:, row, column], atol=3e-6)
        np.testing.assert_allclose(found.bests, bests[:, row, column], atol=3e-6)
        np.testing.assert_allclose(found.fitness, fitness[:, row, column], rtol=1e-6)
        np.testing.assert_allclose(found.global_best, best[row, column], atol=3e-6)
        assert found.positions.std(axis=0).min() > 0
        leader = np.argmin(found.fitness)
        np.testing.assert_allclose(found.bests[leader], found.global_best, atol=3e-6)


def test_the_names_are_those_of_the_components_that_are_searched(recover, probe):
    recovery = recover(subject(model=TWO_LOBES.name)[0], TWO_LOBES)
    recovery.step(iterations=1)
    row, column = some_texels(recovery.domain)[0]
    assert probe(recovery).read(row, column).particles.names == (
        "base_color.r", "base_color.g", "base_color.b", "normal.x", "normal.y", "normal.z", "r1", "r2", "w",
    )  # fmt: skip


@pytest.mark.parametrize("card", [True, False], ids=["card", "mesh"])
def test_error_and_values_are_those_of_the_maps(recover, probe, card):
    domain, _ = subject(model=TWO_LOBES.name, card=card, colored=True)
    recovery = recover(domain, TWO_LOBES)
    reader = probe(recovery)
    for iterations in (0, 5, None):
        recovery.step(iterations)
        maps = recovery.maps(confidence=False)
        for row, column in some_texels(domain):
            state = reader.read(row, column)
            assert state.error == pytest.approx(float(maps.residual[row, column]), rel=1e-6)
            assert state.values.keys() == maps.values.keys()
            for name, value in state.values.items():
                np.testing.assert_array_equal(value, maps.values[name][row, column])
    assert recovery.progress.done and state.particles is None


def test_an_unsolved_texel_has_no_state_and_one_outside_is_refused(recover, probe):
    domain, _ = subject()
    reader = probe(recover(domain))
    row, column = np.argwhere(~domain.solvable)[0]
    assert reader.read(int(row), int(column)) is None
    for place in ((-1, 0), (0, -1), (13, 0), (0, 17)):
        with pytest.raises(InputError, match="the domain has 13 rows and 17 columns, from 0"):
            reader.read(*place)


def test_every_phase_of_standard_is_read(recover, probe):
    domain, _ = subject(7, 5, model="cook_torrance_two_lobe", observations=14, holes=False)
    recovery = recover(domain, PRINCIPLED, STANDARD)
    reader, names = probe(recovery), {}
    while not recovery.progress.done:
        recovery.step(iterations=1)
        state, title = reader.read(3, 2), recovery.progress.title
        with recovery.view() as lent:
            at = textures.download(lent["u_packed"])[3, 2].astype(int)
            lies = [textures.download(lent[f"u_estimate_{i}"])[at[1], at[0]] for i in range(2)]
        np.testing.assert_array_equal(np.concatenate(list(state.values.values())), np.concatenate(lies))
        names.setdefault(title, set()).add(state.particles and state.particles.names)
    searched = tuple(p.name for p in prefit_model().parameters if p.kind == "search" and not p.is_normal)
    prefit = next(iter(names["prefit of the normals"] - {None}))
    assert set(searched) | {"normal.x", "normal.y", "normal.z"} == set(prefit)
    assert names["refinement"] == {None}
    swarms = [title for title in names if "base_color" in title]
    for name, value in state.values.items():
        np.testing.assert_array_equal(value, recovery.maps(confidence=False).values[name][3, 2])
    # The prefit has found the normals, and the albedo is solved in closed form.
    assert names[swarms[0]] - {None} == {("roughness", "specular")}


def test_an_unplaced_swarm_is_not_shown(recover, probe):
    domain, _ = subject()
    recovery = recover(domain)
    reader = probe(recovery)
    assert recovery.progress.iteration < 0
    row, column = some_texels(domain)[0]
    assert reader.read(row, column).particles is None
    recovery.step(iterations=0)
    assert np.isfinite(reader.read(row, column).particles.fitness).all()


def test_a_coarse_level_is_read_at_its_own_texel(probe):
    domain, _ = subject(20, 23, holes=False)
    schedule = load_schedule("swarm").replaced(iterations=3, levels=2, particles=4, particles_per_dimension=0.0)
    with Pyramid(domain, load_model("lambert"), schedule, entry="fragment") as pyramid:
        pyramid.step(iterations=2)
        reader, maps = probe(pyramid), pyramid._live.maps(confidence=False)
        assert maps.residual.shape == (10, 12)
        for row, column in ((0, 0), (13, 7), (19, 22)):
            state = reader.read(row, column)
            assert state.error == pytest.approx(float(maps.residual[row // 2, column // 2]), rel=1e-6)
            assert state.particles.positions.shape == (4, 6)
        pyramid.step()
        residual = pyramid.maps(confidence=False).residual
        assert reader.read(13, 7).error == pytest.approx(float(residual[13, 7]), rel=1e-6)
        reader.close()


def test_little_is_read_back(recover, probe, monkeypatch):
    recovery = recover(subject()[0])
    recovery.step(iterations=2)
    row, column = some_texels(recovery.domain)[0]
    reader, read = probe(recovery), []
    download = texel_probe.textures.download
    monkeypatch.setattr(texel_probe.textures, "download", lambda t: read.append(t.width * t.height) or download(t))
    reader.read(row, column)
    assert len(read) == 2 and sum(read) < 60


def test_reading_a_texel_does_not_change_the_maps(recover, probe):
    domain, _ = subject()
    runs = [recover(domain), recover(domain)]
    reader, (row, column) = probe(runs[0]), some_texels(domain)[0]
    while not runs[0].step(time_budget_s=1e-6).done:
        reader.read(row, column)
    runs[1].step()
    for name, value in runs[0].maps(confidence=False).values.items():
        np.testing.assert_array_equal(value, runs[1].maps(confidence=False).values[name])
