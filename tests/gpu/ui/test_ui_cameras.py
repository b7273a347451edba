"""Import Cameras: other programs' cameras as objects, which see what they saw."""

import bpy
import numpy as np
import pytest

from irpso_addon.blender.scenes.scene import DISTORTION, camera_from_object
from irpso_addon.core.errors import InputError
from irpso_addon.ui.session import scene_capture
from tests.builders.captures import chunk, write_png
from tests.builders.exif import exif
from tests.builders.poses import (
    CENTRE,
    COLMAP_LENSES,
    HEIGHT,
    POINTS,
    TERMS,
    WIDTH,
    alicevision,
    alicevision_pixels,
    colmap,
    colmap_pixels,
    metashape,
    metashape_pixels,
    row,
)
from tests.builders.scene_captures import add_light

pytestmark = [pytest.mark.bpy_only, pytest.mark.usefixtures("registered")]
TURN = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # y up to z up
RNG = np.random.default_rng(5)
FLIP = np.diag([1.0, -1.0, -1.0])


@pytest.fixture(autouse=True)
def scene(registered):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def blender_pixels(obj, points):
    """Return where Blender itself projects world points, from the upper left corner."""
    bpy.context.view_layer.update()
    width, height = obj["irpso_resolution"]
    aspect = obj["irpso_pixel_aspect"]
    projection = obj.calc_matrix_camera(
        bpy.context.evaluated_depsgraph_get(), x=width, y=height, scale_x=aspect[0], scale_y=aspect[1]
    )
    clip = np.c_[points, np.ones(len(points))] @ np.array(projection @ obj.matrix_world.inverted()).T
    place = (clip[:, :2] / clip[:, 3:] * 0.5 + 0.5) * (width, height)
    return np.c_[place[:, 0], height - place[:, 1]]


def test_blender_sees_points_where_colmap_did(scene, tmp_path):
    colmap(tmp_path / "model")
    assert bpy.ops.irpso.import_cameras(filepath=str(tmp_path / "model" / "cameras.txt")) == {"FINISHED"}
    camera = bpy.data.objects["IMG_0001.JPG"]
    np.testing.assert_allclose(
        blender_pixels(camera, POINTS), colmap_pixels("PINHOLE", COLMAP_LENSES["PINHOLE"]), atol=0.02
    )
    assert camera.users_collection[0].name == "Cameras model" and camera.parent.type == "EMPTY"
    assert DISTORTION not in camera


@pytest.mark.parametrize("axes", ["AUTO", "FILE"])
def test_cameras_follow_a_mesh_that_blender_imports_from_obj(scene, tmp_path, axes):
    straight = {**TERMS, "k1": 0, "k2": 0, "k3": 0, "p1": 0, "p2": 0}
    bpy.ops.irpso.import_cameras(filepath=str(metashape(tmp_path / "a.xml", straight)), axes=axes)
    camera = bpy.data.objects["IMG_0001"]
    (tmp_path / "points.obj").write_text("".join(f"v {x} {y} {z}\n" for x, y, z in POINTS) + "f 1 2 3\n")
    forward = {} if axes == "AUTO" else {"forward_axis": "Y", "up_axis": "Z"}
    bpy.ops.wm.obj_import(filepath=str(tmp_path / "points.obj"), **forward)
    bpy.context.view_layer.update()
    mesh = bpy.context.object
    found = blender_pixels(camera, [mesh.matrix_world @ vertex.co for vertex in mesh.data.vertices])
    np.testing.assert_allclose(found, metashape_pixels(straight)[: len(found)], atol=0.02)


def test_meshrooms_mesh_and_cameras_match_and_move_with_their_empty(scene, tmp_path):
    plain = {"type": "pinhole", "distortionParams": ""}
    bpy.ops.irpso.import_cameras(filepath=str(alicevision(tmp_path / "a.sfm", (1, 2, 6), plain)))
    camera = bpy.data.objects["IMG_0001.JPG"]
    camera.parent.matrix_world = camera.parent.matrix_world.Translation((3, 2, 1)) @ camera.parent.matrix_world
    camera.parent.scale = (2, 2, 2)
    points = 2 * POINTS @ FLIP @ TURN.T + (3, 2, 1)
    np.testing.assert_allclose(blender_pixels(camera, points), alicevision_pixels(), atol=0.02)


