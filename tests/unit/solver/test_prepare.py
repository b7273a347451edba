"""Before the search: scales, shadow weights and the Lambertian guess, against numpy's percentile and lstsq."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.geometry.domain import tile, with_samples
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state import prepare
from tests.builders.domains import make_domain, unit, with_radiance
from tests.oracles.swarm import direction_to, frames, turned

LENS = {"near": True, "colored": True}


def grey_of(domain, y, x):
    """Return the weighted samples of a texel, as grey radiance over the light's grey intensity."""
    samples = domain.stack.values[:, y, x].astype(np.float64)
    keep = samples[:, 3] > 0
    return samples[keep, :3].mean(axis=1) / domain.intensities[keep].astype(np.float64).mean(axis=1)


@pytest.mark.parametrize("percentile", [1, 50, 80, 100])
@pytest.mark.parametrize("options", [{}, {"colored": True}, {"observations": 1}, {"observations": 2}], ids=str)
def test_the_scale_is_the_percentile_of_the_weighted_samples(percentile, options):
    domain = make_domain(9, 7, **options)
    scale = prepare.texel_scale(domain, percentile)
    for y, x in np.ndindex(domain.shape):
        wanted = np.percentile(grey_of(domain, y, x), percentile) if domain.solvable[y, x] else 1.0
        assert scale[y, x] == pytest.approx(wanted, rel=1e-5)


def test_a_texel_that_is_black_has_the_scale_1():
    domain = make_domain(3, 3, holes=False)
    domain.stack.values[:, 1, 1, :3] = 0
    domain = with_samples(domain, domain.stack.values)
    assert prepare.texel_scale(domain, 80)[1, 1] == 1


def test_the_scale_of_a_texel_that_few_lights_reach_is_that_of_its_light():
    domain = make_domain(3, 3, holes=False)
    values = domain.stack.values.copy()
    values[2:, 1, 1, :3] = 0
    domain = with_samples(domain, values)
    grey = grey_of(domain, 1, 1)
    wanted = np.percentile(grey[grey > 0], 50)
    assert prepare.texel_scale(domain, 50)[1, 1] == pytest.approx(wanted, rel=1e-5)


def test_samples_under_the_shadow_threshold_weigh_nothing():
    domain = make_domain(9, 7, colored=True)
    fitness = load_schedule("swarm").fitness
    fitness = replace(fitness, loss="cauchy", shadow=0.5)
    scale = prepare.texel_scale(domain, 80)
    stack = domain.stack.values.copy()
    prepare.drop_shadow(stack, domain.lights, domain.intensities, domain.bake.position, scale, fitness)
    for y, x in np.argwhere(domain.solvable):
        before = domain.stack.values[:, y, x].astype(np.float64)
        grey = before[:, :3].mean(axis=1) / domain.intensities.mean(axis=1)
        wanted = np.where((before[:, 3] > 0) & (grey >= 0.5 * scale[y, x]), before[:, 3], 0)
        np.testing.assert_array_equal(stack[:, y, x, 3], wanted.astype(np.float32))
    assert 0 < (stack[..., 3] > 0).sum() < (domain.stack.values[..., 3] > 0).sum()


@pytest.mark.parametrize("distance", [0.3, 3.0])
def test_the_distance_of_near_lights_does_not_matter_to_scale_and_shadow(distance):
    rng = np.random.default_rng(3)
    domain = make_domain(5, 4, holes=False)
    count = domain.observations
    place = np.concatenate([rng.normal(size=(count, 2)) * 0.2, np.ones((count, 1))], axis=1)
    lights = np.concatenate([distance * place, np.ones((count, 1))], axis=1)
    toward = lights[:, None, None, :3] - domain.bake.position
    squared = (toward.astype(np.float64) ** 2).sum(axis=-1)
    shade = rng.uniform(0.1, 1.0, squared.shape)  # radiance under an irradiance of π
    radiance = shade[..., None] * domain.intensities[:, None, None].mean(axis=-1, keepdims=True) / squared[..., None]
    stack = np.concatenate([np.repeat(radiance, 3, axis=-1), np.ones((*shade.shape, 1))], axis=-1).astype(np.float32)
    near = replace(with_samples(domain, stack), lights=lights)
    scale = prepare.texel_scale(near, 80)
    np.testing.assert_allclose(scale, np.percentile(shade, 80, axis=0), rtol=1e-5)
    assert prepare.mean_irradiance(near) == pytest.approx(domain.intensities.mean() * (1 / squared).mean(), rel=1e-6)
    fitness = replace(load_schedule("swarm").fitness, loss="cauchy", shadow=0.5)
    prepare.drop_shadow(stack, lights, domain.intensities, domain.bake.position, scale, fitness)
    np.testing.assert_array_equal(stack[..., 3] > 0, shade >= 0.5 * scale)


