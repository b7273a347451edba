"""Sub-pixel shifts of frames under different lights, against shifts that were put in at four times the resolution."""

import numpy as np
import pytest
from scipy import ndimage

from irpso_addon.calibration.register import find_shifts, moved_back

FINE = 4  # fine pixels a pixel: shifts are whole numbers of these
SIZE, MARGIN = 128, 8


def card(seed, texture, relief):
    """Return albedo and normals of a card at the fine resolution: smooth noise."""
    rng = np.random.default_rng(seed)
    shape = ((SIZE + 2 * MARGIN) * FINE,) * 2

    def noise():
        mixed = sum(s * ndimage.gaussian_filter(rng.standard_normal(shape), s, mode="wrap") for s in (5, 12, 30))
        return mixed / mixed.std()

    up, right = np.gradient(noise() * relief * FINE * 3)
    normals = np.stack([-right, -up, np.ones(shape)], axis=-1)
    return np.clip(0.45 + 0.15 * texture * noise(), 0.05, 1), normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def photographs(count, texture=1.0, relief=0.3, noise=0.02, seed=0, widest=3.0):
    """Return frames (K, H, W) under as many lights, and their shifts (K, 2) in pixels (right, up): 0 first."""
    albedo, normals = card(seed, texture, relief)
    rng = np.random.default_rng(seed + 1)
    shifts = np.rint(rng.uniform(-widest, widest, (count, 2)) * FINE) / FINE
    shifts[0] = 0
    frames = []
    for right, up in shifts:
        theta, phi = np.radians(rng.uniform(10, 60)), rng.uniform(0, 2 * np.pi)
        light = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
        shaded = albedo * np.maximum(normals @ light, 0)
        rows, columns = (round((MARGIN - s) * FINE) for s in (up, right))
        part = shaded[rows : rows + SIZE * FINE, columns : columns + SIZE * FINE]
        frame = part.reshape(SIZE, FINE, SIZE, FINE).mean(axis=(1, 3))
        frames.append(frame + noise * frame.max() * rng.standard_normal(frame.shape))
    return np.array(frames), shifts


def errors(found, shifts):
    return np.hypot(*(found.pixels - shifts).T)[1:]


@pytest.mark.parametrize(("texture", "relief"), [(1.0, 0.3), (0.3, 0.6)])
def test_shifts_under_different_lights_are_found_to_a_twentieth_of_a_pixel(texture, relief):
    frames, shifts = photographs(14, texture, relief)
    found = find_shifts(frames)
    assert found.trusted.all() and errors(found, shifts).mean() < 0.05 and errors(found, shifts).max() < 0.15


@pytest.mark.parametrize("count", [2, 3, 6])
def test_few_frames_are_compared_by_their_edges_alone(count):
    frames, shifts = photographs(count, relief=0.1)
    found = find_shifts(frames)
    assert found.trusted.all() and np.isnan(found.agreement).all() and errors(found, shifts).mean() < 0.05


def test_shifts_count_from_the_reference():
    frames, shifts = photographs(6, relief=0.1)
    found = find_shifts(frames, reference=4)
    assert found.pixels[4].tolist() == [0, 0]
    np.testing.assert_allclose(found.pixels, shifts - shifts[4], atol=0.1)


@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1)], ids=["before", "after"])
def test_a_frame_that_matches_one_neighbour_is_placed_by_where_that_neighbour_ended(order):
    # One frame shares edges with the one before or after it alone, which shares others with one frame of the rest.
    rng = np.random.default_rng(0)
    first, second, third = (
        sum(s * ndimage.gaussian_filter(rng.standard_normal((96, 96)), s, mode="wrap") for s in (1, 2, 5))
        for _ in range(3)
    )
    shifts = rng.integers(-4, 5, (9, 2)) * (np.arange(9) > 0)[:, None]
    pictures = [first] * 6 + [first + second, *[second + 0.8 * third, third][order]]
    moved = [np.roll(picture, (up, right), (0, 1)) for picture, (right, up) in zip(pictures, shifts, strict=True)]
    frames = np.array([0.5 + 0.1 * one / first.std() + 0.004 * rng.standard_normal((96, 96)) for one in moved])
    found = find_shifts(frames)
    assert found.trusted.all()
    np.testing.assert_allclose(found.pixels, shifts, atol=0.3)


