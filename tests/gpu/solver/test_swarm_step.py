"""One step of the swarm on the GPU against the float64 oracle, and the two entries against each other."""

import dataclasses
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from irpso_addon.gpu import context
from irpso_addon.gpu.bands import Bands
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.phases.phase import PhaseContext
from irpso_addon.solver.phases.sequential_swarm import SequentialSwarmPhase
from irpso_addon.solver.settings.resolve import particle_count, resolve
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state.packing import Packing
from irpso_addon.solver.state.textures import DomainTextures, Estimates
from tests.builders.domains import make_domain, makers, pack_layers, unit, with_radiance
from tests.builders.synchronous_swarm import particle_arrays, random_material
from tests.oracles import random_numbers as numbers
from tests.oracles import swarm as oracle

# Places are in [0, 1] and speeds below 1, in float32: a handful of roundings of 2⁻²⁴.
PLACE_TOLERANCE = 1e-6
# A normal turned into another frame goes through square roots that lose digits near the corners of its square.
TURNED_TOLERANCE = 5e-5


@dataclass(frozen=True)
class Case:
    """A stage to compare: which model and parameters, what domain, which settings."""

    name: str
    search: tuple[str, ...]
    shape: tuple[int, int] = (13, 17)
    model: str = "lambert"
    domain: dict = field(default_factory=dict)
    settings: dict = field(default_factory=dict)
    iterations: int = 3

    def __str__(self) -> str:
        return self.name


MESH = {"card": False}
LENS = {"perspective": True, "near": True, "colored": True}
CASES = [
    Case("albedo-l1-clamp-H3", ("diffuse",), settings={"loss": "l1", "walls": "clamp", "c3": 0.1}),
    Case("albedo-l2-stop-H1", ("diffuse",), settings={"loss": "l2", "walls": "stop", "neighbourhood": 1, "c3": 0.3}),
    Case("albedo-robust-reflect-H5-as-printed", ("diffuse",),
         settings={"loss": "cauchy", "walls": "reflect", "neighbourhood": 5, "c3": 0.3, "inertia": 1.0, "v_max": 1.0}),
    Case("albedo-on-a-mesh-under-near-coloured-lights", ("diffuse",), domain=MESH | LENS, settings={"loss": "l2"}),
    Case("cartesian-normal-on-a-card-H9", ("normal",),
         settings={"normal": "cartesian", "neighbourhood": 9, "c3": 0.1, "loss": "l1"}),
    Case("cartesian-normal-on-a-mesh-H3", ("normal",), domain=MESH,
         settings={"normal": "cartesian", "walls": "reflect", "c3": 0.3, "loss": "l1"}),
    Case("hemisphere-on-a-card-H3", ("normal",), domain={"colored": True}, settings={"c3": 0.1}),
    Case("hemisphere-on-a-mesh-H5-near-perspective", ("normal",), domain=MESH | LENS,
         settings={"neighbourhood": 5, "c3": 0.3}),
    Case("five-dimensions-on-a-mesh-H9", ("diffuse", "normal"), domain=MESH | {"perspective": True},
         settings={"neighbourhood": 9, "c3": 0.3, "loss": "l1", "walls": "clamp"}),
    Case("five-dimensions-on-a-card-constriction", ("diffuse", "normal"), shape=(17, 13), domain=LENS,
         settings={"constriction": 0.7298, "inertia": 1.0, "c1": 2.05, "c2": 2.05, "v_max": 1.0}),
    Case("six-dimensions-odd-m", ("diffuse", "normal"), shape=(7, 11),
         settings={"normal": "cartesian", "particles": 5, "particles_per_dimension": 0.0, "c3": 0.1}),
    Case("one-row", ("normal",), shape=(1, 7), domain=MESH, settings={"neighbourhood": 5, "c3": 0.3}),
    Case("one-column", ("diffuse", "normal"), shape=(7, 1), domain=MESH, settings={"c3": 0.3}),
    Case("one-texel-one-particle", ("diffuse",), shape=(1, 1), domain={"holes": False},
         settings={"particles": 1, "particles_per_dimension": 0.0}),
    Case("two-lobes", ("specular",), model="cook_torrance_two_lobe", domain={"observations": 12},
         settings={"c3": 0.1}),
    Case("two-lobes-l1-on-a-mesh", ("specular",), model="cook_torrance_two_lobe", domain=MESH | LENS,
         settings={"loss": "l1", "walls": "reflect"}),
    Case("eight-dimensions", ("all",), model="cook_torrance_two_lobe", domain=MESH | {"observations": 12},
         settings={"neighbourhood": 5, "c3": 0.3}),
    Case("neighbours-bests-on-a-mesh", ("normal",), domain=MESH, settings={"neighbour_interval": 1, "c3": 0.0}),
    Case("neighbours-bests-every-second-time", ("all",), model="cook_torrance_two_lobe",
         settings={"neighbour_interval": 2, "walls": "clamp"}),
    Case("cartesian-neighbours-bests-on-a-mesh", ("diffuse", "normal"), domain=MESH,
         settings={"normal": "cartesian", "neighbour_interval": 1}),
    Case("the-whole-range-of-albedo", ("diffuse",), settings={"linear_limit": 0.0, "loss": "l1"}),
    Case("bounded-albedo", ("diffuse", "normal"), settings={"linear_limit": 0.7}),
    Case("codes-of-8-bits", ("diffuse", "normal"), domain={"noise": 0.02}),
    Case("a-threshold-stops-swarms", ("diffuse",), settings={"threshold": 0.2, "loss": "l1"}),
]  # fmt: skip


