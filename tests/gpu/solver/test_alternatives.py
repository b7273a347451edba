"""Materials far from the estimates: how much worse they fit, against float64, and what a whole material makes of it."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.geometry.domain import with_samples
from irpso_addon.gpu.bands import Bands
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.modes import with_modes
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state.alternatives import Alternatives
from irpso_addon.solver.state.packing import Packing
from irpso_addon.solver.state.textures import DomainTextures, Estimates
from tests.builders.domains import make_domain, pack_layers, unit
from tests.oracles import alternatives as alternatives_oracle
from tests.oracles import confidence as confidence_oracle

pytestmark = pytest.mark.usefixtures("gpu")

STANDARD = load_schedule("standard")
SHAPE = (9, 14)
MESH = {"card": False, "near": True, "perspective": True, "colored": True}
SMOOTH = 0.1


def random_values(model, shape):
    """Materials over all of the table's ranges as float32 has them, lobes in order, normals within 35° of z."""
    rng, values = np.random.default_rng(5), {}
    for p in model.parameters:
        value = rng.uniform(*p.range, size=(*shape, p.components))
        values[p.name] = unit(0.5 * value * (1, 1, 0) + (0, 0, 1)) if p.is_normal else value
    if model.ordered:
        pair = [values[name] for name in model.ordered]
        values |= dict(zip(model.ordered, (np.minimum(*pair), np.maximum(*pair)), strict=True))
    return {name: value.astype(np.float32).astype(np.float64) for name, value in values.items()}


def rendered(domain, name, values, noise):
    """The domain with the radiances of a model's values and noise; samples without weight are NaN."""
    stack = domain.stack.values.copy()
    render = confidence_oracle.radiance(domain, name, values)
    render = np.maximum(render + noise * np.random.default_rng(1).normal(size=render.shape), 0)
    stack[..., :3] = np.where(stack[..., 3:] > 0, render, np.nan)
    return with_samples(domain, stack)


def alternatives(domain, model, values, scale, fixed=(), fitness=STANDARD.fitness):
    """What the pass says, name → (H, W, 1), NaN where nothing is solved."""
    pack = Packing(domain.solvable)
    uploaded = DomainTextures(domain, pack, pack_layers(pack, domain.stack.values), pack.pack(scale.astype(np.float32)))
    estimates = Estimates(model, {name: pack.pack(value) for name, value in values.items()})
    work = Alternatives(model, fixed, fitness, uploaded.defines)
    for _ in work.measure_steps(uploaded, estimates.bindings(), Bands(), 0.25):
        pass
    found = work.read()
    work.close()
    return {name: pack.unpack(value, np.nan) for name, value in found.items()}


@pytest.mark.parametrize(
    ("name", "fixed", "domain"),
    [
        ("metallic_roughness", (), {"observations": 16}),
        ("metallic_roughness", ("metallic", "base_color"), {"observations": 6}),
        ("principled", (), {"observations": 12, **MESH}),
        ("cook_torrance_two_lobe", (), {"observations": 20}),
        ("clear_coat", ("coat_roughness",), {"observations": 8}),
    ],
    ids=["default", "known", "mesh", "two-lobes", "coat"],
)
def test_alternatives_are_as_much_worse_as_float64_says(name, fixed, domain):
    model = load_model(name)
    values, scale = random_values(model, SHAPE), np.random.default_rng(6).uniform(0.3, 0.8, SHAPE)
    domain = rendered(make_domain(*SHAPE, **domain), name, values, 0.02)
    got = alternatives(domain, model, values, scale, fixed)
    expected = alternatives_oracle.log_ratios(domain, model, values, STANDARD, scale, fixed)
    assert set(got) == set(expected) and expected
    solvable = domain.solvable
    for number, wanted in expected.items():
        off = np.abs(got[number] - wanted)[solvable]
        # Where a bound of float32 decides, as whether a light is above the horizon, single texels differ.
        assert (off < 0.01).mean() > 0.95 and np.median(off) < 1e-3, number
        assert np.isnan(got[number][~solvable]).all()
        assert np.ptp(wanted[solvable]) > 5, number


