"""Every model on the GPU against float64 and the contract of shaders/README.md."""

import itertools

import numpy as np
import pytest

from irpso_addon.reflectance.model import load_model, shipped_models
from tests.builders.model_probe import evaluate, single
from tests.oracles import reflectance as oracles

EPS = 2.0**-23
UNSEEN = ("ward", "oren_nayar")  # written as a user would, known to nothing but these tests
ALL = (*shipped_models(), *UNSEEN)
# Whose base loses what the layer above it takes, by the view alone.
LAYERED = ("principled", "principled_metallic", "metallic_roughness", "clear_coat", "anisotropic")


@pytest.fixture
def model(request, root):
    """The model of a test's parameter, by name or by the path of a user's own file."""
    name = request.param
    return load_model(root / "tests/gpu/models" / f"{name}.toml" if name in UNSEEN else name)


every_model = pytest.mark.parametrize("model", ALL, indirect=True)


def random_materials(model, count, rng):
    """Uniform over the table's ranges, a third of each parameter at an end of its range."""
    values = {}
    for p in model.parameters:
        if p.is_normal:
            values[p.name] = oracles.unit(rng.normal(size=(count, 3)) * 0.5 + [0, 0, 1])
            continue
        low, high = p.range
        value = rng.uniform(low, high, (count, p.components))
        ends = rng.random((count, p.components))
        value = np.where(ends < 1 / 6, low, np.where(ends > 5 / 6, high, value))
        values[p.name] = value if p.components > 1 else value[:, 0]
    return {name: single(value) for name, value in values.items()}