class Bench:
    """A stage on the GPU beside the problem that its oracle solves. Starts from a random state."""

    def __init__(self, case: Case, entry: str = "fragment", seed: int = 7):
        context.ensure()
        self.model = load_model(case.model)
        self.schedule = load_schedule("swarm").replaced(search=case.search, iterations=40, **case.settings)
        noise = case.domain.get("noise", 0.0)
        made = {name: value for name, value in case.domain.items() if name != "noise"}
        self.domain = replace(make_domain(*case.shape, **made), noise=noise)
        rng = np.random.default_rng(seed)
        scale = rng.uniform(0.5, 2, size=case.shape).astype(np.float32)
        estimates = random_material(self.model, case.shape, rng)
        stage = resolve(self.schedule, self.model, set())[0]
        self.packing = pack = Packing(self.domain.solvable)
        self.textures = DomainTextures(self.domain, pack, pack_layers(pack, self.domain.stack.values), pack.pack(scale))
        self.estimates = Estimates(self.model, {name: pack.pack(value) for name, value in estimates.items()})
        shared = PhaseContext(self.model, self.schedule, self.textures, self.estimates, entry)
        self.stage = SequentialSwarmPhase(stage, shared, seed)
        count = particle_count(self.schedule, stage.dimensions(self.schedule.swarm.normal))
        self.problem = oracle.Problem(
            self.domain, self.model, stage, self.schedule, estimates, scale.astype(np.float64), count, seed
        )
        self.bands = Bands()
        self.rng = rng

    def randomise(self) -> None:
        """Give every particle a random place, speed and best, of which about half will be improved upon."""
        problem, rng = self.problem, self.rng
        shape = (problem.particles, *problem.domain.shape)
        x, p = (rng.uniform(0, 1, size=(*shape, problem.columns)) for _ in range(2))
        v = rng.uniform(-0.3, 0.3, size=x.shape)
        x, v = oracle.ordered_lobes(problem, x, v)
        g = rng.uniform(0, 1, size=x.shape[1:])
        typical = oracle.fitness(problem, x[0])
        typical = np.where(typical < 1e29, typical, 1.0)
        self.give(
            oracle.State(x, v, p, typical * rng.uniform(0.5, 1.5, shape), g, typical * rng.uniform(0.2, 1, shape[1:]))
        )

    def give(self, state: oracle.State) -> None:
        """Make ``state`` the state on the GPU."""
        atlas, blocks = self.stage.textures.atlas, self.stage.encoding.blocks
        arrays = particle_arrays(state, self.packing, atlas, blocks)
        g = self.packing.pack(state.g)
        arrays |= {f"global_best_{b}": g[..., 4 * b : 4 * b + 4] for b in range(blocks)}
        self.stage.textures.restore(arrays | {"global_fitness": self.packing.pack(state.g_fitness)[..., None]})

    def read(self) -> oracle.State:
        """Return the state on the GPU; 0 where no texel is solved, and there a fitness of UNFIT."""
        stage, pack = self.stage, self.packing
        arrays = {name: array.astype(np.float64) for name, array in stage.state().items()}
        sizes = (self.problem.particles, pack.height, pack.width)
        atlases = {
            n: numbers.from_atlas(arrays[n], *sizes, self.problem.columns) for n in ("position", "velocity", "best")
        }
        x, v, p = (np.stack([pack.unpack(one) for one in a]) for a in atlases.values())
        fitness = numbers.from_atlas(arrays["fitness"], *sizes, 1)[..., 0]
        g = np.concatenate([arrays[f"global_best_{b}"] for b in range(stage.encoding.blocks)], axis=-1)
        fitness = np.stack([pack.unpack(one, oracle.UNFIT) for one in fitness])
        g_fitness = pack.unpack(arrays["global_fitness"][..., 0], oracle.UNFIT)
        return oracle.State(x, v, p, fitness, pack.unpack(g), g_fitness)

    def advance(self) -> None:
        """Make one iteration."""
        for _ in self.stage.advance(self.bands, 1.0):
            pass

    def close(self) -> None:
        """Free what lies on the GPU."""
        self.stage.close()


@pytest.fixture
def bench():
    """A maker of benches that are closed at the end."""
    yield from makers(Bench)


