"""Normals that belong to a surface: the relaxation against float64, whom it moves and whom not, what never changes."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.core.steps import run_steps
from irpso_addon.geometry.domain import with_samples
from irpso_addon.geometry.seams.edges import SeamEdges
from irpso_addon.geometry.seams.seams import SeamMap
from irpso_addon.gpu import context
from irpso_addon.gpu.bands import Bands
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.engine.tiled import TiledRecovery
from irpso_addon.solver.phases.phase import PhaseContext
from irpso_addon.solver.phases.surface import SurfacePhase
from irpso_addon.solver.planning.cost import recovery_cost
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
from tests.oracles import surface as oracle

LAMBERT, TWO_LOBES = load_model("lambert"), load_model("cook_torrance_two_lobe")
OFF = load_schedule("standard").replaced(
    prefit_iterations=0, refinement_rounds=0, materials_rounds=0, prior_rounds=0, surface_rounds=0
)
ON = OFF.replaced(surface_rounds=2)  # with the preset's smoothness
LOOPS = ON.replaced(surface_smoothness=0.0)
NO_EDGES = SeamEdges(*(np.zeros((0, *shape)) for shape in ((2,), (2,), (2,), (), (), (2, 3))))
recover = pytest.fixture(recoveries)


class Bench:
    """The phase over a domain's given estimates, on the GPU. values: name → (H, W, components)."""

    def __init__(self, model, domain, values, schedule=ON, entry="fragment"):
        context.ensure()
        self.model, self.domain, self.pack = model, domain, Packing(domain.solvable, domain.seams)
        scale = self.pack.pack(np.ones(domain.shape, np.float32))
        domain_textures = DomainTextures(domain, self.pack, pack_layers(self.pack, domain.stack.values), scale)
        self.estimates = Estimates(model, {name: self.pack.pack(np.float32(v)) for name, v in values.items()})
        (resolved,) = resolve(schedule, model, set())[-1:]
        self.phase = SurfacePhase(resolved, PhaseContext(model, schedule, domain_textures, self.estimates, entry))

    def run(self, iterations=None):
        """Make iterations until so many were made, or all."""
        while not self.phase.done and (iterations is None or self.phase.iteration < iterations):
            run_steps(self.phase.advance(Bands(), 0.25))

    def read(self, group):
        """(H, W, 4) float64."""
        return self.pack.unpack(self.phase.read(group), np.nan).astype(np.float64)

    def put(self, group, values):
        """Replace a group by (H, W, 4)."""
        self.phase.textures.upload(group, [self.pack.pack(values.astype(np.float32))])

    def found(self):
        """What was found, name → (H, W, components) float64."""
        self.phase.write_estimates_at_once()
        return {name: self.pack.unpack(v, np.nan).astype(np.float64) for name, v in self.estimates.values().items()}

    def close(self):
        self.phase.close()


@pytest.fixture
def bench():
    """A maker of benches."""
    yield from makers(Bench)


def normals_of(slopes):
    return unit(np.concatenate([-slopes, np.ones((*slopes.shape[:2], 1))], axis=-1))


