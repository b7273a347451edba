"""Captures in folders, and as lights and cameras of a scene, for the tests of the window."""

import bpy
import numpy as np

from irpso_addon.blender.images import decode
from irpso_addon.capture import Camera, Capture, Light, Observation, read_capture, write_capture
from irpso_addon.ui.session import scene_capture
from tests.builders.captures import write_png

RNG = np.random.default_rng(5)
ANYWHERE = np.array([[0.36, 0.48, -0.8, 1.5], [-0.8, 0.6, 0, -2.0], [0.48, 0.64, 0.6, 3.25], [0, 0, 0, 1]])


def readers_of(frames):
    """Return a function for each frame (H, W, 3) that reads it with weight 1."""
    return [lambda f=f: np.concatenate([f, np.ones((*f.shape[:2], 1))], axis=-1).astype(np.float32) for f in frames]


def write_views(folder, single_file=False):
    """Write a capture of two cameras, near and distant coloured lights and a mask; return it as read back."""
    cameras = (Camera.from_fov(24, 18, 40.0, ANYWHERE), Camera(24, 18, (30.0, 33.0), (11.0, 8.0), np.eye(4)))
    mask = np.zeros((18, 24), bool)
    mask[3:12, 5:20] = True
    lights = [Light((0.6, 0.0, 0.8), (1.0, 0.5, 0.25)), Light((0.5, -1.5, 2.0), (3.0, 4.0, 5.0), False),
              Light((-0.6, 0.0, 0.8), (0.7, 0.7, 0.7)), Light((0.0, 0.0, 1.0), (2.0, 1.0, 0.0))]  # fmt: skip
    frames = readers_of(RNG.uniform(0.1, 0.9, (4, 18, 24, 3)))
    shots = tuple(Observation(f"shot {k}", frames[k], light, k % 2) for k, light in enumerate(lights))
    write_capture(Capture("views", shots, cameras, (mask, np.ones_like(mask))), folder, single_file=single_file)
    return read_capture(folder, decode)


def created(scene, path):
    """Create the scene of a capture, select it as the source, and return the scene's capture."""
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


def assert_same_camera(a, b):
    """Assert that two cameras are equal to float32."""
    assert (a.width, a.height, a.perspective) == (b.width, b.height, b.perspective)
    np.testing.assert_allclose(a.scale, b.scale, rtol=1e-6)
    np.testing.assert_allclose(a.centre, b.centre, atol=1e-5)
    np.testing.assert_allclose(a.matrix, b.matrix, atol=1e-6)
