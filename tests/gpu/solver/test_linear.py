"""Linear weights in closed form: against scipy's bounded least squares, inside the swarm's own kernel."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from irpso_addon.core.errors import InputError
from irpso_addon.core.paths import SHADERS
from irpso_addon.geometry.domain import with_samples
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.kernels.linear_weights import linear_weights
from irpso_addon.solver.settings.resolve import resolve
from irpso_addon.solver.settings.schedule import load_schedule
from tests.builders.domains import make_domain, recoveries, unit
from tests.builders.synchronous_swarm import Case, benches
from tests.oracles import confidence as confidence_oracle
from tests.oracles import synchronous_swarm as oracle
from tests.oracles.swarm import delta_of

PREFIT = str(SHADERS / "prefit" / "base_lobe.toml")
TWO_LOBES = "cook_torrance_two_lobe"
ONE = {"particles": 1, "particles_per_dimension": 0.0, "c3": 0.0, "start": "random"}
SHAPE = (6, 9)
bench = pytest.fixture(benches)
recover = pytest.fixture(recoveries)


@pytest.fixture(scope="module")
def blinn_phong(root, tmp_path_factory):
    """The path of the model that shaders/README.md gives as an example."""
    folder = tmp_path_factory.mktemp("model")
    page = (root / "shaders/README.md").read_text(encoding="utf-8")
    page = page[page.index("## A model of your own") :]
    for kind in ("glsl", "toml"):
        (folder / f"blinn_phong.{kind}").write_text(page.split(f"```{kind}\n")[1].split("```")[0], encoding="utf-8")
    return str(folder / "blinn_phong.toml")


@pytest.fixture
def path_of(blinn_phong):
    """Return what load_model takes for a model's name in these tests."""
    return lambda name: {"blinn_phong": blinn_phong, "base_lobe": PREFIT}.get(name, name)


def scipys(problem, a, right, counted):
    """Return (L,) weights of one texel by lsq_linear: a (K, 3, L), right and counted (K, 3)."""
    root = np.sqrt(counted).ravel()
    rows = a.reshape(-1, a.shape[-1]) * root[:, None]
    low, high = np.array([row[2:] for row in problem.weights]).T
    return lsq_linear(rows, right.ravel() * root, (low, high), method="bvls", tol=1e-14).x


def compared(b):
    """Place one particle a texel; return what was found, scipy's answer (N, L), and how much more the former costs.

    The cost is the weighted root mean square of the error, beside that of the radiance itself.
    """
    b.advance()
    state, problem = b.read(), b.problem
    s = problem.decode(state.x[0])
    counted = oracle.sample_weights(problem, {name: np.float64(v) for name, v in b.values.items()})
    a, right = oracle.system(problem, s)
    clear = b.domain.solvable & ~oracle.on_edge(problem, s["normal"])
    clear &= ~oracle.on_edge(problem, np.float64(b.values["normal"]))
    found, wanted, excess = [], [], []
    for y, x in np.argwhere(clear):
        answer = scipys(problem, a[:, y, x], right[:, y, x], counted[:, y, x])
        costs = [
            np.sqrt((counted[:, y, x] * (a[:, y, x] @ w - right[:, y, x]) ** 2).sum())
            for w in (state.w[y, x], answer, 0 * answer)
        ]
        found.append(state.w[y, x])
        wanted.append(answer)
        excess.append((costs[0] - costs[1]) / costs[2])
    return np.array(found), np.array(wanted), np.array(excess)


@pytest.mark.parametrize("loss", ["l2", "cauchy", "l1"])
@pytest.mark.parametrize(
    ("name", "count"),
    [("lambert", 3), ("principled", 3), ("principled_metallic", 3), (TWO_LOBES, 4), ("principled_two_lobe", 4),
     ("blinn_phong", 4), ("base_lobe", 2)],
)  # fmt: skip
def test_weights_are_those_of_scipys_bounded_least_squares(bench, path_of, name, count, loss):
    options = {"observations": 24, "colored": name != "base_lobe"}
    b = bench(Case(name, shape=SHAPE, model=path_of(name), domain=options, settings=ONE | {"loss": loss}))
    found, wanted, excess = compared(b)
    assert found.shape[0] > 30 and found.shape[1] == count
    # Where bases resemble each other weights trade; what they cost is what matters, and that is met.
    assert excess.max() < 1e-5, excess.max()
    low, high = np.array([row[2:] for row in b.problem.weights]).T
    ends = (wanted <= low + 1e-9) | (wanted >= high - 1e-9)
    assert ends.any() and not ends.all()
    assert (np.abs(found - wanted) < 1e-3 * (1 + wanted)).mean() > 0.95
    assert ((found >= np.float32(low)) & (found <= np.float32(high))).all()


def test_an_unobserved_weight_stays_at_its_minimum(bench, blinn_phong):
    domain = make_domain(*SHAPE, observations=12, holes=False)
    for channel in (0, 2):
        domain.intensities[:, channel] = 0
    b = bench(Case("lit-in-green", shape=SHAPE, model=blinn_phong, settings=ONE | {"loss": "l2"}), domain=domain)
    b.advance()
    w = b.read().w
    assert (w[..., [0, 2]] == 0).all() and (w[..., 1] > 0).mean() > 0.5