@cache
def cracked(height=24, width=32, observations=6):
    """(domain, normals): a card of waves with noise; the right half lies tilted and cut off from the left one."""
    y, x = np.mgrid[:height, :width]
    slopes = np.stack([0.3 * np.sin(x / 5 + y / 9), 0.3 * np.sin(x / 5 + y / 9) * 5 / 9], axis=-1)
    slopes += np.where(x[..., None] >= width // 2, (0.2, -0.5), (-0.2, 0.3))
    domain = make_domain(height, width, observations, holes=False)
    grid = np.stack([x, y, 0 * x], axis=-1).astype(np.float32)
    domain = replace(domain, bake=replace(domain.bake, position=grid))
    truth = {"base_color": np.full((height, width, 3), 0.6, np.float32), "normal": np.float32(normals_of(slopes))}
    return noisy(with_radiance(domain, "lambert", truth), 0.02), truth["normal"].astype(np.float64)


def degrees(found, normal):
    return np.degrees(np.arccos(np.clip((found * normal).sum(axis=-1), -1, 1)))


@pytest.mark.parametrize("entry", ["fragment", "compute"])
@pytest.mark.parametrize("weight", [0.3, 3.0])
def test_the_relaxed_slopes_solve_the_convex_problem(bench, weight, entry):
    domain = make_domain(9, 11, 6, holes=True)
    rng, shape = np.random.default_rng(3), domain.shape
    made = bench(LAMBERT, domain, subject(9, 11)[1], ON.replaced(surface_weight=weight, surface_rounds=16), entry)
    made.run(2)
    begins = made.read("covariance")[..., 3] > 0
    covered = domain.solvable
    solved = covered[:-1, :-1] & covered[1:, :-1] & covered[:-1, 1:] & covered[1:, 1:]
    np.testing.assert_array_equal(begins, np.pad(solved, ((0, 1), (0, 1))))
    root = rng.normal(size=(*shape, 2, 2)) * 10 ** rng.uniform(-1.5, -0.5, (*shape, 1, 1)) + 0.02 * np.eye(2)
    covariance = root @ np.swapaxes(root, -1, -2)
    slopes = 0.2 * rng.normal(size=(*shape, 2))
    made.put("field", np.concatenate([slopes, np.zeros_like(slopes)], axis=-1))
    made.put("covariance", np.stack([*covariance.reshape(*shape, 4)[..., [0, 1, 3]].transpose(2, 0, 1), begins], -1))
    made.run()
    multiplier = made.read("field")[..., 2][begins]
    pull = np.einsum("lhwi,l->hwi", oracle.circulation(begins), multiplier)
    found = slopes - np.einsum("hwij,hwj->hwi", covariance, pull)
    wanted = oracle.relaxed(slopes, covariance, begins, weight)
    moved = np.abs(wanted - slopes)[covered]
    assert np.median(moved) > 0.005
    np.testing.assert_allclose(found[covered], wanted[covered], atol=0.02 * np.median(moved))


@pytest.mark.parametrize("kind", ["card", "perspective", "mesh"])
def test_slopes_and_their_covariance_are_those_of_float64(bench, kind):
    mesh = kind == "mesh"
    domain = make_domain(7, 8, 12, card=not mesh, holes=mesh)
    lean = np.zeros((*domain.shape, 2))
    if kind == "perspective":
        place = np.array((0.4, -0.3, 3.0))
        domain = replace(domain, views=np.tile(np.float32([*place, 1]), (12, 1)))
        way = place - domain.bake.position
        lean = way[..., :2] / way[..., 2:]
    _, truth = subject(7, 8, TWO_LOBES.name)
    domain = noisy(with_radiance(domain, TWO_LOBES.name, truth), 0.01)
    made = bench(TWO_LOBES, domain, truth, ON.replaced(loss="l2", shadow=0.0))
    made.run(2)
    values = {name: v.astype(np.float64) for name, v in truth.items()}
    grid = oracle.grid_of(domain)
    inside = domain.solvable & (np.abs(np.linalg.det(grid)) > 0)
    field, covariance, noise = (made.read(name)[inside] for name in ("field", "covariance", "noise"))
    np.testing.assert_allclose(field[:, :2], oracle.slopes_of(values["normal"], grid, lean)[inside], atol=1e-5)
    variance = made.read("noise")[..., 2]
    assert (variance[inside] > 0).all() and noise.shape[0] > 30
    wanted = oracle.covariance_of(domain, TWO_LOBES, values, np.where(inside, variance, 1), grid, lean)[inside]
    scale = np.trace(wanted, axis1=-2, axis2=-1)[:, None]
    wanted = wanted.reshape(-1, 4)[:, [0, 1, 3]]
    off = np.abs(covariance[:, :3] - wanted).max(axis=-1) / scale[:, 0]
    assert np.median(off) < 0.005 and np.quantile(off, 0.9) < 0.05


def test_normals_follow_their_slopes_and_albedo_follows_the_normals(bench):
    domain, normal = cracked()
    normal = unit(normal + 0.01 * np.random.default_rng(6).normal(size=normal.shape))
    schedule = LOOPS.replaced(loss="l2", shadow=0.0)
    made = bench(LAMBERT, domain, {"normal": normal, "base_color": _albedo(domain, normal)}, schedule)
    made.run()
    field, covariance, begins = made.read("field"), made.read("covariance"), made.read("covariance")[..., 3] > 0
    pull = np.einsum("lhwi,l->hwi", oracle.circulation(begins), field[..., 2][begins])
    by = np.stack([(covariance[..., i : i + 2] * pull).sum(axis=-1) for i in (0, 1)], axis=-1)
    assert (np.einsum("hwi,hwi->hw", by, pull) < 9).all()  # no move is cut off
    found = made.found()
    np.testing.assert_allclose(found["normal"], normals_of(field[..., :2] - by), atol=2e-6)
    before, after = (_albedo(domain, n) for n in (normal, found["normal"]))
    moved = np.abs(after - before)
    assert np.median(moved) > 2e-5
    assert np.median(np.abs(found["base_color"] - after)) < 0.1 * np.median(moved)


@pytest.mark.parametrize("entry", ["fragment", "compute"])
@pytest.mark.parametrize("smoothness", [1.0, 0.3])
def test_slopes_move_to_the_plane_of_their_neighbours_as_far_as_noise_explains(bench, smoothness, entry):
    domain = make_domain(9, 11, 6, holes=True)
    y, x = np.mgrid[: domain.shape[0], : domain.shape[1]]
    step = np.array([0.3, 0.08])  # of a texel, longer than wide
    position = np.stack([step[0] * x, step[1] * y, 0 * x], axis=-1).astype(np.float32)
    domain = replace(domain, bake=replace(domain.bake, position=position))
    rng, shape, grid = np.random.default_rng(5), domain.shape, oracle.grid_of(domain)
    # Loops that bind nothing, and a fit that may become as bad as it will: the slopes alone decide.
    schedule = ON.replaced(surface_smoothness=smoothness, surface_tolerance=1e4)
    made = bench(LAMBERT, domain, subject(9, 11)[1], schedule, entry)
    made.run()
    root = 0.04 * (rng.normal(size=(*shape, 2, 2)) * rng.uniform(0.3, 1.5, (*shape, 1, 1)) + 0.3 * np.eye(2))
    covariance = root @ np.swapaxes(root, -1, -2)
    covariance[np.linalg.det(grid) == 0] = 0  # holes on both sides: no slope
    covariance[6, 8:10] *= 1e-8  # two neighbours that know it all leave nothing to learn t² from
    # Left a plane with noise, right a relief that no plane follows, between them a step.
    slopes = np.stack([0.03 * x, -0.02 * y], axis=-1) + np.einsum("hwij,hwj->hwi", root, rng.normal(size=(*shape, 2)))
    slopes += np.where(x[..., None] > 5, 0.15 * rng.normal(size=(*shape, 2)) + 0.6, 0.0)
    slopes, covariance = slopes * step, covariance * np.outer(step, step)
    made.put("field", np.concatenate([slopes, np.zeros_like(slopes)], axis=-1))
    made.put("covariance", np.stack([*covariance.reshape(*shape, 4)[..., [0, 1, 3]].transpose(2, 0, 1), 0 * x], -1))
    wanted = oracle.smoothed(slopes, smoothness * covariance, grid, domain.solvable)
    inside = domain.solvable & (covariance[..., 0, 0] > 0)
    moved = np.linalg.norm((wanted - slopes) / step, axis=-1)
    assert np.median(moved[inside & (x < 5)]) > 0.005
    np.testing.assert_allclose(made.found()["normal"][inside], normals_of(wanted / step)[inside], atol=2e-5)


def _albedo(domain, normal):
    """(H, W, 3) float64: least squares of a Lambertian albedo."""
    shade = np.maximum(np.einsum("ki,hwi->khw", domain.lights[:, :3].astype(np.float64), normal), 0)[..., None]
    weight, radiance = domain.stack.values[..., 3:], domain.stack.values[..., :3]
    return (weight * shade * radiance).sum(axis=0) / (weight * shade**2).sum(axis=0)


def test_normals_improve_and_a_crack_stays(recover):
    domain, normal = cracked()
    angles = []
    for schedule in (OFF, ON):
        run = recover(domain, LAMBERT, schedule)
        run.step()
        angles.append(degrees(run.maps(confidence=False).values["normal"].astype(np.float64), normal))
    before, after = angles
    assert after.mean() < 0.9 * before.mean()
    middle = domain.shape[1] // 2
    crack = slice(middle - 1, middle + 1)
    assert after[:, crack].mean() < 1.02 * before[:, crack].mean()


def test_the_exposure_of_the_photographs_does_not_matter(recover):
    domain, _ = cracked()
    found = []
    for factor in (1.0, 2.0**-20):
        dimmed = with_samples(domain, domain.stack.values * np.float32([factor, factor, factor, 1]))
        run = recover(replace(dimmed, intensities=domain.intensities * np.float32(factor)), LAMBERT, ON)
        run.step()
        found.append(run.maps(confidence=False).values["normal"])
    np.testing.assert_allclose(found[0], found[1], atol=1e-5)


def test_a_texel_keeps_its_estimate_if_its_samples_contradict_its_neighbours(bench):
    domain, normal = cracked()
    values = {"normal": normal.copy(), "base_color": _albedo(domain, normal)}
    made = bench(LAMBERT, domain, values)
    made.run(2)
    covariance, field = made.read("covariance"), made.read("field")
    covariance[5, 5, :3] = (4.0, 0.0, 4.0)  # told to know nothing, while its samples are as good as all
    field[4:7, 4:7, :2] += np.random.default_rng(2).normal(size=(3, 3, 2))
    made.put("covariance", covariance)
    made.put("field", field)
    made.run()
    np.testing.assert_array_equal(made.found()["normal"][5, 5], np.float32(normal[5, 5]))


def test_loops_do_not_cross_uv_seams(bench):
    domain = make_domain(8, 12, 6, card=False, holes=False)
    columns = np.broadcast_to(np.arange(12), domain.shape)
    island = np.where(columns < 5, 0, 1)
    chart = np.where((columns >= 7) & (columns < 9), -2, island)  # a part of island 1, beside a gap
    none = (np.zeros((0, 2), np.int32), np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2), np.float32))
    ghosts = (np.zeros((0, 2), np.int32), np.zeros((0, 3), np.float32), np.zeros((0, 4), np.float32))
    domain = replace(domain, seams=SeamMap(island, chart, *none, 2, NO_EDGES, *ghosts))
    made = bench(LAMBERT, domain, subject(8, 12)[1])
    made.run(2)
    begins = np.zeros(domain.shape, bool)
    begins[:-1, :-1] = island[:-1, :-1] == island[:-1, 1:]
    np.testing.assert_array_equal(made.read("covariance")[..., 3] > 0, begins)