def random_directions(normal, count, rng):
    """Lights and views: everywhere, at the normal's horizon, and around each other's mirror direction."""
    light, view = (oracles.unit(rng.normal(size=(count, 3)) + 0.8 * normal) for _ in range(2))
    grazing = slice(0, count // 4)
    for direction in (light, view):
        height = 10.0 ** rng.uniform(-6, -1, count // 4)
        off = oracles.dot(direction, normal)[grazing] - height * rng.choice([1, 1, 1, -1], count // 4)
        direction[grazing] -= off[:, None] * normal[grazing]
    shiny = slice(count // 4, 3 * count // 4)
    mirror = 2 * oracles.dot(normal, light)[:, None] * normal - light
    view[shiny] = (mirror + 10.0 ** rng.uniform(-6, -0.5, (count, 1)) * rng.normal(size=(count, 3)))[shiny]
    return single(oracles.unit(light)), single(oracles.unit(view))


def forgiven(oracle, values, light, view, rng):
    """How far the radiance moves when every input moves by a float32 rounding: the best a float32 shader can do."""
    here, moved = oracle(values, light, view), 0.0
    for _ in range(12):

        def shake(a):
            return a + rng.uniform(-1, 1, np.shape(a)) * EPS * np.maximum(np.abs(a), 0.5 if np.ndim(a) > 1 else 0)

        shaken = {name: shake(a) for name, a in values.items()}
        moved = np.maximum(moved, np.abs(oracle(shaken, shake(light), shake(view)) - here))
    return here, moved


@every_model
def test_reflectance_is_the_oracles_to_float32_rounding(model, root):
    rng = np.random.default_rng(11)
    values = random_materials(model, 6000, rng)
    light, view = random_directions(values["normal"], 6000, rng)
    expected, moved = forgiven(oracles.MODELS[model.name], values, light, view, rng)
    got = evaluate(root, model, values, light, view)
    assert np.isfinite(got).all()
    # Where rounding decides whether a direction is above the horizon, either answer is right.
    cosines = np.minimum(oracles.dot(values["normal"], light), oracles.dot(values["normal"], view))
    decided = np.abs(cosines) > 4e-7
    assert decided.mean() > 0.9 and (expected > 0).mean() > 0.3
    excess = np.abs(got - expected) - (1e-5 * np.abs(expected) + 4 * moved + 1e-30)
    worst = np.argmax(np.where(decided[:, None], excess, -1).max(axis=1))
    assert excess[worst].max() <= 0, f"{got[worst]} instead of {expected[worst]}, moved {moved[worst]}"


@every_model
def test_most_values_agree_to_a_few_parts_in_a_million(model, root):
    rng = np.random.default_rng(12)
    values = random_materials(model, 4000, rng)
    light, view = (single(oracles.unit(rng.normal(size=(4000, 3)) + 2 * values["normal"])) for _ in range(2))
    expected = oracles.MODELS[model.name](values, light, view)
    seen = (expected > 1e-6).all(axis=1)
    error = np.abs(evaluate(root, model, values, light, view)[seen] / expected[seen] - 1)
    assert seen.mean() > 0.5
    assert np.median(error) < 1e-6
    # A metal has nothing beside its lobe, of which rounded directions take digits where it is narrow.
    # Across the grain a lobe is up to three times as narrow as its roughness.
    bound = 1e-4 if model.name == "anisotropic" else 6e-5
    assert np.quantile(error, 0.99) < (bound if "metallic" in values else 2e-5)


@every_model
def test_reflectance_is_the_weighted_sum_of_its_basis(model, root):
    rng = np.random.default_rng(13)
    values = random_materials(model, 500, rng)
    light, view = random_directions(values["normal"], 500, rng)
    linear = [p.name for p in model.parameters if p.kind == "linear"]
    total = terms = np.zeros((500, 3))
    if "basis_fixed" in model.shader.read_text(encoding="utf-8"):
        total = evaluate(root, model, values, light, view, "basis_fixed(s, l, v)")
        terms = np.abs(total)
    other = dict(values)
    for name in linear:
        other[name] = single(np.random.default_rng(1).uniform(0, 0.5, np.shape(values[name])))
    for name in linear:
        basis = evaluate(root, model, values, light, view, f"basis_{name}(s, l, v)")
        assert np.array_equal(basis, evaluate(root, model, other, light, view, f"basis_{name}(s, l, v)"))
        total = total + np.reshape(values[name], (500, -1)) * basis
        terms = terms + np.abs(np.reshape(values[name], (500, -1)) * basis)
    got = evaluate(root, model, values, light, view)
    # Of the terms, not of their sum: where one takes from another, as a weight between two lobes does, digits go too.
    assert (np.abs(got - total) <= 1e-6 * terms + 1e-30).all()


@every_model
def test_a_light_or_a_view_below_the_horizon_gives_nothing(model, root):
    rng = np.random.default_rng(14)
    values = random_materials(model, 400, rng)
    up, down = (single(oracles.unit(sign * values["normal"] + 0.4 * rng.normal(size=(400, 3)))) for sign in (1, -1))
    keep = (oracles.dot(values["normal"], up) > 0) & (oracles.dot(values["normal"], down) < 0)
    for light, view in ((up, down), (down, up), (down, down), (up, -up)):
        assert not evaluate(root, model, values, light, view)[keep].any()
        assert not evaluate(root, model, values, light, view, "basis_base_color(s, l, v)")[keep].any()


@every_model
def test_radiance_is_finite_for_every_corner_of_the_table_and_every_axis(model, root):
    corners = list(itertools.product(*[(p.range if not p.is_normal else (0, 1)) for p in model.parameters]))
    axes = [np.array(a, float) for a in itertools.product((-1, 0, 1), repeat=3) if any(a)]
    axes += [np.array([1.0, 0, h]) for h in (1e-30, 1e-9, 1e-7, 2e-7, 1e-4)] + [np.array([-1.0, 0, 2e-7])]
    pairs = np.array(list(itertools.product(oracles.unit(axes), repeat=2)))
    light, view = (np.tile(pairs[:, i], (len(corners), 1)) for i in range(2))
    values = {}
    for i, p in enumerate(model.parameters):
        column = np.repeat([c[i] for c in corners], len(pairs))
        values[p.name] = np.repeat(column[:, None], 3, axis=1) if p.components == 3 else column
    values["normal"] = np.tile([0.0, 0.0, 1.0], (len(light), 1))
    got = evaluate(root, model, *cut(values, light, view))
    assert np.isfinite(got).all() and (got >= 0).all()


def cut(values, light, view, most=8000):
    """An even choice of at most ``most`` rows: a texture is no wider than 16384."""
    step = -(-len(light) // most)
    return {n: v[::step] for n, v in values.items()}, light[::step], view[::step]


@pytest.mark.parametrize("model", [n for n in ALL if n not in LAYERED], indirect=True)
def test_exchanging_light_and_view_leaves_the_brdf(model, root):
    rng = np.random.default_rng(15)
    assert_reciprocal(root, model, random_materials(model, 1000, rng), rng)


@pytest.mark.parametrize("model", LAYERED, indirect=True)
def test_without_their_base_layered_models_are_reciprocal(model, root):
    rng = np.random.default_rng(16)
    values = random_materials(model, 500, rng)
    values["base_color"] = np.zeros((500, 3))
    if "coat_weight" in values:  # the coat takes from the base's lobe by the view alone
        values["coat_weight"] = np.zeros(500)
    assert_reciprocal(root, model, values, rng)


def assert_reciprocal(root, model, values, rng):
    """Light and view may be exchanged, for all materials ``values``."""
    n = values["normal"]
    light, view = (single(oracles.unit(rng.normal(size=n.shape) + 2 * n)) for _ in range(2))
    cos_light, cos_view = oracles.dot(n, light), oracles.dot(n, view)
    keep = (cos_light > 0.05) & (cos_view > 0.05)
    there = evaluate(root, model, values, light, view)[keep] / cos_light[keep, None]
    back = evaluate(root, model, values, view, light)[keep] / cos_view[keep, None]
    assert np.allclose(there, back, rtol=2e-5, atol=1e-30)


@pytest.mark.parametrize(
    ("model", "settings"),
    [("lambert", {}), ("principled", {"roughness": 0.2}), ("principled", {"roughness": 1.0}),
     ("principled", {"roughness": 0.5, "specular": 1.0}), ("oren_nayar", {"sigma": 1.0}),
     ("clear_coat", {"roughness": 0.8, "coat_weight": 1.0, "coat_roughness": 0.2}),
     ("clear_coat", {"roughness": 0.8, "coat_weight": 1.0, "coat_roughness": 0.6}),
     ("anisotropic", {"roughness": 0.5, "stretch": 0.5, "slant": 0.5})],
    indirect=["model"],
)  # fmt: skip
def test_a_white_surface_reflects_no_more_than_it_receives(model, settings, root):
    for cos_view in (1.0, 0.7, 0.3, 0.1):
        albedo = directional_albedo(root, model, {"base_color": (1, 1, 1), **settings}, cos_view)
        assert albedo <= 1.006, cos_view  # the fit of the layer's albedo is good to 0.005
        assert albedo > 0.5


@pytest.mark.parametrize("model", ["cook_torrance_two_lobe", "principled_two_lobe"], indirect=True)
def test_the_lobes_alone_reflect_less_than_a_mirror_of_skin(model, root):
    for cos_view, mirror in ((1.0, 0.0281), (0.5, 0.06), (0.2, 0.35)):
        for low in model.parameter("r1").range:
            albedo = directional_albedo(root, model, {"base_color": (0, 0, 0), "r1": low, "w": 1.0}, cos_view)
            assert 0 < albedo < mirror


def directional_albedo(root, model, settings, cos_view, steps=(90, 90)):
    """∫ f_r n·l dω of a material seen at ``cos_view``, over an even grid of u = sin²θ and φ."""
    nodes, weights = np.polynomial.legendre.leggauss(steps[0])
    u, phi = (nodes + 1) / 2, (np.arange(steps[1]) + 0.5) / steps[1] * 2 * np.pi
    u, phi = (a.ravel() for a in np.meshgrid(u, phi, indexing="ij"))
    light = np.stack([np.sqrt(u) * np.cos(phi), np.sqrt(u) * np.sin(phi), np.sqrt(1 - u)], axis=-1)
    view = np.tile([np.sqrt(1 - cos_view**2), 0, cos_view], (len(light), 1))
    values = {p.name: np.tile(settings.get(p.name, p.default), (len(light), 1)) for p in model.parameters}
    radiance = evaluate(root, model, values, light, view)[:, 0]
    # dω n·l = du dφ / 2, and the radiance is π f_r n·l.
    return np.sum(radiance / light[:, 2] * np.repeat(weights / 2, steps[1]) / steps[1])


@pytest.mark.parametrize("model", ["anisotropic"], indirect=True)
def test_without_a_grain_a_brushed_surface_is_principled_metallic(model, root):
    rng = np.random.default_rng(20)
    values = random_materials(model, 2000, rng)
    values |= {"stretch": np.zeros(2000), "slant": np.zeros(2000)}
    light, view = (single(oracles.unit(rng.normal(size=(2000, 3)) + values["normal"])) for _ in range(2))
    plain = evaluate(root, load_model("principled_metallic"), values, light, view)
    difference = np.abs(evaluate(root, model, values, light, view) - plain)
    assert np.quantile(difference / (plain + 1e-6), 0.99) < 6e-5


@pytest.mark.parametrize("model", ["anisotropic"], indirect=True)
def test_turning_the_grain_with_light_and_view_changes_nothing(model, root):
    rng = np.random.default_rng(21)
    values = random_materials(model, 1000, rng)
    values["normal"] = np.tile([0.0, 0.0, 1.0], (1000, 1))
    strength, angle, turn = rng.uniform(0.05, 1, 1000), *(rng.uniform(0, 2 * np.pi, 1000) for _ in range(2))
    light, view = (oracles.unit(rng.normal(size=(1000, 3)) + [0, 0, 2]) for _ in range(2))
    values |= {"roughness": rng.uniform(0.3, 1, 1000)}

    def turned(d, by):
        x, y = np.cos(by) * d[:, 0] - np.sin(by) * d[:, 1], np.sin(by) * d[:, 0] + np.cos(by) * d[:, 1]
        return np.stack([x, y, d[:, 2]], axis=-1)

    one, other = (
        evaluate(root, model, {**values, "stretch": strength * np.cos(2 * at), "slant": strength * np.sin(2 * at)},
                 turned(light, at), turned(view, at))
        for at in (angle, angle + turn)
    )  # fmt: skip
    assert np.allclose(one, other, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("model", ["cook_torrance_two_lobe", "principled_two_lobe"], indirect=True)
def test_exchanging_the_lobes_with_their_weights_changes_nothing(model, root):
    rng = np.random.default_rng(17)
    values = random_materials(model, 500, rng)
    light, view = random_directions(values["normal"], 500, rng)
    values["w"] = np.round(values["w"] * 1024) / 1024  # 1 − w has no rounding
    exchanged = {**values, "r1": values["r2"], "r2": values["r1"], "w": 1 - values["w"]}
    one, other = (evaluate(root, model, v, light, view) for v in (values, exchanged))
    assert model.ordered == ("r1", "r2") and model.complement == ("w",)
    assert np.allclose(one, other, rtol=1e-6, atol=1e-30)


@every_model
def test_compute_and_fragment_entries_agree(model, root):
    rng = np.random.default_rng(18)
    values = random_materials(model, 300, rng)
    light, view = random_directions(values["normal"], 300, rng)
    fragment, compute = (evaluate(root, model, values, light, view, entry=e) for e in ("fragment", "compute"))
    assert np.allclose(fragment, compute, rtol=4 * EPS, atol=1e-30)


def test_the_example_of_the_readme_keeps_the_contract(root, tmp_path):
    page = (root / "shaders/README.md").read_text(encoding="utf-8")
    page = page[page.index("## A model of your own") :]
    for kind in ("glsl", "toml"):
        text = page.split(f"```{kind}\n")[1].split("```")[0]
        (tmp_path / f"blinn_phong.{kind}").write_text(text, encoding="utf-8")
    model, rng = load_model(tmp_path / "blinn_phong.toml"), np.random.default_rng(19)
    values = random_materials(model, 3000, rng)
    light, view = random_directions(values["normal"], 3000, rng)
    expected, moved = forgiven(oracles.blinn_phong, values, light, view, rng)
    got = evaluate(root, model, values, light, view)
    cosines = np.minimum(oracles.dot(values["normal"], light), oracles.dot(values["normal"], view))
    # pow() may be off by 2e-6 of its exponent's worth, and the exponent goes up to 798.
    close = np.abs(got - expected) <= 2e-3 * expected + 4 * moved + 1e-30
    assert np.isfinite(got).all() and close[np.abs(cosines) > 4e-7].all()
    names = ("base_color", "strength")
    diffuse, gloss = (evaluate(root, model, values, light, view, f"basis_{name}(s, l, v)") for name in names)
    assert np.allclose(got, values["base_color"] * diffuse + values["strength"][:, None] * gloss, rtol=1e-6)


def test_the_specular_level_is_not_a_linear_weight():
    # The mean of level 0 and 1 is off from level 0.5 by up to 19 % of a grey surface's radiance, 2 % in the mean.
    normal, light = np.array([0, 0, 1.0]), oracles.unit([0.5, 0, 0.8])
    views = oracles.unit([[np.sin(a), 0, np.cos(a)] for a in np.radians(np.linspace(-80, 80, 81))])
    p = {"normal": normal, "base_color": np.full(3, 0.3), "roughness": 0.3}
    none, half, full = (oracles.principled({**p, "specular": level}, light, views)[:, 0] for level in (0.0, 0.5, 1.0))
    assert 0.15 < np.max(np.abs((none + full) / 2 / half - 1)) < 0.2
