"""Standard deviations of the maps against float64, against noise that is really added, and where nothing is known."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from irpso_addon.geometry.domain import with_samples
from irpso_addon.gpu import context
from irpso_addon.gpu.bands import Bands
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.confidence import Confidence
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state.packing import Packing
from irpso_addon.solver.state.separation_record import SEPARATED_SHADOW, Separation
from irpso_addon.solver.state.textures import DomainTextures, Estimates
from tests.builders.domains import make_domain, pack_layers, unit
from tests.oracles import confidence as oracle
from tests.oracles import reflectance as oracles

SHAPE = (12, 25)
MESH = {"card": False, "near": True, "perspective": True, "colored": True}
TWO_LOBES = "cook_torrance_two_lobe"
UNIFORM = load_schedule("paper").fitness  # noise that is the same in all samples


@dataclass
class Subject:
    """A domain whose radiances are those of ``values`` with noise of ``noise`` added."""

    model: object
    domain: object
    values: dict


def random_values(model, shape, seed=0):
    """Materials over all of the table's ranges, rounded to float32, lobes in order, normals within 35° of z."""
    rng, values = np.random.default_rng(seed), {}
    for p in model.parameters:
        value = rng.uniform(*p.range, size=(*shape, p.components))
        values[p.name] = unit(0.5 * value * (1, 1, 0) + (0, 0, 1)) if p.is_normal else value
    if model.ordered:
        first, second = model.ordered
        pair = values[first], values[second]
        values |= {first: np.minimum(*pair), second: np.maximum(*pair)}
    return {name: value.astype(np.float32).astype(np.float64) for name, value in values.items()}


def make_subject(name, shape=SHAPE, noise=0.003, changes=None, seed=0, **domain):
    """A subject of random materials; changes: parameter name → value everywhere."""
    model = load_model(name)
    values = random_values(model, shape, seed)
    for changed, value in (changes or {}).items():
        values[changed] = np.broadcast_to(np.float64(np.float32(value)), values[changed].shape)
    return observed(model, make_domain(*shape, **domain), values, noise, seed)


def observed(model, domain, values, noise, seed=0):
    """The subject with the domain's weights; what weighs nothing is NaN."""
    render = oracle.radiance(domain, model.name, values)
    render = render + noise * np.random.default_rng(seed + 1).normal(size=render.shape)
    stack = domain.stack.values.copy()
    stack[..., :3] = np.where(stack[..., 3:] > 0, render, np.nan)
    return Subject(model, with_samples(domain, stack), values)


def deviations(subject, fixed=(), values=None, seconds=0.25, fitness=UNIFORM, shadow=None, separated=False):
    """What the pass says, name → (H, W, components) over the domain, NaN where nothing is solved.

    shadow: (H, W), raised where the light is indirect. separated: whether that light was subtracted there.
    """
    context.ensure()
    domain, pack = subject.domain, Packing(subject.domain.solvable)
    scale = pack.pack(np.ones(domain.shape, np.float32))
    raised = pack.pack(np.float32(np.zeros(domain.shape) if shadow is None else shadow))
    separation = Separation.none(raised.shape)
    separation.values[separated & (raised > 0), 0] = 1
    uploaded = DomainTextures(domain, pack, pack_layers(pack, domain.stack.values), scale, separation=separation)
    uploaded.raise_shadow(raised)
    estimates = Estimates(subject.model, {n: pack.pack(v) for n, v in (values or subject.values).items()})
    work = Confidence(subject.model, fixed, fitness, uploaded.defines)
    for _ in work.measure_steps(uploaded, estimates.bindings(), Bands(), seconds):
        pass
    found = work.read()
    work.close()
    return {name: pack.unpack(value, np.nan) for name, value in found.items()}


def width(p):
    """The range of a parameter, a normal's in radians."""
    return np.pi / 2 if p.is_normal else p.range[1] - p.range[0]


