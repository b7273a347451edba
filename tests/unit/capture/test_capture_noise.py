"""The noise of 8-bit photographs against noise that was added, with texture, highlights, shadows and JPEG."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.fft import dctn, idctn
from scipy.ndimage import gaussian_filter

from irpso_addon.capture.camera import Camera
from irpso_addon.capture.images.linearise import Picture, samples_of_picture
from irpso_addon.capture.inspect.report import inspect_capture
from irpso_addon.capture.noise import MAX_NOISE, MIN_NOISE, USUAL, NoiseEstimate, images_read, noise_of
from irpso_addon.capture.read import read_capture
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.core.encode import srgb_from_linear
from irpso_addon.core.steps import run_steps
from irpso_addon.geometry.build import domain_from_card
from tests.builders.captures import decode_png, write_png
from tests.oracles.reflectance import unit

SIZE = 64
# JPEG, ISO/IEC 10918-1, Table K.1, at the quality of 90 (a fifth of it).
TABLE = np.array(
    [[16, 11, 10, 16, 24, 40, 51, 61], [12, 12, 14, 19, 26, 58, 60, 55], [14, 13, 16, 24, 40, 57, 69, 56],
     [14, 17, 22, 29, 51, 87, 80, 62], [18, 22, 37, 56, 68, 109, 103, 77], [24, 35, 55, 64, 81, 104, 113, 92],
     [49, 64, 78, 87, 103, 121, 120, 101], [72, 92, 95, 98, 112, 100, 103, 99]]
)  # fmt: skip


def lights(count):
    turn = 2.4 * np.arange(count)
    return unit(np.stack([0.7 * np.cos(turn), 0.7 * np.sin(turn), 0.6 + 0.05 * np.arange(count) % 0.4], axis=-1))


def clean(count=12, texture=1.0, relief=0.15, seed=0):
    """(K, H, W, 3) codes without noise: slopes of ``relief`` root mean square, pixel-sized texture, a highlight."""
    rng = np.random.default_rng(seed)
    albedo = 0.45 * (1 - texture * rng.uniform(0, 0.8, (SIZE, SIZE, 3)))
    slopes = gaussian_filter(rng.normal(size=(SIZE, SIZE, 2)), (3, 3, 0), mode="wrap")
    slopes *= relief / slopes.std()
    normals = unit(np.concatenate([slopes, np.ones((SIZE, SIZE, 1))], axis=-1))
    shade = np.maximum(np.einsum("hwc,kc->khw", normals, lights(count)), 0)
    glint = 0.1 * np.maximum(np.einsum("hwc,kc->khw", normals, unit(lights(count) + (0, 0, 1))), 0) ** 40
    return 255 * srgb_from_linear(albedo * shade[..., None] + glint[..., None])


def noisy(codes, deviation, seed=1):
    return codes + deviation * np.random.default_rng(seed).normal(size=codes.shape)


def jpeg(codes, table=TABLE / 5):
    """What JPEG makes of (K, H, W, 3) codes, channel by channel: blocks of 8 × 8 whose cosine transform is rounded."""
    count, height, width, _ = codes.shape
    blocks = np.round(codes).reshape(count, height // 8, 8, width // 8, 8, 3)
    found = dctn(blocks, axes=(2, 4), norm="ortho")
    step = table[None, None, :, None, :, None]
    return idctn(np.round(found / step) * step, axes=(2, 4), norm="ortho").reshape(codes.shape)


def capture_of(codes, coarse=True, mask=None, cameras=1):
    codes = np.clip(np.round(codes), 0, 255).astype(np.float32)

    def reader(image):
        return lambda: samples_of_picture(Picture(image / np.float32(255), 8)).bounds

    shots = tuple(
        Observation(f"{k:03}", reader(image), Light(tuple(light)), k % cameras, coarse)
        for k, (image, light) in enumerate(zip(codes, lights(len(codes)), strict=True))
    )
    height, width = codes.shape[1:3]
    mask = np.ones((height, width), bool) if mask is None else mask
    return Capture("c", shots, (Camera.orthographic(width, height, 2.0),) * cameras, (mask,) * cameras)


def found(codes, **options):
    return 255 * run_steps(noise_of(capture_of(codes, **options)))


@pytest.mark.parametrize("deviation", [1.5, 3.0, 6.0])
@pytest.mark.parametrize("texture", [0.0, 1.0])
def test_the_noise_that_was_added_is_found_whatever_the_texture(deviation, texture):
    assert found(noisy(clean(texture=texture), deviation)) == pytest.approx(deviation)


def test_texture_without_noise_is_not_taken_for_noise():
    assert found(clean(texture=1.0)) == 255 * MIN_NOISE


@pytest.mark.parametrize("deviation", [1.5, 3.0])
def test_noise_is_measured_through_jpeg(deviation):
    truth = clean(texture=0.0)
    spoiled = jpeg(noisy(truth, deviation))
    assert found(spoiled) == pytest.approx((spoiled - truth).std(), rel=0.25)


def test_cast_shadows_and_clipped_pixels_hardly_count():
    codes = noisy(clean(), 3.0)
    for k, image in enumerate(codes):
        image[:, 5 * k : 5 * k + 9] *= 0.3 if k % 2 else 1  # a shadow at another place in each
        image[4 * k : 4 * k + 18] = 300
    assert found(codes) == pytest.approx(3.0)


def test_a_black_background_does_not_count_with_a_mask_or_without():
    codes = noisy(clean(), 3.0)
    codes[:, :, :40] = 0
    mask = np.ones((SIZE, SIZE), bool)
    mask[:, :40] = False
    assert found(codes, mask=mask) == found(codes) == pytest.approx(3.0)


def test_the_noise_does_not_depend_on_image_order_or_window():
    looked_at = np.linspace(0, 23, 12).round().astype(int)
    others = np.setdiff1d(np.arange(24), looked_at)
    codes = clean(24)
    codes[looked_at] = noisy(codes[looked_at], 4.0)
    capture = capture_of(codes)
    turned = replace(capture, observations=tuple(capture.observations[k] for k in (*looked_at, *others)))
    whole = domain_from_card(capture).noise
    assert domain_from_card(turned).noise == whole
    assert domain_from_card(capture, window=(3, 5, 20, 4)).noise == whole
    assert whole == pytest.approx(4 / 255)


def test_few_images_get_the_usual_noise_and_finer_files_none():
    codes = noisy(clean(12), 5.0)
    assert found(codes[:6]) == found(codes, cameras=2) == 255 * USUAL
    assert found(codes[:, :7, :7]) == 255 * USUAL
    assert found(codes[:7]) == pytest.approx(5.0, abs=0.6)
    assert found(codes, coarse=False) == 0 == images_read(capture_of(codes, coarse=False))


def test_the_noise_stays_within_its_limits():
    assert found(noisy(clean(), 20.0)) == 255 * MAX_NOISE


def test_the_announced_number_of_images_is_read():
    for count in (8, 20):
        capture = capture_of(clean(count))
        steps = sum(1 for _ in noise_of(capture))
        assert steps == images_read(capture) == min(count, 12)


@pytest.mark.parametrize("window", [None, (3, 5, 20, 4)])
def test_a_domain_reads_each_photograph_once(window):
    capture, read = capture_of(noisy(clean(20), 4.0)), []

    def counted(shot):
        return replace(shot, read=lambda: (read.append(shot.name), shot.read())[1])

    counting = replace(capture, observations=tuple(map(counted, capture.observations)))
    assert domain_from_card(counting, window=window).noise == run_steps(noise_of(capture))
    assert sorted(read) == [shot.name for shot in capture.observations]


def test_photographs_that_were_taken_before_are_not_read_again_and_the_others_are():
    capture = capture_of(noisy(clean(8), 4.0))
    estimate = NoiseEstimate(capture)
    for shot in capture.observations[:2:-1]:
        estimate.take(shot, shot.read())
    steps = estimate.finishing()
    assert sum(1 for _ in steps) == 3
    estimate = NoiseEstimate(capture)
    for shot in capture.observations[::-1]:
        estimate.take(shot, shot.read())
    assert run_steps(estimate.finishing()) == run_steps(noise_of(capture))


def test_inspect_states_the_noise_of_8_bit_files(tmp_path):
    codes = np.clip(np.round(noisy(clean(), 3.0)), 0, 254).astype(int)
    names = [f"{k:03}.png" for k in range(12)]
    for name, image in zip(names, codes, strict=True):
        write_png(tmp_path / name, image[::-1])
    lines = [f"{name} {x} {y} {z}" for name, (x, y, z) in zip(names, lights(12), strict=True)]
    (tmp_path / "dirs.lp").write_text("\n".join(["12", *lines]) + "\n")
    fact = dict(inspect_capture(tmp_path, decode_png, "srgb").facts)["noise"]
    assert fact == "3.0 codes of 255"
    assert "noise" not in dict(inspect_capture(tmp_path, decode_png, "linear").facts)
    domain = domain_from_card(read_capture(tmp_path, decode_png, "srgb"))
    assert 255 * domain.noise == pytest.approx(3.0)
