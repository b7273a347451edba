"""The prefit: grey samples, surfaces that no model describes, resumed runs, real captures."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.blender.images import decode
from irpso_addon.capture import read_capture, read_exr
from irpso_addon.capture.bounds import bounded, weight_and_clipped
from irpso_addon.core.steps import run_steps
from irpso_addon.geometry.build import domain_from_card
from irpso_addon.geometry.domain import with_samples
from irpso_addon.gpu import context, textures
from irpso_addon.gpu.bands import Bands
from irpso_addon.gpu.kernel import Kernel, Output
from irpso_addon.gpu.passes import Pass
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.kernels import declarations
from irpso_addon.solver.phases import prefit
from irpso_addon.solver.phases.prefit import grey
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state.packing import Packing
from irpso_addon.solver.state.prepare import texel_scale
from irpso_addon.solver.state.textures import DomainTextures
from tests.builders.command_line import dome_lights
from tests.builders.domains import bits_of, ended_prefit, make_domain, masked, pack_layers, recoveries, unit
from tests.oracles import confidence as confidence_oracle
from tests.oracles.loss import loss

STANDARD = load_schedule("standard").replaced(prior_rounds=0, surface_rounds=0, materials_rounds=0)
PRINCIPLED = load_model("principled")
LAMBERT = load_model("lambert")
DIRECTIONS = 40
recover = pytest.fixture(recoveries)


def degrees(maps, normal):
    """Return (H, W): the angles between the normals that were found and those that are true."""
    found, true = maps.values["normal"].astype(np.float64), np.asarray(normal, np.float64)
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(found, true), axis=-1), (found * true).sum(axis=-1)))


def card(model, shape=(14, 15), observations=DIRECTIONS, noise=0.0, seed=3, colors=None, **values):
    """Return (domain, truth) of a card as the oracle's model renders it, in float64 until the end.

    colors: the lights' intensities (K, 3); they are white without.
    """
    rng = np.random.default_rng(seed)
    truth = {
        "normal": unit(rng.normal(size=(*shape, 3)) * 0.3 + (0, 0, 1)),
        "base_color": rng.uniform(0.2, 0.8, (*shape, 3)),
        "roughness": rng.uniform(0.25, 0.5, (*shape, 1)),
        "specular": rng.uniform(0.3, 0.8, (*shape, 1)),
        "base": rng.uniform(0.3, 0.8, (*shape, 1)),
        "lobe": np.full((*shape, 1), 0.05),
        "cosine_exponent": np.full((*shape, 1), 1.2),
    } | values
    made = make_domain(*shape, observations=observations, holes=False)
    lights = unit(rng.normal(size=(observations, 3)) * (1, 1, 0.4) + (0, 0, 1.3))
    made = replace(made, lights=np.float32(np.pad(lights, ((0, 0), (0, 1)))))
    if colors is not None:
        made = replace(made, intensities=np.float32(colors))
    stack = np.ones((observations, *shape, 4))
    stack[..., :3] = confidence_oracle.radiance(made, model, truth)
    stack[..., :3] = np.maximum(stack[..., :3] + noise * rng.normal(size=stack[..., :3].shape), 0)
    return with_samples(made, stack.astype(np.float32)), truth


def prefit_fitness(recovery):
    """Step through the prefit alone; return its maps."""
    while recovery.progress.stage == 0 and recovery.progress.title == "prefit of the normals":
        recovery.step(iterations=1)
    return recovery.maps(confidence=False)


def test_the_fraction_never_steps_back(recover):
    domain, _ = card("principled", (6, 7))
    recovery, fractions = recover(domain, PRINCIPLED, schedule=STANDARD), []
    while recovery.progress.title == "prefit of the normals":
        fractions.append(recovery.step(time_budget_s=0.0).fraction)  # returns after every band
    assert len(fractions) > 4 * STANDARD.prefit.iterations
    assert fractions == sorted(fractions)


# ---- grey --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"card": False, "near": True}], ids=["distant", "near"])
def test_grey_samples_are_those_of_numpy(root, options):
    context.ensure()
    domain = make_domain(6, 7, observations=9, colored=True, **options)
    domain.intensities[2] = (0, 1.5, 0.5)
    domain.intensities[3] = (0, 0, 2)
    domain.intensities[4] = 0
    clipped = np.random.default_rng(6).random((*domain.stack.values.shape[:3], 3)) < 0.1
    domain.stack.values[..., 3] = bounded(domain.stack.values[..., 3], clipped)
    pack = Packing(domain.solvable)
    scale = np.random.default_rng(2).uniform(0.5, 2, domain.shape).astype(np.float32)
    grey_textures = grey(
        DomainTextures(domain, pack, pack_layers(pack, domain.stack.values), pack.pack(scale)),
        STANDARD.replaced(prefit_shadow=0.4),
    )
    assert grey_textures.mean_irradiance == 1
    outputs = tuple(Output(name) for name in ("o_light", "o_intensity", "o_radiance", "o_clipped"))
    kernel = Kernel(
        str(root / "tests/gpu/kernels/observe.glsl"),
        outputs,
        declarations.OBSERVATIONS,
        {"u_observation": "INT"},
        grey_textures.defines,
    )
    one = Pass(kernel)
    targets = [textures.empty(pack.width, pack.height) for _ in outputs]
    dropped = 0
    for k in range(domain.observations):
        one.run(targets, {n: grey_textures.textures[n] for n in declarations.OBSERVATIONS}, {"u_observation": k})
        light, intensity, radiance, clipped = (pack.unpack(textures.download(t)) for t in targets)
        sample = domain.stack.values[k].astype(np.float64)
        weight, bound = weight_and_clipped(domain.stack.values[k][..., 3])
        has = domain.intensities[k] > 0
        squared = 1.0
        if domain.lights[k, 3]:
            squared = ((domain.lights[k, :3] - domain.bake.position.astype(np.float64)) ** 2).sum(axis=-1)
        value = np.zeros(domain.shape)
        if has.any():
            value = (sample[..., :3][..., has] / domain.intensities[k][has]).mean(axis=-1) * squared
        lit = (weight > 0) & domain.solvable & has.any() & (value >= 0.4 * scale)
        clear = np.abs(value - 0.4 * scale) > 1e-5
        np.testing.assert_array_equal(light[..., 3][clear], np.where(lit, weight, 0)[clear])
        some = lit & clear
        np.testing.assert_array_equal(clipped[some, :3], np.repeat(bound.any(axis=-1)[some][:, None], 3, axis=1))
        np.testing.assert_allclose(radiance[lit, :3], np.repeat(value[lit][:, None], 3, axis=1), rtol=1e-5)
        assert (intensity[lit, :3] == 1).all()
        dropped += (~lit & (weight > 0) & domain.solvable).sum()
    one.close()
    assert dropped > 42  # more than the light that has no channel


def test_the_prefit_is_blind_to_the_colours_of_lights(recover):
    rng = np.random.default_rng(4)
    colors = rng.uniform(0.3, 2, (DIRECTIONS, 3))
    colors[5] = (0, 1.2, 0)
    found = []
    for given in (None, colors):
        # A grey surface: of a coloured one the lights' colours change a texel's scale, and so what is in shadow.
        domain, truth = card("base_lobe", colors=given)
        found.append(prefit_fitness(recover(domain, PRINCIPLED, STANDARD.replaced(prefit_refinement_iterations=30))))
        assert degrees(found[-1], truth["normal"]).mean() < 0.02
    apart = degrees(found[0], found[1].values["normal"])
    assert np.quantile(apart, 0.95) < 0.02


# ---- what it is for ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def uneven():
    """(domain, truth): a base that darkens faster than Lambert's, under a lobe."""
    return card("base_lobe", shape=(12, 13), noise=0.001)