@pytest.mark.parametrize(
    ("name", "fixed", "domain"),
    [
        ("lambert", (), {}),
        ("lambert", (), MESH),
        ("lambert", ("base_color",), MESH),
        ("lambert", ("normal",), {"colored": True}),
        ("principled", (), {"observations": 60}),
        (TWO_LOBES, (), {"observations": 60}),
        (TWO_LOBES, (), {"observations": 60, "noise": 0.001, **MESH}),
        (TWO_LOBES, ("r2", "base_color"), {"observations": 40}),
        ("principled_two_lobe", ("normal",), {"observations": 60}),
    ],
)
def test_deviations_are_those_of_float64_where_the_samples_determine_everything(name, fixed, domain):
    subject = make_subject(name, **domain)
    got = deviations(subject, fixed)
    matrix, variance = oracle.normal_matrix(subject.domain, subject.model, subject.values, fixed)
    expected = oracle.deviations(subject.model, matrix, variance, fixed)
    rows = [p for p in subject.model.parameters if p.name not in fixed]
    # 0.4: from σ = 1 range on an unknown is taken for undetermined, and changes what the others have.
    determined = np.all([(expected[p.name] < 0.4 * width(p)).all(axis=-1) for p in rows], axis=0)
    determined &= subject.domain.solvable
    assert determined.sum() > 35
    for p in subject.model.parameters:
        if p.name in fixed:
            assert (got[p.name][subject.domain.solvable] == 0).all()
            continue
        ratio = got[p.name][determined] / expected[p.name][determined]
        assert np.median(np.abs(ratio - 1)) < 1e-3, p.name
        # Nearly all; elsewhere a difference straddles a horizon, or float32 cannot tell what float64 can and says so.
        assert (np.abs(ratio - 1) < 0.03).mean() > 0.97 and (ratio > 0.9).mean() > 0.99, p.name


def test_a_prior_counts_like_samples_of_its_own():
    subject = make_subject("metallic_roughness", observations=60)
    without = Subject(
        subject.model.without_priors({"metallic", "roughness", "specular"}), subject.domain, subject.values
    )
    matrix, variance = oracle.normal_matrix(subject.domain, subject.model, subject.values)
    precision = {"specular": np.full(SHAPE, 1 / 0.1**2)}  # the other two are concave
    believed = matrix.copy()
    for u, (p, _, wide) in enumerate(oracle.unknowns(subject.model)):
        if p.name in precision:
            believed[..., u, u] += np.nan_to_num(variance) * wide**2 * precision[p.name]
    for made, normal in ((subject, believed), (without, matrix)):
        got, wanted = deviations(made), oracle.deviations(subject.model, normal, variance)
        determined = np.all([(wanted[p.name] < 0.4 * width(p)).all(axis=-1) for p in subject.model.parameters], axis=0)
        determined &= subject.domain.solvable
        assert determined.sum() > 35
        for name in precision:
            ratio = got[name][determined] / wanted[name][determined]
            assert np.median(np.abs(ratio - 1)) < 1e-3, name
            assert (np.abs(ratio - 1) < 0.03).mean() > 0.97, name
    smaller = deviations(subject)["specular"] < 0.9 * deviations(without)["specular"]
    assert smaller[subject.domain.solvable].mean() > 0.2


def test_no_deviation_exceeds_its_range_and_all_are_finite():
    for name in (TWO_LOBES, "principled"):
        subject = make_subject(name, noise=0.1, observations=20, **MESH)
        for p in subject.model.parameters:
            got = deviations(subject)[p.name][subject.domain.solvable]
            assert np.isfinite(got).all() and (got >= 0).all() and (got <= np.float32(width(p))).all()


@pytest.mark.parametrize(
    ("name", "end"), [("base_color", 0), ("base_color", 1), ("specular", 0), ("specular", 1), ("roughness", 1)]
)
def test_deviations_at_range_ends_use_inner_differences(name, end):
    model = load_model("principled")
    changes = {"base_color": 0.4, "roughness": 0.4, "specular": 0.5, name: model.parameter(name).range[end]}
    fixed = ("roughness",) if changes["specular"] == 0 else ()  # there is no highlight to see it by
    subject = make_subject("principled", observations=80, changes=changes, holes=False)
    got = deviations(subject, fixed)
    matrix, variance = oracle.normal_matrix(subject.domain, model, subject.values, fixed)
    expected = oracle.deviations(model, matrix, variance, fixed)
    for found in {"base_color", "normal", "roughness", "specular"} - set(fixed):
        determined = expected[found] < 0.4
        assert determined.mean() > 0.5, found
        assert (np.abs(got[found] / expected[found] - 1)[determined] < 0.03).mean() > 0.97, found


def test_two_lobes_of_one_width_leave_both_widths_and_their_weight_open():
    subject = make_subject(TWO_LOBES, observations=80, changes={"r1": 0.3, "r2": 0.3, "w": 0.5}, holes=False)
    got = deviations(subject)
    for name in ("r1", "r2", "w"):
        assert (got[name] > 0.99 * width(subject.model.parameter(name))).all(), name
    # What a lobe looks like is known all the same, and so is what does not depend on it.
    assert got["base_color"].max() < 0.01 and got["normal"].max() < 0.01
    uneven = deviations(make_subject(TWO_LOBES, observations=80, changes={"r1": 0.3, "r2": 0.3, "w": 0.8}, holes=False))
    assert np.allclose(uneven["r2"], 0.75) and np.allclose(uneven["w"], 1)
    # 0.8 dr1 + 0.2 dr2 = 0 is all that may move: a quarter of r2's range, and noise.
    assert np.allclose(uneven["r1"], 0.75 / 4, rtol=0.1)


