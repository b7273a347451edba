"""A capture table takes cameras from files of other programs, and says all that cameras and lights can be."""

import numpy as np
import pytest

from irpso_addon.calibration.photographs import with_camera
from irpso_addon.capture import Camera, Capture, CaptureError, Light, Observation, read_capture, write_capture
from irpso_addon.capture.images import image
from irpso_addon.capture.images.raw import RawHeader
from irpso_addon.capture.inspect.report import inspect_capture
from irpso_addon.capture.read import read_spec
from tests.builders.captures import chunk, decode_png, write_png
from tests.builders.poses import CENTRE, HEIGHT, POINTS, ROTATION, SEEN, WIDTH, colmap, quaternion, row

LENS = "OPENCV 64 48 50 51 33.05 23.625 -0.11 0.06 0.004 -0.003"
LIT = "light_direction = [0, 0, 1]\n"


@pytest.fixture
def scan(tmp_path):
    """Three photographs of 64 × 48 with a COLMAP model of them; the third was not aligned."""
    for name in ("IMG_1.png", "IMG_2.png", "IMG_3.png", "lit.png"):
        write_png(tmp_path / name, np.full((48, 64, 3), 90))
    poses = [(ROTATION, CENTRE), (ROTATION.T, np.array([0.5, 0.25, -3]))]
    lines = [f"{n} {row([*quaternion(r), *(-r @ c)])} 1 IMG_{n}.png\n\n" for n, (r, c) in enumerate(poses, 1)]
    (tmp_path / "colmap").mkdir()
    (tmp_path / "colmap" / "cameras.txt").write_text(f"1 {LENS}\n")
    (tmp_path / "colmap" / "images.txt").write_text("".join(lines))
    return tmp_path


def read(folder, observations, top="", cameras=""):
    body = "".join(f"[[observation]]\n{LIT}{text}\n" for text in observations)
    (folder / "capture.toml").write_text(f'cameras = "colmap/"\n{top}\n{cameras}\n{body}')
    return read_capture(folder, decode_png)


def test_every_observation_has_the_camera_of_its_image_or_the_one_it_names(scan):
    lines = ['image = "IMG_2.png"', 'image = "lit.png"\ncamera = "IMG_1"', 'image = "IMG_1.png"', 'image = "IMG_2.png"']
    capture = read(scan, lines)
    assert [o.camera for o in capture.observations] == [0, 1, 1, 0] and len(capture.cameras) == 2
    one = capture.cameras[1]
    assert (one.width, one.height, one.scale) == (64, 48, (50, 51))
    np.testing.assert_allclose(one.centre, (33.05, 48 - 23.625), atol=1e-12)
    np.testing.assert_allclose(one.distortion, (-0.11, 0.06, 0.004, -0.003))
    np.testing.assert_allclose(one.position, CENTRE, atol=1e-12)
    # Along the axis of the camera, one away: the principal point.
    found, depth = one.project(CENTRE + ROTATION[2])
    np.testing.assert_allclose((*found, depth), (*one.centre, 1), atol=1e-12)
    assert all(mask.all() for mask in capture.masks)


def test_a_capture_has_only_used_cameras_and_a_table_may_mask_them(scan):
    mask = np.zeros((48, 64, 1))
    mask[:10] = 255
    write_png(scan / "mask.png", mask)
    extra = '[[camera]]\nname = "IMG_1.png"\nmask = "mask.png"\n[[camera]]\nname = "own"\nfov_degrees = 40.0\n'
    capture = read(scan, ['image = "lit.png"\ncamera = "own"', 'image = "IMG_1.png"'], cameras=extra)
    assert [o.camera for o in capture.observations] == [0, 1] and len(capture.cameras) == 2
    np.testing.assert_array_equal(capture.masks[1], mask[::-1, :, 0] > 0)
    assert capture.masks[0].all() and capture.cameras[0].distortion == ()


