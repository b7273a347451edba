"""Spots and area lights, cameras with distortion: Blender's objects are the capture's again, and Cycles agrees."""

import bpy
import numpy as np
import OpenEXR
import pytest

from irpso_addon.blender.images import decode
from irpso_addon.blender.scenes import light_units as lights
from irpso_addon.blender.scenes import scene_lights, scene_objects
from irpso_addon.blender.scenes.scene_capture import wide_lights_around
from irpso_addon.capture import Camera, Capture, Light, Observation, read_capture, write_capture
from irpso_addon.ui.session import scene_capture
from tests.builders.captures import write_png

pytestmark = [pytest.mark.bpy_only, pytest.mark.usefixtures("registered")]
AXIS = (0.48, 0.64, -0.6)
PLACE = (0.5, -1.5, 2.0)
DIRECTED = {
    "spot": Light(PLACE, (3.0, 4.0, 5.0), False, AXIS, 22.5),
    "wide spot": Light(PLACE, (1.0, 1.0, 1.0), False, AXIS, 90.0),
    "wider than Blender's spots": Light(PLACE, (1.0, 1.0, 1.0), False, AXIS, 120.0),
    "flat": Light(PLACE, (0.5, 1.0, 0.25), False, AXIS, None, True),
    "flash": Light(PLACE, (0.5, 1.0, 0.25), False, AXIS, None, 2.5),
    "flat with a snoot": Light(PLACE, (0.5, 1.0, 0.25), False, AXIS, 33.0, True),
}


@pytest.fixture(autouse=True)
def scene(registered):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def add(scene, name, data):
    obj = bpy.data.objects.new(name, data)
    scene.collection.objects.link(obj)
    return obj


@pytest.mark.parametrize("name", DIRECTED)
def test_a_light_object_is_the_light_again(scene, name):
    light = DIRECTED[name]
    obj = add(scene, "Lamp", bpy.data.lights.new("Lamp", "SUN"))
    scene_objects.set_light(obj, light)
    assert obj.data.type == ("AREA" if light.cosine else "SPOT")
    bpy.context.view_layer.update()
    found = scene_lights.light_of(obj)
    for given, expected in ((found.vector, light.vector), (found.axis, light.axis), (found.intensity, light.intensity)):
        np.testing.assert_allclose(given, expected, rtol=3e-7, atol=3e-7)
    assert found.cosine == light.cosine and found.distant is False
    np.testing.assert_allclose(found.cone or 0, light.cone or 0, rtol=1e-6)


def test_a_light_object_can_change_its_type(scene):
    obj = add(scene, "Lamp", bpy.data.lights.new("Lamp", "SUN"))
    for light in (*DIRECTED.values(), Light((0.0, 0.0, 1.0)), Light(PLACE, distant=False), DIRECTED["flat"]):
        scene_objects.set_light(obj, light)
        bpy.context.view_layer.update()
        found = scene_lights.light_of(obj)
        assert (found.distant, found.cosine, found.axis is None) == (light.distant, light.cosine, light.axis is None)
        np.testing.assert_allclose(found.cone or 0, light.cone or 0, rtol=1e-6)


@pytest.mark.parametrize(
    ("name", "change", "expected"),
    [
        ("flat with a snoot", {"type": "SPOT", "spot_size": np.radians(50), "spot_blend": 0.0}, (25.0, 0)),
        ("flash", {"type": "SPOT", "spot_size": np.pi, "spot_blend": 0.0}, (90.0, 0)),
        ("wider than Blender's spots", {"type": "AREA", "spread": np.pi}, (None, 1)),
        ("wider than Blender's spots", {"spot_size": np.radians(50)}, (25.0, 0)),
        # acos((cos 90° + 0.5 (1 − cos 90°)) = acos 0.5
        ("wider than Blender's spots", {"spot_blend": 0.5}, (60.0, 0)),
        ("wider than Blender's spots", {"energy": 7.0}, (120.0, 0)),
        ("flat with a snoot", {"size": 0.1}, (33.0, 1)),
    ],
)
def test_a_changed_light_object_emits_as_changed(scene, name, change, expected):
    obj = add(scene, "Lamp", bpy.data.lights.new("Lamp", "SUN"))
    scene_objects.set_light(obj, DIRECTED[name])
    for key, value in change.items():
        setattr(obj.data, key, value)
    bpy.context.view_layer.update()
    found = scene_lights.light_of(obj)
    assert found.cosine == expected[1] and found.cone == (expected[0] and pytest.approx(expected[0], abs=1e-4))


