"""Camera files of other programs, written by hand from the formats' documentation: known points on known pixels."""

import json

import numpy as np
import pytest

from irpso_addon.capture import CaptureError
from irpso_addon.capture.poses import read_poses
from tests.builders.poses import (
    CENTRE,
    CHUNK,
    COLMAP_LENSES,
    COMPONENT,
    HEIGHT,
    POINTS,
    POSE,
    SCALE,
    SHIFT,
    TERMS,
    TURN,
    TURNED,
    WIDTH,
    alicevision,
    alicevision_pixels,
    assert_sees,
    colmap,
    colmap_pixels,
    metashape,
    metashape_pixels,
    row,
)

# ---- COLMAP


@pytest.mark.parametrize("model", COLMAP_LENSES)
@pytest.mark.parametrize("place", [".", "sparse/0"])
def test_colmap_cameras_project_like_its_models(tmp_path, model, place):
    colmap(tmp_path / place, model, row(COLMAP_LENSES[model]))
    found = read_poses(tmp_path)
    assert (found.program, list(found.cameras)) == ("COLMAP", ["IMG_0001.JPG"])
    camera = found.cameras["IMG_0001.JPG"]
    assert (camera.width, camera.height) == (WIDTH, HEIGHT)
    np.testing.assert_allclose(camera.position, CENTRE, atol=1e-12)
    assert_sees(camera, colmap_pixels(model, COLMAP_LENSES[model]))


@pytest.mark.parametrize("points", ["", "1.5 2.5 -1 3.5 4.5 12"])
def test_the_lines_of_points_may_be_empty_and_names_may_hold_spaces(tmp_path, points):
    pose = row([1, 0, 0, 0, 1, 2, 3])
    images = [f"1 {pose} 7 left camera/IMG 1.JPG", f"9 {pose} 7 right/0002"]
    found = read_poses(colmap(tmp_path, images=images, points=points) / "cameras.txt")
    assert list(found.cameras) == ["left camera/IMG 1.JPG", "right/0002"]
    np.testing.assert_allclose(found.cameras["right/0002"].position, (-1, -2, -3), atol=1e-15)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"parameters": "500 510 330"}, "line 4: PINHOLE has 4 parameters (fx, fy, cx, cy), not 3"),
        ({"parameters": "500 510 330 nan"}, "cameras.txt: line 4: holds a value that is no finite number"),
        ({"parameters": "500 510 330 x"}, "'x' is not a number"),
        ({"parameters": "-500 510 330 240"}, "must be above 0"),
        ({"images": [f"1 {POSE} 7 a", f"2 {POSE} 7 a"]}, "'a' is listed twice"),
        ({"images": [f"1 {POSE} 8 a"]}, "cameras.txt has no camera 8"),
        ({"images": ["1 0 0 0 0 1 2 3 7 a"]}, "line 3: the quaternion has length 0, not 1"),
        ({"images": ["1 1 0 0 nan 1 2 3 7 a"]}, "no finite number"),
        ({"images": ["1 1 0 0 0 1 2"]}, "line 3: is neither an image (ten words) nor an image's points"),
        ({"count": 2}, "images.txt: says it lists 2 and lists 1; it is cut short"),
        ({"images": []}, "holds no camera; align"),
        ({"model": "OPENCV_FISHEYE", "parameters": "1 2 3 4 5 6 7 8"}, "OPENCV_FISHEYE, which is not read; undistort"),
        ({"model": "MY_OWN"}, "of model MY_OWN, which is not read; undistort in COLMAP"),
    ],
)
def test_a_broken_colmap_model_is_reported_in_one_line(tmp_path, given, words):
    with pytest.raises(CaptureError) as caught:
        read_poses(colmap(tmp_path, **given))
    message = str(caught.value)
    assert words in message and len(message.splitlines()) == 1 and str(tmp_path) in message


