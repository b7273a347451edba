"""Lights, sensor and scores of the benchmarks' scenes."""

import numpy as np
import pytest

from benchmarks.scenes.lights import dome_lights, grid_lights, seen_and_unseen, uneven_intensities
from benchmarks.scenes.resample import resampled
from irpso_addon.sample.sensor import Sensor

scores = pytest.importorskip("benchmarks.scenes.scores", reason="scores need scipy")


def test_grid_lights_are_unit_vectors_that_fill_the_angles_asked_for():
    lights = grid_lights(12, 8, (45, 35))
    assert lights.shape == (96, 3)
    np.testing.assert_allclose((lights**2).sum(axis=-1), 1, rtol=1e-12)
    side, up = np.degrees(np.arctan2(lights[:, 0], lights[:, 2])), np.degrees(np.arctan2(lights[:, 1], lights[:, 2]))
    assert side.max() == pytest.approx(45, abs=1) and side.min() == pytest.approx(-45, abs=1)
    assert up.max() == pytest.approx(35, abs=1) and up.min() == pytest.approx(-35, abs=1)
    assert up[0] > 0 > side[0]  # the first light stands at the upper left


def test_dome_lights_are_spread_evenly_over_their_cap():
    lights = dome_lights(400, 60)
    # Archimedes: equal areas of a sphere lie between equally spaced heights; a cap's mean height is its middle.
    assert lights[:, 2].mean() == pytest.approx((1 + 0.5) / 2, abs=1e-9)
    assert np.abs(lights[:, :2].mean(axis=0)).max() < 0.01
    assert lights[:, 2].min() > np.cos(np.radians(60))


def test_the_unseen_lights_are_five_to_ten_degrees_from_those_of_the_capture():
    seen, unseen = seen_and_unseen()
    assert len(seen) == 40 and len(unseen) == 10
    nearest = np.degrees(np.arccos((unseen @ seen.T).max(axis=-1)))
    assert nearest.min() > 5 and nearest.max() < 10.5


def test_intensities_stay_inside_their_range_and_differ():
    values = uneven_intensities(96, 1.5, 6)
    assert values.min() >= 1.5 and values.max() <= 6 and values.mean(axis=-1).std() > 0.8


def test_the_sensors_noise_has_the_variance_of_read_and_shot_noise():
    sensor = Sensor(gain=0.5, read=0.001, shot=0.004)
    for radiance in (0.4, 1.6):
        exposed = sensor.expose(np.full(200_000, radiance), seed=3)
        expected = np.sqrt(0.001**2 + 0.004**2 * 0.5 * radiance)
        assert exposed.mean() == pytest.approx(0.5 * radiance, abs=4 * expected / np.sqrt(200_000))
        assert exposed.std() == pytest.approx(expected, rel=0.01)


def test_the_sensor_saturates_and_counts_in_steps_of_16_bits():
    exposed = Sensor(gain=1.0).expose(np.linspace(0, 2, 1001), seed=0)
    assert (exposed[600:] == 1).all() and exposed.min() >= 0
    np.testing.assert_allclose(exposed * 65535, np.round(exposed * 65535), atol=1e-9)


def test_ssim_is_the_formula_of_wang_summed_window_by_window():
    rng = np.random.default_rng(1)
    a = rng.random((24, 27, 1))
    b = np.clip(a + 0.2 * rng.standard_normal(a.shape), 0, 1)
    mask = np.zeros((24, 27), bool)
    mask[8:15, 9:16] = True
    offsets = np.arange(-5, 6)
    window = np.exp(-(offsets[:, None] ** 2 + offsets[None] ** 2) / (2 * 1.5**2))
    window /= window.sum()
    total = []
    x, y = a[..., 0] * mask, b[..., 0] * mask
    for i, j in np.argwhere(mask):
        p, q = (v[i - 5 : i + 6, j - 5 : j + 6] for v in (x, y))
        mp, mq = (window * p).sum(), (window * q).sum()
        vp, vq = (window * (p - mp) ** 2).sum(), (window * (q - mq) ** 2).sum()
        cov = (window * (p - mp) * (q - mq)).sum()
        total.append((2 * mp * mq + 0.0001) * (2 * cov + 0.0009) / ((mp**2 + mq**2 + 0.0001) * (vp + vq + 0.0009)))
    assert scores.ssim(a, b, mask) == pytest.approx(np.mean(total), abs=1e-9)
    assert scores.ssim(a, a, mask) == pytest.approx(1)


def test_psnr_counts_only_what_the_mask_shows():
    a = np.zeros((4, 4, 3))
    b = np.full((4, 4, 3), 0.9)
    mask = np.zeros((4, 4), bool)
    mask[1, 2] = True
    b[1, 2] = 0.1
    assert scores.psnr(a, b, mask) == pytest.approx(20.0)


def test_angles_keep_their_digits_where_they_are_small():
    tilt = 1e-6
    other = np.array([np.sin(tilt), 0, np.cos(tilt)])
    assert scores.angles(np.array([0.0, 0, 1]), other) == pytest.approx(np.degrees(tilt), rel=1e-6)
    assert scores.angles(np.array([0.0, 0, 1]), np.array([0.0, 1, 0])) == pytest.approx(90)


def test_resampling_keeps_a_wave_that_fits_and_its_place():
    def wave(size):
        middles = (np.arange(size) + 0.5) / size
        return np.sin(2 * np.pi * (middles[:, None] + 2 * middles[None])) + 0.3

    found = resampled(wave(512), 128, 64)
    assert found.shape == (128, 128)
    np.testing.assert_allclose(found, wave(128), atol=0.012)  # linear between 32 points of a wave: (π/32)²/2 + block


def test_resampling_to_the_same_detail_takes_the_mean_of_blocks():
    values = np.random.default_rng(0).random((8, 8, 3))
    np.testing.assert_allclose(resampled(values, 4, 4)[1, 2], values[2:4, 4:6].mean(axis=(0, 1)))