def test_the_worlds_matrix_moves_the_cameras_and_leaves_their_axes_unscaled(scan):
    world = np.eye(4)
    world[:3] = np.c_[2.5 * ROTATION, [1, 2, 3]]
    text = f"cameras_matrix = [{', '.join(map(str, world.ravel()))}]"
    before, after = (read(scan, ['image = "IMG_1.png"'], top).cameras[0] for top in ("", text))
    points = (0.1 * SEEN) @ ROTATION + CENTRE
    np.testing.assert_allclose(
        after.project(2.5 * points @ ROTATION.T + [1, 2, 3])[0], before.project(points)[0], atol=1e-9
    )
    np.testing.assert_allclose(after.matrix[:3, :3].T @ after.matrix[:3, :3], np.eye(3), atol=1e-12)


def test_a_photograph_on_its_side_and_at_half_the_size_has_its_camera_turned_and_scaled(scan):
    tiff = b"II*\0\x08\0\0\0\x01\0" + b"\x12\x01\x03\0\x01\0\0\0\x06\0\0\0" + b"\0\0\0\0"  # orientation 6
    write_png(scan / "IMG_1.png", np.full((24, 32, 3), 90), extra=chunk(b"eXIf", tiff))
    stored = read(scan, ['image = "IMG_2.png"\ncamera = "IMG_1.png"']).cameras[0]
    shown = read_spec(scan / "capture.toml").views  # specs make no camera before the sizes are known
    assert len(shown) == 1 and shown[0].placed
    (scan / "capture.toml").write_text(f'cameras = "colmap"\n[[observation]]\nimage = "IMG_1.png"\n{LIT}')
    (view,) = read_spec(scan / "capture.toml").views
    turned = view.make(24, 32)
    points = SEEN @ ROTATION + CENTRE
    x, y = stored.project(points)[0].T
    np.testing.assert_allclose(turned.project(points)[0], np.c_[y, 64 - x] / 2, atol=1e-9)


def test_a_lens_is_not_set_for_a_camera_of_the_cameras_file(scan):
    read(scan, ['image = "IMG_1.png"'], cameras='[[camera]]\nname = "IMG_1.png"\nmask = "lit.png"')
    with pytest.raises(CaptureError, match="colmap: camera 'IMG_1.png': its lens is that of .*; leave --fov out"):
        with_camera(read_spec(scan / "capture.toml"), {"fov_degrees": 40.0}, "--fov")


@pytest.mark.parametrize("tag", [1, 3])
def test_a_raw_file_that_is_no_tiff_has_the_camera_of_its_pose(scan, tag, monkeypatch):
    monkeypatch.setattr(image, "raw_header", lambda path: RawHeader(64, 48, tag))  # LibRaw turns its picture upright
    (scan / "IMG_1.CR3").write_bytes(b"\0\0\0\x18ftypcrx ")
    text = 'image = "IMG_1.CR3"\ncamera = "IMG_1.png"'
    (scan / "capture.toml").write_text(f'cameras = "colmap"\n[[observation]]\n{text}\n{LIT}')
    (view,) = read_spec(scan / "capture.toml").views
    camera = view.make(64, 48)
    np.testing.assert_allclose(camera.position, CENTRE, atol=1e-12)
    (scan / "capture.toml").write_text(f'cameras = "colmap"\n[[observation]]\nimage = "IMG_1.png"\n{LIT}')
    stored = read_spec(scan / "capture.toml").views[0].make(64, 48)
    points = SEEN @ ROTATION + CENTRE
    pixels = stored.project(points)[0]
    expected = pixels if tag == 1 else np.array([64, 48]) - pixels
    np.testing.assert_allclose(camera.project(points)[0], expected, atol=1e-9)


@pytest.mark.parametrize(
    ("observations", "top", "words"),
    [
        (['image = "IMG_3.png"'], "", "observation 1: its camera should be in .*colmap: it has no 'IMG_3.png'"),
        (
            ['image = "IMG_1.png"\ncamera = "x"'],
            "",
            "it has no 'x'; set camera to one that it has: 'IMG_1.png', 'IMG_2",
        ),
        (['image = "IMG_1.png"'], "cameras_matrix = [1, 2]", "cameras_matrix must be 16 numbers, row by row$"),
        (
            ['image = "IMG_1.png"'],
            f"cameras_matrix = {np.diag([1, 2, 3, 1]).tolist()}",
            "cameras_matrix scales unevenly",
        ),
        (
            ['image = "small.png"\ncamera = "IMG_1"'],
            "",
            "camera 'IMG_1.png': the picture is 20×48 pixels, its camera 64",
        ),
    ],
)
def test_contradictions_to_the_cameras_file_are_reported(scan, observations, top, words):
    write_png(scan / "small.png", np.full((48, 20, 3), 90))
    with pytest.raises(CaptureError, match=words):
        read(scan, observations, top)


