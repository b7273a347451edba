"""A capture as a scene's objects: read back as the capture, set up again, shown one by one, rendered."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from irpso_addon.blender.images import decode
from irpso_addon.blender.materials import material
from irpso_addon.capture import Camera, Capture, Light, Observation, read_capture, write_capture
from irpso_addon.ui.operators import scene_setup
from irpso_addon.ui.session import scene_capture, session
from irpso_addon.ui.session.scene_job import make_job
from tests.builders.captures import LIGHTS, chunk, shade, sphere, write_diligent, write_png
from tests.builders.drawn_panels import drawn
from tests.builders.exif import exif
from tests.builders.profiles import icc, png_icc, table
from tests.builders.scene_captures import (
    ANYWHERE,
    add_camera,
    add_light,
    assert_same_camera,
    created,
    image_of,
    readers_of,
    write_views,
)

pytestmark = [pytest.mark.bpy_only, pytest.mark.usefixtures("registered")]
RNG = np.random.default_rng(5)


@pytest.fixture(autouse=True)
def scene(registered):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


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


@pytest.mark.parametrize(
    ("bits", "space", "extra"),
    [
        (8, "auto", b""), (8, "linear", b""), (16, "auto", b""), (16, "srgb", b""),
        (16, "auto", png_icc(icc())), (16, "auto", png_icc(icc(curve=table([])))),
        (16, "auto", chunk(b"sRGB", b"\0")),
    ],
    ids=["8", "8 linear", "16", "16 sRGB", "16 profile", "16 linear profile", "16 stating sRGB"],
)  # fmt: skip
def test_the_colour_space_of_files_goes_along(scene, tmp_path, bits, space, extra):
    for k in range(3):
        write_png(tmp_path / f"{k}.png", RNG.integers(0, 2**bits - 1, (9, 11, 3)), bits, extra)
    rows = [f'[[observation]]\nimage = "{k}.png"\nlight_direction = [0.0, {k / 4}, 1.0]' for k in range(3)]
    text = "\n".join([f'colour_space = "{space}"', 'name = "spaces"', "[[camera]]", *rows])
    (tmp_path / "capture.toml").write_text(text)
    assert_same(created(scene, tmp_path), read_capture(tmp_path, decode))


def test_a_stated_colour_space_of_an_exr_goes_along(scene, tmp_path):
    write_diligent(tmp_path / "ball")
    rows = [f'[[observation]]\nimage = "ball/00{k}.exr"\nlight_direction = [0.0, {k / 4}, 1.0]' for k in range(3)]
    (tmp_path / "capture.toml").write_text("\n".join(['colour_space = "srgb"', 'name = "s"', "[[camera]]", *rows]))
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


@pytest.mark.parametrize("kind", ["LIGHT", "CAMERA"])
def test_setup_again_leaves_the_users_duplicates_and_updates_the_originals(scene, tmp_path, kind):
    normals, mask = sphere(24)
    write_diligent(tmp_path / "ball", shade(normals), mask=mask)
    created(scene, tmp_path / "ball")
    original = next(obj for obj in scene.objects if obj.type == kind)
    place = original.matrix_world.copy()
    for name in ("Beauty", original.name):  # renamed, and with Blender's number
        copy = original.copy()
        copy.name = name
        copy.location = (9, 9, 9)
        scene.collection.objects.link(copy)
    original.location = (5, 5, 5)
    bpy.ops.irpso.create_scene()
    bpy.context.view_layer.update()
    np.testing.assert_allclose(original.matrix_world, place, atol=1e-6)
    copies = [obj for obj in scene.objects if obj.name in ("Beauty", f"{original.name}.001")]
    assert [tuple(copy.location) for copy in copies] == [(9, 9, 9)] * 2


@pytest.mark.parametrize("change", ["colour space", "paint"])
def test_an_image_that_the_user_has_changed_is_loaded_again_as_the_capture_reads_it(scene, tmp_path, change):
    write_png(tmp_path / "a.png", RNG.integers(0, 255, (6, 8, 3)))
    write_png(tmp_path / "deep.png", RNG.integers(0, 2**16, (6, 8, 3)), 16)
    (tmp_path / "two.lp").write_text("2\na.png 0 0.6 0.8\ndeep.png 0.6 0 0.8\n")
    changed = [image_of(tmp_path / name) for name in ("a.png", "deep.png")]
    for image in changed:
        if change == "paint":
            image.pixels[0] = 0.25
        else:
            image.colorspace_settings.name = "Non-Color" if image.name == "a.png" else "sRGB"
    expected = read_capture(tmp_path / "two.lp", decode)
    for count in (4, 4):  # pressed again, it finds its own
        assert_same(created(scene, tmp_path / "two.lp"), expected)
        assert len(bpy.data.images) == count
    assert changed[0].colorspace_settings.name == ("sRGB" if change == "paint" else "Non-Color")
    assert [image.is_dirty for image in changed] == [change == "paint"] * 2


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


def test_a_photograph_that_exif_turns_is_turned_behind_its_camera(scene, tmp_path):
    """tests/gui/test_background.py looks at what Blender draws."""
    for name, shape, orientation in (("a", (4, 6, 3), 6), ("b", (6, 4, 3), 2)):
        write_png(tmp_path / f"{name}.png", np.zeros(shape, int), extra=chunk(b"eXIf", exif(orientation=orientation)))
    write_png(tmp_path / "c.png", np.zeros((6, 4, 3), int))
    images = [image_of(tmp_path / f"{name}.png") for name in "abc"]
    camera = add_camera(scene)
    scene_setup.set_camera(camera, Camera.from_fov(4, 6, 40.0))
    turns, flips, scales = (np.pi / 2, 0, 0), (False, True, False), (1.5, 1, 1)
    for shown, turn, flipped, scale in zip(images, turns, flips, scales, strict=True):
        scene_setup.set_background(camera, shown)
        (background,) = camera.data.background_images
        assert background.image == shown and (background.use_flip_x, background.use_flip_y) == (flipped, False)
        np.testing.assert_allclose((background.rotation, background.scale), (turn, scale), rtol=1e-6)
        assert background.frame_method == ("FIT" if turn else "STRETCH")
    scene_setup.set_background(camera, images[0])
    background.rotation, background.frame_method, background.scale = 0, "STRETCH", 1  # as earlier versions left it
    scene_setup.set_background(camera, images[0])
    np.testing.assert_allclose((background.rotation, background.scale), (np.pi / 2, 1.5), rtol=1e-6)


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


@pytest.mark.parametrize("source", ["FILES", "SCENE"])
def test_a_photograph_has_one_number_in_scene_and_recovery_also_beside_left_out_ones(scene, tmp_path, source):
    settings, damaged = scene.irpso, write_diligent(tmp_path / "ball") / "002.exr"
    settings.capture_path, settings.subject, settings.model = str(tmp_path / "ball"), "CARD", "lambert"
    settings.skip_damaged = True
    if source == "FILES":
        damaged.write_bytes(b"")
    bpy.ops.irpso.create_scene()
    damaged.write_bytes(b"")
    settings.source, settings.view.shown = source, "RENDER"
    running = session.begin(make_job(bpy.context))
    try:
        while running.display is None:
            running.tick(0.05)
        for number, recovered in ((1, 1), (2, 2), (3, 4), (4, 4), (5, 5)):
            bpy.ops.irpso.show_observation(number=number)
            (on,) = (obj for obj in scene.objects if obj.type == "LIGHT" and not obj.hide_render)
            shown = running.job.capture.observations[running.observation(settings.view)].name
            assert shown.endswith(f"{recovered - 1:03d}.exr")
            if number == recovered:
                assert on.name.endswith(shown)
            texts = " ".join(drawn().texts)  # wrapped
            assert ("Photograph 3 is left out: 4 is shown" in texts) == (number == 3)
            assert "of 5" in texts and "of 4" not in texts
        assert scene_setup.observation_count(scene) == 5
    finally:
        session.end()


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
    shots = tuple(Observation(str(k), readers_of(frames)[k], light) for k, light in enumerate(lights))
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


def write_one(folder):
    """Write a capture of three shots of a grey card."""
    camera = Camera(8, 6, (9.0, 9.0), (4.0, 3.0), perspective=False)
    vectors = [(0.6, 0, 0.8), (0, 0.6, 0.8), (-0.6, 0, 0.8)]
    readers = readers_of([np.full((6, 8, 3), 0.4)] * 3)
    shots = tuple(Observation(str(k), readers[k], Light(vector)) for k, vector in enumerate(vectors))
    folder.parent.mkdir()
    write_capture(Capture(folder.name, shots, (camera,), (np.ones((6, 8), bool),), card_distance=1.0), folder)
    bpy.ops.irpso.import_capture(filepath=str(folder))
    bpy.context.scene.irpso.subject = "CARD"
    bpy.ops.irpso.create_scene()


def test_a_card_keeps_its_relief_and_a_capture_of_the_same_name_gets_its_own(scene, tmp_path):
    write_one(tmp_path / "first" / "photos")
    (card,) = [obj for obj in scene.objects if obj.type == "MESH"]
    made = bpy.data.materials.new("kept")
    made[material.TAG], made[material.ORIGIN] = "photos", str(scene_capture.capture_of(scene).source)
    material.card_object("photos", 6, 8, displaced=True)
    assert [modifier.type for modifier in card.modifiers] == ["SUBSURF"]
    bpy.ops.irpso.create_scene()
    assert [modifier.type for modifier in card.modifiers] == ["SUBSURF"]
    assert [obj for obj in scene.objects if obj.type == "MESH"] == [card]
    write_one(tmp_path / "second" / "photos")
    cards = [obj for obj in scene.objects if obj.type == "MESH"]
    assert len(cards) == 2 and {obj[material.TAG] for obj in cards} == {"photos", "photos.001"}


def test_a_capture_of_the_same_name_gets_its_own_lights_and_one_that_was_moved_keeps_them(scene, tmp_path):
    def lights():
        return {obj.name: obj for obj in scene.objects if obj.type == "LIGHT"}

    write_one(tmp_path / "first" / "photos")
    first = lights()
    write_one(tmp_path / "second" / "photos")
    second = {name: obj for name, obj in lights().items() if name not in first}
    assert len(first) == len(second) == 3 and len({obj.irpso.image for obj in lights().values()}) == 6
    assert {obj.users_collection[0] for obj in first.values()}.isdisjoint(
        obj.users_collection[0] for obj in second.values()
    )
    assert scene_setup.numbered_lights(scene) == dict(enumerate(second[name] for name in sorted(second)))
    (tmp_path / "second").rename(tmp_path / "third")
    bpy.ops.irpso.import_capture(filepath=str(tmp_path / "third" / "photos"))
    bpy.ops.irpso.create_scene()
    assert lights() == first | second
    assert {str(tmp_path / "third") in obj.irpso.image.filepath for obj in second.values()} == {True}
    bpy.ops.irpso.import_capture(filepath=str(tmp_path / "first" / "photos"))
    bpy.ops.irpso.create_scene()
    assert lights() == first | second
    assert scene_setup.numbered_lights(scene) == dict(enumerate(first[name] for name in sorted(first)))
