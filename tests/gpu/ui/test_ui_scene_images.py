"""Photographs of a scene's lights: images of the open file, their assignment, and scenes that are refused."""

import bpy
import numpy as np
import pytest

from irpso_addon.blender.scenes.scene_images import open_photograph, stored_orientation
from irpso_addon.capture import write_exr
from irpso_addon.capture.images.exr_header import Turn
from irpso_addon.capture.images.image import ImageStore
from irpso_addon.capture.noise import USUAL
from irpso_addon.core.errors import InputError
from irpso_addon.geometry.build import domain_from_card
from irpso_addon.ui.properties.scene_settings import model_of
from irpso_addon.ui.session import scene_capture
from tests.builders.captures import write_png
from tests.builders.exif import dng
from tests.builders.scene_captures import add_camera, add_light, image_of, write_views

pytestmark = [pytest.mark.bpy_only, pytest.mark.usefixtures("registered")]
RNG = np.random.default_rng(5)


@pytest.fixture(autouse=True)
def scene(registered):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def photographed(scene, image, name="Key"):
    """Return the one observation of a scene whose only light has that image."""
    add_camera(scene)
    add_light(scene, name, image)
    (observation,) = scene_capture.capture_from_scene(scene).observations
    return observation


def test_packing_an_image_changes_nothing(scene, tmp_path):
    codes = RNG.integers(0, 2**16, (7, 9, 3))
    image = image_of(tmp_path / "a.png", codes, 16)
    observation = photographed(scene, image)
    before = observation.read()
    np.testing.assert_allclose(before[::-1, :, :3], codes / 65535, atol=1e-7)
    image.pack()
    (tmp_path / "a.png").unlink()
    (packed,) = scene_capture.capture_from_scene(scene).observations
    np.testing.assert_array_equal(packed.read(), before)


def test_packing_a_raw_photograph_changes_nothing(scene, tmp_path):
    pytest.importorskip("rawpy")
    (tmp_path / "a.dng").write_bytes(dng(RNG.integers(1000, 60000, (32, 48)).astype(np.uint16)))
    image = image_of(tmp_path / "a.dng")
    before = photographed(scene, image).read()
    assert np.ptp(before[..., :3].mean(axis=(0, 1))) > 0.01  # demosaiced: no grey
    image.pack()
    (packed,) = scene_capture.capture_from_scene(scene).observations
    np.testing.assert_array_equal(packed.read(), before)


@pytest.mark.parametrize("how", ["file", "packed", "painted"])
def test_a_developed_photograph_is_upright_and_says_how_it_was_turned(scene, tmp_path, how):
    """Its camera, of the stored photograph, is turned; its pixels are not, in the file and in Blender."""
    pixels = RNG.random((7, 9)).astype(np.float32)
    write_exr(tmp_path / "a.exr", {"": dict.fromkeys("RGB", pixels)}, turn=Turn(6, 6))
    image = image_of(tmp_path / "a.exr")
    if how == "packed":
        image.pack()
    elif how == "painted":
        image.pixels[0] = image.pixels[0]
    photograph = open_photograph(image, "light 'Key'", ImageStore())
    assert (photograph.size, photograph.turned_by) == ((9, 7), 6) and image.is_dirty == (how == "painted")
    np.testing.assert_allclose(photograph.read().rgba[..., 0], pixels, atol=1e-6)
    assert stored_orientation(image) == 1


def test_an_eight_bit_image_that_is_set_to_non_color_is_linear(scene, tmp_path):
    codes = RNG.integers(0, 255, (7, 9, 3))
    image = image_of(tmp_path / "a.png", codes)
    image.colorspace_settings.name = "Non-Color"
    observation = photographed(scene, image)
    np.testing.assert_allclose(observation.read()[::-1, :, :3], codes / 255, atol=1e-7)
    assert not observation.coarse


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("packed", [False, True])
def test_only_images_of_eight_bits_have_the_noise_of_their_codes(scene, tmp_path, bits, packed):
    image = image_of(tmp_path / "a.png", RNG.integers(0, 255, (7, 9, 3)), bits)
    if packed:
        image.pack()
        (tmp_path / "a.png").unlink()
    assert photographed(scene, image).coarse == (bits == 8)
    assert domain_from_card(scene_capture.capture_from_scene(scene)).noise == (USUAL if bits == 8 else 0)


def test_the_color_space_of_files_says_nothing_of_the_scenes_own_images(scene, tmp_path):
    """Each image has a setting of its own; that of files is not shown with This Scene."""
    image = image_of(tmp_path / "a.png", RNG.integers(0, 255, (7, 9, 3)))
    expected = photographed(scene, image).read()
    scene.irpso.source, scene.irpso.colour_space = "SCENE", "linear"
    np.testing.assert_array_equal(scene_capture.capture_of(scene).observations[0].read(), expected)