def test_one_camera_is_not_taken_for_the_images_of_two_folders(scan):
    for folder in ("a", "b"):
        (scan / folder).mkdir()
        write_png(scan / folder / "IMG_1.png", np.full((48, 64, 3), 90))
    images = ['image = "a/IMG_1.png"', 'image = "b/IMG_1.png"']
    with pytest.raises(CaptureError, match=r"observation 2: 'b/IMG_1.png' and 'a/IMG_1.png' both fit .*; set camera"):
        read(scan, images)
    assert len(read(scan, [images[0], images[0]]).cameras) == 1
    assert len(read(scan, [f'{text}\ncamera = "IMG_1"' for text in images]).cameras) == 1


def test_a_missing_cameras_file_or_a_matrix_without_one_is_reported(tmp_path):
    write_png(tmp_path / "a.png", np.full((2, 2, 3), 90))
    rest = f'[[camera]]\n[[observation]]\nimage = "a.png"\n{LIT}'
    for top, words in (
        ('cameras = "gone.sfm"', "gone.sfm: is not there"),
        ("cameras = 3", "must be a text"),
        (f"cameras_matrix = {np.eye(4).tolist()}", "cameras_matrix is for a file of cameras"),
    ):
        (tmp_path / "capture.toml").write_text(f"{top}\n{rest}")
        with pytest.raises(CaptureError, match=words):
            read_spec(tmp_path)