def test_without_rounds_or_with_fixed_normals_nothing_changes(recover):
    domain, _ = cracked(12, 16)
    runs = [recover(domain, LAMBERT, schedule) for schedule in (OFF, OFF.replaced(surface_weight=3.0))]
    bits = []
    for run in runs:
        run.step()
        bits.append(bits_of(run.maps(confidence=False)))
    assert bits[0] == bits[1]
    assert resolve(ON, LAMBERT, set())[-1].title == "surface"
    assert resolve(ON, LAMBERT, {"normal"})[-1].title != "surface"
    assert "surface" not in {stage.title for stage in resolve(OFF, LAMBERT, set())}


@pytest.fixture(scope="module")
def whole():
    domain, _ = cracked()
    with Recovery(domain, LAMBERT, ON, 1, entry="fragment") as run:
        total = run.step().iterations_in_all
        return domain, bits_of(run.maps()), total


@pytest.mark.parametrize("resident", [True, False])
def test_tiles_find_the_same_maps(whole, resident):
    domain, wanted, _ = whole
    boxes = [(0, 0, 9, 24), (9, 0, 23, 11), (9, 11, 23, 13)]
    options = {"boxes": boxes, "halo": 10, "on_device": None if resident else 1}
    with TiledRecovery(domain, LAMBERT, ON, 1, entry="fragment", **options) as run:
        run.step()
        assert bits_of(run.maps()) == wanted


