"""Maps that repeat: against functions that repeat by themselves, brute force, and analytic reliefs, in float64."""

import itertools

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from irpso_addon.core.errors import InputError
from irpso_addon.geometry.relief.periodic import periodic_height
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.seamless import cheapest_path, largest_square, seamless

MODEL = load_model("metallic_roughness")


def maps(shape, seed=0, grain=2.0):
    """Random maps of a rough card, one picture in roughness and metallic."""
    random = np.random.default_rng(seed)

    def texture(channels):
        noise = gaussian_filter(random.normal(size=(*shape, channels)), (grain, grain, 0))
        return 0.5 + 0.12 * noise / noise.std()

    normal = np.concatenate([texture(2) - 0.5, np.ones((*shape, 1))], axis=-1)
    shared = np.clip(texture(1), 0, 1)
    values = {"normal": normal / np.linalg.norm(normal, axis=-1, keepdims=True), "roughness": shared,
              "metallic": shared, "base_color": np.clip(texture(3), 0, 1)}  # fmt: skip
    values["specular"] = np.full((*shape, 1), 0.5)
    return values


def waves(side, period, channels, phase):
    """A function of places that repeats after ``period`` texels in both directions."""
    x, y = np.meshgrid(*[2 * np.pi * np.arange(side) / period] * 2)
    return np.stack([0.5 + 0.2 * np.sin(x + phase + c) * np.cos(2 * y - c) for c in range(channels)], axis=-1)


def test_maps_that_repeat_by_themselves_stay_as_they_are():
    values = {p.name: waves(192, 144, p.components, k) for k, p in enumerate(MODEL.parameters)}
    values["normal"] = np.concatenate([waves(192, 144, 2, 3.0) - 0.5, np.ones((192, 192, 1))], axis=-1)
    values["normal"] /= np.linalg.norm(values["normal"], axis=-1, keepdims=True)
    found = seamless(MODEL, values, np.ones((192, 192), bool), size=144)
    for name, value in values.items():
        np.testing.assert_allclose(found.values[name], value[:144, :144], atol=1e-6)


def test_random_maps_show_no_seam_are_cut_along_one_path_and_stay_materials():
    values = maps((200, 220))
    found = seamless(MODEL, values, np.ones((200, 220), bool))
    assert found.values["normal"].shape == (128, 128, 3) and found.crop[2] == 200
    assert found.seam < 1.2 < 2 < found.plain
    np.testing.assert_allclose(found.values["roughness"], found.values["metallic"], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(found.values["normal"], axis=-1), 1, atol=1e-5)
    for axis in (0, 1):
        image = found.values["base_color"]
        over_border = np.abs(image.take(0, axis) - image.take(-1, axis)).mean()
        assert over_border == pytest.approx(np.abs(np.diff(image, axis=axis)).mean(), rel=0.4)
    detail = [np.std(one - gaussian_filter(one, (3, 3, 0))) for one in (image, values["base_color"])]
    assert detail[0] == pytest.approx(detail[1], rel=0.2), "a cross-fade would blur"


def test_smooth_maps_have_no_jump_anywhere_not_even_where_the_paths_close():
    """Three seeds: where a path ends in another column than it began in, few texels jump."""
    for seed in range(3):
        found = seamless(MODEL, maps((160, 160), seed, grain=9.0), np.ones((160, 160), bool), size=120)
        image = found.values["base_color"]
        for axis in (0, 1):
            steps = np.abs(np.diff(np.concatenate([image, image.take([0], axis)], axis), axis=axis))
            over_border = steps.take(-1, axis)
            assert over_border.max() < np.quantile(steps, 0.999)