def test_a_full_size_model_reads_the_same_through_the_table(tmp_path):
    colmap(tmp_path / "c")
    write_png(tmp_path / "IMG_0001.png", np.full((HEIGHT // 4, WIDTH // 4, 3), 90))
    body = f'cameras = "c"\n[[observation]]\nimage = "IMG_0001.png"\n{LIT}'
    (tmp_path / "capture.toml").write_text(body)
    (camera,) = read_capture(tmp_path, decode_png).cameras
    local = (POINTS - CENTRE) @ ROTATION.T
    u, v = 500 * local[:, 0] / local[:, 2] + 330.5, 510 * local[:, 1] / local[:, 2] + 236.25
    np.testing.assert_allclose(camera.project(POINTS)[0], np.c_[u, HEIGHT - v] / 4, atol=1e-9)


def test_inspect_reports_lenses_cones_and_cosines(scan):
    near = "light_position = [0, 0, 1]\nlight_axis = [0, 0, -1]\n"
    (scan / "capture.toml").write_text(
        f'cameras = "colmap"\n[[observation]]\nimage = "IMG_1.png"\n{LIT}'
        f'[[observation]]\nimage = "IMG_2.png"\n{near}light_cone_degrees = 20\n'
        f'[[observation]]\nimage = "IMG_2.png"\n{near}light_cosine = true\n'
    )
    facts = dict(inspect_capture(scan, decode_png).facts)
    assert facts["lights"] == "1 distant, 2 near, 1 with a cone, 1 falling with the cosine"
    assert facts["IMG_1.png"] == "64×48 perspective with lens distortion, no mask"


# ---- distortion, cones, cosines


def test_a_capture_with_distortion_spots_and_flat_lamps_comes_back(tmp_path):
    axis = (0.48, 0.64, -0.6)
    lights = (
        Light((1.0, 2.0, 3.0), (1.0, 0.5, 0.25), False, axis, 22.5),
        Light((1.0, 2.0, 3.0), (1.0, 1.0, 1.0), False, axis, None, True),
        Light((1.0, 2.0, 3.0), (1.0, 1.0, 1.0), False, axis, 80.0, True),
        Light((1.0, 2.0, 3.0), (1.0, 1.0, 1.0), False, axis),
        Light((1.0, 2.0, 3.0), (1.0, 1.0, 1.0), False, axis, None, 2.5),
        Light((0.0, 0.0, 1.0)),
    )
    camera = Camera(8, 6, (7.0, 7.5), (4.25, 3.0), np.eye(4), True, (-0.1, 1 / 3, 0.001, -0.002, 0.05, 0.0, 1e-9))
    frame = np.random.default_rng(2).random((6, 8, 4)).astype(np.float32)
    shots = tuple(Observation(f"{k}", lambda: frame, light) for k, light in enumerate(lights))
    write_capture(Capture("all", shots, (camera,), (np.ones((6, 8), bool),)), tmp_path / "out")
    found = read_capture(tmp_path / "out")
    for a, b in zip(found.observations, lights, strict=True):
        assert (a.light.distant, a.light.cone, a.light.cosine, a.light.vector) == (
            b.distant,
            b.cone,
            b.cosine,
            b.vector,
        )
        np.testing.assert_allclose(a.light.axis or 0, b.axis or 0, rtol=1e-15)
    assert found.cameras[0].distortion == camera.distortion


@pytest.mark.parametrize(
    ("camera", "light", "words"),
    [
        (
            "fov_degrees = 40\ndistortion = 0.1",
            LIT,
            "camera 1: distortion must be a list of up to 8 numbers: k1, k2, p1",
        ),
        ("fov_degrees = 40\ndistortion = []", LIT, "up to 8 numbers"),
        (f"fov_degrees = 40\ndistortion = {[0.1] * 9}", LIT, "up to 8 numbers"),
        ("fov_degrees = 40\ndistortion = [nan]", LIT, "finite numbers only"),
        ("fov_degrees = 40\ndistortion = [1e308]", LIT, "finite numbers only"),
        (f"fov_degrees = 40\ndistortion = [{10**400}]", LIT, "up to 8 numbers"),
        ("world_width = 2\ndistortion = [0.1]", LIT, "distortion is for perspective cameras"),
        ("", LIT + "light_axis = [0, 0, 1]", "observation 1: light_axis is for a light_position"),
        ("", "light_position = [0, 0, 1]\nlight_cone_degrees = 20", "light_cone_degrees needs light_axis"),
        ("", "light_position = [0, 0, 1]\nlight_axis = [0, 0, 0]", "light_axis is no direction"),
        ("", "light_position = [0, 0, 1]\nlight_axis = [0, nan, 0]", "light_axis is no direction"),
        ("", "light_position = [0, 0, 1]\nlight_axis = [0, 1]", "light_axis must be a list of 3 numbers"),
        ("", "light_position = [0, 0, 1]\nlight_axis = [0, 0, 1]\nlight_cone_degrees = 200", "180 at most"),
        (
            "",
            "light_position = [0, 0, 1]\nlight_axis = [0, 0, 1]\nlight_cone_degrees = 0",
            "light_cone_degrees must be",
        ),
        (
            "",
            'light_position = [0, 0, 1]\nlight_axis = [0, 0, 1]\nlight_cosine = "yes"',
            "must be true, false or a power",
        ),
    ],
)
def test_invalid_distortion_and_cones_are_reported(tmp_path, camera, light, words):
    write_png(tmp_path / "a.png", np.full((2, 2, 3), 90))
    (tmp_path / "capture.toml").write_text(f'[[camera]]\n{camera}\n[[observation]]\nimage = "a.png"\n{light}\n')
    with pytest.raises(CaptureError, match=words):
        read_capture(tmp_path, decode_png)


def test_an_axis_of_any_length_becomes_a_unit_one(tmp_path):
    write_png(tmp_path / "a.png", np.full((2, 2, 3), 90))
    light = "light_position = [0, 0, 1]\nlight_axis = [0, 0, -5]\nlight_cone_degrees = 20\nlight_cosine = true\n"
    (tmp_path / "capture.toml").write_text(f'[[camera]]\n[[observation]]\nimage = "a.png"\n{light}')
    (observation,) = read_capture(tmp_path, decode_png).observations
    assert observation.light == Light((0, 0, 1), (1, 1, 1), False, (0, 0, -1), 20.0, True)