def test_a_capture_with_such_lights_and_a_bent_lens_is_its_scene_again_after_saving(scene, tmp_path):
    matrix = np.array([[0.36, 0.48, -0.8, 1.5], [-0.8, 0.6, 0, -2.0], [0.48, 0.64, 0.6, 3.25], [0, 0, 0, 1]])
    camera = Camera(12, 9, (11.0, 11.5), (6.5, 4.0), matrix, True, (-0.1, 1 / 3, 0.001, -0.002))
    frames = np.random.default_rng(5).random((len(DIRECTED), 9, 12, 4)).astype(np.float32)
    shots = tuple(
        Observation(f"{k}", lambda k=k: frames[k], light) for k, light in enumerate(DIRECTED.values())
    )  # fmt: skip
    write_capture(Capture("views", shots, (camera,), (np.ones((9, 12), bool),)), tmp_path / "views")
    expected = read_capture(tmp_path / "views", decode)
    scene.irpso.capture_path, scene.irpso.source, scene.irpso.subject = str(tmp_path / "views"), "SCENE", "MESH"
    bpy.ops.irpso.create_scene()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    found = scene_capture.capture_of(bpy.context.scene)
    assert found.cameras[0].distortion == camera.distortion
    for a, b in zip(found.observations, expected.observations, strict=True):
        np.testing.assert_allclose(a.light.axis, b.light.axis, atol=3e-7)
        np.testing.assert_allclose((a.light.cone or 0, a.light.cosine), (b.light.cone or 0, b.light.cosine), rtol=1e-6)
        np.testing.assert_array_equal(a.read(), b.read())


# ---- Cycles


SIZE = 32


