"""Hand-held photographs with a flash: poses, lens, lamp and beam against the truth that made them, in float64."""

from argparse import Namespace
from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.calibration.handheld.ambiguous_positions import ambiguous_positions
from irpso_addon.calibration.handheld.bundle import Bundle, Views, adjusted, rotation_errors, seen
from irpso_addon.calibration.handheld.cameras import placed_cameras
from irpso_addon.calibration.handheld.flash import Samples, flash_of, irradiance
from irpso_addon.calibration.handheld.handheld_calibration import _flash, handheld_steps
from irpso_addon.calibration.handheld.poses import camera_matrix, focal_of, plane_of, pose_of
from irpso_addon.calibration.handheld.tracks import Tracks, _Match, _merged
from irpso_addon.capture.frame.board import board_of
from irpso_addon.capture.frame.homography import homography, mapped
from irpso_addon.capture.images.exif import upright
from irpso_addon.capture.spec import build_capture
from irpso_addon.commands import handheld
from irpso_addon.core.errors import InputError
from irpso_addon.core.steps import run_steps
from tests.builders.captures import decode_png, write_png
from tests.builders.flat_scene import from_upper_left, texture
from tests.builders.handheld import BEAM, FOCAL, OFFSET, STRENGTH, hand, on_board, photographs, shining