@pytest.mark.parametrize("is_float", [False, True])
def test_an_image_made_in_blender_is_taken_as_it_is(scene, is_float):
    image = bpy.data.images.new("made", 6, 4, float_buffer=is_float)
    image.colorspace_settings.name = "sRGB"  # of a file that floats are saved to: in memory they are linear
    values = RNG.integers(0, 254, (4, 6, 4)) / 255 * (3 if is_float else 1)
    values[..., 3] = 1
    image.pixels.foreach_set(values.astype(np.float32).ravel())
    observation = photographed(scene, image)
    assert observation.coarse == (not is_float)
    encoded = values[..., :3]
    expected = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(observation.read()[..., :3], encoded if is_float else expected, rtol=1e-5, atol=1e-7)
    bpy.data.images.remove(image)
    with pytest.raises(InputError, match="'made' of light 'Key' was deleted"):
        observation.read()


def test_lights_get_images_in_the_order_of_their_numbers(scene, tmp_path):
    add_camera(scene)
    for k in (10, 2, 1):
        add_light(scene, f"Lamp {k}")
        write_png(tmp_path / f"shot{k}.png", np.full((4, 4, 3), 10 * k))
    files = [{"name": f"shot{k}.png"} for k in (2, 10, 1)]
    assert bpy.ops.irpso.assign_images(directory=str(tmp_path), files=files) == {"FINISHED"}
    given = {obj.name: obj.irpso.image.name for obj in scene.objects if obj.type == "LIGHT"}
    assert given == {f"Lamp {k}": f"shot{k}.png" for k in (1, 2, 10)}
    assert [o.name for o in scene_capture.capture_from_scene(scene).observations] == ["Lamp 1", "Lamp 2", "Lamp 10"]
    scene.objects["Lamp 2"].select_set(True)
    bpy.ops.irpso.assign_images(directory=str(tmp_path), files=files[1:])
    assert scene.objects["Lamp 2"].irpso.image.name == "shot1.png"
    assert scene.objects["Lamp 10"].irpso.image.name == "shot10.png"


@pytest.mark.parametrize("chosen", ["scene.blend", "gone.png"])
def test_another_file_than_an_image_is_refused_before_lights_change(scene, tmp_path, chosen):
    add_camera(scene)
    add_light(scene, "Lamp 1"), add_light(scene, "Lamp 2")
    write_png(tmp_path / "a.png", np.full((4, 4, 3), 10))
    (tmp_path / "scene.blend").write_bytes(b"BLENDER-v500")
    files = [{"name": name} for name in ("a.png", chosen)]
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.irpso.assign_images(directory=str(tmp_path), files=files)
    said = str(caught.value).strip()
    assert len(said.splitlines()) == 1 and chosen in said and "Traceback" not in said
    assert not bpy.data.images and all(obj.irpso.image is None for obj in scene.objects)


def test_a_path_beside_a_file_that_is_not_saved_is_refused_with_the_settings_name(scene, tmp_path):
    settings = scene.irpso
    settings.capture_path, settings.model, settings.model_path = "//shots", "CUSTOM", "//own.toml"
    with pytest.raises(InputError, match="Capture: //shots lies beside the .blend file, which is not saved yet"):
        scene_capture.capture_of(scene)
    with pytest.raises(InputError, match="Model File: //own.toml lies beside"):
        model_of(settings)
    write_views(tmp_path / "shots")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    assert scene_capture.capture_of(bpy.context.scene).name == "views"


def narrow_area(scene, tmp_path):
    add_light(scene, "Softbox", image_of(tmp_path / "b.png"), "AREA").data.spread = np.radians(90)


def soft_spot(scene, tmp_path):
    add_light(scene, "Spot", image_of(tmp_path / "b.png"), "SPOT").data.spot_blend = 1.0


def square_spot(scene, tmp_path):
    add_light(scene, "Spot", image_of(tmp_path / "b.png"), "SPOT").data.use_square = True


def stretched_spot(scene, tmp_path):
    add_light(scene, "Spot", image_of(tmp_path / "b.png"), "SPOT").scale = (1, 2, 1)


def dark(scene, tmp_path):
    add_light(scene, "Off", image_of(tmp_path / "b.png")).data.energy = 0


def without_camera(scene, tmp_path):
    scene.camera = None


def missing_file(scene, tmp_path):
    (tmp_path / "a.png").unlink()


