"""The spatial prior: its pooling against float64, whom it moves and whom not, and what never changes."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.gpu import context
from irpso_addon.gpu.bands import Bands
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.tiled import TiledRecovery
from irpso_addon.solver.phases.phase import PhaseContext
from irpso_addon.solver.phases.spatial_prior import SpatialPriorPhase
from irpso_addon.solver.planning.cost import recovery_cost
from irpso_addon.solver.settings.refinement_groups import SpatialPrior
from irpso_addon.solver.settings.resolve import resolve
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state.packing import Packing
from irpso_addon.solver.state.textures import DomainTextures, Estimates
from tests.builders.domains import (
    bits_of,
    make_domain,
    makers,
    noisy,
    pack_layers,
    recoveries,
    subject,
    unit,
    with_radiance,
)
from tests.oracles import confidence as confidence_oracle
from tests.oracles import spatial_prior as prior_oracle

TWO_LOBES = load_model("cook_torrance_two_lobe")
PRIOR = SpatialPrior(rounds=2, scales=2, iterations=3)
NOISE = 0.003
recover = pytest.fixture(recoveries)


def schedule_of(swarm=8, loss="cauchy", **settings):
    """Few iterations of swarms and refinement, and a prior."""
    schedule = load_schedule("standard").replaced(
        iterations=swarm,
        refinement_iterations=3,
        refinement_rounds=0,
        prefit_iterations=0,
        loss=loss,
        shadow=0.0,
        materials_rounds=0,
        surface_rounds=0,
    )
    return schedule.replaced(prior=replace(PRIOR, **settings))


class Bench:
    """A prior over a domain's given estimates, on the GPU. values: name → (H, W, components)."""

    def __init__(self, model, domain, values, schedule, entry="fragment", fixed=frozenset()):
        context.ensure()
        self.model, self.domain, self.pack = model, domain, Packing(domain.solvable)
        scale = self.pack.pack(np.ones(domain.shape, np.float32))
        self.uploaded = DomainTextures(domain, self.pack, pack_layers(self.pack, domain.stack.values), scale)
        self.estimates = Estimates(model, {name: self.pack.pack(np.float32(v)) for name, v in values.items()})
        resolved = resolve(schedule, model, fixed)[-1]
        self.prior = SpatialPriorPhase(resolved, PhaseContext(model, schedule, self.uploaded, self.estimates, entry))
        self.bands = Bands()

    def run(self, iterations=None):
        """Make iterations until so many were made, or all."""
        while not self.prior.done and (iterations is None or self.prior.iteration < iterations):
            for _ in self.prior.advance(self.bands, 0.25):
                pass

    def found(self):
        """What was found, name → (H, W, components) float64."""
        self.prior.write_estimates_at_once()
        values = self.estimates.values()
        return {name: self.pack.unpack(v, np.nan).astype(np.float64) for name, v in values.items()}

    def read(self, group):
        """(H, W, 4 n) of a group of n textures."""
        return self.pack.unpack(self.prior.read(group), np.nan).astype(np.float64)

    def set_deviations(self, **deviations):
        """Say how well the samples tell numbers: name → (H, W)."""
        own = self.read("own")
        components = {p.name: p.components for p in self.model.parameters}
        for name, value in deviations.items():
            at = self.model.offset(name)
            own[..., at : at + components[name]] = value[..., None]
        packed = self.pack.pack(own.astype(np.float32))
        for group in ("own", "deviation"):
            self.prior.textures.upload(group, np.split(packed, packed.shape[-1] // 4, axis=-1))

    def close(self):
        self.prior.close()


@pytest.fixture
def prior():
    """A maker of benches of a prior."""
    yield from makers(Bench)


def smooth(height, width, observations=30, seed=2, model=TWO_LOBES, **options):
    """(domain, truth, halves): two materials side by side on a bumpy card, seen with noise; halves tells which."""
    rng, shape = np.random.default_rng(seed), (height, width)
    right = np.broadcast_to(np.arange(width) >= width // 2, shape)

    def of(left, other):
        return np.where(right, other, left)[..., None] + np.zeros(shape)[..., None]

    truth = {
        "base_color": np.where(right[..., None], (0.2, 0.5, 0.6), (0.6, 0.3, 0.2)),
        "normal": unit(rng.normal(size=(*shape, 3)) * 0.1 + (0, 0, 1)),
        "r1": of(0.2, 0.12), "r2": of(0.5, 0.35), "w": of(0.5, 0.7),
        "roughness": of(0.3, 0.5), "specular": of(0.5, 0.8),
    }  # fmt: skip
    truth = {p.name: truth[p.name].astype(np.float32) for p in model.parameters}
    domain = with_radiance(make_domain(height, width, observations, holes=False, **options), model.name, truth)
    return noisy(domain, NOISE), truth, right


def components(model, values):
    """(H, W, C) of name → (H, W, components)."""
    return np.concatenate([values[p.name] for p in model.parameters], axis=-1).astype(np.float64)


@pytest.mark.parametrize("entry", ["fragment", "compute"])
@pytest.mark.parametrize("rounds", [1, 3])
@pytest.mark.parametrize("fixed", [frozenset(), frozenset({"w"})])
def test_the_pooling_is_that_of_float64(prior, rounds, entry, fixed):
    domain = make_domain(9, 12, 10, holes=True)
    rng, shape = np.random.default_rng(4), (9, 12)
    _, truth = subject(9, 12, "cook_torrance_two_lobe")
    values = {**truth, "base_color": (0.5 + 0.03 * rng.normal(size=(*shape, 3))).astype(np.float32)}
    bench = prior(TWO_LOBES, domain, values, schedule_of(rounds=rounds, scales=3), entry=entry, fixed=fixed)
    bench.run(2)
    deviations = {name: 10 ** rng.uniform(-4, 0, shape) for name in ("r1", "r2", "w") if name not in fixed}
    bench.set_deviations(**{name: np.minimum(d, 0.75) for name, d in deviations.items()})
    own = bench.read("own")[..., : TWO_LOBES.components]
    bench.run(2 + rounds)
    mean, deviation = bench.read("mean"), bench.read("deviation")
    estimates, covered = components(TWO_LOBES, values), domain.solvable
    wanted, spread = prior_oracle.pooled(SpatialPrior(rounds=rounds, scales=3), TWO_LOBES, covered, estimates, own)
    held = {TWO_LOBES.offset(name) for name in fixed}
    pooled = [c for c, _ in prior_oracle.components(TWO_LOBES) if c not in held]
    assert (spread[covered][:, pooled] > 0).any(axis=0).all()
    for c in pooled:
        np.testing.assert_array_equal(deviation[covered][:, c] > 0, spread[covered][:, c] > 0)
        np.testing.assert_allclose(deviation[covered][:, c], spread[covered][:, c], rtol=2e-3, atol=1e-6)
        np.testing.assert_allclose(mean[covered][:, c], wanted[covered][:, c], atol=2e-4)
    others = [c for c in range(TWO_LOBES.components) if c not in {*pooled, *held}]
    assert not deviation[covered][:, others].any()  # normals are not pooled


def test_the_noise_combines_samples_and_neighbours(prior):
    domain, truth, _ = smooth(8, 9, observations=12)
    domain.stack.values[2:, 4, 4, 3] = 0  # two samples tell less than the model has unknowns
    bench = prior(TWO_LOBES, domain, truth, schedule_of(loss="l2"))
    bench.run(2)
    noise = bench.read("noise")
    clean = with_radiance(domain, TWO_LOBES.name, truth).stack.values.astype(np.float64)
    error = np.where(domain.stack.values[..., 3:] > 0, domain.stack.values[..., :3] - clean[..., :3], 0)
    errors = (domain.stack.values[..., 3:] * error**2).sum(axis=(0, 3))
    channels = 3 * domain.stack.values[..., 3].sum(axis=0)
    np.testing.assert_allclose(noise[..., 0], errors, rtol=2e-3)
    np.testing.assert_allclose(noise[..., 1], channels, rtol=1e-6)
    freedom = np.maximum(channels - 8, 0)
    assert freedom[4, 4] == 0
    for row, column in ((4, 4), (0, 0), (7, 3)):
        there = prior_oracle.around(domain.shape, domain.solvable, row, column, PRIOR.scales)
        shared = errors[there][freedom[there] > 0].sum() / freedom[there].sum()
        own = errors[row, column] if freedom[row, column] > 0 else 0
        wanted = (own + PRIOR.noise_samples * shared) / (freedom[row, column] + PRIOR.noise_samples)
        assert noise[row, column, 2] == pytest.approx(wanted, rel=2e-3)
    # Nothing was fitted, so that none of 36 samples is spent on the 8 unknowns.
    assert np.sqrt(noise[4, 4, 2]) == pytest.approx(NOISE * np.sqrt(36 / 28), rel=0.1)


def test_own_deviations_come_from_the_inverse_normal_matrix(prior):
    domain, truth, _ = smooth(6, 7)
    bench = prior(TWO_LOBES, domain, truth, schedule_of(loss="l2"))
    bench.run(2)
    own, noise = bench.read("own"), bench.read("noise")
    j = confidence_oracle.jacobian(domain, TWO_LOBES, {name: v.astype(np.float64) for name, v in truth.items()})
    weighted = j * domain.stack.values[None, ..., 3:]
    gram = np.einsum("akyxc,bkyxc->yxab", weighted, j)
    wanted = np.sqrt(noise[..., 2, None] * np.diagonal(np.linalg.inv(gram), axis1=-2, axis2=-1))
    scalars = {name: i for i, (p, _, _) in enumerate(confidence_oracle.unknowns(TWO_LOBES)) for name in [p.name]}
    for name in ("r1", "r2", "w"):
        p = TWO_LOBES.parameter(name)
        determined = wanted[..., scalars[name]] < 0.2
        assert determined.sum() > 20
        found = own[..., TWO_LOBES.offset(name)] / (p.range[1] - p.range[0])
        np.testing.assert_allclose(found[determined], wanted[determined][:, scalars[name]], rtol=0.02)


@pytest.mark.parametrize("entry", ["fragment", "compute"])
def test_certain_texels_stay_and_uncertain_ones_follow_alike_texels(prior, entry):
    domain, truth, right = smooth(12, 14)
    ignorant = np.zeros(domain.shape, bool)
    ignorant[[3, 3, 8, 8], [2, 11, 6, 7]] = True  # the last two beside the other material
    domain.stack.values[:, ignorant, 3] = 0
    domain.stack.values[:4, ignorant, 3] = 1
    values = {name: value.copy() for name, value in truth.items()}
    for name, wrong in (("r1", 0.4), ("r2", 0.7), ("w", 0.1)):
        values[name][ignorant] = wrong
    bench = prior(TWO_LOBES, domain, values, schedule_of(scales=3, iterations=8, tolerance=1e3), entry=entry)
    bench.run(2)
    everywhere = np.where(ignorant, 0.75, 1e-3)
    bench.set_deviations(r1=everywhere, r2=everywhere, w=everywhere, base_color=everywhere / 100)
    bench.run(4)
    mean = bench.read("mean")
    bench.run()
    found = bench.found()
    for name, value in truth.items():
        np.testing.assert_array_equal(found[name][~ignorant], value[~ignorant])
    for row, column in np.argwhere(ignorant):
        for name in ("r1", "r2", "w"):
            own, other = (
                truth[name][(right == side) & ~ignorant].mean() for side in (right[row, column], not right[row, column])
            )
            assert abs(mean[row, column, TWO_LOBES.offset(name)] - own) < 0.02 * abs(own - other)
            assert abs(found[name][row, column, 0] - own) < 0.2 * abs(own - other)


def test_a_texel_keeps_its_estimate_if_its_samples_contradict_its_neighbours(prior):
    domain, truth, _ = smooth(8, 8)
    values = {name: value.copy() for name, value in truth.items()}
    bench = prior(TWO_LOBES, domain, values, schedule_of(tolerance=3.0))
    bench.run(2)
    low = np.full(domain.shape, 1e-3)
    low[3, 3] = 0.75  # told to know nothing, while its samples are as good as all
    bench.set_deviations(r1=low, r2=low, w=low)
    moved = bench.prior.read("mean")
    for name, wrong in (("r1", 0.5), ("r2", 0.75), ("w", 0.05)):
        moved[..., TWO_LOBES.offset(name)] = np.where(np.arange(64).reshape(8, 8) == 27, 0.5, wrong)
    bench.prior.textures.upload("mean", np.split(moved, moved.shape[-1] // 4, axis=-1))
    bench.run()
    found = bench.found()
    assert bench.read("deviation")[3, 3, TWO_LOBES.offset("w")] > 0  # there is a prior
    before, after = (
        confidence_oracle.radiance(domain, TWO_LOBES.name, {name: v.astype(np.float64) for name, v in what.items()})
        for what in (values, found)
    )
    noise = bench.read("noise")[3, 3, 2]
    samples = domain.stack.values[..., :3].astype(np.float64)
    weight = domain.stack.values[:, 3, 3, 3:]
    deviances = [(weight * (render - samples)[:, 3, 3] ** 2).sum() / noise for render in (before, after)]
    assert deviances[1] - deviances[0] <= 9 + 0.5
    assert abs(found["w"][3, 3, 0] - 0.05) > 0.2


def test_neighbours_improve_two_lobes(recover):
    domain, truth, _ = smooth(16, 18, 24)
    few = np.random.default_rng(3).random(domain.shape) < 0.15
    domain.stack.values[6:, few, 3] = 0
    errors = {}
    for rounds in (0, 2):
        run = recover(domain, TWO_LOBES, schedule_of(20, rounds=rounds, scales=3, iterations=6))
        run.step()
        found = run.maps(confidence=False).values
        errors[rounds] = {name: abs(found[name] - truth[name]).mean() for name in ("r1", "r2", "w")}
        turned = np.arccos(np.clip((found["normal"] * truth["normal"]).sum(axis=-1), -1, 1))
        errors[rounds]["normal"] = np.degrees(turned).mean()
    for name in ("r1", "r2", "w"):
        assert errors[2][name] < 0.7 * errors[0][name]
    assert errors[2]["normal"] < errors[0]["normal"]


def test_without_rounds_and_for_models_without_scalars_there_is_no_prior(recover):
    domain, _, _ = smooth(6, 7)
    plain = replace(schedule_of(rounds=2), prior=SpatialPrior())
    bits = []
    for schedule in (plain, plain.replaced(prior_rounds=0, prior_bandwidth=0.7)):
        run = recover(domain, TWO_LOBES, schedule)
        run.step()
        bits.append(bits_of(run.maps(confidence=False)))
    assert bits[0] == bits[1]
    assert resolve(schedule_of(), load_model("lambert"), set())[-1].title == "refinement"
    assert resolve(schedule_of(), TWO_LOBES, {"r1", "r2", "w"})[-1].title == "refinement"


def test_the_lock_step_driver_gives_the_same_bits(recover):
    domain = noisy(subject(model="cook_torrance_two_lobe", observations=12)[0], NOISE)
    schedule = schedule_of().replaced(materials_rounds=1, materials_iterations=2)
    whole = recover(domain, TWO_LOBES, schedule)
    whole.step()
    boxes = [(0, 0, 7, 13), (7, 0, 10, 4), (7, 4, 10, 9)]
    with TiledRecovery(domain, TWO_LOBES, schedule, 1, entry="fragment", boxes=boxes, halo=4) as run:
        run.step()
        assert bits_of(run.maps()) == bits_of(whole.maps())


def test_slices_reads_and_checkpoints_change_nothing(recover, tmp_path):
    domain = noisy(subject(model="cook_torrance_two_lobe", observations=12)[0], NOISE)
    schedule = schedule_of()
    whole = recover(domain, TWO_LOBES, schedule)
    total = whole.step().iterations_in_all
    wanted = bits_of(whole.maps())
    sliced = recover(domain, TWO_LOBES, schedule)
    while not sliced.step(time_budget_s=1e-6).done:
        sliced.maps(confidence=False)
    assert bits_of(sliced.maps()) == wanted
    for left in (1, PRIOR.iterations + 1, PRIOR.rounds + PRIOR.iterations + 1):
        first = recover(domain, TWO_LOBES, schedule)
        first.step(iterations=total - left)
        assert first.progress.title == "prior"
        first.save(tmp_path / "run.npz")
        second = recover(domain, TWO_LOBES, schedule)
        second.load(tmp_path / "run.npz")
        second.step()
        assert bits_of(second.maps()) == wanted


def test_maps_before_the_end_show_the_refinement(recover):
    domain = noisy(subject(model="cook_torrance_two_lobe", observations=12)[0], NOISE)
    without = recover(domain, TWO_LOBES, schedule_of(rounds=0))
    without.step()
    wanted = bits_of(without.maps(confidence=False))
    run = recover(domain, TWO_LOBES, schedule_of())
    while run.progress.title != "prior":
        run.step(iterations=1)
    for _ in range(PRIOR.rounds + PRIOR.iterations + 1):
        run.step(iterations=1)
        assert bits_of(run.maps(confidence=False)) == wanted
    run.step()
    assert bits_of(run.maps(confidence=False)) != wanted


@pytest.mark.parametrize(("model", "loss"), [("principled", "l1"), ("cook_torrance_two_lobe", "cauchy")])
def test_no_number_leaves_its_range_and_nothing_is_not_a_number(recover, model, loss):
    domain = make_domain(11, 12, 9, card=False, near=True, perspective=True, colored=True)
    model = load_model(model)
    run = recover(domain, model, schedule_of(3, loss=loss))
    run.step()
    maps = run.maps(confidence=False)
    for p in model.parameters:
        value = maps.values[p.name][maps.solved]
        assert np.isfinite(value).all()
        assert (value >= p.range[0]).all() and (value <= p.range[1]).all()
    for first, second in zip(model.ordered, model.ordered[1:], strict=False):
        assert (maps.values[first] <= maps.values[second])[maps.solved].all()


def test_a_prior_reads_and_renders_as_planned(prior):
    schedule = schedule_of().replaced(iterations=0)
    cost = recovery_cost(TWO_LOBES, schedule, (), 12).phases[-1]
    domain, truth, _ = smooth(9, 11, 12)
    bench, radii, renders = prior(TWO_LOBES, domain, truth, schedule), [], 0
    while not bench.prior.done:
        radii.append(bench.prior.stencil_radius)
        renders += bench.prior.evaluations
        bench.run(bench.prior.iteration + 1)
    wanted = cost.stencil_radius, cost.exchanges, cost.evaluations
    assert (max(radii), sum(radius > 0 for radius in radii), renders) == wanted


@pytest.mark.parametrize("setting, value", [("rounds", -1), ("scales", 0), ("scales", 7), ("iterations", 0),
                                            ("bandwidth", 0.0), ("min_deviation", float("nan")), ("tolerance", "3"),
                                            ("normals", 1)])  # fmt: skip
def test_settings_that_make_no_sense_are_refused_by_name(setting, value):
    with pytest.raises(InputError, match=f"prior_{setting}"):
        load_schedule("standard").replaced(**{f"prior_{setting}": value})