def test_normals_of_a_non_lambertian_base_come_from_the_prefit(recover, uneven):
    domain, truth = uneven
    errors = []
    for iterations in (STANDARD.prefit.iterations, 0):
        recovery = recover(domain, PRINCIPLED, STANDARD.replaced(prefit_iterations=iterations))
        recovery.step()
        errors.append(degrees(recovery.maps(confidence=False), truth["normal"]).mean())
    assert errors[0] < 0.3 and errors[1] > 1, errors


def test_a_prior_separates_exponent_and_tilt_under_narrow_lights(recover, monkeypatch):
    lights = dome_lights(12, widest=22)
    errors = []
    for deviation in (prefit._EXPONENT_DEVIATION, 100.0):
        monkeypatch.setattr(prefit, "_EXPONENT_DEVIATION", deviation)
        domain, truth = card("lambert", shape=(12, 13), observations=12, noise=0.003)
        domain = replace(domain, lights=np.float32(np.pad(lights, ((0, 0), (0, 1)))))
        stack = np.ones_like(domain.stack.values)
        stack[..., :3] = confidence_oracle.radiance(domain, "lambert", truth)
        stack[..., :3] += 0.003 * np.random.default_rng(2).normal(size=stack[..., :3].shape)
        found = prefit_fitness(recover(with_samples(domain, stack), PRINCIPLED, STANDARD))
        errors.append(degrees(found, truth["normal"]).mean())
    assert errors[0] < 0.7 * errors[1], errors


