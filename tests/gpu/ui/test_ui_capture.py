"""Captures in the window's settings: imported from files, checked, made of the scene's own lights and back again."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from irpso_addon.blender.images import decode
from irpso_addon.blender.scenes import scene_lights
from irpso_addon.blender.scenes.scene import camera_from_object
from irpso_addon.capture import Camera, Capture, Light, Observation, read_capture, write_capture, write_exr
from irpso_addon.capture.inspect.report import inspect_steps
from irpso_addon.capture.noise import USUAL
from irpso_addon.core.errors import InputError
from irpso_addon.geometry.build import domain_from_card
from irpso_addon.ui.operators import capture_import, scene_setup
from irpso_addon.ui.properties import findings
from irpso_addon.ui.properties.scene_settings import model_of
from irpso_addon.ui.session import scene_capture
from tests.builders.captures import LIGHTS, shade, sphere, write_diligent, write_png

pytestmark = [pytest.mark.bpy_only, pytest.mark.usefixtures("registered")]
RNG = np.random.default_rng(5)
ANYWHERE = np.array([[0.36, 0.48, -0.8, 1.5], [-0.8, 0.6, 0, -2.0], [0.48, 0.64, 0.6, 3.25], [0, 0, 0, 1]])
CAMERAS = {
    "wide": Camera.from_fov(40, 30, 75.0),
    "tall and turned": Camera.from_fov(30, 50, 20.0, ANYWHERE),
    "off centre": Camera(64, 48, (90.0, 90.0), (20.5, 40.25), ANYWHERE),
    "oblong pixels": Camera(64, 48, (90.0, 60.0), (30.0, 22.0), ANYWHERE),
    "lying pixels": Camera(64, 48, (60.0, 75.0), (30.0, 22.0), ANYWHERE),
    "orthographic": Camera(50, 70, (12.0, 15.0), (22.0, 33.0), ANYWHERE, False),
}


@pytest.fixture(autouse=True)
def scene(registered):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def given(frames):
    """Return what reads each frame (H, W, 3) with full weight."""
    return [lambda f=f: np.concatenate([f, np.ones((*f.shape[:2], 1))], axis=-1).astype(np.float32) for f in frames]


def write_views(folder, single_file=False):
    """Write a capture of two cameras, near and distant coloured lights and a mask; return it as read back."""
    cameras = (Camera.from_fov(24, 18, 40.0, ANYWHERE), Camera(24, 18, (30.0, 33.0), (11.0, 8.0), np.eye(4)))
    mask = np.zeros((18, 24), bool)
    mask[3:12, 5:20] = True
    lights = [Light((0.6, 0.0, 0.8), (1.0, 0.5, 0.25)), Light((0.5, -1.5, 2.0), (3.0, 4.0, 5.0), False),
              Light((-0.6, 0.0, 0.8), (0.7, 0.7, 0.7)), Light((0.0, 0.0, 1.0), (2.0, 1.0, 0.0))]  # fmt: skip
    frames = given(RNG.uniform(0.1, 0.9, (4, 18, 24, 3)))
    shots = tuple(Observation(f"shot {k}", frames[k], light, k % 2) for k, light in enumerate(lights))
    write_capture(Capture("views", shots, cameras, (mask, np.ones_like(mask))), folder, single_file=single_file)
    return read_capture(folder, decode)


def assert_same(found, expected):
    """Lights and cameras are equal to float32, masks and images exactly."""
    assert found.name == expected.name and len(found.observations) == len(expected.observations)
    for a, b in zip(found.observations, expected.observations, strict=True):
        assert (a.light.distant, a.camera) == (b.light.distant, b.camera)
        np.testing.assert_allclose(a.light.vector, b.light.vector, atol=3e-7)
        np.testing.assert_allclose(a.light.intensity, b.light.intensity, rtol=3e-7)
        np.testing.assert_array_equal(a.read(), b.read())
    for a, b in zip(found.cameras, expected.cameras, strict=True):
        assert_same_camera(a, b)
    for a, b in zip(found.masks, expected.masks, strict=True):
        np.testing.assert_array_equal(a, b)


def assert_same_camera(a, b):
    assert (a.width, a.height, a.perspective) == (b.width, b.height, b.perspective)
    np.testing.assert_allclose(a.scale, b.scale, rtol=1e-6)
    np.testing.assert_allclose(a.centre, b.centre, atol=1e-5)
    np.testing.assert_allclose(a.matrix, b.matrix, atol=1e-6)


def created(scene, path):
    """Make the scene of a capture, make it the source, and return the capture that it is."""
    scene.irpso.capture_path = str(path)
    assert bpy.ops.irpso.create_scene() == {"FINISHED"}
    scene.irpso.source = "SCENE"
    return scene_capture.capture_of(scene)


def add_light(scene, name, image=None, kind="SUN"):
    light = bpy.data.objects.new(name, bpy.data.lights.new(name, kind))
    scene.collection.objects.link(light)
    light.irpso.image = image
    return light


def add_camera(scene):
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    return camera


def image_of(path, codes=None, bits=8):
    if codes is not None:
        write_png(path, codes, bits)
    return bpy.data.images.load(str(path))


def photographed(scene, image, name="Key"):
    """Return the one observation of a scene whose only light has that image."""
    add_camera(scene)
    add_light(scene, name, image)
    (observation,) = scene_capture.capture_from_scene(scene).observations
    return observation


# ---- files


@pytest.mark.parametrize("chosen", ["", "filenames.txt", "002.exr", "camera.toml"])
def test_any_file_of_a_folder_imports_the_folder(scene, tmp_path, chosen):
    write_diligent(tmp_path / "bowl")
    (tmp_path / "bowl" / "camera.toml").write_text("fov_degrees = 30.0\n")
    assert bpy.ops.irpso.import_capture(filepath=str(tmp_path / "bowl" / chosen)) == {"FINISHED"}
    settings = scene.irpso
    assert (settings.source, settings.subject) == ("FILES", "CARD")
    assert settings.capture_path == str((tmp_path / "bowl").resolve()) == settings.checked_path
    assert "images: 5" in settings.summary and "24×24 perspective" in settings.summary
    capture = scene_capture.capture_of(scene)
    np.testing.assert_allclose([o.light.vector for o in capture.observations], LIGHTS, atol=1e-7)


def test_a_list_of_lights_is_a_card_and_cameras_around_something_are_a_mesh(scene, tmp_path):
    write_diligent(tmp_path / "a")
    rows = [f"{k:03d}.exr {x} {y} {z}" for k, (x, y, z) in enumerate(LIGHTS)]
    (tmp_path / "a" / "dome.lp").write_text("\n".join(["5", *rows]))
    bpy.ops.irpso.import_capture(filepath=str(tmp_path / "a" / "dome.lp"))
    assert scene.irpso.subject == "CARD" and scene.irpso.capture_path.endswith("dome.lp")
    write_views(tmp_path / "b")
    bpy.ops.irpso.import_capture(filepath=str(tmp_path / "b" / "capture.toml"))
    assert scene.irpso.subject == "MESH"


@pytest.mark.parametrize("chosen", ["nothing", "gone/capture.toml", "odd.lp", ""])
def test_another_file_than_a_capture_is_reported_in_one_line_and_changes_nothing(scene, tmp_path, chosen):
    write_diligent(tmp_path / "good")
    bpy.ops.irpso.import_capture(filepath=str(tmp_path / "good"))
    (tmp_path / "nothing").mkdir()
    (tmp_path / "odd.lp").write_text("two\nimages")
    before = {name: getattr(scene.irpso, name) for name in ("source", "capture_path", "summary", "checked_path")}
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.irpso.import_capture(filepath=str(tmp_path / chosen) if chosen else "")
    assert len(str(caught.value).strip().splitlines()) == 1
    assert {name: getattr(scene.irpso, name) for name in before} == before


def test_findings_of_the_check_are_kept_as_settings(scene, tmp_path):
    normals, mask = sphere(24)
    frames = shade(normals)
    frames[3] = 0
    write_diligent(tmp_path / "a", frames, mask=mask)
    (tmp_path / "a" / "001.exr").unlink()
    bpy.ops.irpso.import_capture(filepath=str(tmp_path / "a"))
    (missing,) = [item for item in scene.irpso.findings if item.severity == "error"]
    assert missing.message.startswith("001.exr: this image is not there;")  # without its folder: a panel is narrow
    write_exr(tmp_path / "a" / "001.exr", {"": dict.fromkeys("RGB", frames[1])})
    bpy.ops.irpso.check_capture()
    assert {item.severity for item in scene.irpso.findings} == {"warning"}
    assert any("003.exr: is all black" in item.message for item in scene.irpso.findings)


def test_light_sufficiency_follows_the_recovered_parameters(scene):
    settings = scene.irpso
    asked = {}
    for name in ("lambert", "principled", "cook_torrance_two_lobe"):
        settings.model = name
        asked[name] = capture_import.goals_of(settings)
    assert asked == {
        "lambert": ("normals",), "principled": ("normals", "roughness"),
        "cook_torrance_two_lobe": ("normals", "two lobes"),
    }  # fmt: skip
    settings.model = "principled"
    for item in settings.parameters:
        item.recover = item.name == "base_color"
    assert capture_import.goals_of(settings) == ()


def test_a_check_pauses_at_every_image(tmp_path):
    write_diligent(tmp_path / "a")
    lines = list(inspect_steps(tmp_path / "a", decode))
    for words in ("Looking at headers: {} of 5", "Checking images: {} of 5"):
        assert [words.format(k) for k in range(1, 6)] == [line for line in lines if line.startswith(words[:8])][:5]


def test_a_slice_of_a_check_is_short_and_another_capture_ends_it(scene, tmp_path):
    normals, mask = sphere(24)
    write_diligent(tmp_path / "a", shade(normals), mask=mask)
    bpy.ops.irpso.import_capture(filepath=str(tmp_path / "a"))
    scene.irpso.summary = ""
    steps = inspect_steps(tmp_path / "a", decode)
    check = capture_import._Check(scene.session_uid, scene.irpso.capture_path, steps)
    capture_import._running[:] = [check]
    assert capture_import._slice(check, 1e-5) and check.doing.startswith("Looking") and scene.irpso.summary == ""
    assert not capture_import._slice(check, 60.0) and "5 distant" in scene.irpso.summary
    assert capture_import._running == []
    capture_import._running[:] = [check]
    scene.irpso.capture_path = str(tmp_path)
    assert not capture_import._slice(check, 60.0) and capture_import._running == []


def test_files_can_be_dropped_where_maps_are_seen():
    handler = capture_import.CaptureFiles
    assert handler.bl_import_operator == "irpso.import_capture"
    assert handler.bl_file_extensions.split(";") == [".lp", ".toml", ".txt"]


# ---- cameras and lights


@pytest.mark.parametrize("name", CAMERAS)
def test_a_camera_object_is_the_camera_again(scene, name):
    camera = CAMERAS[name]
    obj = add_camera(scene)
    scene_setup.set_camera(obj, camera)
    assert_same_camera(camera_from_object(obj, camera.width, camera.height, tuple(obj["irpso_pixel_aspect"])), camera)


@pytest.mark.parametrize("name", CAMERAS)
def test_blender_projects_points_where_the_camera_does(scene, name):
    camera = CAMERAS[name]
    obj = add_camera(scene)
    scene_setup.set_camera(obj, camera)
    aspect = obj["irpso_pixel_aspect"]
    bpy.context.view_layer.update()
    projection = obj.calc_matrix_camera(
        bpy.context.evaluated_depsgraph_get(), x=camera.width, y=camera.height, scale_x=aspect[0], scale_y=aspect[1]
    )
    points = RNG.uniform((-1, -1, -5), (1, 1, -2), (20, 3)) @ camera.matrix[:3, :3].T + camera.matrix[:3, 3]
    clip = np.c_[points, np.ones(20)] @ np.array(projection @ obj.matrix_world.inverted()).T
    pixels = (clip[:, :2] / clip[:, 3:] * 0.5 + 0.5) * (camera.width, camera.height)
    np.testing.assert_allclose(pixels, camera.project(points)[0], atol=2e-3)


@pytest.mark.parametrize("hidden", [False, True])
def test_lights_are_read_at_world_positions_even_parented_or_hidden(scene, hidden):
    direction = np.array([0.48, 0.64, 0.6])
    light = add_light(scene, "Key")
    scene_setup.set_light(light, Light(tuple(direction), (2.0, 1.0, 0.5)), (1, 2, 3), 4.0)
    parent = bpy.data.objects.new("Turntable", None)
    scene.collection.objects.link(parent)
    light.parent, parent.rotation_euler = parent, (0, 0, np.pi / 2)
    light.hide_viewport = hidden
    bpy.context.view_layer.update()
    found = scene_lights.light_of(light)
    np.testing.assert_allclose(found.vector, (-0.64, 0.48, 0.6), atol=1e-6)
    np.testing.assert_allclose(found.intensity, (2.0, 1.0, 0.5), rtol=1e-6)
    # On a dome of radius 4 about (1, 2, 3), turned by the parent.
    place = np.array([1, 2, 3]) + 4 * direction
    from irpso_addon.blender.scenes.scene import world_matrix

    np.testing.assert_allclose(world_matrix(light)[:3, 3], (-place[1], place[0], place[2]), atol=1e-5)


def test_strength_exposure_and_nodes_of_a_light_multiply(scene):
    light = add_light(scene, "Lamp", kind="POINT")
    light.data.energy, light.data.color, light.location = 4 * np.pi**2, (1.0, 0.5, 0.25), (1, 2, 3)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(scene_lights.light_of(light).intensity, (1, 0.5, 0.25), rtol=1e-6)
    assert scene_lights.light_of(light).vector == (1, 2, 3)
    light.data.use_nodes = True
    light.data.node_tree.nodes["Emission"].inputs["Strength"].default_value = 3.0
    np.testing.assert_allclose(scene_lights.light_of(light).intensity, (3, 1.5, 0.75), rtol=1e-6)
    if hasattr(light.data, "exposure"):
        light.data.exposure = 1.0
        np.testing.assert_allclose(scene_lights.light_of(light).intensity, (6, 3, 1.5), rtol=1e-6)


# ---- the scene as a capture


@pytest.mark.parametrize("single_file", [False, True])
def test_the_scene_of_a_capture_is_the_capture_again(scene, tmp_path, single_file):
    expected = write_views(tmp_path / "views", single_file)
    assert_same(created(scene, tmp_path / "views"), expected)


def test_the_scene_of_a_masked_capture_survives_saving(scene, tmp_path):
    normals, mask = sphere(24)
    write_diligent(tmp_path / "ball", shade(normals), mask=mask)
    expected = read_capture(tmp_path / "ball", decode)
    assert_same(created(scene, tmp_path / "ball"), expected)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    assert_same(scene_capture.capture_of(bpy.context.scene), expected)


def test_the_scene_of_the_icon_is_the_capture_again(scene, shared_data):
    expected = read_capture(shared_data / "rti_icon", decode)
    found = created(scene, shared_data / "rti_icon")
    assert len(found.observations) == 72
    assert_same(*(replace(c, observations=c.observations[::9]) for c in (found, expected)))  # all take six seconds


@pytest.mark.parametrize(("bits", "space"), [(8, "auto"), (8, "linear"), (16, "auto"), (16, "srgb")])
def test_the_colour_space_of_files_goes_along(scene, tmp_path, bits, space):
    for k in range(3):
        write_png(tmp_path / f"{k}.png", RNG.integers(0, 2**bits - 1, (9, 11, 3)), bits)
    rows = [f'[[observation]]\nimage = "{k}.png"\nlight_direction = [0.0, {k / 4}, 1.0]' for k in range(3)]
    table = "\n".join([f'colour_space = "{space}"', 'name = "spaces"', "[[camera]]", *rows])
    (tmp_path / "capture.toml").write_text(table)
    assert_same(created(scene, tmp_path), read_capture(tmp_path, decode))


def test_setup_again_keeps_the_users_objects_and_removes_stale_ones(scene, tmp_path):
    mine = add_light(scene, "My own", kind="AREA")
    camera = add_camera(scene)
    normals, mask = sphere(24)
    write_diligent(tmp_path / "ball", shade(normals), mask=mask)
    created(scene, tmp_path / "ball")
    first = {obj.name: obj.session_uid for obj in scene.objects}
    images = len(bpy.data.images)
    bpy.ops.irpso.create_scene()
    assert {obj.name: obj.session_uid for obj in scene.objects} == first and len(bpy.data.images) == images
    assert scene.camera == camera and not mine.hide_render
    write_diligent(tmp_path / "ball", shade(normals)[:4], LIGHTS[:4], mask)
    bpy.ops.irpso.create_scene()
    assert sorted(set(first) - {obj.name for obj in scene.objects}) == ["Light 004 004.exr"]
    assert len([light for light in bpy.data.lights if light.name.startswith("Light")]) == 4


def test_one_light_shines_at_a_time_over_its_photograph(scene, tmp_path):
    write_views(tmp_path / "views")
    created(scene, tmp_path / "views")
    lights = [obj for obj in scene.objects if obj.type == "LIGHT"]
    for number in (1, 4, 2, 99):
        bpy.ops.irpso.show_observation(number=number)
        shown = [obj for obj in lights if not obj.hide_render]
        assert [obj.name[:9] for obj in shown] == [f"Light {min(number, 4) - 1:03d}"]
        assert scene.irpso.view.observation == min(number, 4)
        assert shown == [obj for obj in lights if not obj.hide_viewport]
        assert scene.camera == shown[0].irpso.camera
        assert scene.camera.data.background_images[0].image == shown[0].irpso.image
    assert (scene.render.resolution_x, scene.render.resolution_y) == (24, 18)
    np.testing.assert_allclose((scene.render.pixel_aspect_x, scene.render.pixel_aspect_y), (1.1, 1.0), rtol=1e-6)


def test_lights_that_were_given_photographs_by_hand_shine_one_at_a_time_too(scene, tmp_path):
    add_camera(scene)
    image = image_of(tmp_path / "a.png", np.zeros((4, 4, 3)))
    room = add_light(scene, "Room")
    lamps = [add_light(scene, f"Lamp {number}", image) for number in (1, 2, 10)]
    assert not bpy.ops.irpso.show_observation.poll()
    scene.irpso.source = "SCENE"
    bpy.context.view_layer.update()
    for index in (2, 0):
        bpy.ops.irpso.show_observation(number=index + 1)
        assert [obj for obj in [room, *lamps] if not obj.hide_render] == [room, lamps[index]]
        assert [obj for obj in [room, *lamps] if not obj.hide_viewport] == [room, lamps[index]]


def rendered(scene, path):
    """Return (H, W, 3) radiance of a render by Cycles, row 0 at the bottom."""
    scene.render.engine, scene.cycles.samples, scene.cycles.max_bounces = "CYCLES", 16, 0
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01  # pixel centres alone
    scene.cycles.use_denoising = False
    scene.view_settings.view_transform = "Raw"
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    values = np.empty(np.prod(image.size) * image.channels, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], -1)[..., :3]


@pytest.mark.parametrize("perspective", [True, False])
def test_cycles_renders_the_photographs_of_a_card(scene, tmp_path, perspective):
    # Oblong pixels and an off-centre axis, seen from somewhere: near lights tell whether the card lies right.
    camera = Camera(16, 12, (14.0, 15.0), (7.0, 6.5), ANYWHERE, perspective)
    if not perspective:
        camera = Camera(16, 12, (9.0, 9.0), (7.0, 6.5), ANYWHERE, False)
    points, facing, albedo = camera.points(2.5), ANYWHERE[:3, 2], 0.8
    near = tuple(points[3, 12] + 0.9 * facing + 0.2 * ANYWHERE[:3, 0])
    lights = [Light(tuple(ANYWHERE[:3, :3] @ (0.6, 0, 0.8)), (1.0, 0.5, 0.25)), Light(near, (0.1, 0.2, 0.3), False)]
    toward = [np.broadcast_to(lights[0].vector, points.shape), np.array(near) - points]
    far = [1.0, np.linalg.norm(toward[1], axis=-1)]
    frames = [
        albedo * (t @ facing / d**3)[..., None] * light.intensity
        for t, d, light in zip(toward, far, lights, strict=True)
    ]
    shots = tuple(Observation(str(k), given(frames)[k], light) for k, light in enumerate(lights))
    taken = Capture("card", shots, (camera,), (np.ones((12, 16), bool),), card_distance=2.5)
    write_capture(taken, tmp_path / "card")
    bpy.ops.irpso.import_capture(filepath=str(tmp_path / "card"))
    scene.irpso.subject = "CARD"
    bpy.ops.irpso.create_scene()
    (card,) = [obj for obj in scene.objects if obj.type == "MESH"]
    matt = bpy.data.materials.new("matt")
    matt.use_nodes = True
    matt.node_tree.nodes.clear()
    diffuse, output = (matt.node_tree.nodes.new(f"ShaderNode{kind}") for kind in ("BsdfDiffuse", "OutputMaterial"))
    diffuse.inputs["Color"].default_value = (albedo, albedo, albedo, 1)
    matt.node_tree.links.new(diffuse.outputs[0], output.inputs[0])
    card.data.materials.append(matt)
    for index, frame in enumerate(frames):
        bpy.ops.irpso.show_observation(number=index + 1)
        np.testing.assert_allclose(rendered(scene, tmp_path / f"{index}.exr"), frame, rtol=5e-3, atol=1e-5)


# ---- images of the open file


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


# ---- what bars Recover


def recoverable(scene):
    """Return whether Recover can be pressed, and what the panel says where it cannot."""
    from irpso_addon.ui.properties import upkeep
    from irpso_addon.ui.session import job

    upkeep.fill_lists()
    return bpy.ops.irpso.recover.poll(), job.missing(bpy.context)


@pytest.mark.parametrize("count", [1, 2])
def test_too_few_lights_bar_recover_with_the_reason_unless_normals_are_given(scene, tmp_path, count):
    normals, mask = sphere(24)
    write_diligent(tmp_path, shade(normals)[:count], LIGHTS[:count], mask)
    bpy.ops.irpso.import_capture(filepath=str(tmp_path))
    possible, why = recoverable(scene)
    assert not possible and f"has {count} light" in why and "a normal needs at least three" in why
    assert "enough for: not for normals (few)" in scene.irpso.summary
    for item in scene.irpso.parameters:
        item.recover = not item.is_normal
    assert recoverable(scene) == (True, "") and findings.shown(scene.irpso) == []


def test_lights_of_the_scene_that_are_too_few_bar_recover_with_the_reason(scene, tmp_path):
    image = image_of(tmp_path / "a.png", np.full((4, 4, 3), 99))
    add_camera(scene)
    scene.irpso.source = "SCENE"
    for count in range(3):
        possible, why = recoverable(scene)
        assert not possible and ("No light" if count == 0 else f"Only {count} light") in why
        add_light(scene, f"Key {count}", image)
    assert recoverable(scene)[0]
    bpy.ops.irpso.check_capture()  # all three shine from above
    assert [item.code for item in scene.irpso.findings] == ["lights_same"]


def test_a_damaged_image_bars_recover_until_it_is_left_out(scene, tmp_path):
    normals, mask = sphere(24)
    write_diligent(tmp_path, shade(normals), mask=mask)
    (tmp_path / "001.exr").write_bytes((tmp_path / "001.exr").read_bytes()[:-50])
    bpy.ops.irpso.import_capture(filepath=str(tmp_path))
    possible, why = recoverable(scene)
    assert not possible and "001.exr: is cut short" in why
    scene.irpso.skip_damaged = True  # which checks again
    assert recoverable(scene) == (True, "") and "images: 4, 1 more left out" in scene.irpso.summary
    assert any("left out: 001.exr: is cut short" in item.message for item in scene.irpso.findings)
    capture = scene_capture.capture_of(scene)
    assert [one.index for one in capture.left_out] == [1] and len(capture.observations) == 4
    assert bpy.ops.irpso.create_scene() == {"FINISHED"}
    assert sum(obj.type == "LIGHT" for obj in scene.objects) == 4


def test_a_damaged_photograph_of_the_scene_is_left_out(scene, tmp_path):
    write_views(tmp_path / "views")
    created(scene, tmp_path / "views" / "capture.toml")
    scene.irpso.subject = "MESH"
    lights = sorted((obj for obj in scene.objects if obj.type == "LIGHT"), key=lambda obj: obj.name)
    path = scene_images_file(lights[2].irpso.image)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(InputError, match=f"light '{lights[2].name}'.*cut short.*--skip-damaged"):
        scene_capture.capture_of(scene)
    bpy.ops.irpso.check_capture()
    (item,) = scene.irpso.findings
    assert item.code == "image_truncated" and "Leave Out Damaged Images" in item.message
    scene.irpso.skip_damaged = True
    capture = scene_capture.capture_of(scene)
    assert [one.image for one in capture.left_out] == [lights[2].name] and len(capture.observations) == 3
    assert any("left out" in item.message for item in scene.irpso.findings)


def scene_images_file(image):
    from irpso_addon.blender.scenes import scene_images

    return scene_images.file_of(image)