def off(found, true):
    """Return the largest turn in degrees and the largest shift over the distance, of cameras from the true ones."""
    turns = [np.degrees(np.arccos(np.clip((np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2, -1, 1)))
             for a, b in zip(found, true, strict=True)]  # fmt: skip
    shifts = [np.linalg.norm(a[:3, 3] - b[:3, 3]) / np.linalg.norm(b[:3, 3]) for a, b in zip(found, true, strict=True)]
    return max(turns), max(shifts)


def shifted(camera):
    """Return (3, 3) from pixels to pixels counted from the middle of the picture, y down."""
    return np.array([(1, 0, -camera.width / 2), (0, 1, -camera.height / 2), (0, 0, 1.0)])


@pytest.fixture(scope="module")
def cloud():
    """Return cameras, places (P, 3) of a card with relief, and the exact views from the upper left corner."""
    cameras = hand(12)
    places = np.random.default_rng(1).uniform(-60, 60, (70, 3)) * (1, 1, 0.03)
    pixels = []
    for camera in cameras:
        at, _ = camera.project(places)
        pixels.append(np.stack([at[:, 0], camera.height - at[:, 1]], axis=-1))
    k, p = np.repeat(np.arange(12), 70), np.tile(np.arange(70), 12)
    return cameras, places, Views(k, p, np.concatenate(pixels))


def test_the_homographies_of_a_plane_of_known_form_tell_focal_length_and_poses():
    cameras, plane = hand(6), np.random.default_rng(2).uniform(-60, 60, (9, 2))
    maps = [shifted(camera) @ homography(plane, from_upper_left(camera, plane)) for camera in cameras]
    assert focal_of(maps) == pytest.approx(FOCAL, rel=1e-6)
    poses = [pose_of(np.diag([1 / FOCAL, 1 / FOCAL, 1]) @ matrix) for matrix in maps]
    assert max(off([camera_matrix(*pose) for pose in poses], [c.matrix for c in cameras])) < 1e-5


@pytest.mark.parametrize("given", [FOCAL, None])
def test_the_form_of_an_unknown_plane_follows_from_right_angles_in_all_views(given):
    cameras, plane = hand(10), np.random.default_rng(2).uniform(-60, 60, (9, 2))
    pictures = [from_upper_left(camera, plane) for camera in cameras]
    centre = [np.linalg.inv(shifted(camera)) for camera in cameras]
    maps = [shifted(c) @ homography(pictures[4], at) @ centre[4] for c, at in zip(cameras, pictures, strict=True)]
    form, focal, misfit = plane_of(maps, given, 320)
    assert focal == pytest.approx(FOCAL, rel=1e-3) and misfit < 1e-3
    rectified = mapped(np.linalg.inv(np.diag([focal, focal, 1]) @ form), mapped(shifted(cameras[4]), pictures[4]))
    lengths = [np.linalg.norm(a[:, None] - a, axis=-1) for a in (rectified, plane)]
    ratio = lengths[0][np.triu_indices(9, 1)] / lengths[1][np.triu_indices(9, 1)]
    assert np.ptp(ratio) < 2e-3 * ratio.mean()
    turned = rectified - rectified.mean(axis=0)
    wanted = plane - plane.mean(axis=0)
    assert np.linalg.det(turned.T @ wanted) > 0, "y is up: nothing is mirrored"


def test_bundle_adjustment_finds_cameras_lens_and_relief_from_a_flat_start(cloud):
    cameras, places, views = cloud
    noisy = replace(views, pixels=views.pixels + np.random.default_rng(3).normal(0, 0.1, views.pixels.shape))
    matrices = [c.matrix for c in cameras]
    flip = np.diag([1.0, -1.0, -1.0])
    rotations = np.stack([flip @ m[:3, :3].T for m in matrices])
    shifts = np.stack([-r @ m[:3, 3] for r, m in zip(rotations, matrices, strict=True)])
    random = np.random.default_rng(4)
    centres = np.tile([160.0, 120.0], (12, 1))
    exact = Bundle(rotations, shifts, places, FOCAL, 0.0, centres)
    np.testing.assert_allclose(seen(exact, views), views.pixels, atol=1e-9)
    start = replace(
        exact, points=places * (1, 1, 0), focal=1.04 * FOCAL, shifts=shifts + random.normal(0, 6.0, shifts.shape)
    )
    found = adjusted(start, noisy, 0.1, relief=3.0)
    assert found.focal == pytest.approx(FOCAL, rel=0.01) and abs(found.radial) < 0.03
    height = np.corrcoef(found.points[:, 2], places[:, 2])[0, 1]
    assert height > 0.97 and found.points[:, 2].std() == pytest.approx(places[:, 2].std(), rel=0.25)
    assert np.median(np.linalg.norm(seen(found, noisy) - noisy.pixels, axis=1)) < 0.15


def test_the_standard_error_of_a_rotation_is_the_spread_over_draws_of_the_noise():
    """A photograph from straight above, one from the side and one with few points; rotation and shift refined alone."""
    steep, flat = hand(2, seed=3, widest=50.0)[1], np.eye(4)
    flat[2, 3] = 400.0
    matrices = [flat, steep.matrix, flat]
    flip = np.diag([1.0, -1.0, -1.0])
    rotations = np.stack([flip @ m[:3, :3].T for m in matrices])
    shifts = np.stack([-r @ m[:3, 3] for r, m in zip(rotations, matrices, strict=True)])
    random = np.random.default_rng(6)
    places = np.insert(random.uniform(-60, 60, (60, 2)), 2, 0.0, axis=1)
    exact = Bundle(rotations, shifts, places, FOCAL, 0.0, np.tile([160.0, 120.0], (3, 1)))
    point = np.concatenate([np.arange(60), np.arange(60), np.arange(8)])
    views = Views(np.repeat([0, 1, 2], [60, 60, 8]), point, np.zeros((128, 2)))
    views = replace(views, pixels=seen(exact, views))
    turns, told = [], []
    for _ in range(60):
        noisy = replace(views, pixels=views.pixels + random.normal(0, 0.15, (128, 2)))
        found = adjusted(exact, noisy, 0.0, None)
        turned = found.rotations @ rotations.transpose(0, 2, 1)
        turns.append([(r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]) for r in turned])
        told.append(rotation_errors(found, noisy))
    spread = [
        np.degrees(np.sqrt(np.linalg.eigvalsh(np.cov(0.5 * one.T))[-1])) for one in np.array(turns).swapaxes(0, 1)
    ]
    np.testing.assert_allclose(np.median(told, axis=0), spread, rtol=0.25)
    assert spread[2] > 2 * spread[0] > 2 * spread[1]


def test_a_photograph_from_straight_above_that_shows_too_few_points_for_its_angle_is_left_out():
    cameras, random = hand(10, seed=8, widest=40.0), np.random.default_rng(9)
    places = random.uniform(-60, 60, (80, 2))
    pixels = np.stack([from_upper_left(camera, places) for camera in cameras]) + random.normal(0, 0.5, (10, 80, 2))
    shown = [np.arange(80) if k else np.arange(12) for k in range(10)]
    photograph, point = np.repeat(np.arange(10), [len(one) for one in shown]), np.concatenate(shown)
    tracks = Tracks(photograph, point, pixels[photograph, point], pixels[5], tuple(range(10)), reference=5)
    seen_by = [replace(camera, matrix=np.eye(4)) for camera in cameras]
    assert placed_cameras(tracks, seen_by, 1.0, "known").tracks.used == tuple(range(1, 10))