def test_alternatives_skip_fixed_linear_and_normal_prior_parameters_and_other_losses():
    model, values = load_model("metallic_roughness"), random_values(load_model("metallic_roughness"), SHAPE)
    domain, scale = rendered(make_domain(*SHAPE), model.name, values, 0.01), np.ones(SHAPE)
    assert set(alternatives(domain, model, values, scale)) == {"roughness", "metallic"}
    assert set(alternatives(domain, model, values, scale, ("metallic",))) == {"roughness"}
    free = model.without_priors({"specular"})
    assert set(alternatives(domain, free, values, scale)) == {"roughness", "metallic", "specular"}
    assert alternatives(domain, model, values, scale, fitness=replace(STANDARD.fitness, loss="l2")) == {}
    assert alternatives(domain, load_model("lambert"), values, scale) == {}


def test_too_few_samples_contradict_nothing():
    model, values = load_model("metallic_roughness"), random_values(load_model("metallic_roughness"), SHAPE)
    domain = rendered(make_domain(*SHAPE, observations=2, holes=False), model.name, values, 0.01)
    for worse in alternatives(domain, model, values, np.ones(SHAPE)).values():
        assert (worse == 0).all()


@pytest.fixture(scope="module")
def polished():
    """Maps of a polished dielectric: six lights, noise of 1 % of white; no highlight is seen on the left half.

    On the right half, of another colour, three texels in ten face where a light is mirrored.
    """
    shape, rng = (16, 24), np.random.default_rng(8)
    lights = unit(np.stack([*rng.uniform(-1, 1, (2, 6)), np.full(6, 0.9)], axis=1))
    mirrors = unit(lights + (0, 0, 1))
    hidden = np.zeros(shape, bool)
    hidden[:, : shape[1] // 2] = True
    normal = unit(np.concatenate([rng.uniform(-0.4, 0.4, (9000, 2)), np.ones((9000, 1))], axis=-1))
    away = np.degrees(np.arccos((normal @ mirrors.T).max(axis=1)))
    dark = normal[away > 12][: np.prod(shape)].reshape(*shape, 3)
    lit = unit(mirrors[rng.integers(0, 6, shape)] + rng.normal(0, 0.01, (*shape, 3)))
    sees = ~hidden & (rng.uniform(size=shape) < 0.3)
    values = {
        "base_color": np.where(hidden[..., None], (0.1, 0.25, 0.5), (0.5, 0.2, 0.1))
        * rng.uniform(0.9, 1.1, (*shape, 1)),
        "normal": np.where(sees[..., None], lit, dark),
        "roughness": np.full((*shape, 1), SMOOTH),
        "metallic": np.zeros((*shape, 1)),
        "specular": np.full((*shape, 1), 0.5),
    }
    domain = make_domain(*shape, observations=6, holes=False)
    domain = replace(
        with_samples(domain, np.ones_like(domain.stack.values)),
        lights=np.pad(lights, ((0, 0), (0, 1))).astype(np.float32),
    )
    domain = rendered(domain, "metallic_roughness", values, 0.01)
    fixed = {"metallic": values["metallic"].astype(np.float32)}
    with Recovery(domain, load_model("metallic_roughness"), STANDARD, fixed=fixed) as recovery:
        recovery.step()
        assert recovery.maps(confidence=False).alternatives is None
        yield recovery.maps(), hidden


def test_a_material_without_visible_highlight_has_two_modes(polished):
    maps, hidden = polished
    marked = with_modes(maps)
    assert set(marked.two_modes) == {"roughness"}
    two, found = marked.two_modes["roughness"], marked.values["roughness"][..., 0]
    assert two[hidden].mean() > 0.95 and two[~hidden].mean() < 0.05
    # The prior has decided for matt where nothing is seen, and it is wrong; where some see a highlight, all know.
    assert np.median(found[hidden]) > 0.6 and np.median(np.abs(found[~hidden] - SMOOTH)) < 0.1
    # A texel alone cannot tell: those that face no light are as open in both halves.
    assert np.median(maps.alternatives["roughness"][..., 0][~hidden]) < 1


def test_two_modes_are_marked_unknown_and_reported(polished):
    maps, hidden = polished
    certain = replace(maps, confidence={name: 0 * value for name, value in maps.confidence.items()})
    assert not certain.unknown()["roughness"].any()
    unknown = with_modes(certain).unknown()["roughness"]
    assert unknown[hidden].mean() > 0.95 and unknown[~hidden].mean() < 0.05