def other_size(scene, tmp_path):
    add_light(scene, "Other", image_of(tmp_path / "c.png", np.zeros((5, 4, 3))))


def odd_space(scene, tmp_path):
    scene.objects["Key"].irpso.image.colorspace_settings.name = "Filmic sRGB"


def sequence(scene, tmp_path):
    scene.objects["Key"].irpso.image.source = "SEQUENCE"


def layers(scene, tmp_path):
    pixels = np.zeros((4, 4), np.float32)
    write_exr(tmp_path / "l.exr", {"": {f"{layer}.{c}": pixels for layer in ("a", "b") for c in "RGB"}})
    scene.objects["Key"].irpso.image = image_of(tmp_path / "l.exr")


def mask_size(scene, tmp_path):
    scene.camera.irpso.image = image_of(tmp_path / "c.png", np.zeros((5, 4, 3)))


def noded(scene, tmp_path):
    data = scene.objects["Key"].data
    data.use_nodes = True
    tree = data.node_tree
    tree.links.new(tree.nodes.new("ShaderNodeLightFalloff").outputs[0], tree.nodes["Emission"].inputs["Strength"])


def nothing(scene, tmp_path):
    scene.objects["Key"].irpso.image = None


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (narrow_area, "light 'Softbox' has a Spread of 90°, which is not supported; set it to 180°"),
        (soft_spot, "light 'Spot' reaches full strength nowhere; lower Blend"),
        (square_spot, "light 'Spot' has a cone that is not round; turn Square off"),
        (stretched_spot, "light 'Spot' has a cone that is not round"),
        (dark, "light 'Off' gives no light"),
        (without_camera, "light 'Key' has no camera"),
        (missing_file, "image 'a.png' of light 'Key' is missing"),
        (other_size, "image '.*' of light '.*' is 4 × .*, others of camera 'Camera' are"),
        (odd_space, "color space 'Filmic sRGB'; set it to sRGB"),
        (sequence, "is an image sequence"),
        (layers, "is an EXR of several layers"),
        (mask_size, "of camera 'Camera', its mask, is 4 × 5, its photographs are 4 × 4"),
        (noded, "light 'Key' has nodes other than a plain Emission"),
        (nothing, "no light of this scene has a photograph"),
    ],
)
def test_an_incomplete_scene_is_reported_with_the_remedy(scene, tmp_path, spoil, message):
    add_camera(scene)
    write_png(tmp_path / "b.png", np.zeros((4, 4, 3)))
    add_light(scene, "Key", image_of(tmp_path / "a.png", np.full((4, 4, 3), 100)))
    scene.irpso.source = "SCENE"
    assert len(scene_capture.capture_of(scene).observations) == 1
    spoil(scene, tmp_path)
    with pytest.raises(InputError, match=message) as caught:
        scene_capture.capture_of(scene)
    assert "\n" not in str(caught.value) and ";" in str(caught.value)
    bpy.ops.irpso.check_capture()
    assert [item.severity for item in scene.irpso.findings] == ["error"]


def test_linked_lights_and_cameras_may_have_the_names_of_local_ones(scene, tmp_path):
    greys = (40, 90)
    for name, grey, lens, size in (("library", greys[0], 85.0, 4), ("local", greys[1], 35.0, 6)):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene = bpy.context.scene
        camera = add_camera(scene)
        camera.data.lens = lens
        light = add_light(scene, "Key", image_of(tmp_path / f"{name}.png", np.full((size, size, 3), grey)))
        light.irpso.camera = camera
        light.rotation_euler = (0.5, 0, 0) if name == "library" else (0, 0, 0)
        if name == "library":
            bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"), copy=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (there, here):
        here.objects = there.objects
    for obj in here.objects:
        scene.collection.objects.link(obj)
    scene.irpso.source = "SCENE"
    capture = scene_capture.capture_of(scene)
    assert [shot.name for shot in capture.observations] == ["Key", "Key"]
    found = {camera.width: camera.scale[0] / camera.width * 36 for camera in capture.cameras}
    assert found == pytest.approx({4: 85.0, 6: 35.0}, rel=1e-5)
    for shot in capture.observations:
        width = capture.cameras[shot.camera].width
        grey, tilted = (greys[0], True) if width == 4 else (greys[1], False)
        assert (abs(shot.light.vector[1]) > 0.1) == tilted
        code = grey / 255
        np.testing.assert_allclose(shot.read()[..., :3], ((code + 0.055) / 1.055) ** 2.4, rtol=1e-3)
        assert shot.read().shape[:2] == (width, width)