@pytest.mark.parametrize(("w", "absent", "present"), [(1.0, "r2", "r1"), (0.0, "r1", "r2")])
def test_a_lobe_without_weight_has_an_open_width(w, absent, present):
    subject = make_subject(TWO_LOBES, observations=80, changes={"r1": 0.15, "r2": 0.35, "w": w}, holes=False)
    got = deviations(subject)
    alone = deviations(subject, fixed=(absent,))
    assert np.allclose(got[absent], 0.75)
    for name in ("base_color", "normal", present, "w"):
        assert np.allclose(got[name], alone[name], rtol=0.01), name
    assert np.median(got[present]) < 0.1 and np.median(got["w"]) < 0.3


def test_without_noise_everything_that_is_determined_is_certain():
    changes = {"r1": 0.15, "r2": 0.4, "w": 0.5}
    got = deviations(make_subject(TWO_LOBES, noise=0, observations=80, changes=changes, holes=False))
    for name in ("base_color", "normal", "r1", "r2", "w"):
        assert np.median(got[name]) < 1e-4, name
    same = deviations(make_subject(TWO_LOBES, noise=0, observations=80, changes={"r1": 0.3, "r2": 0.3}, holes=False))
    assert np.allclose(same["r2"][same["r1"] < 0.75], 0.75) and np.allclose(same["w"], 1)


def test_fewer_samples_than_unknowns_leave_everything_open():
    subject = make_subject("lambert", observations=1, holes=False)
    got = deviations(subject)
    assert np.allclose(got["base_color"], 1) and np.allclose(got["normal"], np.pi / 2)


def test_a_weighted_sample_that_is_not_finite_leaves_everything_open():
    subject = make_subject("lambert", observations=20, holes=False)
    subject.domain.stack.values[3, ..., 1] = np.nan
    got = deviations(subject)
    assert np.allclose(got["base_color"], 1) and np.allclose(got["normal"], np.pi / 2)


def test_a_colour_that_no_light_carries_is_open_and_the_others_are_not():
    model = load_model("lambert")
    domain = make_domain(*SHAPE, observations=20, holes=False)
    domain = replace(domain, intensities=domain.intensities * np.float32((1, 1, 0)))
    got = deviations(observed(model, domain, random_values(model, SHAPE), 0.003))
    assert np.allclose(got["base_color"][..., 2], 1) and got["base_color"][..., :2].max() < 0.01


def test_samples_count_by_their_weight():
    subject = make_subject("lambert", observations=20, holes=False)
    stack = subject.domain.stack.values.copy()
    stack[..., 3] = 1
    stack[10:, ..., 3] = 0
    stack[10:, ..., :3] = np.nan
    few = deviations(replace(subject, domain=with_samples(subject.domain, stack)))
    twice = stack.copy()
    twice[10:] = stack[:10]
    twice[..., 3] = 0.5
    lights, views = (np.concatenate([a[:10]] * 2) for a in (subject.domain.lights, subject.domain.views))
    halves = deviations(
        replace(subject, domain=replace(with_samples(subject.domain, twice), lights=lights, views=views))
    )
    for name in few:
        assert np.allclose(few[name], halves[name], rtol=1e-4)


@pytest.mark.parametrize(
    ("shadow_there", "separated", "left"),
    [(0.05, False, 0.8), (SEPARATED_SHADOW, True, 0.7), (SEPARATED_SHADOW, False, 0.8), (0.05, True, 0.8)],
)
def test_indirect_light_that_is_not_explained_leaves_everything_open(shadow_there, separated, left):
    subject = make_subject("lambert", noise=0.0, holes=False, changes={"base_color": 0.5})
    dark = {**subject.values, "base_color": left * subject.values["base_color"]}
    shadow = np.zeros(SHAPE)
    shadow[:, ::2] = shadow_there
    explained, unexplained = (
        deviations(subject, values=values, shadow=shadow, separated=separated) for values in (None, dark)
    )
    for p in subject.model.parameters:
        np.testing.assert_array_equal(unexplained[p.name][:, ::2], np.float32(p.width))
        assert (unexplained[p.name][:, 1::2] < 0.9 * p.width).mean() > 0.5
        assert (explained[p.name] < 0.9 * p.width).mean() > 0.5


def test_bands_of_rows_change_nothing():
    subject = make_subject(TWO_LOBES, observations=30)
    whole, cut = deviations(subject, seconds=10), deviations(subject, seconds=1e-9)
    for name in whole:
        assert np.array_equal(whole[name], cut[name], equal_nan=True)