def test_the_prefit_does_not_degrade_surfaces_of_the_model(recover):
    domain, truth = card("principled", shape=(12, 13))
    errors = []
    for iterations in (STANDARD.prefit.iterations, 0):
        recovery = recover(domain, PRINCIPLED, STANDARD.replaced(prefit_iterations=iterations))
        recovery.step()
        maps = recovery.maps(confidence=False)
        errors.append(degrees(maps, truth["normal"]).mean())
    assert errors[0] < 0.1 and errors[0] < errors[1] + 0.02, errors


@pytest.mark.parametrize(
    ("settings", "fixed", "observations"),
    [({"prefit_iterations": 0}, {}, 12), ({}, {}, 9), ({}, {"normal": np.float32([0, 0, 1])}, 12),
     ({"search": ["base_color"]}, {}, 12)],
    ids=["switched-off", "nine-observations", "known-normal", "a-normal-nobody-asks-for"],
)  # fmt: skip
def test_the_prefit_needs_iterations_observations_and_a_free_normal(recover, settings, fixed, observations):
    domain, _ = card("principled", shape=(3, 4), observations=observations)
    titles = [s.title for s in recover(domain, PRINCIPLED, STANDARD.replaced(**settings), fixed=fixed)._stages]
    assert "prefit of the normals" not in titles and titles[-1] == "refinement"
    whole, _ = card("principled", shape=(3, 4), observations=12)
    stages = recover(whole, PRINCIPLED, STANDARD)._stages
    assert [s.title for s in stages] == [
        "prefit of the normals", "prefit of the normals with sheen", "sheen", "indirect light",
        "separation of indirect light", "prefit of the normals in indirect light",
        "roughness + specular + base_color", "refinement", "refinement, normals fixed",
    ]  # fmt: skip


# ---- its misfit --------------------------------------------------------------------------------------------------


def bounded_misfit(domain, model, values, settings, scale):
    """(H, W): the mean over grey samples of e² / (1 + e²), e in acceptance_delta of the scale, in float64."""
    grey_of = (domain.stack.values[..., :3] / domain.intensities[:, None, None]).astype(np.float64).mean(axis=-1)
    white = replace(domain, intensities=np.ones_like(domain.intensities))
    render = confidence_oracle.radiance(white, model, {n: np.float64(v) for n, v in values.items()}).mean(axis=-1)
    weight = domain.stack.values[..., 3] * (grey_of >= settings.shadow * scale)
    # A highlight may be off in proportion to its brightness (Fitness.highlight_power).
    e = (render - grey_of) / (settings.acceptance_delta * np.maximum(scale, grey_of))
    return (weight * loss("geman_mcclure", e)).sum(axis=0) / weight.sum(axis=0), (weight > 0).sum(axis=0)


