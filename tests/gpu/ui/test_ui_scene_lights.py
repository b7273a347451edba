"""Cameras and lights of a scene: read as the renderer places them, hidden, animated or parented."""

import bpy
import numpy as np
import pytest

from irpso_addon.blender.scenes import scene_lights
from irpso_addon.blender.scenes.scene import camera_from_object
from irpso_addon.capture import Camera, Light
from irpso_addon.core.errors import InputError
from irpso_addon.ui.operators import scene_setup
from tests.builders.scene_captures import ANYWHERE, add_camera, add_light, assert_same_camera

pytestmark = [pytest.mark.bpy_only, pytest.mark.usefixtures("registered")]
RNG = np.random.default_rng(5)
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


def keyed(light, scene):
    for frame, x, energy in ((1, 1, 10.0), (10, 9, 50.0)):
        light.location.x, light.data.energy = x, energy
        light.keyframe_insert("location", frame=frame)
        light.data.keyframe_insert("energy", frame=frame)


def driven(light, scene):
    for owner, path, index in ((light, "location", 0), (light.data, "energy", None)):
        curve = owner.driver_add(path, index) if index is not None else owner.driver_add(path)
        curve.driver.expression = "frame - 1" if owner == light else "5 * frame"


def constrained(light, scene):
    target = bpy.data.objects.new("Target", None)
    scene.collection.objects.link(target)
    target.location.x, light.data.energy = 9, 50
    light.constraints.new("COPY_LOCATION").target = target


def on_a_keyed_parent(light, scene):
    parent = bpy.data.objects.new("Slider", None)
    scene.collection.objects.link(parent)
    parent.hide_viewport = True
    light.parent, light.data.energy = parent, 50
    for frame, x in ((1, 1), (10, 9)):
        parent.location.x = x
        parent.keyframe_insert("location", frame=frame)


@pytest.mark.parametrize("place", [keyed, driven, constrained, on_a_keyed_parent])
@pytest.mark.parametrize("hidden", [False, True])
def test_a_light_is_read_where_the_current_frame_has_it_even_disabled_in_viewports(scene, place, hidden):
    light = add_light(scene, "Key", kind="POINT")
    place(light, scene)
    scene.frame_set(1)
    light.hide_viewport = hidden
    bpy.context.view_layer.update()
    scene.frame_set(10)
    found = scene_lights.light_of(light)
    np.testing.assert_allclose(found.vector, (9, 0, 0), atol=1e-6)
    np.testing.assert_allclose(found.intensity, 50 / (4 * np.pi**2), rtol=1e-6)
    assert light.hide_viewport == hidden


def test_an_animated_light_of_a_hidden_collection_is_refused(scene):
    light = add_light(scene, "Key", kind="POINT")
    keyed(light, scene)
    collection = bpy.data.collections.new("off")
    scene.collection.children.link(collection)
    scene.collection.objects.unlink(light), collection.objects.link(light)
    collection.hide_viewport = True
    bpy.context.view_layer.update()
    with pytest.raises(InputError, match="object 'Key' is hidden and has constraints, animation or drivers; show it"):
        scene_lights.light_of(light)


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