def test_brightness_tells_place_beam_and_strength_of_the_flash():
    cameras = np.stack([c.matrix for c in hand(24, widest=55)])
    random = np.random.default_rng(5)
    places = random.uniform(-60, 60, (200, 2))
    albedo = random.uniform(0.1, 0.8, 200)
    gains = np.exp(random.normal(0, 0.2, 24))
    gains /= np.exp(np.log(gains).mean())
    exact = np.stack([g * albedo * irradiance(places, c, OFFSET, BEAM) for g, c in zip(gains, cameras, strict=True)])
    noisy = exact * np.exp(random.normal(0, 0.02, exact.shape))
    noisy[random.random(exact.shape) < 0.05] *= 3  # highlights
    found = flash_of(Samples(places, cameras, noisy))
    np.testing.assert_allclose(found.offset, OFFSET, atol=1.5)
    assert found.beam == pytest.approx(BEAM, abs=0.1) and (found.error < 1.5).all()
    np.testing.assert_allclose(found.gains, gains, rtol=0.02)
    assert np.median(found.albedo / albedo) == pytest.approx(1, abs=0.02)


def test_light_that_rises_toward_the_corners_gives_an_even_beam_and_gains_that_fit_it():
    cameras, random = np.stack([c.matrix for c in hand(24, widest=55)]), np.random.default_rng(5)
    places, albedo = random.uniform(-60, 60, (200, 2)), random.uniform(0.1, 0.8, 200)
    exact = np.stack([albedo * irradiance(places, c, OFFSET, -0.4) for c in cameras])
    found = flash_of(Samples(places, cameras, exact * np.exp(random.normal(0, 0.02, exact.shape))))
    assert found.beam == 0
    lit = np.stack([irradiance(places, c, found.offset, 0.0) for c in cameras])
    ratio = np.log(exact / (lit * found.albedo)).mean(axis=1)
    np.testing.assert_allclose(np.log(found.gains), ratio - ratio.mean(), atol=0.02)


def test_irradiance_falls_with_distance_cosine_and_beam():
    camera = np.eye(4)
    camera[2, 3] = 300
    away = np.array([90.0, 0, -300]) - (14, -8, 0)
    cosine = 300 / np.linalg.norm(away)
    wanted = cosine * cosine**BEAM / (away @ away)
    assert irradiance(np.array([[90.0, 0]]), camera, OFFSET, BEAM)[0] == pytest.approx(wanted)


@pytest.fixture(scope="module")
def on_paper():
    pytest.importorskip("cv2", reason="OpenCV is not installed")
    cameras = hand(9, seed=6, widest=40.0, far=500.0)
    return cameras, photographs(cameras, on_board, blurred=(4,))


def test_photographs_of_a_board_give_cameras_and_flash_in_millimetres(on_paper):
    cameras, capture = on_paper
    found = run_steps(handheld_steps(capture, "known"))
    assert found.numbers == (0, 1, 2, 3, 5, 6, 7, 8) and "blurred: IMG_4" in found.warnings[0]
    turn, shift = off([c.matrix for c in found.cameras], [cameras[n].matrix for n in found.numbers])
    assert found.board is not None and turn < 0.8 and shift < 0.012
    np.testing.assert_allclose(found.flash.offset, OFFSET, atol=3.0)
    assert found.flash.beam == pytest.approx(BEAM, abs=0.3)
    np.testing.assert_allclose(found.intensities, STRENGTH, rtol=0.05)
    np.testing.assert_allclose(found.field, (-65, -108.5, 65, 108.5))
    given = run_steps(handheld_steps(capture, "known", OFFSET))
    np.testing.assert_array_equal(given.flash.offset, OFFSET)


def turned_by_exif(capture, orientations):
    """Return a capture as reading turns its photographs upright."""
    shots, cameras = [], []
    for shot, camera, orientation in zip(capture.observations, capture.cameras, orientations, strict=True):
        picture = upright(shot.read(), orientation)
        shots.append(replace(shot, read=lambda picture=picture: picture))
        height, width = picture.shape[:2]
        cameras.append(replace(camera, width=width, height=height, centre=(width / 2, height / 2)))
    return replace(capture, observations=tuple(shots), cameras=tuple(cameras))