def test_a_light_seen_by_an_imported_camera_has_all_of_its_lens(scene, tmp_path):
    path = colmap(tmp_path / "model", "OPENCV", row(COLMAP_LENSES["OPENCV"]))
    bpy.ops.irpso.import_cameras(directory=str(path))
    write_png(tmp_path / "lit.png", np.full((HEIGHT // 4, WIDTH // 4, 3), 100))
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "SUN"))
    scene.collection.objects.link(lamp)
    lamp.irpso.image = bpy.data.images.load(str(tmp_path / "lit.png"))
    lamp.irpso.camera = bpy.data.objects["IMG_0001.JPG"]
    (camera,) = scene_capture.capture_from_scene(scene).cameras
    found, _ = camera.project(POINTS)
    expected = np.array(colmap_pixels("OPENCV", COLMAP_LENSES["OPENCV"])) / 4
    np.testing.assert_allclose(np.c_[found[:, 0], HEIGHT / 4 - found[:, 1]], expected, atol=1e-3)


def lit_by(scene, path, codes, orientation=1):
    """Give the imported camera a lamp with a photograph of this EXIF orientation; return the lamp."""
    write_png(path, codes, extra=chunk(b"eXIf", exif(orientation=orientation)))
    lamp = add_light(scene, f"Lamp of {path.stem}", bpy.data.images.load(str(path)))
    lamp.irpso.camera = bpy.data.objects["IMG_0001.JPG"]
    return lamp


@pytest.mark.parametrize("state", ["file", "packed", "painted"])
def test_a_photograph_that_exif_turns_is_seen_by_the_imported_camera_turned(scene, tmp_path, state):
    bpy.ops.irpso.import_cameras(directory=str(colmap(tmp_path / "model")))
    codes = RNG.integers(0, 255, (HEIGHT // 4, WIDTH // 4, 3))
    image = lit_by(scene, tmp_path / "lit.png", codes, 6).irpso.image
    if state == "packed":
        image.pack()
        (tmp_path / "lit.png").unlink()
    elif state == "painted":
        image.pixels[0] = image.pixels[0]
        assert image.is_dirty
    capture = scene_capture.capture_from_scene(scene)
    (camera,) = capture.cameras
    found, _ = camera.project(POINTS)
    x, y = np.array(colmap_pixels("PINHOLE", COLMAP_LENSES["PINHOLE"])).T / 4
    # 90° clockwise: the stored picture's lower left corner becomes the upper left one.
    expected = np.c_[HEIGHT / 4 - y, x]
    np.testing.assert_allclose(np.c_[found[:, 0], WIDTH / 4 - found[:, 1]], expected, atol=1e-3)
    upright = np.rot90(codes, -1)[::-1] / 255
    linear = np.where(upright <= 0.04045, upright / 12.92, ((upright + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(capture.observations[0].read()[..., :3], linear, atol=1e-5)


def test_photographs_that_an_imported_camera_cannot_have_taken_are_refused(scene, tmp_path):
    bpy.ops.irpso.import_cameras(directory=str(colmap(tmp_path / "model")))
    codes = np.full((HEIGHT // 4, WIDTH // 4, 3), 100)
    lamp = lit_by(scene, tmp_path / "cropped.png", codes[:, 20:])
    with pytest.raises(InputError, match="camera 'IMG_0001.JPG': the picture is 140×120 pixels, its camera 640×480; "):
        scene_capture.capture_from_scene(scene)
    bpy.data.objects.remove(lamp)
    lit_by(scene, tmp_path / "a.png", codes), lit_by(scene, tmp_path / "b.png", codes)
    assert len(scene_capture.capture_from_scene(scene).observations) == 2
    lit_by(scene, tmp_path / "odd.png", codes, 3)
    with pytest.raises(InputError, match="image 'odd.png' of .*: its EXIF orientation is 3 where others .* have 1; "):
        scene_capture.capture_from_scene(scene)


def test_importing_again_updates_cameras_and_keeps_their_empty(scene, tmp_path):
    colmap(tmp_path / "model")
    bpy.ops.irpso.import_cameras(directory=str(tmp_path / "model"))
    camera = bpy.data.objects["IMG_0001.JPG"]
    camera.parent.location, camera.location = (5, 0, 0), (0, 0, 0)
    images = [f"{n} 1 0 0 0 {row(-CENTRE)} 7 IMG_{n:04d}.JPG" for n in (1, 2)]
    colmap(tmp_path / "model", images=images)
    bpy.ops.irpso.import_cameras(directory=str(tmp_path / "model"))
    bpy.context.view_layer.update()
    names = sorted(obj.name for obj in scene.objects)
    assert names == ["Cameras model", "IMG_0001.JPG", "IMG_0002.JPG"] and bpy.data.objects["IMG_0001.JPG"] == camera
    np.testing.assert_allclose(np.array(camera.matrix_world)[:3, 3], CENTRE + (5, 0, 0), atol=1e-6)
    np.testing.assert_allclose(np.array(camera.matrix_world)[:3, :3], FLIP, atol=1e-6)


def test_importing_again_leaves_a_duplicate_and_updates_the_original(scene, tmp_path):
    colmap(tmp_path / "model")
    bpy.ops.irpso.import_cameras(directory=str(tmp_path / "model"))
    camera = bpy.data.objects["IMG_0001.JPG"]
    copy = camera.copy()
    copy.name, copy.parent, copy.location = "Beauty", None, (3, 3, 3)
    camera.users_collection[0].objects.link(copy)
    camera.location = (9, 9, 9)
    bpy.ops.irpso.import_cameras(directory=str(tmp_path / "model"))
    assert tuple(copy.location) == (3, 3, 3) and copy.parent is None
    assert tuple(camera.location) != (9, 9, 9) and camera.parent is not None


def test_a_capture_of_such_cameras_is_imported_and_its_scene_is_it_again(scene, tmp_path):
    colmap(tmp_path / "model", "OPENCV", row(COLMAP_LENSES["OPENCV"]))
    write_png(tmp_path / "lit.png", np.full((HEIGHT // 4, WIDTH // 4, 3), 100))
    shots = "".join(
        f'[[observation]]\nimage = "lit.png"\ncamera = "IMG_0001"\nlight_direction = [0, {k}, 1]\n' for k in (0, 1, 2)
    )
    (tmp_path / "capture.toml").write_text(f'name = "scan"\ncameras = "model"\n{shots}')
    bpy.ops.irpso.import_capture(filepath=str(tmp_path / "capture.toml"))
    assert scene.irpso.subject == "MESH" and "perspective with lens distortion" in scene.irpso.summary
    expected = scene_capture.capture_of(scene).cameras[0]
    bpy.ops.irpso.create_scene()
    scene.irpso.source = "SCENE"
    capture = scene_capture.capture_of(scene)
    assert capture.name == "scan" and [o.camera for o in capture.observations] == [0, 0, 0]
    np.testing.assert_allclose(capture.cameras[0].project(POINTS)[0], expected.project(POINTS)[0], atol=1e-3)
    assert capture.cameras[0].distortion == expected.distortion


@pytest.mark.parametrize(("chosen", "words"), [("", "no file was chosen"), ("gone.xml", "gone.xml: is not there")])
def test_another_file_than_cameras_is_reported(scene, tmp_path, chosen, words):
    with pytest.raises(RuntimeError, match=words):
        bpy.ops.irpso.import_cameras(filepath=str(tmp_path / chosen) if chosen else "")
    assert not scene.objects and not scene.collection.children


def test_unreadable_cameras_are_reported(scene, tmp_path, capfd):
    metashape(tmp_path / "a.xml")
    assert bpy.ops.irpso.import_cameras(filepath=str(tmp_path / "a.xml")) == {"FINISHED"}
    assert len([obj for obj in scene.objects if obj.type == "CAMERA"]) == 1
    assert "1 camera of Metashape; 2 left out: 'IMG_0002' is disabled" in capfd.readouterr().out


def test_invalid_distortion_is_reported_with_the_cameras_name(scene):
    obj = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    scene.collection.objects.link(obj)
    obj[DISTORTION] = 0.1
    assert camera_from_object(obj, 40, 30).distortion == (0.1,)
    for wrong, words in (("strong", "holds no numbers"), ([0.1] * 9, "up to 8"), ([float("nan")], "finite")):
        obj[DISTORTION] = wrong
        with pytest.raises(InputError, match=f"'eye'.*{DISTORTION} .*{words}"):
            camera_from_object(obj, 40, 30)
    obj[DISTORTION], obj.data.type = [0.1], "ORTHO"
    with pytest.raises(InputError, match="'eye'.*undistort"):
        camera_from_object(obj, 40, 30)