def test_binary_models_and_missing_files_name_the_remedy(tmp_path):
    with pytest.raises(CaptureError, match="has no cameras.txt; give the folder"):
        read_poses(tmp_path)
    (tmp_path / "cameras.bin").write_bytes(b"\0")
    with pytest.raises(CaptureError, match="export the model as text"):
        read_poses(tmp_path)
    (colmap(tmp_path) / "images.txt").unlink()
    with pytest.raises(CaptureError, match=r"images.txt: is not there; export"):
        read_poses(tmp_path)
    (tmp_path / "images.txt").write_bytes(b"\xff\xfe\0")
    with pytest.raises(CaptureError, match="is no text file"):
        read_poses(tmp_path)
    for name in ("gone.xml", "a.obj"):
        (tmp_path / "a.obj").touch()
        with pytest.raises(CaptureError, match="cameras are read from a COLMAP folder"):
            read_poses(tmp_path / name)


# ---- Metashape


@pytest.mark.parametrize("world", ["", COMPONENT, CHUNK])
def test_metashape_cameras_project_like_its_manual(tmp_path, world):
    found = read_poses(metashape(tmp_path / "cameras.xml", world=world))
    assert (found.program, list(found.cameras)) == ("Metashape", ["IMG_0001"])
    camera = found.cameras["IMG_0001"]
    points = SCALE * POINTS @ TURN.T + SHIFT if world else POINTS
    assert_sees(camera, metashape_pixels(TERMS), points)
    np.testing.assert_allclose(camera.position, SCALE * TURN @ CENTRE + SHIFT if world else CENTRE, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(camera.matrix[:3, :3], axis=0), 1, atol=1e-12)


def test_cameras_that_are_disabled_or_not_aligned_are_named_as_such(tmp_path):
    found = read_poses(metashape(tmp_path / "cameras.xml"))
    with pytest.raises(CaptureError, match="^here: .*'IMG_0002' is disabled; enable it"):
        found.name_of("IMG_0002.JPG", "here")
    with pytest.raises(CaptureError, match="'IMG_0003' was not aligned"):
        found.name_of("img_0003.jpg", "here")
    with pytest.raises(CaptureError, match="has no 'IMG_9.JPG'; set camera to one that it has: 'IMG_0001'$"):
        found.name_of("IMG_9.JPG", "here")
    assert found.name_of("photos/img_0001.tif", "here") == "IMG_0001"


def test_a_slave_camera_of_a_rig_is_named_as_such(tmp_path):
    slave = '<camera id="9" sensor_id="0" component_id="0" master_id="0" label="NIR"/>'
    found = read_poses(metashape(tmp_path / "cameras.xml", camera=slave))
    with pytest.raises(CaptureError, match="'NIR' is a slave camera of a multi-camera system, .* as single cameras"):
        found.name_of("NIR.TIF", "here")


PLACED = COMPONENT.replace("<components>", '<components active_id="{}">').replace("</components>", "{}</components>")


@pytest.mark.parametrize(
    ("world", "other", "used"),
    [
        (PLACED.format(0, '<component id="1"><region/></component>'), 1, True),
        (COMPONENT.replace("</components>", '<component id="1"/></components>'), 1, True),  # none is said to be active
        (PLACED.format(1, '<component id="1"/>'), 0, False),
        (PLACED.format(1, COMPONENT[12:-13].replace('id="0"', 'id="1"')), 0, False),
        (COMPONENT.replace("<components>", '<components active_id="0">'), None, True),
        ('<components active_id="7"><component id="0"/><component id="1"/></components>', None, True),
    ],
)
def test_cameras_of_another_metashape_component_are_unusable(tmp_path, world, other, used):
    """Components share no tie points: their places and scales have nothing to do with each other."""
    camera = f'<camera id="8" sensor_id="0" component_id="1" label="B"><transform>{row(np.eye(4))}</transform></camera>'
    found = read_poses(metashape(tmp_path / "a.xml", world=world, camera=camera))
    unusable = {1: ["B"], 0: ["IMG_0001"], None: []}[other]
    assert [name for name, why in found.unusable.items() if "another component than the model's" in why] == unusable
    assert ("IMG_0001" in found.cameras) == used and ("B" in found.cameras) == (other != 1)