@pytest.mark.parametrize("left", [1, 2, 3])
def test_a_run_continues_from_a_checkpoint_with_the_same_maps(whole, recover, left):
    domain, wanted, total = whole
    first, second = (recover(domain, LAMBERT, ON) for _ in range(2))
    first.step(iterations=total - left)
    assert first.progress.title == "surface"
    second.restore(first.state())
    second.step()
    assert bits_of(second.maps()) == wanted


def test_slices_of_time_change_nothing(whole, recover):
    domain, wanted, _ = whole
    run = recover(domain, LAMBERT, ON)
    while not run.step(time_budget_s=1e-6).done:
        run.maps(confidence=False)
    assert bits_of(run.maps()) == wanted


def test_no_number_leaves_its_range_and_nothing_is_not_a_number(recover):
    domain = make_domain(11, 12, 9, card=False, near=True, perspective=True, colored=True)
    model = load_model("metallic_roughness")
    run = recover(domain, model, ON.replaced(iterations=3))
    run.step()
    maps = run.maps(confidence=False)
    for p in model.parameters:
        value = maps.values[p.name][maps.solved]
        assert np.isfinite(value).all()
        assert (value >= p.range[0]).all() and (value <= p.range[1]).all()


def test_a_surface_reads_and_renders_as_planned(bench):
    domain, _ = cracked(12, 16)
    cost = recovery_cost(TWO_LOBES, ON, (), 6).phases[-1]
    made, radii, renders = bench(TWO_LOBES, domain, subject(12, 16, TWO_LOBES.name)[1]), [], 0
    while not made.phase.done:
        radii.append(made.phase.stencil_radius)
        renders += made.phase.evaluations
        made.run(made.phase.iteration + 1)
    assert (max(radii), sum(radius > 0 for radius in radii), renders) == (
        cost.stencil_radius,
        cost.exchanges,
        cost.evaluations,
    )


@pytest.mark.parametrize("setting, value", [("rounds", -1), ("rounds", 1.5), ("weight", 0.0), ("tolerance", 0.0)])
def test_settings_that_make_no_sense_are_refused_by_name(setting, value):
    with pytest.raises(InputError, match=f"surface_{setting}"):
        load_schedule("standard").replaced(**{f"surface_{setting}": value})
