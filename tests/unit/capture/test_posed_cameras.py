"""Cameras of other programs: names that images find them by, and conversion to our worlds and picture sizes."""

from pathlib import Path

import numpy as np
import pytest

from irpso_addon.capture import CaptureError
from irpso_addon.capture.images.exif import upright
from irpso_addon.capture.poses import PoseFile, moved, posed, read_poses, similarity, upright_camera
from tests.builders.poses import (
    COLMAP_LENSES,
    HEIGHT,
    POINTS,
    POSE,
    ROTATION,
    SCALE,
    SHIFT,
    WIDTH,
    alicevision,
    assert_sees,
    colmap,
    colmap_pixels,
    row,
)


def a_camera(tmp_path, model="FULL_OPENCV"):
    return read_poses(colmap(tmp_path, model, row(COLMAP_LENSES[model]))).cameras["IMG_0001.JPG"]


def test_moving_the_world_keeps_projections(tmp_path):
    camera = a_camera(tmp_path)
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = SCALE * ROTATION, SHIFT
    assert_sees(
        moved(camera, similarity(world, "here")),
        colmap_pixels("FULL_OPENCV", COLMAP_LENSES["FULL_OPENCV"]),
        SCALE * POINTS @ ROTATION.T + SHIFT,
    )


@pytest.mark.parametrize(
    "matrix",
    [np.diag([1, 1, 2, 1]), np.diag([1, 1, -1, 1]), np.diag([1, 1, 1, 2]), np.full((4, 4), np.nan), np.zeros((4, 4))],
)
def test_a_matrix_other_than_a_similarity_is_refused(matrix):
    with pytest.raises(CaptureError, match="^here: cameras_matrix"):
        similarity(matrix, "here: cameras_matrix")


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
@pytest.mark.parametrize("factor", [1, 0.5])
def test_a_picture_shown_upright_has_the_camera_of_the_stored_one_turned_with_it(tmp_path, orientation, factor):
    camera = a_camera(tmp_path)
    # A picture as it is stored whose two channels say where its pixels' centres are; turned as any picture is.
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    turned = upright(np.stack([x, y], axis=-1), orientation)
    height, width = (int(side * factor) for side in turned.shape[:2])
    shown = upright_camera(camera, width, height, orientation, "here")
    assert (shown.width, shown.height) == (width, height)
    pixels, _ = shown.project(POINTS)
    stored, _ = camera.project(POINTS)
    # Between pixel centres, beyond the frame as well: the turn is affine.
    centres = (pixels / factor - 0.5)[:, None, :]
    step = np.array([turned[0, 1] - turned[0, 0], turned[1, 0] - turned[0, 0]])
    np.testing.assert_allclose((turned[0, 0] + centres @ step)[:, 0], stored, atol=1e-9)


def test_a_size_already_turned_by_the_program_is_kept(tmp_path):
    camera = a_camera(tmp_path)
    assert upright_camera(camera, WIDTH, HEIGHT, 6, "here") == camera


@pytest.mark.parametrize(("size", "orientation", "words"), [((600, 480), 1, "uncropped"), ((640, 480), 2, "mirrored")])
def test_a_cropped_or_mirrored_picture_is_refused(tmp_path, size, orientation, words):
    with pytest.raises(CaptureError, match=f"^here: .*{words}"):
        upright_camera(a_camera(tmp_path), *size, orientation, "here")


def test_an_image_name_that_fits_several_cameras_must_be_whole(tmp_path):
    images = [f"{n} {POSE} 7 {name}" for n, name in enumerate(["a/1.jpg", "b/1.jpg", "b/2.jpg"], 1)]
    found = read_poses(colmap(tmp_path, images=images))
    assert found.name_of("b/1.jpg", "here") == "b/1.jpg" and found.name_of("2.png", "here") == "b/2.jpg"
    with pytest.raises(CaptureError, match="'1.jpg' may be any of 'a/1.jpg', 'b/1.jpg' of .*; give camera its whole"):
        found.name_of("1.jpg", "here")


@pytest.mark.parametrize(
    ("names", "image", "found"),
    [
        (["images/1.jpg", "images/2.jpg"], "developed/1.exr", "images/1.jpg"),
        (["cam1/2.jpg", "cam2/1.jpg"], "cam1/1.jpg", None),
        (["cam1/2.jpg", "cam2/1.jpg"], "photos/cam1/1.jpg", None),
        (["cam1/1.jpg", "cam2/1.jpg"], "photos/cam1/1.jpg", "cam1/1.jpg"),
        (["cam1/1.jpg", "cam2/1.jpg"], "Photos/Cam2/1.TIF", "cam2/1.jpg"),
        (["photos/cam1/1.jpg", "photos/cam2/1.jpg"], "cam2/1.jpg", "photos/cam2/1.jpg"),
        (["cam2\\1.jpg", "cam1\\2.jpg"], "cam1/1.jpg", None),
        (["cam2\\1.jpg", "cam1\\2.jpg"], "cam1/2.jpg", "cam1\\2.jpg"),
        (["1.jpg"], "cam1/1.jpg", "1.jpg"),
        (["Bu\u0308ste"], "B\u00fcste.jpg", "Bu\u0308ste"),  # u and its dots, as macOS writes ü
        (["B\u00dcSTE.JPG"], "bu\u0308ste.jpg", "B\u00dcSTE.JPG"),
        # Paths of another computer: only the folders that differ count.
        (["/scan/1.jpg", "/scan/2.jpg"], "developed/1.exr", "/scan/1.jpg"),
        (["/scan/cam1/2.jpg", "/scan/cam2/1.jpg"], "developed/cam1/1.exr", None),
        (["/scan/cam1/1.jpg", "/scan/cam2/1.jpg"], "developed/cam1/1.exr", "/scan/cam1/1.jpg"),
    ],
)
def test_an_image_never_has_the_camera_of_another_folders_image(tmp_path, names, image, found):
    poses = read_poses(colmap(tmp_path, images=[f"{n} {POSE} 7 {name}" for n, name in enumerate(names, 1)]))
    if found is not None:
        assert poses.name_of(image, "here") == found
        return
    with pytest.raises(CaptureError, match=f"^here: .*it has no '{image}'; set camera"):
        poses.name_of(image, "here")


def test_names_are_prepared_once_for_all_photographs(monkeypatch):
    calls = []
    lower = posed._lower
    monkeypatch.setattr(posed, "_lower", lambda parts: calls.append(parts) or lower(parts))
    names = [f"IMG_{number:04}" for number in range(300)]
    found = PoseFile(Path("a.xml"), "Metashape", dict.fromkeys(names, a_camera), {})
    assert [found.name_of(f"photos/{name}.JPG", "here") for name in names] == names
    assert len(calls) <= 5 * len(names)


def test_an_image_that_fits_an_unusable_camera_as_well_has_no_other(tmp_path):
    view = {"path": "/other/IMG_0001.JPG"}
    found = read_poses(alicevision(tmp_path / "a.sfm", view=view))
    assert list(found.cameras) == ["/scan/IMG_0001.JPG"]
    with pytest.raises(CaptureError, match="it has no 'photos/IMG_0001.JPG'"):
        found.name_of("photos/IMG_0001.JPG", "here")
    with pytest.raises(CaptureError, match="'IMG_0001.JPG' may be any of '/scan/IMG_0001.JPG', '/other/IMG_0001.JPG'"):
        found.name_of("IMG_0001.JPG", "here")
    with pytest.raises(CaptureError, match="its '/other/IMG_0001.JPG' was not aligned"):
        found.name_of("photos/other/IMG_0001.JPG", "here")