def test_a_frame_of_another_subject_is_reported_and_not_moved():
    frames, shifts = photographs(14)
    frames[5] = photographs(1, seed=77)[0][0]
    frames[9] = np.random.default_rng(0).random(frames[9].shape)
    found = find_shifts(frames)
    assert np.flatnonzero(~found.trusted).tolist() == [5, 9]
    assert not found.pixels[[5, 9]].any()
    keep = np.delete(np.arange(14), [0, 5, 9])
    assert np.hypot(*(found.pixels - shifts)[keep].T).mean() < 0.05


def test_frames_that_no_three_images_explain_are_not_moved_though_their_edges_agree():
    rng = np.random.default_rng(4)
    frames, _ = photographs(12, relief=0.1, noise=0.0, widest=0.0)
    clouds = np.exp(
        1.5 * ndimage.gaussian_filter(rng.standard_normal(frames.shape), (0, 8, 8)) * 8 * np.sqrt(4 * np.pi)
    )
    found = find_shifts(frames * clouds)
    assert found.agreement.min() < 0.8 and not found.trusted.any() and not found.pixels.any()


def test_where_hardly_any_frames_agree_none_is_moved():
    frames = np.random.default_rng(3).random((12, 64, 64))
    found = find_shifts(frames)
    assert not found.trusted.any() and not found.pixels.any()


def test_frames_that_stand_still_stay_where_they_are():
    frames, _ = photographs(12, widest=0.0)
    assert np.abs(find_shifts(frames).pixels).max() < 0.03


def test_tiny_or_single_frames_are_left_alone():
    assert find_shifts(np.ones((3, 8, 8))).pixels.tolist() == [[0, 0]] * 3
    assert find_shifts(np.ones((1, 64, 64))).trusted.tolist() == [True]


def rgba(image, weight=None):
    weight = np.ones(image.shape) if weight is None else weight
    return np.concatenate([np.repeat(image[..., None], 3, axis=-1), weight[..., None]], axis=-1).astype(np.float32)


def test_an_image_is_moved_back_as_a_wave_of_known_phase():
    y, x = np.mgrid[:40, :50].astype(float)
    for right, up in ((0.5, 0.0), (-1.3, 2.25), (3.0, -2.0)):

        def wave(x, y):
            return 0.5 + 0.2 * np.sin(0.7 * x + 0.3) * np.cos(0.5 * y) + 0.1 * np.cos(0.3 * x - 0.9 * y)

        moved = moved_back(rgba(wave(x - right, y - up)), right, up)
        inside = moved[..., 3] > 0
        assert inside[6:-6, 6:-6].all()
        assert np.abs(moved[..., 0] - wave(x, y))[inside].max() < 0.01


def test_pixels_from_outside_the_frame_have_weight_0():
    moved = moved_back(rgba(np.ones((20, 30))), 2.0, -1.0)
    expected = np.ones((20, 30))
    expected[:, -2:] = expected[0] = 0
    np.testing.assert_array_equal(moved[..., 3], expected)


def test_clipped_pixels_take_their_neighbourhood_along():
    weight = np.ones((20, 30))
    weight[10, 15] = 0
    whole = moved_back(rgba(np.ones((20, 30)), weight), 4.0, 2.0)
    assert np.argwhere(whole[4:16, 4:24, 3] == 0).tolist() == [[10 - 2 - 4, 15 - 4 - 4]]
    half = moved_back(rgba(np.ones((20, 30)), weight), 0.5, 0.0)
    # Lanczos at half a pixel: taps of 0.02, 0.14 and 0.61 on each side; the outermost may be lost.
    assert np.argwhere(half[4:16, 4:24, 3] == 0).tolist() == [[6, c] for c in (9, 10, 11, 12)]
