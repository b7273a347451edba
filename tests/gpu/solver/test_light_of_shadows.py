"""Light that a texel is sent, told by its shadows: against the light that was put there, numpy's and scipy's fit."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from irpso_addon.core.steps import run_steps
from irpso_addon.geometry.domain import with_samples
from irpso_addon.gpu import context
from irpso_addon.gpu.bands import Bands
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.phases.separation import shadow_light_pass, shadow_light_steps
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state.prepare import prepare
from irpso_addon.solver.state.separation import SeparatedStack
from irpso_addon.solver.state.separation_record import Separation
from irpso_addon.solver.state.shadow_light import harmonics, light_of
from irpso_addon.solver.state.textures import DomainTextures, Estimates
from tests.builders.domains import make_domain, unit
from tests.oracles.shadow_light import shadow_light

LIGHTS, SHAPE = 96, (3, 8)
CHROMA = np.array([0.5, 0.3, 0.2])


def hollow(near=False, card=True, noise=0.0, strength=1.0, lights=LIGHTS):
    """Return (domain, normals, direct light, sent light): the left half of matt texels stands beside a wall.

    The wall hides them from lamps of one side, and sends them light that changes with the lamp's direction.
    """
    rng = np.random.default_rng(6)
    domain = make_domain(*SHAPE, observations=lights, near=near, card=card, colored=True, holes=False)
    toward = domain.lights[:, None, None, :3] - near * domain.bake.position
    squared = (toward**2).sum(axis=-1, keepdims=True) if near else 1
    toward, frame = unit(toward), domain.bake.frames().swapaxes(-1, -2)
    local = np.einsum("khwi,hwij->khwj", toward, frame)
    normal = unit(rng.normal(size=(*SHAPE, 3)) * 0.3 + (0, 0, 1))
    inside = np.broadcast_to(np.arange(SHAPE[1]) < SHAPE[1] // 2, SHAPE)
    direct = np.maximum((local * normal).sum(axis=-1), 0) * ~(inside & (local[..., 0] > 0.3))
    sent = strength * inside * (0.03 + 0.015 * local[..., 0] + 0.01 * local[..., 0] * local[..., 1])
    direct = direct[..., None] * rng.uniform(0.5, 0.9, (*SHAPE, 3))
    sent = sent[..., None] * 3 * CHROMA
    irradiance = domain.intensities[:, None, None] / squared
    stack = np.ones((lights, *SHAPE, 4))
    stack[..., :3] = (direct + sent) * irradiance * (1 + noise * rng.normal(size=(lights, *SHAPE, 1)))
    return with_samples(domain, np.float32(stack)), normal, direct * irradiance, sent * irradiance, inside


def found(domain, normal, misfit=1.0, least=0.05, entry="fragment", turn=0.0):
    context.ensure()
    model, misfit = load_model("lambert"), np.broadcast_to(np.float32(misfit), domain.shape)
    prepared = prepare(domain, model, load_schedule("standard"))
    packing = prepared.packing
    domain_textures = DomainTextures(
        domain, packing, prepared.stack, packing.pack(prepared.scale), prepared.mean_irradiance, prepared.arrays
    )
    values = {"normal": packing.pack(normal), "base_color": packing.pack(np.zeros((*domain.shape, 3)))}
    work = shadow_light_pass(model, least, turn, domain_textures.defines, entry)
    return run_steps(shadow_light_steps(work, domain_textures, Estimates(model, values), misfit, Bands(), 1.0))


@pytest.mark.parametrize("entry", ["fragment", "compute"])
@pytest.mark.parametrize(
    ("near", "card", "lights"),
    [(False, True, 96), (True, True, 96), (False, False, 96), (False, True, 50), (True, True, 35)],
)
def test_it_is_that_of_the_oracle(near, card, lights, entry):
    domain, normal, _, _, inside = hollow(near, card, noise=0.03, lights=lights)
    mine, other = found(domain, normal, entry=entry), shadow_light(domain, normal, np.ones(SHAPE), 0.05, 0.0)
    np.testing.assert_array_equal(mine[..., -1] > 0, other[..., -1] > 0)
    assert (mine[inside][:, -1] > 0).mean() > 0.6
    np.testing.assert_allclose(mine[..., 9:], other[..., 9:], atol=2e-3)
    vectors = domain.lights[:, None, :3].astype(np.float64)
    for texel in np.argwhere(mine[..., -1] > 0):
        a, b = (light_of(vectors, v[tuple(texel)][None, :9], np.full((1, 3), 1 / 3)) for v in (mine, other))
        assert np.abs(a - b).mean() < 0.01 * b.mean()


@pytest.mark.parametrize(("near", "card"), [(False, True), (True, True), (False, False), (True, False)])
def test_what_is_left_is_the_direct_light(near, card):
    domain, normal, direct, sent, inside = hollow(near, card)
    told_by = found(domain, normal)
    coefficients, chroma, share = told_by[..., :9], told_by[..., 9:11], told_by[..., 11]
    told = share > 0.05  # on a bumpy mesh the wall hides some texels from few lamps
    assert told[inside].mean() >= (1 if card else 0.75) and not share[~inside].any() and not coefficients[~told].any()
    np.testing.assert_allclose(chroma[told], np.broadcast_to(CHROMA[:2], (told.sum(), 2)), atol=1e-3)
    left, errors = SeparatedStack(domain, Separation.of_shadows(told_by)), []
    for observation in range(LIGHTS):
        errors.append(left.layer(observation)[..., :3] - direct[observation])
        np.testing.assert_array_equal(left.layer(observation)[~inside], domain.stack.layer(observation)[~inside])
    # Where lamps reach, the light is extrapolated: what is left of it there is most of the error.
    assert np.abs(np.stack(errors)[:, told]).mean() < 0.35 * sent[:, told].mean()
    rows, columns = np.nonzero(inside)
    layers = np.stack([left.layer(k)[rows, columns] for k in range(LIGHTS)])
    np.testing.assert_array_equal(left.texels(rows, columns), layers)
    np.testing.assert_array_equal(left.subset(np.array([3, 5])).layer(1), left.layer(5))
    part = slice(1, 3), slice(2, 6)
    np.testing.assert_array_equal(left.window(*part).layer(7), left.layer(7)[part])


def test_the_fit_is_that_of_scipy():
    domain, normal, _, _, inside = hollow(noise=0.05)
    coefficients = found(domain, normal)[..., :9]
    vectors = domain.lights[:, :3].astype(np.float64)
    basis = harmonics(vectors)
    for row, column in np.argwhere(inside)[::3]:
        grey = (domain.stack.values[:, row, column, :3] / domain.intensities).mean(axis=-1).astype(np.float64)
        lit = (vectors @ normal[row, column] >= 0) & (vectors[:, 0] <= 0.3)
        dark, bright = ~lit, np.percentile(grey, 95)

        def errors(x, dark=dark, grey=grey, bright=bright):
            ridge = np.sqrt(np.array([1e-3, *[0.1] * 8]) * 0.02 * bright) * x
            return np.concatenate([np.sqrt(np.abs(grey - basis @ x)[dark] + 1e-12), ridge])

        best = least_squares(errors, coefficients[row, column], loss="linear").x
        mine, other = (light_of(vectors[:, None], x[None], np.full((1, 3), 1 / 3))[dark, 0, 0]
                       for x in (coefficients[row, column].astype(np.float64), best))  # fmt: skip
        assert np.abs(mine - other).mean() < 0.05 * grey[dark].mean()


def test_a_first_normal_that_this_light_has_turned_tells_the_same_light():
    domain, normal, _, _, inside = hollow()
    right, wrong = found(domain, normal), found(domain, unit(normal + (0, 0.25, 0)))
    assert (((right[..., -1] > 0) & (wrong[..., -1] > 0)) == inside).all()
    vectors = domain.lights[:, None, :3].astype(np.float64)
    a, b = (light_of(vectors, v[inside][:, :9], np.full((1, 3), 1 / 3)) for v in (right, wrong))
    assert np.abs(a - b).mean() < 0.01 * a.mean()


def test_light_that_hardly_turns_a_normal_stays():
    domain, normal, _, _, inside = hollow(strength=2.0)
    told = found(domain, normal, turn=2.0)[..., -1] > 0
    np.testing.assert_array_equal(told, shadow_light(domain, normal, np.ones(SHAPE), 0.05, 2.0)[..., -1] > 0)
    assert 0.2 < told[inside].mean() < 0.7 and (found(domain, normal)[inside][:, -1] > 0).mean() > 0.9


@pytest.mark.parametrize("why", ["no shadows", "noise", "metal", "a light lacks a channel", "too little", "not sought"])
def test_where_shadows_do_not_tell_nothing_is_taken_off(why):
    domain, normal, _, _, inside = hollow(strength=0.05 if why == "too little" else 1.0)
    misfit, values = np.ones(SHAPE), domain.stack.values.copy()
    if why == "no shadows":
        values[(domain.lights[:, 0] > 0.3) | (domain.lights[:, 2] < 0.75), ..., 3] = 0
    elif why == "noise":
        values[..., :3] *= np.random.default_rng(1).lognormal(0, 2, (LIGHTS, *SHAPE, 1))
    elif why == "metal":  # dark beside its highlight, as if a wall stood there
        half = unit(domain.lights[:, None, None, :3] + (0, 0, 1))
        values[..., :3] = 0.02 + ((half * normal).sum(axis=-1, keepdims=True) ** 60) * domain.intensities[:, None, None]
    elif why == "a light lacks a channel":
        domain.intensities[4, 2] = 0
    elif why == "not sought":
        misfit = ~inside
    assert not found(with_samples(domain, values), normal, misfit, 0.05).any()


def test_a_texel_that_the_prefit_explains_better_keeps_its_light():
    domain, normal, direct, sent, inside = hollow()
    values = domain.stack.values.copy()
    shine = 1 + 0.2 * np.random.default_rng(2).uniform(-1, 1, (LIGHTS, *SHAPE, 1))  # lit samples are not quite matt
    values[..., :3] = direct * shine + sent
    domain = with_samples(domain, np.float32(values))
    for misfit, part in ((1.0, 1.0), (0.3, 0.0)):
        told = found(domain, normal, misfit)[..., -1] > 0
        assert told[inside].mean() == part
        np.testing.assert_array_equal(
            told, shadow_light(domain, normal, np.full(SHAPE, misfit), 0.05, 0.0)[..., -1] > 0
        )


def test_bounds_and_samples_of_no_weight_neither_tell_nor_change():
    domain, normal, _, _, inside = hollow()
    values = domain.stack.values.copy()
    values[0, ..., 3], values[1, ..., 3], values[1, ..., :3] = -2.5, 0, np.nan
    domain = with_samples(domain, values)
    told_by = found(domain, normal)
    assert (told_by[inside][:, -1] > 0.05).all() and np.isfinite(told_by).all()
    left = SeparatedStack(domain, Separation.of_shadows(told_by))
    for observation in (0, 1):
        np.testing.assert_array_equal(left.layer(observation), domain.stack.layer(observation))
    np.testing.assert_array_equal(left.layer(2)[..., 3], domain.stack.layer(2)[..., 3])
    assert (left.layer(2)[inside] != domain.stack.layer(2)[inside]).any()


def test_a_texel_is_told_by_itself_alone():
    domain, normal, _, _, _ = hollow()
    whole = found(domain, normal)
    for column in range(SHAPE[1]):
        sought = np.zeros(SHAPE, bool)
        sought[1, column] = True
        np.testing.assert_array_equal(found(domain, normal, sought)[1, column], whole[1, column])