@pytest.mark.parametrize(
    ("sensor", "words"),
    [
        (
            '<sensor id="5" type="spherical"><resolution width="640" height="480"/></sensor>',
            "a lens of type spherical; o",
        ),
        ('<sensor id="5" type="frame"/>', "a sensor without a calibration; align"),
    ],
)
def test_a_metashape_sensor_without_a_calibration_leaves_the_other_cameras_usable(tmp_path, sensor, words):
    """Spherical sensors have none, as in the file of issue 1634 of nerfstudio."""
    camera = f'<camera id="8" sensor_id="5" label="B"><transform>{row(np.eye(4))}</transform></camera>'
    path = metashape(tmp_path / "a.xml", camera=camera)
    path.write_text(path.read_text().replace("</sensors>", f"{sensor}</sensors>"))
    found = read_poses(path)
    assert list(found.cameras) == ["IMG_0001"] and words in found.unusable["B"]


def test_a_metashape_sensor_of_an_empty_type_has_a_frame_lens(tmp_path):
    found = read_poses(metashape(tmp_path / "a.xml", kind=""))
    assert_sees(found.cameras["IMG_0001"], metashape_pixels(TERMS))


def test_a_repeated_label_is_reported_only_if_used(tmp_path):
    other = f'<camera id="8" sensor_id="0" label="other"><transform>{row(np.eye(4))}</transform></camera>'
    again = '<camera id="9" sensor_id="0" label="IMG_0001"/><camera id="10" sensor_id="0" label="IMG_0001"/>'
    found = read_poses(metashape(tmp_path / "a.xml", camera=other + again))
    assert list(found.cameras) == ["other"]
    with pytest.raises(CaptureError, match="its 'IMG_0001' is the name of several photographs; give them"):
        found.name_of("IMG_0001.JPG", "here")


@pytest.mark.parametrize(
    ("terms", "refused"),
    [
        ({"k4": 1e-6, "b2": 0.01}, ""),  # less than a tenth of a pixel in the corners
        ({"k4": 0.01}, "K4"),
        ({"b2": -1}, "B2"),
        ({"p3": 5}, "P3 and P4"),
    ],
)
def test_unsupported_metashape_terms_are_refused_unless_zero(tmp_path, terms, refused):
    metashape(tmp_path / "a.xml", {**TERMS, **terms})
    if not refused:
        assert_sees(read_poses(tmp_path / "a.xml").cameras["IMG_0001"], metashape_pixels(TERMS))
        return
    with pytest.raises(CaptureError, match=f"has {refused}, which is not read; optimize"):
        read_poses(tmp_path / "a.xml")