def test_the_joint_is_as_wide_as_a_pattern_needs_to_continue():
    """Waves of 34 columns and 29 rows with some grain; at a quarter of the side 8.8 and 10.3 of them would repeat."""
    values, covered = maps((400, 400), seed=5), np.ones((400, 400), bool)
    x, y = np.meshgrid(2 * np.pi * np.arange(400) / 34, 2 * np.pi * np.arange(400) / 29)
    pattern = np.stack([0.5 + 0.2 * np.sin(x + c) * np.cos(y - c) for c in range(3)], axis=-1)
    values["base_color"] = pattern + 0.02 * (values["base_color"] - 0.5)
    found = seamless(MODEL, values, covered, size=0)
    assert (found.period[0] + 2) % 34 <= 4 and (found.period[1] + 2) % 29 <= 4
    assert found.period[0] / found.period[1] == pytest.approx(1, abs=0.035)
    given = seamless(MODEL, values, covered, size=0, overlap=0.25)
    assert given.period == (300, 300)
    # Of waves that continue over the border all power is in one frequency: four bins of a real picture.
    spectra = [np.abs(np.fft.fft2(cut.values["base_color"][..., 0])) ** 2 for cut in (found, given)]
    pure, broken = (np.sort(s.ravel()[1:])[-4:].sum() / s.ravel()[1:].sum() for s in spectra)
    assert pure > 0.95 > 0.8 > broken


def test_a_slow_change_of_colour_ends_nowhere():
    values = maps((160, 160), seed=3)
    values["base_color"] = np.clip(values["base_color"] + np.linspace(-0.2, 0.2, 160)[:, None], 0, 1)
    found = seamless(MODEL, values, np.ones((160, 160), bool), size=120).values["base_color"]
    smooth = gaussian_filter(found, (6, 6, 0), mode="wrap")
    steps = np.abs(np.diff(np.tile(smooth, (1, 2, 1)), axis=1)).mean(axis=(0, 2))
    assert steps.max() < 4 * np.median(steps)


def test_the_cheapest_path_is_that_of_brute_force_and_a_wrapped_one_closes():
    random = np.random.default_rng(1)
    for _ in range(5):
        cost = random.random((5, 4))
        paths = [p for p in itertools.product(range(4), repeat=5) if (np.abs(np.diff(p)) <= 1).all()]
        best = min(paths, key=lambda path: sum(cost[row, column] for row, column in enumerate(path)))
        np.testing.assert_array_equal(cheapest_path(cost), best)
        closed = cheapest_path(random.random((30, 8)), wraps=True)
        assert (np.abs(np.diff([*closed, closed[0]])) <= 1).all() and len(closed) == 30


def test_the_largest_square_is_that_of_brute_force():
    random = np.random.default_rng(2)
    for _ in range(5):
        covered = random.random((9, 12)) < 0.85
        sides = [
            n for n in range(1, 10) for y in range(10 - n) for x in range(13 - n) if covered[y : y + n, x : x + n].all()
        ]
        x, y, side = largest_square(covered)
        assert side == max(sides) and covered[y : y + side, x : x + side].all()


@pytest.mark.parametrize("side", [64, 65, 66, 67])
def test_half_of_any_side_can_overlap(side):
    found = seamless(MODEL, maps((side, side)), np.ones((side, side), bool), size=0, overlap=0.5)
    assert found.period == (side - side // 2,) * 2
    assert found.values["specular"].shape[:2] == found.period


@pytest.mark.parametrize("side", [32, 40, 49])
def test_the_least_overlap_serves_small_squares(side):
    found = seamless(MODEL, maps((side, side)), np.ones((side, side), bool), size=0, overlap=0.05)
    assert found.period == (side - 3,) * 2 and np.isfinite(found.seam)


def test_a_card_that_is_too_small_is_refused():
    with pytest.raises(InputError, match="largest square without holes has 20 texels"):
        seamless(MODEL, maps((20, 60)), np.ones((20, 60), bool))


def test_the_height_of_a_relief_that_repeats_is_the_relief():
    x, y = np.meshgrid(2 * np.pi * np.arange(64) / 64, 2 * np.pi * np.arange(48) / 48)
    relief = 2 * np.sin(x) * np.cos(2 * y) + np.cos(3 * x)
    slope_x = (2 * np.cos(x) * np.cos(2 * y) - 3 * np.sin(3 * x)) * 2 * np.pi / 64
    slope_y = -4 * np.sin(x) * np.sin(2 * y) * 2 * np.pi / 48
    normal = np.stack([-slope_x, -slope_y, np.ones_like(relief)], axis=-1)
    found = periodic_height(normal / np.linalg.norm(normal, axis=-1, keepdims=True))
    np.testing.assert_allclose(found.values, relief - relief.mean(), atol=1e-4)