@pytest.mark.parametrize("held", ["base_color", "strength"])
def test_an_unsolved_linear_parameter_enters_the_remainder(bench, blinn_phong, held):
    case = Case(f"held-{held}", shape=SHAPE, model=blinn_phong, domain={"observations": 24},
                settings=ONE | {"loss": "l2"}, fixed=frozenset({held}))  # fmt: skip
    b = bench(case)
    found, wanted, excess = compared(b)
    assert [p.name for p in b.stage.stage.solved] == [{"base_color": "strength", "strength": "base_color"}[held]]
    assert excess.max() < 1e-5
    np.testing.assert_allclose(found, wanted, atol=1e-4, rtol=1e-3)


def test_the_weight_of_the_lobes_is_known_and_the_base_is_solved_beside_it(bench):
    case = Case("known-w", shape=SHAPE, model=TWO_LOBES, domain={"observations": 24}, settings=ONE | {"loss": "l2"},
                fixed=frozenset({"w"}))  # fmt: skip
    found, wanted, excess = compared(bench(case))
    assert found.shape[1] == 3 and excess.max() < 1e-5
    np.testing.assert_allclose(found, wanted, atol=1e-4, rtol=1e-3)


def test_more_weights_than_eight_are_refused(tmp_path):
    rows = "".join(f'[[parameter]]\nname = "c{i}"\ncomponents = 3\nkind = "linear"\n\n' for i in range(3))
    (tmp_path / "many.toml").write_text(
        f'title = "Many"\nsource = "none"\n\n[[parameter]]\nname = "normal"\nis_normal = true\n\n{rows}'
    )
    bases = "".join(f"vec3 basis_c{i}(Material s, vec3 l, vec3 v) {{ return vec3(1.0); }}\n" for i in range(3))
    (tmp_path / "many.glsl").write_text(
        bases + "vec3 reflectance(Material s, vec3 l, vec3 v) { return s.c0 + s.c1 + s.c2; }\n"
    )
    model = load_model(tmp_path / "many.toml")
    stage = resolve(load_schedule("standard").replaced(prefit_iterations=0), model, set())[0]
    with pytest.raises(InputError, match=r"9 linear components, at most 8 .*; fix some .*, or search them"):
        linear_weights(model, stage.solved)
    assert linear_weights(model, stage.solved[:2]).components == 6


# ---- reweighting -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["lambert", TWO_LOBES])
def test_reweighting_from_the_best_finds_the_albedo_under_cast_shadow(recover, name):
    model, shape, rng = load_model(name), (9, 8), np.random.default_rng(1)
    truth = {
        "base_color": rng.uniform(0.2, 0.9, (*shape, 3)),
        "normal": unit(rng.normal(size=(*shape, 3)) * 0.25 + (0, 0, 1)),
        "r1": rng.uniform(0.1, 0.2, (*shape, 1)), "r2": rng.uniform(0.4, 0.6, (*shape, 1)),
        "w": rng.uniform(0.3, 0.7, (*shape, 1)),
    }  # fmt: skip
    truth = {p.name: truth[p.name].astype(np.float32) for p in model.parameters}
    domain = make_domain(*shape, observations=60, holes=False)
    render = confidence_oracle.radiance(domain, name, {n: np.float64(v) for n, v in truth.items()})
    stack = domain.stack.values.copy()
    stack[..., :3] = render * (rng.random(stack.shape[:3]) >= 0.15)[..., None]
    stack[..., 3] = 1
    domain = with_samples(domain, stack)
    schedule = load_schedule("standard").replaced(
        update="all", linear="solve", iterations=10, shadow=0.0, refinement_iterations=0, prefit_iterations=0,
        prior_rounds=0, surface_rounds=0, particles=1, particles_per_dimension=0.0, start="random",
    )  # fmt: skip
    fixed = {n: v for n, v in truth.items() if model.parameter(n).kind == "search"}
    recovery = recover(domain, model, schedule, fixed=fixed)
    error = []
    for _ in range(10):
        recovery.step(iterations=1)
        found = recovery.maps(confidence=False).values
        error.append(np.abs(found["base_color"] / truth["base_color"] - 1).max())
    assert recovery.progress.done and error[-1] < 0.01, error
    if name == "lambert":
        # The same in float64, to the end: least squares by the weights of Cauchy's loss.
        scale = np.percentile(stack[..., :3].mean(axis=-1), schedule.fitness.scale_percentile, axis=0)
        basis = render / truth["base_color"]
        albedo = (basis * stack[..., :3]).sum(axis=0) / (basis**2).sum(axis=0)
        for _ in range(100):
            delta = delta_of(stack, scale, schedule.fitness)
            e = (albedo * basis - stack[..., :3]) / delta
            weight = 1 / (1 + e**2) / delta**2
            albedo = (weight * basis * stack[..., :3]).sum(axis=0) / (weight * basis**2).sum(axis=0)
        np.testing.assert_allclose(found["base_color"], albedo, rtol=1e-4)
        assert error[0] > 0.01 > 2 * error[-1], error