BOMB = """<!DOCTYPE lolz [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">
<!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;&b;&b;">]>"""


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"head": BOMB}, "declares a document type"),
        ({"head": '<!DOCTYPE a SYSTEM "file:///etc/passwd">'}, "declares a document type"),
        ({"terms": {"cx": 1}}, "sensor 'Body, 50 mm': its calibration has no f"),
        ({"terms": {"f": "nan"}}, "f must be 1 finite number"),
        ({"terms": {"f": "five"}}, "f must be 1 finite number"),
        ({"terms": {"f": -5}}, "resolution and f must be above 0"),
        ({"transform": "1 0 0"}, "camera 'IMG_0001': its transform must be 16 finite numbers"),
        ({"transform": row(np.diag([2, 2, 2, 1]))}, "must be a rotation and a position"),
        ({"transform": row(np.full(16, np.nan))}, "16 finite numbers"),
        ({"kind": "fisheye"}, "'IMG_0001' has a lens of type fisheye; only frame cameras are read"),
        ({"kind": "equidistant_fisheye"}, "has a lens of type equidistant_fisheye"),
        ({"world": CHUNK.replace("2.5", "0")}, "the chunk's transform must be a rotation, a shift and a scale"),
        ({"world": CHUNK.replace("2.5", "1 2")}, "the chunk's transform must be 1 finite number"),
        ({"camera": '<camera id="9" sensor_id="5" label="x"><transform/></camera>'}, "sensor 5 is not there"),
        ({"reference": '<reference>GEOGCS["WGS 84",1]</reference>'}, "its cameras have geographic coordinates"),
    ],
)
def test_a_broken_metashape_file_is_reported_in_one_line(tmp_path, given, words):
    with pytest.raises(CaptureError) as caught:
        read_poses(metashape(tmp_path / "cameras.xml", **given))
    assert words in str(caught.value) and len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (lambda whole: whole[: len(whole) // 2], "is cut short or no XML"),
        (lambda whole: "", "is cut short or no XML"),
        (lambda whole: "<html><body/></html>", "is no list of Metashape's cameras"),
        (lambda whole: whole.replace("</chunk>", "</chunk><chunk/>"), "holds 2 chunks"),
        (lambda whole: whole.replace("<cameras", "<kameras").replace("</cameras", "</kameras"), "holds no camera"),
    ],
)
def test_another_file_than_metashapes_is_reported(tmp_path, text, words):
    path = metashape(tmp_path / "cameras.xml")
    path.write_text(text(path.read_text()))
    with pytest.raises(CaptureError, match=words):
        read_poses(path)


@pytest.mark.parametrize("encoding", ["shift_jis", "x-unknown"])
def test_an_xml_of_an_encoding_that_is_not_read_is_reported(tmp_path, encoding):
    path = metashape(tmp_path / "cameras.xml")
    path.write_text(path.read_text().replace("UTF-8", encoding))
    with pytest.raises(CaptureError, match="cameras.xml: has an encoding that is not read .*; save it as UTF-8"):
        read_poses(path)


# ---- AliceVision


@pytest.mark.parametrize("version", [(1, 0, 0), (1, 2, 0), (1, 2, 1), (1, 2, 2), (1, 2, 3), (1, 2, 14)])
def test_alicevision_cameras_see_points_of_the_mesh_of_their_version(tmp_path, version):
    found = read_poses(alicevision(tmp_path / "cameras.sfm", version))
    assert (found.program, list(found.cameras)) == ("AliceVision", ["/scan/IMG_0001.JPG"])
    points = POINTS @ TURNED if version >= (1, 2, 3) else POINTS
    assert_sees(found.cameras["/scan/IMG_0001.JPG"], alicevision_pixels(-0.11, 0.06, 0.02), points)


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ({"type": "pinhole", "distortionParams": ""}, ()),
        ({"type": "radial1", "distortionParams": ["0.07"]}, (0.07,)),
        ({"type": "pinhole", "distortionType": "radialk1", "distortionParams": ["0.07"]}, (0.07,)),
        ({"type": "pinhole", "distortionType": "none", "undistortionType": "none", "distortionParams": ""}, ()),
        (
            {"type": "brown", "distortionParams": ["0.07", "-0.03", "0.01", "0.004", "-0.003"]},
            (0.07, -0.03, 0.01, 0.004, -0.003),
        ),
    ],
)
def test_alicevision_distortions_match_its_models(tmp_path, kind, values):
    found = read_poses(alicevision(tmp_path / "a.json", (1, 2, 2), kind))
    assert_sees(found.cameras["/scan/IMG_0001.JPG"], alicevision_pixels(*values))