@pytest.mark.parametrize("change", [{"loss": "l1"}, {"loss": "l2"}, {"shadow": 0.0}])
def test_only_a_robust_fitness_with_a_threshold_drops_shadow(change):
    domain = make_domain(5, 4)
    stack = domain.stack.values.copy()
    fitness = replace(replace(load_schedule("swarm").fitness, loss="cauchy", shadow=0.9), **change)
    prepare.drop_shadow(stack, domain.lights, domain.intensities, domain.bake.position, np.ones(domain.shape), fitness)
    np.testing.assert_array_equal(stack, domain.stack.values)


@pytest.mark.parametrize("options", [{}, {"card": False}, LENS, LENS | {"card": False}], ids=str)
def test_light_vectors_are_unit_in_the_texels_frame_and_fall_with_the_square(options):
    domain = make_domain(4, 5, **options)
    texels = np.nonzero(domain.solvable)
    vectors, irradiance = prepare.light_vectors(domain, texels)
    frame, position = frames(domain.bake), domain.bake.position.astype(np.float64)
    for k in range(domain.observations):
        toward, squared = direction_to(domain.lights[k], position)
        # One texel stands for all where they share their lights, as on a card under distant ones.
        everywhere = np.broadcast_to(vectors[k], (len(texels[0]), 3))
        np.testing.assert_allclose(everywhere, turned(frame, toward)[texels], atol=1e-6)
        expected = (domain.intensities[k] / squared)[texels]
        np.testing.assert_allclose(np.broadcast_to(irradiance[k], expected.shape), expected, rtol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=-1), 1, rtol=1e-6)


def trimmed_fit(domain, y, x):
    """Return normal and albedo of one texel by lstsq over its lit samples between the 20th and 75th percentile."""
    frame, position = frames(domain.bake)[y, x], domain.bake.position[y, x].astype(np.float64)
    rows, shades = [], []
    for k in range(domain.observations):
        toward, squared = direction_to(domain.lights[k], position)
        if domain.stack.values[k, y, x, 3] > 0:
            rows.append(frame @ toward)
            shades.append(domain.stack.values[k, y, x, :3] / (domain.intensities[k] / squared))
    if not rows:
        return np.array([0, 0, 1.0]), np.zeros(3)
    rows, shades = np.array(rows), np.array(shades, np.float64)
    grey = shades.mean(axis=1)
    lit = grey > 0
    low, high = np.percentile(grey[lit], [20, 75])
    kept = lit & (grey >= low) & (grey <= high)
    kept = kept if kept.sum() >= 3 else lit
    if kept.sum() < 3:
        return np.array([0, 0, 1.0]), None
    scaled = np.linalg.lstsq(rows[kept], grey[kept], rcond=None)[0]
    scaled[2] = max(scaled[2], 0)
    normal = scaled / np.linalg.norm(scaled)
    cosine = np.maximum(rows[kept] @ normal, 0)
    return normal, (cosine[:, None] * shades[kept]).sum(axis=0) / max((cosine**2).sum(), 1e-8)


@pytest.mark.parametrize("options", [{}, {"card": False, "observations": 20}, LENS, {"observations": 3}], ids=str)
def test_the_seed_is_a_trimmed_least_squares_fit_of_every_texel(options):
    domain = make_domain(7, 6, **({"observations": 15} | options))
    normals, albedos = prepare.lambert_fit(domain)
    assert np.isfinite(normals).all() and np.isfinite(albedos).all()
    for y, x in np.argwhere(domain.solvable):
        normal, albedo = trimmed_fit(domain, y, x)
        np.testing.assert_allclose(normals[y, x], normal, atol=2e-4)
        if albedo is not None:
            np.testing.assert_allclose(albedos[y, x], albedo, rtol=2e-3, atol=2e-4)
    np.testing.assert_allclose(normals[~domain.solvable], np.tile((0, 0, 1), ((~domain.solvable).sum(), 1)))


@pytest.mark.parametrize("options", [{}, {"card": False}, LENS | {"card": False}], ids=str)
def test_the_seed_of_a_lambertian_subject_is_the_subject(options):
    rng = np.random.default_rng(2)
    normal = unit(rng.normal(size=(7, 6, 3)) * 0.25 + (0, 0, 1))
    truth = {"normal": normal, "base_color": rng.uniform(0.1, 1, (7, 6, 3))}
    domain = with_radiance(make_domain(7, 6, observations=30, **options), "lambert", truth)
    domain.stack.values[3, ..., :3] = np.nan
    domain.stack.values[3, ..., 3] = 0
    found, albedo = prepare.lambert_fit(domain)
    lit = ((domain.stack.values[..., 3] > 0) & (domain.stack.values[..., 0] > 0)).sum(axis=0)
    seen = domain.solvable & (lit >= 6)
    assert seen.sum() > 20
    assert (found[seen] * normal[seen]).sum(axis=-1).min() > 1 - 1e-6
    np.testing.assert_allclose(albedo[seen], truth["base_color"][seen], rtol=1e-4)