def assert_equal_states(found: oracle.State, step: oracle.Step, tolerance: np.ndarray, places: float) -> None:
    """Compare all that a swarm remembers; bests only where rounding could not have decided the comparison."""
    clear = step.margin > tolerance
    # Normals placed on the horizon tie: nothing of their render is lit. Ties after a move are chance.
    assert clear.mean() > (0.85 if (step.state.p_fitness >= 1e29).any() else 0.97) or (~clear).sum() <= 1
    wanted = step.state
    np.testing.assert_allclose(found.x, wanted.x, atol=places, rtol=0)
    np.testing.assert_allclose(found.v, wanted.v, atol=places, rtol=0)
    np.testing.assert_allclose(found.p[:, clear], wanted.p[:, clear], atol=places, rtol=0)
    np.testing.assert_allclose(found.g[clear], wanted.g[clear], atol=places, rtol=0)
    for a, b in ((found.p_fitness, wanted.p_fitness), (found.g_fitness, wanted.g_fitness)):
        difference = np.where(b >= 1e29, np.abs(a / 1e30 - 1), np.abs(a - b))
        assert (difference <= np.where(b >= 1e29, 1e-6, tolerance))[..., clear].all(), np.nanmax(difference)


def rounding_of(step: oracle.Step) -> np.ndarray:
    """Return (H, W): what float32 may lose of a fitness: the errors are differences of radiances near 1."""
    return 3e-6 * (1 + np.minimum(step.fitness, 100))


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_swarm_step_matches_the_oracle(case, bench):
    b = bench(case)
    b.stage.iteration = 0
    b.randomise()
    for iteration in range(case.iterations):
        before = b.read()
        b.advance()
        step = oracle.move(b.problem, before, iteration)
        turned = not b.domain.card and "normal" in b.stage.stage.title
        assert_equal_states(b.read(), step, rounding_of(step), TURNED_TOLERANCE if turned else PLACE_TOLERANCE)
        verdict = b.packing.unpack(b.stage.read("verdict"), -1)
        np.testing.assert_array_equal(verdict[..., 3], step.particle)


@pytest.mark.parametrize("case", [CASES[0], CASES[7], CASES[16]], ids=str)
@pytest.mark.parametrize("start", ["random", "lambert"])
def test_particles_are_placed_where_the_oracle_places_them(case, start, bench):
    case = dataclasses.replace(
        case, settings=case.settings | {"start": start, "start_fraction": 0.3, "start_spread": 0.2}
    )
    b = bench(case)
    for index in range(b.problem.particles):
        before = b.read()
        assert b.stage.iteration == index - b.problem.particles
        b.advance()
        step = oracle.place(b.problem, before, index)
        assert_equal_states(b.read(), step, rounding_of(step), PLACE_TOLERANCE)
    placed, _ = oracle.solved_and_covered(b.domain)
    assert (b.read().g_fitness[placed] < 1e29).all()


@pytest.mark.parametrize("case", [CASES[2], CASES[8], CASES[16]], ids=str)
def test_fragment_and_compute_agree_within_four_ulp(case, bench):
    fragment, compute = bench(case, "fragment"), bench(case, "compute")
    for b in (fragment, compute):
        b.stage.iteration = 0
    fragment.randomise()
    for _ in range(case.iterations):
        compute.give(fragment.read())
        fragment.advance()
        compute.advance()
        other = compute.stage.state()
        for name, array in fragment.stage.state().items():
            np.testing.assert_array_max_ulp(array, other[name], maxulp=4)


def test_fragment_and_compute_end_with_equal_error_quantiles():
    rng = np.random.default_rng(3)
    normal = unit(rng.normal(size=(9, 7, 3)) * 0.3 + (0, 0, 1))
    truth = {"base_color": rng.uniform(0.1, 0.9, (9, 7, 3)), "normal": normal}
    domain = with_radiance(make_domain(9, 7, observations=10), "lambert", truth)
    schedule = load_schedule("swarm").replaced(iterations=2000, start="random")
    quantiles = []
    for entry in ("fragment", "compute"):
        with Recovery(domain, load_model("lambert"), schedule, 5, entry=entry) as recovery:
            assert recovery.step().done
            maps = recovery.maps()
        error = np.abs(maps.values["base_color"] - truth["base_color"]).max(axis=-1)[maps.solved]
        quantiles.append(np.quantile(error, (0.5, 0.9, 0.99)))
    # Devices may round the two entries differently, after which the swarms go their own ways: to the same place.
    np.testing.assert_allclose(*quantiles, atol=1e-4)
    assert quantiles[0][1] < 1e-3


def test_an_atlas_is_cut_into_tiles_that_hold_every_particle_once(bench):
    b = bench(dataclasses.replace(CASES[10], shape=(5, 3), domain={"holes": False}))
    atlas = b.stage.textures.atlas
    assert atlas.across * atlas.down >= 2 * b.problem.particles
    marks = np.arange(b.problem.particles * 15 * 8, dtype=np.float64).reshape(-1, 5, 3, 8)
    packed = numbers.to_atlas(marks, atlas.across, atlas.down)
    np.testing.assert_array_equal(numbers.from_atlas(packed, b.problem.particles, 5, 3, 8), marks)
    assert b.stage.read("position").shape == packed.shape
