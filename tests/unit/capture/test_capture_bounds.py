"""Clipped pixels as lower bounds: from the file to the texels."""

import numpy as np
import pytest

from irpso_addon.capture.bounds import bounded, weight_and_clipped, without_bounds
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.images.linearise import Picture, samples_of_picture
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.geometry.build import domain_from_card
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state.prepare import prepare


def test_bounds_in_weights_read_back():
    rng = np.random.default_rng(0)
    weight = np.float32(rng.choice([0, 0.25, 0.5, 1], (40, 50)))
    clipped = rng.random((40, 50, 3)) < 0.3
    weights, channels = weight_and_clipped(bounded(weight, clipped))
    np.testing.assert_array_equal(weights, weight)
    np.testing.assert_array_equal(channels, clipped & (weight > 0)[..., None])
    some = np.concatenate([np.ones((40, 50, 3)), bounded(weight, clipped)[..., None]], axis=-1)
    np.testing.assert_array_equal(without_bounds(some)[..., 3], np.where(clipped.any(axis=-1), 0, weight))


@pytest.mark.parametrize("bits", [8, 16])
def test_a_channel_at_the_files_largest_code_is_a_bound(bits):
    colour = np.full((2, 3, 3), 0.5, np.float32)
    colour[0, 0, 0], colour[1, 2] = 1, 1
    found = samples_of_picture(Picture(colour, bits))
    weight, clipped = weight_and_clipped(found.bounds[..., 3])
    np.testing.assert_array_equal(weight, 1)
    # A JPEG mixes the channels: where one is clipped, none of the others is what the camera saw.
    expected = colour == 1 if bits == 16 else np.broadcast_to((colour == 1).any(axis=-1, keepdims=True), colour.shape)
    np.testing.assert_array_equal(clipped, expected)
    np.testing.assert_array_equal(found.rgba[..., 3], ~(colour == 1).any(axis=-1))
    np.testing.assert_array_equal(found.clipped, (colour == 1).any(axis=-1))


def test_floats_and_samples_of_weight_0_are_no_bounds():
    rgba = np.ones((2, 2, 4), np.float32)
    rgba[0, 0, 3] = 0
    assert (samples_of_picture(Picture(rgba, 32)).bounds[..., 3] >= 0).all()
    assert samples_of_picture(Picture(rgba, 8)).bounds[0, 0, 3] == 0


def card(images):
    shots = tuple(
        Observation(f"{n}", lambda image=image: image, Light((0.1 * n, 0, 1.0))) for n, image in enumerate(images)
    )
    height, width = images[0].shape[:2]
    return domain_from_card(
        Capture("c", shots, (Camera.orthographic(width, height, 2.0),), (np.ones((height, width), bool),))
    )


def test_a_card_keeps_bounds_and_a_schedule_may_drop_them():
    rng = np.random.default_rng(1)
    images = [np.float32(np.append(rng.uniform(0.2, 0.9, (4, 5, 3)), np.ones((4, 5, 1)), axis=-1)) for _ in range(4)]
    images[2][1, 3, 1] = 1
    images[2][1, 3, 3] = bounded(np.float32(1), np.array([False, True, False]))
    domain = card(images)
    assert domain.stack.values[2, 1, 3, 3] == images[2][1, 3, 3] == -2.5
    schedule, model = load_schedule("standard"), load_model("principled")
    kept = prepare(domain, model, schedule).stack
    dropped = prepare(domain, model, schedule.replaced(clipped_samples=False)).stack
    assert (kept[..., 3] < 0).sum() == 1 and (dropped[..., 3] < 0).sum() == 0
    np.testing.assert_array_equal(np.maximum(kept[..., 3], 0), dropped[..., 3])


def test_a_capture_of_bounds_alone_is_refused_as_unlit():
    from irpso_addon.core.errors import InputError

    images = [np.ones((3, 3, 4), np.float32) for _ in range(4)]
    for image in images:
        image[..., 3] = bounded(np.float32(1), np.ones(3, bool))
    with pytest.raises(
        InputError, match="no image of capture 'c' shows the card lit; check its cameras, masks and exposure"
    ):
        card(images)
