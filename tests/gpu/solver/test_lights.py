"""Intensities and directions of lights found together with the texels' own materials."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.core.paths import MODELS
from irpso_addon.geometry.domain import subset, with_samples
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.lights.contradiction import contradiction
from irpso_addon.solver.lights.fit import Moving, axes_of
from irpso_addon.solver.lights.refine import estimate_lights, light_steps
from tests.builders.domains import unit
from tests.builders.lights import apart, gains, off, photographed, subject

pytestmark = pytest.mark.usefixtures("gpu")

LAMBERT, PRINCIPLED = load_model("lambert"), load_model("principled")


def turned_lights(domain, degrees, rng):
    """The domain with its distant lights turned by so much (one standard deviation along each of two axes)."""
    true = domain.lights[:, :3].astype(np.float64)
    aside = rng.normal(size=true.shape)
    aside -= (aside * true).sum(axis=-1, keepdims=True) * true
    lights = np.pad(unit(true + np.radians(degrees) * aside), ((0, 0), (0, 1)))
    return replace(domain, lights=lights.astype(np.float32))


def apart_but_for_a_rotation(found, true):
    """Degrees between unit vectors after the one rotation that brings them nearest (Kabsch 1976)."""
    u, _, vt = np.linalg.svd(found.T @ true)
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return apart(found @ rotation, true)


@pytest.mark.parametrize(
    ("model", "options"),
    [
        ("principled", {}),
        ("principled", {"card": False, "near": True, "perspective": True}),
        ("lambert", {"slope": 0.1}),  # normals 3° from the axis
    ],
)
def test_unknown_intensities_are_found_within_two_per_cent(model, options):
    rng = np.random.default_rng(2)
    domain, _ = subject(model, 20, **options)
    true = gains(20, rng)
    found = estimate_lights(photographed(domain, true, rng), load_model(model))
    assert off(found.factors, true).max() < 0.02
    assert off(found.factors, true).mean() < 0.006
    np.testing.assert_allclose(found.intensities, domain.intensities * found.factors, rtol=1e-6)
    np.testing.assert_array_equal(found.lights, domain.lights)
    assert any("nearly flat" in line for line in found.warnings()) == ("slope" in options)
    # What they are told to be off by is what they are off by, within a factor of three.
    assert 1 / 3 < off(found.factors, true).mean() / (0.8 * found.deviations.mean()) < 3


def test_directions_that_are_2_degrees_off_are_refined_along_with_unknown_intensities():
    rng = np.random.default_rng(3)
    domain, _ = subject("principled", 20)
    true = gains(20, rng)
    wrong = turned_lights(photographed(domain, true, rng), 2, rng)
    vectors = domain.lights[:, :3].astype(np.float64)
    before = apart_but_for_a_rotation(wrong.lights[:, :3], vectors).mean()
    found = estimate_lights(wrong, PRINCIPLED, refine_degrees=2)
    after = apart_but_for_a_rotation(found.lights[:, :3], vectors)
    assert before > 2
    assert after.mean() < 0.25
    assert apart(found.lights[:, :3], vectors).mean() < 0.7  # lights and normals may turn together
    np.testing.assert_allclose(found.turned, apart(found.lights[:, :3], wrong.lights[:, :3]), rtol=0.02, atol=0.01)
    assert off(found.factors, true).max() < 0.02


@pytest.mark.parametrize(("model", "least", "most"), [("principled", 0.2, 4.0), ("lambert", 8.0, 20.0)])
def test_highlights_tell_a_common_rotation_but_for_that_about_the_view_and_matt_shading_tells_none(model, least, most):
    rng = np.random.default_rng(3)
    domain, _ = subject(model, 20)
    found = estimate_lights(photographed(domain, gains(20, rng), rng), load_model(model), refine_degrees=10)
    across, up, about = np.degrees(np.sqrt(np.diag(found.rotation)))
    print(f"deviations {across:.2f}°, {up:.2f}°, {about:.2f}°")
    assert least < min(across, up) and max(across, up) < most and about > 8
    assert (estimate_lights(domain, load_model(model)).rotation == 0).all()


def test_an_observation_that_is_held_out_changes_no_other_and_gets_the_intensity_of_its_image():
    rng = np.random.default_rng(4)
    domain, _ = subject("lambert", 13)
    true = gains(13, rng)
    domain = photographed(domain, true, rng, shadow=0.05)
    fitted = [k for k in range(13) if k != 5]
    found = estimate_lights(domain, LAMBERT, fitted=fitted)
    assert off(found.factors, true).max() < 0.02
    spoilt = domain.stack.values.copy()
    spoilt[5, ..., :3] *= 7
    other = estimate_lights(with_samples(domain, spoilt), LAMBERT, fitted=fitted)
    np.testing.assert_array_equal(other.factors[fitted], found.factors[fitted])
    np.testing.assert_allclose(other.factors[5], 7 * found.factors[5], rtol=1e-4)


def test_the_same_seed_gives_the_same_lights_bit_for_bit_and_the_work_comes_in_slices():
    rng = np.random.default_rng(5)
    domain, _ = subject("lambert", 8, shape=(16, 16))
    domain = photographed(domain, gains(8, rng), rng)
    first = estimate_lights(domain, LAMBERT, seed=4)
    steps, fractions = light_steps(domain, LAMBERT, seed=4), []
    try:
        while True:
            fractions.append(next(steps))
    except StopIteration as stop:
        second = stop.value
    assert first.intensities.tobytes() == second.intensities.tobytes()
    assert len(fractions) > 20
    assert (np.diff(fractions) >= -1e-9).all()
    assert fractions[0] >= 0
    assert fractions[-1] <= 1


def test_images_brighter_than_white_scale_all_intensities():
    rng = np.random.default_rng(6)
    domain, truth = subject("lambert", 12)
    true = gains(12, rng)
    found = estimate_lights(photographed(domain, 6 * true, rng, shadow=0.05), LAMBERT)
    assert off(found.factors, true).max() < 0.02
    common = np.exp(np.log(found.factors / true).mean())
    assert 6 * truth["base_color"].max() / common < 1.1  # the albedo that is found


def test_only_contradicted_intensities_get_a_warning():
    rng = np.random.default_rng(7)
    domain, truth = subject("principled", 16)
    values = {name: np.float32(value) for name, value in truth.items()}
    same = photographed(domain, np.ones((16, 3)), rng)
    assert contradiction(same, PRINCIPLED, values, frozenset()) == ""
    text = contradiction(photographed(domain, gains(16, rng), rng), PRINCIPLED, values, frozenset())
    assert "--intensities estimate" in text


def test_a_users_radiance_that_is_not_finite_is_named_and_the_maps_are_made_all_the_same(tmp_path):
    for kind in ("toml", "glsl"):
        text = (MODELS / f"lambert.{kind}").read_text(encoding="utf-8")
        (tmp_path / f"mine.{kind}").write_text(text.replace("Fd_Lambert(NoL)", "sqrt(-NoL)"), encoding="utf-8")
    domain, truth = subject("lambert", 6, shape=(8, 8))
    values = {name: np.float32(value) for name, value in truth.items()}
    text = contradiction(domain, load_model(tmp_path / "mine.toml"), values, frozenset())
    assert "mine.glsl: its radiance is not finite for some materials" in text and "guard its divisions" in text
    with pytest.raises(InputError, match="is not finite"):
        estimate_lights(domain, load_model(tmp_path / "mine.toml"))


def test_lights_move_along_their_axes():
    domain, _ = subject("lambert", 6, shape=(8, 8))
    moves = np.zeros((6, 3))
    moves[:, 0] = np.radians(1.5)
    after = Moving(domain.lights, axes_of(domain), moves, 0.1).lights()
    np.testing.assert_allclose(apart(after[:, :3], domain.lights[:, :3]), 1.5, rtol=1e-3)
    near, _ = subject("lambert", 6, shape=(8, 8), near=True)
    axes = axes_of(near)
    middle = near.bake.position.reshape(-1, 3).mean(axis=0)
    distance = np.linalg.norm(near.lights[:, :3] - middle, axis=-1)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=-1), np.repeat(distance[:, None], 3, axis=1), rtol=1e-5)
    np.testing.assert_allclose(np.einsum("kac,kbc->kab", axes, axes)[:, 0, 1:], 0, atol=1e-5)


def test_three_lights_do_not_determine_their_intensities_unless_normals_are_known():
    domain, truth = subject("lambert", 6, shape=(8, 8))
    with pytest.raises(InputError, match="3 different lights do not determine their intensities or directions"):
        estimate_lights(subset(domain, [0, 1, 2]), LAMBERT)
    with pytest.raises(InputError, match="3 different lights do not determine"):
        estimate_lights(subset(domain, [0, 1, 2]), LAMBERT, intensities=False, refine_degrees=3)
    twice = subset(domain, [0, 1, 2, 2])
    with pytest.raises(InputError, match="3 different lights do not determine"):
        estimate_lights(twice, LAMBERT)
    known = estimate_lights(subset(domain, [0, 1, 2]), LAMBERT, fixed={"normal": np.float32(truth["normal"])})
    np.testing.assert_allclose(known.factors / known.factors.mean(axis=0), 1, atol=0.01)


@pytest.mark.parametrize(("degrees", "intensities"), [(30, True), (-1, True), (0, False)])
def test_invalid_light_options_are_refused(degrees, intensities):
    domain, _ = subject("lambert", 6, shape=(8, 8))
    with pytest.raises(InputError):
        estimate_lights(domain, LAMBERT, intensities=intensities, refine_degrees=degrees)
    with pytest.raises(InputError, match="three observations"):
        estimate_lights(subset(domain, [0, 1]), LAMBERT)