def test_the_flash_stays_on_its_side_of_the_lens_where_exif_turns_photographs(on_paper):
    """With one place in the upright pictures the flash of these photographs is found at 1.1, 0.3 ± 0.2 mm."""
    cameras, capture = on_paper
    orientations = [1, 6, 1, 6, 1, 3, 6, 1, 8]
    found = run_steps(handheld_steps(turned_by_exif(capture, orientations), "known", None, orientations))
    np.testing.assert_allclose(found.flash.offset, OFFSET, atol=3.0)
    lamps = [cameras[n].matrix[:3, :3] @ OFFSET + cameras[n].position for n in found.numbers]
    assert np.linalg.norm(found.lamps - lamps, axis=1).max() < 7
    given = run_steps(handheld_steps(turned_by_exif(capture, orientations), "known", OFFSET, orientations))
    assert np.linalg.norm(given.lamps - lamps, axis=1).max() < 6


def test_turned_photographs_whose_exif_does_not_say_so_are_refused(on_paper):
    turned = turned_by_exif(on_paper[1], [1, 6] + [1] * 7)
    with pytest.raises(InputError, match="IMG_1: is turned against IMG_0, but their EXIF orientation does not say so"):
        run_steps(handheld_steps(turned, "known"))


def test_a_card_that_shines_does_not_bend_the_flash_that_matt_paper_shows():
    """With the places of the card the flash is 7 and 3 mm off."""
    pytest.importorskip("cv2", reason="OpenCV is not installed")
    found = run_steps(
        handheld_steps(photographs(hand(14, seed=6, widest=45.0, far=500.0), on_board, gloss=0.3), "known")
    )
    np.testing.assert_allclose(found.flash.offset, OFFSET, atol=2.6)
    assert found.flash.beam == pytest.approx(BEAM, abs=0.2)


@pytest.mark.parametrize("clipped", [0, 3, 12])
def test_photographs_in_which_the_paper_is_clipped_keep_their_strength(clipped):
    """A glossy card under exposures that differ; of the last photographs no paper can be used."""
    cameras, board, rng = hand(12, seed=6, widest=45.0, far=500.0), board_of("A4", 8), np.random.default_rng(2)
    places = np.concatenate([board.white, rng.uniform(-60, 60, (300, 2))])
    albedo = np.where(np.arange(len(places)) < len(board.white), 0.8, rng.uniform(0.2, 0.6, len(places)))
    strength = 1e5 * np.exp(rng.uniform(-0.4, 0.4, len(cameras)))
    radiance = np.stack([
        each * irradiance(places, camera.matrix, OFFSET, BEAM) * (albedo + shining(places, camera, 0.3))
        for each, camera in zip(strength, cameras, strict=True)
    ])  # fmt: skip
    radiance[len(cameras) - clipped :, : len(board.white)] = np.nan
    samples = Samples(places, np.stack([camera.matrix for camera in cameras]), radiance)
    flash, intensities, _ = _flash(samples, None, board)
    np.testing.assert_allclose(flash.offset, OFFSET, atol=1.0 if clipped == 0 else 15.0)
    ratio = intensities / strength
    assert np.abs(ratio / ratio.mean() - 1).max() < (0.01 if clipped == 0 else 0.2)


def test_a_wrong_focal_length_is_refused_with_the_better_one(on_paper):
    _, capture = on_paper
    wrong = replace(capture, cameras=tuple(replace(c, scale=(1.5 * FOCAL,) * 2) for c in capture.cameras))
    with pytest.raises(InputError, match=r"one of 5\d\.\d° over the width"):
        run_steps(handheld_steps(wrong, "known"))


def test_photographs_from_one_place_are_refused():
    pytest.importorskip("cv2", reason="OpenCV is not installed")
    with pytest.raises(InputError, match="all from one place"):
        run_steps(handheld_steps(photographs(hand(8, widest=4.0, far=500.0), on_board), "known"))