def test_views_without_a_pose_or_in_a_rig_are_named_as_such(tmp_path):
    found = read_poses(alicevision(tmp_path / "a.sfm"))
    with pytest.raises(CaptureError, match="'/scan/IMG_0002.JPG' was not aligned"):
        found.name_of("IMG_0002.JPG", "here")
    rig = {"rigId": "1", "subPoseId": "0", "isPoseIndependant": "false", "poseId": "21"}
    assert "rig" in read_poses(alicevision(tmp_path / "b.sfm", view=rig)).unusable["/scan/IMG_0002.JPG"]
    alone = {"poseId": "21", "intrinsicId": "77"}
    assert "no intrinsics" in read_poses(alicevision(tmp_path / "c.sfm", view=alone)).unusable["/scan/IMG_0002.JPG"]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"intrinsics": {"type": "fisheye4"}}, "intrinsics of type 'fisheye4', which is not read"),
        ({"intrinsics": {"type": "equidistant"}}, "'equidistant', which is not read"),
        ({"intrinsics": {"type": "pinhole", "distortionType": "3deradial4"}}, "'3deradial4', which is not read"),
        ({"intrinsics": {"distortionType": ""}}, "intrinsics of type '', which is not read"),
        ({"intrinsics": {"type": ""}}, "intrinsics of type '', which is not read"),
        ({"intrinsics": {"focalLength": 10**400}}, "focalLength must be a number"),
        (
            {"intrinsics": {"distortionParams": ["1e308", "0", "0"]}},
            "'/scan/IMG_0001.JPG': its distortion is no lens's",
        ),
        ({"intrinsics": {"undistortionType": "3declassicld"}}, "'3declassicld', which is not read"),
        ({"intrinsics": {"pixelRatio": "1.5"}}, "oblong pixels"),
        ({"intrinsics": {"distortionParams": ["1"]}}, "intrinsics 31: distortionParams must be 3 numbers"),
        ({"intrinsics": {"focalLength": "NaN"}}, "focalLength must be a finite number"),
        ({"intrinsics": {"focalLength": None}}, "focalLength must be a number"),
        ({"intrinsics": {"focalLength": "-1"}}, "size and focal length must be above 0"),
        ({"intrinsics": {"sensorWidth": "0"}}, "sensorWidth must be above 0"),
        ({"intrinsics": {"principalPoint": ["1"]}}, "principalPoint must be 2 numbers"),
        ({"pose": {"rotation": ["0"] * 9}}, "pose 21: its rotation scales or mirrors"),
        ({"pose": {"rotation": ["1"] * 8}}, "rotation must be 9 numbers"),
        ({"pose": {"center": ["1", "inf", "2"]}}, "center must be a finite number"),
        ({"poses": [{"poseId": "21"}]}, "pose 21: has no transform"),
        ({"poses": [{}]}, "an entry has no poseId"),
        ({"poses": "many"}, "its poses are no list"),
        ({"version": ["1"]}, "version must be 3 numbers"),
        ({"view": {"path": "/scan/IMG_0001.JPG"}}, "is there twice"),
        ({"poses": []}, "none of its cameras can be used: '/scan/IMG_0001.JPG' was not aligned"),
    ],
)
def test_a_broken_alicevision_file_is_reported_in_one_line(tmp_path, given, words):
    more = {key: given[key] for key in ("poses",) if key in given}
    path = alicevision(tmp_path / "a.sfm", **{**given, **more} if "version" not in given else {})
    if "version" in given:
        path.write_text(json.dumps({**json.loads(path.read_text()), **given}))
    with pytest.raises(CaptureError) as caught:
        read_poses(path)
    assert words in str(caught.value) and len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("text", "words"), [("{", "is cut short or no JSON"), ("[" * 99999, "no JSON"), ("[]", "no views"), ("{}", "views")]
)
def test_another_file_than_alicevisions_is_reported(tmp_path, text, words):
    (tmp_path / "a.sfm").write_text(text)
    with pytest.raises(CaptureError, match=words):
        read_poses(tmp_path / "a.sfm")