def test_the_prefits_misfit_matches_float64(recover, uneven):
    domain, _ = uneven
    recovery = recover(domain, PRINCIPLED, STANDARD)
    phase, pack = ended_prefit(recovery), Packing(domain.solvable)
    fitness = pack.unpack(run_steps(phase.measure_steps(Bands(), 1.0)).fitness)
    own = {n: pack.unpack(v) for n, v in phase.own.values().items()}
    scale = texel_scale(domain, STANDARD.fitness.scale_percentile).astype(np.float64)
    wanted, samples = bounded_misfit(domain, "base_lobe", own, STANDARD.prefit, scale)
    assert (samples >= 10).all()
    np.testing.assert_allclose(fitness, wanted, rtol=5e-3, atol=1e-4)


# ---- what never changes ------------------------------------------------------------------------------------------


SHORT = STANDARD.replaced(
    iterations=2,
    prefit_iterations=3,
    prefit_refinement_iterations=3,
    refinement_iterations=2,
    refinement_start_iterations=1,
)


@pytest.fixture(scope="module")
def whole(uneven):
    """(domain, the maps of an uninterrupted recovery as bytes, its progress)."""
    with Recovery(uneven[0], PRINCIPLED, SHORT, 1, entry="fragment") as recovery:
        progress = recovery.step()
        return uneven[0], bits_of(recovery.maps(confidence=False)), progress


def test_slices_give_the_whole_bit_for_bit(recover, whole):
    domain, wanted, progress = whole
    sliced = recover(domain, PRINCIPLED, SHORT)
    while not sliced.step(time_budget_s=1e-4).done:
        sliced.maps(confidence=False)
    assert bits_of(sliced.maps(confidence=False)) == wanted and sliced.progress == progress


@pytest.mark.parametrize("stop", [None, 0, 2, 3, 5, 6, 7, 10], ids=lambda n: f"after-{n}")
def test_a_checkpoint_resumes_to_the_same_maps(recover, whole, tmp_path, stop):
    # Before all; in the prefit's swarm, at its end, in its refinement, at its end; in the stage; in the refinement.
    domain, wanted, progress = whole
    first = recover(domain, PRINCIPLED, SHORT)
    if stop is not None:
        first.step(iterations=stop)
    first.save(tmp_path / "run")
    second = recover(domain, PRINCIPLED, SHORT)
    second.step(iterations=1)
    second.load(tmp_path / "run")
    assert second.progress == first.progress
    second.step()
    assert bits_of(second.maps(confidence=False)) == wanted and second.progress == progress


def test_a_run_in_the_prefits_refinement_loads_a_checkpoint_of_its_swarm(recover, whole, tmp_path):
    domain, wanted, _ = whole
    recovery = recover(domain, PRINCIPLED, SHORT)
    recovery.step(iterations=1)
    recovery.save(tmp_path / "run")
    recovery.step(iterations=4)
    recovery.load(tmp_path / "run")
    recovery.step()
    assert bits_of(recovery.maps(confidence=False)) == wanted


# ---- real captures -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "limit"),
    # Trimmed least squares has 2.6°; the best of the Lambertian peers, tuned against the truth, 2.04°.
    [("bunny_lambert", 1.0), ("bunny_specular", 1.7)],
)
def test_normals_of_a_rendered_bunny_are_recovered_without_tuning(recover, shared_data, name, limit):
    folder = shared_data / name
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    domain = domain_from_card(read_capture(folder, decode))
    channels = read_exr(folder / "normal_gt.exr")[""]
    truth = np.stack([channels[c] for c in "RGB"], axis=-1)
    rows, columns = domain.shape
    block = np.random.default_rng(0).random((-(-rows // 8), -(-columns // 8))) < 1 / 4
    chosen = np.kron(block, np.ones((8, 8), bool))[:rows, :columns]
    domain = masked(domain, chosen)
    recovery = recover(domain, PRINCIPLED, load_schedule("standard"))
    recovery.step()
    maps = recovery.maps(confidence=False)
    error = degrees(maps, truth)[maps.solved]
    assert error.size > 4000
    assert error.mean() < limit, error.mean()