def test_few_photographs_and_photographs_without_a_card_are_refused(on_paper):
    _, capture = on_paper
    with pytest.raises(InputError, match="5 photographs can be used, 8 are needed"):
        run_steps(handheld_steps(replace(capture, observations=capture.observations[:5])))
    small = replace(capture.cameras[2], width=capture.cameras[2].width // 2, height=capture.cameras[2].height // 2)
    mixed = replace(capture, cameras=(*capture.cameras[:2], small, *capture.cameras[3:]))
    with pytest.raises(InputError, match=rf"IMG_2: is {small.width}×{small.height} pixels where IMG_0 has"):
        run_steps(handheld_steps(mixed))
    empty = photographs(hand(8), lambda places: np.full(len(places), 0.4))
    with pytest.raises(InputError, match="neither printed markers nor enough features"):
        run_steps(handheld_steps(empty))


def test_a_textured_card_without_markers_gives_cameras_up_to_scale_and_place():
    pytest.importorskip("cv2", reason="OpenCV is not installed")
    cameras = hand(9, seed=7, widest=35.0)
    surface, fine = texture(8, 5.0), texture(9, 12.0)

    def value(places):
        return np.where((np.abs(places) < 65).all(-1), 0.1 + 0.35 * surface(places) + 0.35 * fine(places), 0.01)

    found = run_steps(handheld_steps(photographs(cameras, value), "known"))
    assert len(found.cameras) >= 8 and found.board is None
    true = np.stack([cameras[n].matrix for n in found.numbers])
    own = np.stack([camera.matrix for camera in found.cameras])
    # The similarity that brings the found places onto the true ones (Umeyama 1991); its rotation is about z.
    a, b = (m[:, :3, 3] - m[:, :3, 3].mean(axis=0) for m in (own, true))
    u, s, vt = np.linalg.svd(b.T @ a)
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    scale = s.sum() / (a**2).sum()
    assert np.degrees(np.arccos(turn[2, 2])) < 0.7
    assert np.linalg.norm(scale * a @ turn.T - b, axis=1).max() < 6.0
    turned = own.copy()
    turned[:, :3, :3], turned[:, :3, 3] = turn @ own[:, :3, :3], true[:, :3, 3]
    assert off(turned, true)[0] < 1.2
    assert scale == pytest.approx(130, rel=0.1), "the part that is recovered is the card"


def turned(places, quarters):
    """Return places (…, 2) turned by quarter turns."""
    for _ in range(quarters):
        places = np.stack([-places[..., 1], places[..., 0]], axis=-1)
    return places


def four_times(value):
    """Return the mean of a function of places over the four quarter turns."""
    return lambda places: np.mean([value(turned(places, quarters)) for quarters in range(4)], axis=0)


def on_grid(value, quarters, random):
    """Return a picture of a card on a square grid: turned, in a slanting light, with noise and a highlight."""
    along = 130 * ((np.arange(96) + 0.5) / 96 - 0.5)
    places = np.stack(np.meshgrid(along, along), axis=-1)
    grey = (0.2 + value(turned(places, quarters))) * np.exp(places @ random.normal(0, 0.004, 2))
    grey = np.where(np.linalg.norm(places - random.uniform(-50, 50, 2), axis=-1) < 9, 3 * grey, grey)
    grey[:, : random.integers(1, 20)] = np.nan
    return grey * np.exp(random.normal(0, 0.05, grey.shape))


def joined(matches, count=20):
    """Return the tracks of matches (via, number, features of via, features of number) of photographs, 0 the hub.

    Feature f of photograph n is at (100 n + f, 0), and at (f, 0) in the hub.
    """
    places = [np.stack([100.0 * n + np.arange(3 * count), np.zeros(3 * count)], axis=-1) for n in range(4)]
    rows: dict = {}
    for via, number, first, second in matches:
        rows.setdefault(number, []).append((np.full(len(first), via), first, second, places[0][first]))
    merged = [_Match(number, *(np.concatenate(column) for column in zip(*parts, strict=True)))
              for number, parts in rows.items()]  # fmt: skip
    return _merged(merged, places, 0)


def test_features_that_one_photograph_matches_in_two_others_are_one_point():
    hub, beside = np.arange(20), np.arange(20, 40)  # points in the hub, and points beyond its edge
    tracks = joined([(0, 1, hub, hub), (0, 2, hub, hub), (1, 3, beside, beside), (2, 3, beside, beside)])
    by_point = [set(tracks.photograph[tracks.point == p].tolist()) for p in range(len(tracks.plane))]
    assert len(by_point) == 40 and by_point.count({0, 1, 2}) == by_point.count({1, 2, 3}) == 20


def test_two_features_of_one_photograph_are_never_one_point():
    hub, other = np.arange(20), np.arange(20, 40)
    tracks = joined([(0, 1, hub, hub), (0, 2, hub, hub), (1, 3, hub, hub), (2, 3, hub, other)])
    pairs = list(zip(tracks.photograph.tolist(), tracks.point.tolist(), strict=True))
    assert len(pairs) == len(set(pairs)) == 80 and tracks.used == (0, 1, 2, 3)
    np.testing.assert_array_equal(np.sort(tracks.pixels[tracks.photograph == 3][:, 0]), 300 + hub)  # the first match


def test_a_picture_that_is_a_quarter_turn_off_is_in_doubt_and_the_others_are_not():
    random, symmetric, other = np.random.default_rng(10), four_times(texture(11, 6.0)), texture(12, 6.0)

    def value(places):
        return 0.7 * symmetric(places) + 0.3 * other(places)

    for wrong in range(1, 4):
        pictures = np.stack([on_grid(value, wrong if k == 3 else 0, random) for k in range(9)])
        np.testing.assert_array_equal(np.flatnonzero(ambiguous_positions(pictures)), [3])
    pictures = np.stack([on_grid(other, 0, random) for _ in range(9)])
    assert not ambiguous_positions(pictures).any(), "a card without symmetry"


def test_a_card_that_is_the_same_after_a_quarter_turn_or_a_shift_leaves_every_position_in_doubt():
    random = np.random.default_rng(13)
    assert ambiguous_positions(np.stack([on_grid(four_times(texture(14, 6.0)), 0, random) for _ in range(9)])).all()

    def waves(places):
        return np.sin(places[..., 0] * 2 * np.pi / 13) * np.sin(places[..., 1] * 2 * np.pi / 13)

    assert ambiguous_positions(np.stack([on_grid(waves, 0, random) for _ in range(9)])).all()


def test_photographs_of_a_card_that_is_the_same_after_a_quarter_turn_are_refused():
    pytest.importorskip("cv2", reason="OpenCV is not installed")
    surface = four_times(texture(9, 8.0))

    def value(places):
        return np.where((np.abs(places) < 65).all(-1), 0.1 + 0.7 * surface(places), 0.01)

    with pytest.raises(InputError, match="looks the same after a turn or a shift.*IMG_0.*markers"):
        run_steps(handheld_steps(photographs(hand(9, seed=7, widest=35.0), value), "known"))


def test_photographs_of_one_name_in_two_folders_get_cameras_of_two_names(tmp_path):
    names = ["a/1.png", "b/1.png", "b/2.png"]
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        write_png(tmp_path / name, np.zeros((4, 4, 3), int))
    (tmp_path / "filenames.txt").write_text("\n".join(names))
    spec = handheld._photographs(Namespace(photographs=tmp_path, colour_space="auto"))
    assert [shot.name for shot in spec.observations] == ["a/1.png", "b/1.png", "2.png"] == [v.name for v in spec.views]
    (tmp_path / "filenames.txt").write_text("\n".join([*names, "b/../a/1.png"]))
    with pytest.raises(InputError, match=r"filenames.txt: lists .*1.png twice; remove one of the lines"):
        handheld._photographs(Namespace(photographs=tmp_path, colour_space="auto"))


def test_the_angle_of_the_folders_camera_file_is_kept_and_its_other_keys_are_warned_of(tmp_path):
    for name in ("1.png", "2.png"):
        write_png(tmp_path / name, np.zeros((30, 40, 3), int))
    (tmp_path / "camera.toml").write_text("fov_degrees = 60\nprincipal_point = [10, 10]\ndistortion = [-0.3]\n")
    spec = handheld._photographs(Namespace(photographs=tmp_path, colour_space="auto"))
    capture = build_capture(spec, decode_png)
    for fov, angle in ((None, 60.0), (40.0, 40.0)):
        seen_by, lens = handheld._with_lens(capture, spec, fov)
        assert lens == "known"
        np.testing.assert_allclose([c.scale for c in seen_by.cameras], 20 / np.tan(np.radians(angle / 2)))
        np.testing.assert_allclose([c.centre for c in seen_by.cameras], [[20, 15]] * 2)
    (warning,) = handheld._lens_warnings(tmp_path)
    assert "camera.toml: not used: distortion, principal_point; handheld reads" in warning
    (tmp_path / "camera.toml").write_text("focal_length_px = 50\n")
    assert handheld._lens_warnings(tmp_path) == []