def refitted(subject):
    """Values at the least squares of every texel's samples, found by scipy from the truth on."""
    model, domain = subject.model, subject.domain
    lights = domain.lights[:, :3].astype(np.float64)
    render, axes = oracles.MODELS[model.name], oracle.tangents(subject.values["normal"])
    fit = {name: value.copy() for name, value in subject.values.items()}
    for at in np.ndindex(domain.shape):
        start = {name: value[at] for name, value in subject.values.items()}
        first, second = axes[0][at], axes[1][at]

        def values(x, start=start, first=first, second=second):
            moved, used = {}, 0
            for p in model.parameters:
                size = 2 if p.is_normal else p.components
                part, used = x[used : used + size], used + size
                if p.is_normal:
                    moved[p.name] = unit(start[p.name] + part[0] * first + part[1] * second)
                else:
                    moved[p.name] = start[p.name] + (part if p.components > 1 else part[0])
            return moved

        def errors(x, values=values, reference=domain.stack.values[:, *at, :3]):
            p = {n: v[0] if v.shape == (1,) else v for n, v in values(x).items()}
            return (render(p, lights, np.array([0.0, 0, 1])) - reference).ravel()

        found = least_squares(errors, np.zeros(len(oracle.unknowns(model))), method="lm")
        assert found.success
        for name, value in values(found.x).items():
            fit[name][at] = value
    return fit


@pytest.mark.parametrize("name", ["lambert", TWO_LOBES])
def test_refits_to_real_noise_scatter_by_the_deviations(name):
    model, texels, draws = load_model(name), 12, 50
    domain = make_domain(texels, draws, observations=80, holes=False)
    stack = domain.stack.values.copy()
    stack[..., 3] = 1
    one = random_values(model, (texels, 1), seed=3)
    if name == TWO_LOBES:
        rng = np.random.default_rng(4)
        for parameter, low, high in (("r1", 0.15, 0.2), ("r2", 0.4, 0.5), ("w", 0.4, 0.6)):
            one[parameter] = rng.uniform(low, high, size=(texels, 1, 1))
        one["base_color"] = 0.2 + 0.6 * one["base_color"]
    truth = {n: np.broadcast_to(v, (texels, draws, v.shape[-1])).copy() for n, v in one.items()}
    subject = observed(model, with_samples(domain, stack), truth, 0.003, seed=5)
    fit = refitted(subject)
    got = deviations(subject, values=fit)
    for p in model.parameters:
        error = fit[p.name] - truth[p.name]
        if p.is_normal:
            error = np.linalg.norm(error, axis=-1, keepdims=True)
        # A sum of squares over 600 refits (1800 of a colour): its mean is good to √(2 / 600) = 6 %, so these are 4 σ.
        pull = np.mean((error / got[p.name]) ** 2)
        assert 0.77 < pull < 1.27, p.name
        # Every texel by itself: 50 refits, good to 20 %.
        each = np.mean(error**2, axis=1) / np.mean(got[p.name] ** 2, axis=1)
        assert each.min() > 0.35 and each.max() < 2.0, p.name


def test_what_no_stage_searches_is_as_certain_as_if_it_were_fixed():
    subject = make_subject("principled", (9, 11), observations=30)
    schedule = load_schedule("standard").replaced(search=("normal", "base_color"), iterations=10)
    found = []
    for names in ((), ("roughness", "specular")):
        fixed = {p.name: np.float32(p.default) for p in subject.model.parameters if p.name in names}
        with Recovery(subject.domain, subject.model, schedule, fixed=fixed) as recovery:
            assert recovery.unsearched == {"roughness", "specular"}
            recovery.step()
            found.append(recovery.maps())
    assert (found[0].confidence["roughness"] == 0).all() and not found[0].alternatives
    for name, deviation in found[1].confidence.items():
        np.testing.assert_array_equal(found[0].confidence[name], deviation, name)


def test_a_recovery_has_deviations_and_zero_for_fixed_parameters():
    subject = make_subject("lambert", (9, 11), observations=30)
    fixed = {"base_color": subject.values["base_color"].astype(np.float32)}
    schedule = load_schedule("swarm").replaced(search=("normal",), iterations=60, loss="l2")
    with Recovery(subject.domain, subject.model, schedule, fixed=fixed) as recovery:
        recovery.step()
        maps = recovery.maps()
        assert recovery.maps(confidence=False).confidence is None
    covered = maps.solved
    assert {name: v.shape for name, v in maps.confidence.items()} == {"base_color": (9, 11, 3), "normal": (9, 11, 1)}
    assert (maps.confidence["base_color"] == 0).all() and (maps.confidence["normal"][~covered] == 0).all()
    values = {name: v.astype(np.float64) for name, v in maps.values.items()}
    expected = oracle.deviations(
        subject.model, *oracle.normal_matrix(subject.domain, subject.model, values, fixed), fixed
    )
    assert np.allclose(maps.confidence["normal"][covered], expected["normal"][covered], rtol=0.02)
