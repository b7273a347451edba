"""Framed captures against pictures of a plane that are computed anew, in float64."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from irpso_addon.capture import framing
from irpso_addon.capture.bounds import bounded, weight_and_clipped
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.errors import CaptureError
from irpso_addon.capture.formats.table import spec_of_table
from irpso_addon.capture.framing import Framing, framed
from irpso_addon.capture.images.image import ImageStore
from irpso_addon.capture.inspect.report import inspect_capture
from irpso_addon.capture.read import read_capture, read_spec
from irpso_addon.capture.spec import build_capture, reframed
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.capture.write import write_capture

WIDTH, HEIGHT = 80, 60
CARD = 4.0, 3.0  # width and height in world units
WORLD = np.array([[0.0, 0, 1, 2], [1, 0, 0, -1], [0, 1, 0, 5], [0, 0, 0, 1]])  # a camera that is not at the origin


def capture_of(image, camera=None, mask=None):
    image = np.asarray(image, np.float32)
    camera = camera or Camera.from_fov(image.shape[1], image.shape[0], 40.0, WORLD)
    mask = np.ones(image.shape[:2], bool) if mask is None else mask
    light = Light((0.0, 0.0, 1.0))
    return Capture("card", (Observation("one", lambda: image, light),), (camera,), (mask,))


def noise(channels=3):
    colour = np.random.default_rng(1).random((HEIGHT, WIDTH, channels))
    return np.concatenate([colour, np.ones((HEIGHT, WIDTH, 1))], axis=-1).astype(np.float32)


def tilted_card(camera, tilt=25.0, turn=20.0, distance=9.0):
    """Return the picture of a plane with a smooth pattern, its corners from the upper left pixel, and its axes."""
    a, b = np.radians([tilt, turn])
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_z = np.array([[np.cos(b), -np.sin(b), 0], [np.sin(b), np.cos(b), 0], [0, 0, 1]])
    axes = about_x @ about_z  # columns, in the camera's axes
    middle = np.array([0.2, -0.1, -distance])
    rays = replace(camera, matrix=np.eye(4)).points(1.0)
    along = (axes[:, 2] @ middle) / (rays @ axes[:, 2])
    place = (rays * along[..., None] - middle) @ axes[:, :2]
    shown = np.concatenate([pattern(place), np.ones((*place.shape[:2], 1))], axis=-1)
    corners = (
        middle
        + np.array([(-x, y) for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))]) * np.divide(CARD, 2) @ axes[:, :2].T
    )
    pixels = replace(camera, matrix=np.eye(4)).project(corners)[0]
    return shown, tuple((float(x), float(camera.height - y)) for x, y in pixels), axes, -(axes[:, 2] @ middle)


def pattern(place):
    x, y = place[..., 0], place[..., 1]
    return np.stack([0.5 + 0.3 * np.sin(2 * x + y), 0.5 + 0.1 * x, 0.5 + 0.1 * y], axis=-1)


def test_crop_is_a_part_of_the_picture_and_of_its_camera():
    image, mask = noise(), np.zeros((HEIGHT, WIDTH), bool)
    mask[:30] = True
    found = framed(capture_of(image, mask=mask), Framing(crop=(10, 5, 40, 30)))
    rows = slice(HEIGHT - 35, HEIGHT - 5)
    np.testing.assert_array_equal(found.observations[0].read(), image[rows, 10:50])
    np.testing.assert_array_equal(found.masks[0], mask[rows, 10:50])
    point = np.array([0.5, 0.3, 1.0])
    whole = capture_of(image).cameras[0].project(point)[0]
    np.testing.assert_allclose(found.cameras[0].project(point)[0], whole - (10, HEIGHT - 35), atol=1e-9)


@pytest.mark.parametrize("distortion", [(), (-0.1, 0.02)])
def test_scale_averages_whole_pixels(distortion):
    image = noise()
    camera = replace(Camera.from_fov(WIDTH, HEIGHT, 40.0, WORLD), distortion=distortion)
    found = framed(capture_of(image, camera), Framing(scale=0.25))
    expected = image[..., :3].reshape(15, 4, 20, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(found.observations[0].read()[..., :3], expected, atol=1e-6)
    point = np.array([0.5, 0.3, 1.0])
    np.testing.assert_allclose(found.cameras[0].project(point)[0] * 4, camera.project(point)[0], atol=1e-9)


def test_a_mask_keeps_pixels_that_it_covers_for_the_most_part():
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[:2, :2] = mask[0, 2:4] = mask[1, 4] = True
    mask[1, 2] = True
    found = framed(capture_of(noise(), mask=mask), Framing(scale=0.5)).masks[0]
    np.testing.assert_array_equal(found[0, :4], [True, True, False, False])
    assert found.sum() == 2


def test_used_pixels_are_those_of_the_crop_or_between_the_corners():
    camera = Camera.from_fov(WIDTH, HEIGHT, 40.0, WORLD)
    crop = np.zeros((HEIGHT, WIDTH), bool)
    crop[HEIGHT - 28 : HEIGHT - 7, 12:52] = True
    np.testing.assert_array_equal(framing.used_pixels(camera, Framing(crop=(12, 7, 40, 21))), crop)
    _, corners, axes, _ = tilted_card(camera)
    middle = np.array([0.2, -0.1, -9.0])
    rays = replace(camera, matrix=np.eye(4)).points(1.0)
    place = (rays * ((axes[:, 2] @ middle) / (rays @ axes[:, 2]))[..., None] - middle) @ axes[:, :2]
    card = (np.abs(place) < np.divide(CARD, 2)).all(axis=-1)  # the pixels whose ray meets the card
    np.testing.assert_array_equal(framing.used_pixels(camera, Framing(corners=corners)), card)
    assert framing.used_pixels(camera, Framing(scale=0.5)).all()


@pytest.mark.parametrize("background", [0.0, 0.95, 5.0])
@pytest.mark.parametrize("turned", [False, True])
def test_texels_at_the_rim_of_a_mask_show_the_subject_alone(background, turned):
    camera = Camera.from_fov(WIDTH, HEIGHT, 40.0, WORLD)
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    mask = np.hypot(x - 41, y - 30) < 23.3
    image = np.concatenate([np.full((HEIGHT, WIDTH, 3), background), np.ones((HEIGHT, WIDTH, 1))], axis=-1)
    image[~mask, 3] = bounded(np.float32(1), np.full(3, background > 1))  # clipped
    image[mask, :3] = 0.4
    corners = tilted_card(camera)[1] if turned else None
    capture = capture_of(image, camera, mask)
    for scale in (0.5, 0.37):
        part = framed(capture, Framing(corners=corners, scale=scale))
        seen = part.observations[0].read()[part.masks[0]]
        np.testing.assert_allclose(seen[:, :3], 0.4, rtol=1e-5)
        assert seen[:, 3].min() > 0.5 and seen[:, 3].max() == pytest.approx(1)
        if not turned:  # pixels beside the subject have no weight and show the photograph
            corner = part.observations[0].read()[0, 0]
            np.testing.assert_allclose(corner, [*[background] * 3, 0], rtol=1e-5)


def test_scale_that_divides_nothing_keeps_the_mean_and_the_camera():
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    ramp = np.stack([x, y, x + y, np.ones_like(x)], axis=-1)
    found = framed(capture_of(ramp), Framing(scale=0.37)).observations[0].read()
    height, width = found.shape[:2]
    assert (width, height) == (30, 22)
    at_x, at_y = (np.arange(width) + 0.5) * WIDTH / width, (np.arange(height) + 0.5) * HEIGHT / height
    inner = slice(1, -1), slice(1, -1)
    np.testing.assert_allclose(found[inner][..., 0], np.broadcast_to(at_x, (height, width))[inner], atol=1e-4)
    np.testing.assert_allclose(found[inner][..., 1], np.broadcast_to(at_y[:, None], (height, width))[inner], atol=1e-4)


def test_an_orthographic_picture_of_any_scale_is_written_and_comes_back(tmp_path):
    # 24×20 pixels become 17×14, whose pixels are not square: both sides are rounded.
    whole = capture_of(noise()[:20, :24], Camera(24, 20, (12.0, 12.0), (11.0, 10.5), WORLD, False))
    part = framed(whole, Framing(scale=0.7))
    write_capture(part, tmp_path / "part")
    found, camera = read_capture(tmp_path / "part"), part.cameras[0]
    assert (camera.width, camera.height) == (17, 14) and camera.scale == pytest.approx((17 / 2, 14 / 20 * 12))
    back = found.cameras[0]
    assert (back.width, back.height, back.perspective, back.centre) == (17, 14, False, camera.centre)
    np.testing.assert_allclose(back.scale, camera.scale, rtol=1e-14)
    np.testing.assert_array_equal(found.observations[0].read(), part.observations[0].read())


@pytest.mark.parametrize("block", [1, 1000])
def test_parts_are_resampled_in_blocks_of_any_size_to_the_same_bits(block, monkeypatch):
    capture, part = capture_of(noise()), Framing(crop=(7, 5, 61, 43), scale=0.37)
    whole = framed(capture, part).observations[0].read()
    monkeypatch.setattr(framing, "_BLOCK", block)
    np.testing.assert_array_equal(framed(capture, part).observations[0].read(), whole)


def test_a_part_that_is_made_smaller_has_the_means_of_samples_between_its_pixels():
    image, (x0, top, width, height), count = noise(), (7, 5, 61, 43), 2
    found = framed(capture_of(image), Framing(crop=(7, 5, 61, 43), scale=0.63)).observations[0].read()
    rows, columns = found.shape[:2]
    assert (columns, rows) == (38, 27)
    y = (np.arange(rows * count) + 0.5) / count * height / rows + HEIGHT - top - height
    x = (np.arange(columns * count) + 0.5) / count * width / columns + x0
    places = np.meshgrid(y - 0.5, x - 0.5, indexing="ij")
    for channel in range(3):
        samples = map_coordinates(image[..., channel].astype(np.float64), places, order=1)
        means = samples.reshape(rows, count, columns, count).mean(axis=(1, 3))
        np.testing.assert_allclose(found[..., channel], means, atol=1e-6)


def test_weights_and_clipped_channels_survive_a_scale():
    image = noise()
    image[-2:, :2] = (0.9, 0.8, 1.0, 0)  # the upper left pixel of the result: one bound, three samples
    image[-2:, :2, 3] = 1
    image[-1, 0, 3] = bounded(np.array(1.0), np.array([False, False, True]))
    image[-1, 2, :] = (np.nan, 0, 0, 0)  # its neighbour: one that counts for nothing
    image[-2:, 4:6, 3] = 0
    found = framed(capture_of(image), Framing(scale=0.5)).observations[0].read()
    weight, clipped = weight_and_clipped(found[-1, :3, 3])
    np.testing.assert_allclose(weight, (1, 0.75, 0), atol=1e-6)
    np.testing.assert_array_equal(clipped, [[False, False, True], [False] * 3, [False] * 3])
    np.testing.assert_allclose(found[-1, 0, :3], (0.9, 0.8, 1.0), atol=1e-6)
    three = [image[-2, 2, :3], image[-2, 3, :3], image[-1, 3, :3]]
    np.testing.assert_allclose(found[-1, 1, :3], np.mean(three, axis=0), atol=1e-6)


@pytest.mark.parametrize("distortion", [(), (-0.12, 0.03, 0.001, -0.001)])
@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_corners_show_a_tilted_card_from_the_front(distortion, scale):
    camera = replace(Camera.from_fov(320, 240, 45.0, WORLD), distortion=distortion)
    image, corners, axes, distance = tilted_card(camera)
    found = framed(capture_of(image, camera), Framing(corners=corners, scale=scale, card_width=CARD[0]))
    seen = found.cameras[0]
    np.testing.assert_allclose(seen.matrix[:3, :3], WORLD[:3, :3] @ axes, atol=2e-6)
    np.testing.assert_allclose(seen.position, WORLD[:3, 3])
    assert found.card_distance == pytest.approx(distance, rel=0.01)  # whole pixels
    assert seen.width / seen.height == pytest.approx(CARD[0] / CARD[1], rel=0.03)
    got = found.observations[0].read()
    assert got.shape == (seen.height, seen.width, 4)
    x = ((np.arange(seen.width) + 0.5) / seen.width - 0.5) * CARD[0]
    y = ((np.arange(seen.height) + 0.5) / seen.height - 0.5) * CARD[1]
    expected = pattern(np.stack(np.meshgrid(x, y), axis=-1))
    np.testing.assert_allclose(got[1:-1, 1:-1, :3], expected[1:-1, 1:-1], atol=0.003)
    assert (got[1:-1, 1:-1, 3] == 1).all()
    # Nothing is shown more coarsely than in the picture, where the scale is 1.
    longest = max(np.hypot(*np.subtract(corners[k], corners[k - 1])) for k in range(4))
    assert max(seen.width, seen.height) == pytest.approx(longest * scale, rel=0.15)


@pytest.mark.parametrize("tilt", [3.0, 30.0])
def test_a_distance_along_the_lens_is_that_of_the_tilted_cards_plane(tmp_path, tilt):
    camera = Camera.from_fov(320, 240, 45.0)
    image, corners, axes, distance = tilted_card(camera, tilt)
    along = distance / axes[2, 2]  # where the lens's axis meets the plane
    near = Light((0.0, 0.0, 2.0), (80.0,) * 3, False)
    shots = tuple(Observation(f"{n}", lambda: image.astype(np.float32), near) for n in range(3))
    capture = replace(capture_of(image, camera), observations=shots, card_distance=along)
    found = framed(capture, Framing(corners=corners))
    assert found.card_distance == pytest.approx(distance, rel=1e-5)
    assert found.card_distance == pytest.approx(
        framed(capture, Framing(corners=corners, card_width=CARD[0])).card_distance, rel=0.01
    )
    write_capture(capture, tmp_path / "capture")
    table = tmp_path / "capture" / "capture.toml"
    table.write_text(f"corners = {[list(corner) for corner in corners]}\n" + table.read_text())
    said = [finding.message for finding in inspect_capture(table).findings if finding.code == "card_tilted"]
    assert len(said) == (tilt > 5) and all("tilted by 30°" in text and "--card-width" in text for text in said)
    assert not framed(capture, Framing(corners=corners, card_width=CARD[0])).card_warnings


def test_a_width_is_that_of_its_own_part_where_another_is_chosen(tmp_path):
    camera = Camera.from_fov(320, 240, 45.0)
    image, corners, axes, distance = tilted_card(camera)
    write_capture(capture_of(image, camera), tmp_path / "capture")
    table, store = tmp_path / "capture" / "capture.toml", ImageStore()
    plain = table.read_text()
    table.write_text(f"corners = {[list(one) for one in corners]}\ncard_width = {CARD[0]}\n" + plain)
    crop = Framing(crop=(100, 80, 60, 40), card_width=CARD[0])
    spec = reframed(read_spec(table), crop, store)
    found = framed(build_capture(spec), spec.framing)
    assert found.card_distance == pytest.approx(distance / axes[2, 2], rel=0.01)  # along the axis that the crop keeps
    # The whole picture's width, where the file names no part.
    table.write_text(f"card_width = {2 * 9.0 * np.tan(np.radians(22.5))}\n" + plain)
    spec = reframed(read_spec(table), replace(read_spec(table).framing, crop=crop.crop), store)
    assert spec.card_distance == pytest.approx(9.0) and spec.framing == Framing(crop=crop.crop)
    smaller = replace(read_spec(table).framing, scale=0.5)
    assert reframed(read_spec(table), smaller, store).framing == smaller
    table.write_text('corners = "auto"\ncard_width = 4.0\n' + plain)
    assert reframed(read_spec(table), Framing(corners=corners, card_width=4.0), store).framing.card_width == 4.0
    with pytest.raises(CaptureError, match=r"capture\.toml: its card_width is of the part by .*--card-width"):
        reframed(read_spec(table), crop, store)


def test_the_first_corner_becomes_the_upper_left():
    camera = Camera.from_fov(320, 240, 45.0)
    image, corners, _, _ = tilted_card(camera)
    turned = framed(capture_of(image, camera), Framing(corners=corners[1:] + corners[:1])).cameras[0]
    assert turned.width / turned.height == pytest.approx(CARD[1] / CARD[0], rel=0.03)


def test_an_orthographic_card_faces_the_camera():
    camera = Camera.orthographic(WIDTH, HEIGHT, 2.0)
    angle = np.radians(30)
    along, down = 30 * np.array([np.cos(angle), np.sin(angle)]), 20 * np.array([-np.sin(angle), np.cos(angle)])
    first = np.array([30.0, 10.0])
    corners = tuple(map(tuple, (first, first + along, first + along + down, first + down)))
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, HEIGHT - np.arange(HEIGHT) - 0.5)
    image = np.stack([x, y, 0 * x, 0 * x + 1], axis=-1)
    found = framed(capture_of(image, camera), Framing(corners=corners))
    got = found.observations[0].read()
    assert got.shape == (20, 30, 4)
    place = first + along / 60 + down / 40  # the middle of the upper left pixel
    np.testing.assert_allclose(got[-1, 0, :2], place, atol=1e-4)
    np.testing.assert_allclose(found.cameras[0].matrix[:3, 2], (0, 0, 1), atol=1e-12)


def test_a_table_names_what_is_used_of_its_pictures(tmp_path):
    image = noise()
    write_capture(capture_of(image), tmp_path / "capture")
    table = tmp_path / "capture" / "capture.toml"
    table.write_text("crop = [10, 5, 40, 30]\nscale = 0.5\ncard_width = 2.0\n" + table.read_text())
    found = read_capture(table)
    assert found.observations[0].read().shape == (15, 20, 4)
    assert found.card_distance == pytest.approx(2.0 * found.cameras[0].scale[0] / 20)
    assert ("used", "20×15 of that") in inspect_capture(table).facts
    assert dict(inspect_capture(table, card_width=4.0).facts)["card"].endswith("4 × 3")
    assert dict(inspect_capture(table, card_distance=7.0).facts)["card"].startswith("7 from its camera")
    whole = read_capture(table, framing=Framing())
    assert whole.observations[0].read().shape == (HEIGHT, WIDTH, 4)
    text = table.read_text()
    for changed, said in (
        ("crop = [10, 5, 40]", "crop must be a list of 4 numbers"),
        ("crop = [10, 5, 40, 30.5]", "whole numbers"),
        ("corners = [[1, 2], [3, 4]]", "four"),
        ("corners = [[1, 2], [3, 4], [5, 6], 7]", "four points"),
        ("crop = [10, 5, 40, 30]\ncorners = [[1, 2], [3, 4], [5, 6], [7, 8]]", "one of them"),
        ("card_distance = 3.0", "one of card_width and card_distance"),
    ):
        table.write_text(text.replace("crop = [10, 5, 40, 30]", changed))
        with pytest.raises(CaptureError, match=said) as error:
            spec_of_table(table)
        assert "capture.toml" in str(error.value)


@pytest.mark.parametrize(
    ("framing", "said"),
    [
        ({"crop": (50, 5, 40, 30)}, "no part of pictures of 80×60"),
        ({"crop": (0, 0, 2, 30)}, "at least 4 pixels"),
        ({"corners": ((10, 10), (90, 10), (70, 50), (10, 50))}, "outside the picture"),
        ({"corners": ((10, 50), (70, 50), (70, 10), (10, 10))}, "clockwise"),
        ({"corners": ((10, 10), (70, 10), (40, 50), (5, 50))}, "right angle"),
        # Two that nearly coincide are a card seen from its edge: a picture of gigabytes.
        ({"corners": ((10, 10), (70, 10), (70, 10.001), (10, 50))}, r"would have \d+×\d+ pixels, as one seen almost"),
        ({"corners": ((10, 10), (70, 10), (70, 11), (10, 50))}, "seen almost from its edge; check if two of them"),
        ({"scale": 0.01}, "less than 4 of 80 pixels; give 0.05 or more"),
    ],
)
def test_a_part_that_is_none_is_refused(framing, said):
    with pytest.raises(CaptureError, match=said):
        framed(capture_of(noise()), Framing(**framing))


@pytest.mark.parametrize("corners", [((20, 10), (40, 10), (40, 30), (20, 30)), ((1, 1), (79, 1), (79, 59), (1, 59))])
def test_corners_beyond_what_a_lens_shows_are_refused(corners):
    """r (1 − 0.9 r²) has its largest value, 0.41, at r = 0.61: no ray reaches the picture farther out."""
    lens = Camera(WIDTH, HEIGHT, (30.0, 30.0), (40.0, 30.0), WORLD, True, (-0.9,))
    with pytest.raises(CaptureError, match="corners: one lies where a lens of this distortion shows nothing; check"):
        framed(capture_of(noise(), lens), Framing(corners=corners))


@pytest.mark.parametrize(
    "wrong", [{"scale": 0}, {"scale": 1.5}, {"card_width": -1.0}, {"crop": (0, 0, 8, 8.5)}, {"corners": ((0, 0),)}]
)
def test_a_framing_checks_its_numbers(wrong):
    with pytest.raises(CaptureError, match=next(iter(wrong))):
        Framing(**wrong)


def test_only_one_camera_is_cropped_and_a_mask_must_keep_something():
    one = capture_of(noise())
    with pytest.raises(CaptureError, match="2 cameras"):
        framed(replace(one, cameras=one.cameras * 2, masks=one.masks * 2), Framing(crop=(0, 0, 8, 8)))
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[:4] = True
    with pytest.raises(CaptureError, match="leaves no pixel of this part"):
        framed(capture_of(noise(), mask=mask), Framing(crop=(0, 0, 8, 8)))
    with pytest.raises(CaptureError, match="world_width"):
        framed(capture_of(noise(), Camera.orthographic(WIDTH, HEIGHT, 2.0)), Framing(card_width=2.0))