def white_floor(scene):
    """Make a white matt floor, 8 wide, that the camera sees from straight above."""
    matt = bpy.data.materials.new("matt")
    if matt.node_tree is None:
        matt.use_nodes = True
    matt.node_tree.nodes.clear()
    diffuse, output = (matt.node_tree.nodes.new(f"ShaderNode{kind}") for kind in ("BsdfDiffuse", "OutputMaterial"))
    diffuse.inputs["Color"].default_value = (1, 1, 1, 1)
    matt.node_tree.links.new(diffuse.outputs[0], output.inputs[0])
    bpy.ops.mesh.primitive_plane_add(size=8)
    bpy.context.object.data.materials.append(matt)
    camera = add(scene, "Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 8.0, (0, 0, 9)
    scene.camera = camera
    x, y = np.meshgrid(*[(np.arange(SIZE) + 0.5) / SIZE * 8 - 4] * 2)
    return np.stack([x, y, 0 * x], axis=-1)


def rendered(scene, path):
    scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", 16
    scene.cycles.use_denoising, scene.cycles.max_bounces = False, 0
    scene.cycles.filter_width = 0.01  # the middles of the pixels
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return np.stack([file.channels()[c].pixels for c in "RGB"], axis=-1)[::-1].astype(np.float64)


@pytest.mark.parametrize(
    ("kind", "shape"),
    [
        ("SPOT", {"spot_size": np.radians(70), "spot_blend": 0.0}),
        ("SPOT", {"spot_size": np.radians(110), "spot_blend": 0.4}),
        ("AREA", {"shape": "SQUARE", "size": 0.2}),
        ("AREA", {"shape": "RECTANGLE", "size": 0.1, "size_y": 0.3}),
        ("AREA", {"shape": "DISK", "size": 0.3}),
    ],
)
def test_cycles_lights_a_white_floor_as_the_light_that_is_read(scene, tmp_path, kind, shape):
    points = white_floor(scene)
    obj = add(scene, "Lamp", bpy.data.lights.new("Lamp", kind))
    obj.data.energy, obj.data.color = 120.0, (1.0, 0.5, 0.25)
    for name, value in shape.items():
        setattr(obj.data, name, value)
    if kind == "SPOT":
        obj.data.shadow_soft_size = 0.0
    obj.location, obj.rotation_euler, obj.scale = (1.0, -0.5, 3.0), (0.3, 0.2, 0.0), (1.0, 1.0, 1.0)
    bpy.context.view_layer.update()
    light = scene_lights.light_of(obj)
    away = points - light.vector
    distance = np.linalg.norm(away, axis=-1)
    along = away @ light.axis / distance  # the cosine to the axis
    facing = 3.0 / distance
    expected = facing / distance**2 * (along if light.cosine else 1)
    image = rendered(scene, tmp_path / "r.exr")
    inside = along > 0.05 if light.cone is None else np.degrees(np.arccos(along)) < light.cone - 0.3
    assert inside.sum() > 150
    ratio = image[inside] / (expected[inside][:, None] * light.intensity)
    assert np.abs(ratio - 1).max() < 0.02 and abs(ratio.mean() - 1) < 0.004
    if kind == "SPOT" and shape["spot_blend"] == 0:  # else what the blend lets through counts as outside
        assert image[np.degrees(np.arccos(along)) > light.cone + 0.3].max() == 0
    elif kind == "SPOT":  # just outside of the cone that is read it is dimmer already
        rim = np.abs(np.degrees(np.arccos(along)) - light.cone - 3) < 1
        assert 0 < (image[rim, 0] / (expected[rim] * light.intensity[0])).mean() < 0.97


def test_powers_and_intensities_undo_each_other():
    for power, intensity in (
        (lights.sun_strength, lights.sun_intensity), (lights.point_power, lights.point_intensity),
        (lights.spot_power, lights.spot_intensity), (lights.area_power, lights.area_intensity),
    ):  # fmt: skip
        assert intensity(power(0.7)) == pytest.approx(0.7, rel=1e-15)


def test_an_area_light_too_wide_for_its_distance_is_warned_of(scene, tmp_path):
    white_floor(scene)
    write_png(tmp_path / "a.png", np.full((4, 4, 3), 100))
    lamp = add(scene, "Softbox", bpy.data.lights.new("Softbox", "AREA"))
    lamp.irpso.image = bpy.data.images.load(str(tmp_path / "a.png"))
    lamp.location, lamp.data.shape, lamp.data.size, lamp.data.size_y = (0, 0, 4), "RECTANGLE", 0.3, 0.7
    scene.irpso.source, scene.irpso.subject = "SCENE", "MESH"

    def found_of_its_width():
        bpy.ops.irpso.check_capture()
        return [item for item in scene.irpso.findings if "Softbox" in item.message]

    assert found_of_its_width() == []  # 0.7 of 4
    lamp.scale = (1, 2, 1)
    (found,) = found_of_its_width()
    assert found.severity == "warning" and "'Softbox' is 1.4 wide, 4 from the subject" in found.message
    assert wide_lights_around(bpy.data.objects["Plane"]) == [found.message]
    assert len(scene_capture.capture_of(scene).observations) == 1


@pytest.mark.parametrize("kind", ["POINT", "SPOT"])
def test_a_wide_lamp_is_warned_of(scene, kind):
    lamp = add(scene, "Bulb", bpy.data.lights.new("Bulb", kind))
    lamp.location, lamp.scale = (1, 2, 5), (9, 9, 9)  # the scale of a sphere light does not count
    bpy.context.view_layer.update()
    for radius, warned in ((0.39, False), (0.41, True)):  # at 4 from the place
        lamp.data.shadow_soft_size = radius
        found = scene_lights.too_wide(lamp, np.array([1, 2, 1.0]))
        assert bool(found) == warned
    assert found.startswith("light 'Bulb' is 0.82 wide, 4 from the subject, and is used as a point; make it at most")


def test_a_wide_sun_is_warned_of(scene):
    sun = add(scene, "Sky", bpy.data.lights.new("Sky", "SUN"))
    for degrees, warned in ((0.526, False), (11.4, False), (12, True)):  # 2 atan 0.1 = 11.42°
        sun.data.angle = np.radians(degrees)
        assert bool(found := scene_lights.too_wide(sun, np.zeros(3))) == warned
    assert found == (
        "light 'Sky' spans 12°, and is used as one direction; set its Angle to at most 11.4° for sharp highlights"
    )