def test_a_highlight_and_a_shadow_do_not_move_the_seed():
    rng = np.random.default_rng(2)
    domain = make_domain(5, 5, observations=40, holes=False)
    truth = {"normal": unit(rng.normal(size=(5, 5, 3)) * 0.2 + (0, 0, 1)), "base_color": np.full((5, 5, 3), 0.5)}
    domain = with_radiance(domain, "lambert", truth)
    order = np.argsort(domain.stack.values[..., 0], axis=0)
    np.put_along_axis(domain.stack.values[..., 0], order[-6:], 5.0, axis=0)
    domain.stack.values[..., :3] = domain.stack.values[..., :1]
    np.put_along_axis(domain.stack.values[..., 0], order[:5], 1e-4, axis=0)
    normal, _ = prepare.lambert_fit(domain)
    assert (normal * truth["normal"]).sum(axis=-1).min() > np.cos(np.radians(0.1))


@pytest.mark.parametrize("options", [{}, {"holes": False}, LENS], ids=str)
def test_preparing_in_a_thread_gives_the_packed_stack_without_shadow(options):
    domain = make_domain(70, 61, observations=16, **options)  # more than one chunk
    schedule = load_schedule("swarm").replaced(shadow=0.4)
    with ThreadPoolExecutor(1) as pool:
        prepared = pool.submit(prepare.prepare, domain, load_model("lambert"), schedule).result()
    texels = np.nonzero(domain.solvable)
    samples = domain.stack.values[:, texels[0], texels[1]].astype(np.float64)
    squared = 1.0
    if domain.lights[0, 3]:
        squared = ((domain.lights[:, None, :3].astype(np.float64) - domain.bake.position[texels]) ** 2).sum(axis=-1)
    shade = samples[..., :3].mean(axis=-1) * squared / domain.intensities.astype(np.float64).mean(axis=1)[:, None]
    scale = np.nanpercentile(np.where(samples[..., 3] > 0, shade, np.nan), schedule.fitness.scale_percentile, axis=0)
    np.testing.assert_allclose(prepared.scale[texels], scale, rtol=1e-5)
    found = prepared.stack.reshape(16, -1, 4)
    count = len(texels[0])
    clear = np.abs(shade / (0.4 * scale) - 1) > 1e-5  # of the threshold, as far as float32 can tell
    wanted = np.where(shade >= 0.4 * scale, samples[..., 3], -samples[..., 3] / 2)  # shaders/common/observation.glsl
    np.testing.assert_array_equal(found[:, :count, 3][clear], wanted[clear].astype(np.float32))
    np.testing.assert_array_equal(found[:, :count, :3], domain.stack.values[:, texels[0], texels[1], :3])
    assert (found[:, count:] == 0).all() and 0 < (wanted > 0).mean() < 0.95
    places = prepared.arrays["u_geometry"][3].reshape(-1, 4)[:count, :2].astype(int)
    np.testing.assert_array_equal(places, np.stack(texels[::-1], axis=-1))


def test_a_prepared_part_has_the_numbers_of_the_whole():
    domain = make_domain(20, 30)
    whole = prepare.prepare(domain, load_model("lambert"), load_schedule("standard"), pack=False)
    assert whole.stack is None
    rows, columns = slice(3, 11), slice(5, 20)
    part = whole.part(rows, columns).packed(tile(domain, 5, 3, 15, 8), load_schedule("standard"))
    np.testing.assert_array_equal(part.scale, whole.scale[rows, columns])
    np.testing.assert_array_equal(part.guess["normal"], whole.guess["normal"][rows, columns])
    assert part.mean_irradiance == whole.mean_irradiance
    assert part.stack.shape[1:3] == part.arrays["u_geometry"].shape[1:3]


@pytest.mark.parametrize("box", [(5, 3, 1, 2), (0, 0, 1, 30), (3, 4, 20, 9), (11, 0, 30, 1), (12, 12, 1, 1)])
@pytest.mark.parametrize("options", [{}, LENS, {"card": False}, {"card": False, "observations": 40}], ids=str)
def test_a_part_prepared_by_itself_has_the_bits_of_the_whole(options, box):
    domain = make_domain(37, 41, holes=False, **options)
    x, y, width, height = box
    rows, columns = slice(y, y + height), slice(x, x + width)
    whole = prepare.prepare(domain, load_model("lambert"), load_schedule("standard"), pack=False).part(rows, columns)
    alone = prepare.prepare(tile(domain, *box), load_model("lambert"), load_schedule("standard"), pack=False)
    np.testing.assert_array_equal(alone.scale, whole.scale)
    for name, value in whole.guess.items():
        np.testing.assert_array_equal(alone.guess[name], value)


@pytest.mark.parametrize("options", [{}, LENS, {"near": True, "card": False}], ids=str)
def test_the_mean_irradiance_of_parts_adds_up_to_that_of_the_whole_exactly(options):
    domain = make_domain(37, 41, **options)
    sums, count = np.zeros(280, np.int64), 0
    for rows in (slice(20, 37), slice(0, 1), slice(1, 20)):
        counted = np.zeros(domain.shape, bool)
        counted[rows] = domain.solvable[rows]
        part, number = prepare.irradiance_sums(domain, counted)
        sums, count = sums + part, count + number
    assert prepare.mean_irradiance_of(domain, sums, count) == prepare.mean_irradiance(domain)
