"""``recover SCENE.blend``: a scene's own cameras and lights, with their photographs, are a capture."""

import json

import bpy
import numpy as np
import pytest
from mathutils import Vector

import irpso_addon
from irpso_addon.blender.mesh import extract_mesh
from irpso_addon.blender.scenes import light_units as units
from irpso_addon.blender.scenes.scene_capture import capture_of_open_file
from irpso_addon.capture.images.exr import write_exr
from irpso_addon.geometry.build import domain_from_mesh
from tests.builders.command_line import dome_lights, run_cli

pytestmark = pytest.mark.bpy_only
SIZE = 16


def photograph(path, albedo, points, light, kind):
    """Write what a Lambertian card at z = 0, facing up, looks like under a light 1 strong at distance 1."""
    away = points - light
    distance = np.linalg.norm(away, axis=-1)
    shade = light[2] / distance**3
    if kind == "SUN":
        shade = np.full(points.shape[:2], light[2] / np.linalg.norm(light))
    if kind == "AREA":  # it looks at the origin
        shade = shade * (away @ -light) / distance / np.linalg.norm(light)
    radiance = (albedo * shade[..., None]).astype(np.float32)
    write_exr(path, {"": {c: radiance[..., i] for i, c in enumerate("RGB")}})


@pytest.fixture(scope="module")
def card(tmp_path_factory):
    """The folder of a .blend with a card, a camera and twelve lights with their photographs; the albedo."""
    folder = tmp_path_factory.mktemp("scene")
    irpso_addon.register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.name = "Desk"
    bpy.ops.mesh.primitive_plane_add(size=2)
    bpy.context.object.name = "Card"
    camera = bpy.data.objects.new("Above", bpy.data.cameras.new("Above"))
    camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 2.0, (0, 0, 5)
    scene.collection.objects.link(camera)
    scene.camera = camera
    x, y = np.meshgrid(*[(np.arange(SIZE) + 0.5) / SIZE * 2 - 1] * 2)
    points = np.stack([x, y, 0 * x], axis=-1)
    albedo = np.stack([0.3 + 0.2 * x, 0.5 - 0.1 * y, 0.4 + 0.1 * x * y], axis=-1)
    for k, direction in enumerate(dome_lights(12, widest=40)):
        kind = ("SUN", "POINT", "SPOT", "AREA")[k % 4]
        place = 4 * direction
        data = bpy.data.lights.new(f"Lamp {k}", kind)
        data.energy = {"SUN": units.sun_strength, "AREA": units.area_power}.get(kind, units.point_power)(1.0)
        lamp = bpy.data.objects.new(f"Lamp {k}", data)
        scene.collection.objects.link(lamp)
        if kind == "SPOT":
            data.spot_size, data.spot_blend = np.radians(80), 0.0
        elif kind == "AREA":
            data.size = 0.2
        lamp.location, lamp.rotation_mode = place, "QUATERNION"
        lamp.rotation_quaternion = Vector(direction).to_track_quat("Z", "Y")
        photograph(folder / f"{k}.exr", albedo, points, place, kind)
        lamp.irpso.image = bpy.data.images.load(str(folder / f"{k}.exr"))
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "desk.blend"))
    irpso_addon.unregister()
    return folder, albedo


def test_a_scene_is_read_without_the_interface(card):
    folder, _ = card
    bpy.ops.wm.open_mainfile(filepath=str(folder / "desk.blend"))
    assert not hasattr(bpy.context.scene.objects["Lamp 0"], "irpso")
    capture = capture_of_open_file()
    assert capture.name == "Desk" and len(capture.observations) == 12
    assert [o.light.cone is not None for o in capture.observations[:4]] == [False, False, True, False]


def test_recover_takes_a_scene_for_its_capture(card):
    folder, _ = card
    code, out, err = run_cli(
        "recover", folder / "desk.blend", "--model", "lambert", "--resolution", SIZE, "-o", folder / "out",
        "--dry-run", "--json",
    )  # fmt: skip
    assert (code, err) == (0, "")
    assert json.loads(out.splitlines()[-1])["plan"]["observations"] == 12


def test_a_rendered_scene_recovers_its_own_material(card):
    folder, albedo = card
    bpy.ops.wm.open_mainfile(filepath=str(folder / "desk.blend"))
    domain = domain_from_mesh(capture_of_open_file(), extract_mesh(bpy.data.objects["Card"]), SIZE, SIZE)
    rows, columns = np.nonzero((domain.stack.values[..., 3] > 0).sum(axis=0) == 12)
    assert len(rows) >= 14 * 14
    toward = domain.lights[:, None, :3] - domain.lights[:, None, 3:] * domain.bake.position[rows, columns]
    toward /= np.linalg.norm(toward, axis=-1, keepdims=True) ** (1 + 2 * domain.lights[:, None, 3:])
    for texel in range(len(rows)):
        radiance = domain.stack.values[:, rows[texel], columns[texel], :3]
        scaled = np.linalg.lstsq(toward[:, texel], radiance / domain.intensities, rcond=None)[0].T
        lengths = np.linalg.norm(scaled, axis=1)
        np.testing.assert_allclose(lengths, albedo[rows[texel], columns[texel]], rtol=2e-3)
        np.testing.assert_allclose(scaled / lengths[:, None], [[0, 0, 1]] * 3, atol=2e-3)


@pytest.mark.parametrize(
    ("options", "words"),
    [(["--blend", "other.blend"], "the capture is a scene and holds the mesh"), ([], "no light of this scene")],
)
def test_a_scene_that_cannot_be_recovered_is_reported(tmp_path, options, words):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_plane_add(size=2)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    code, _, err = run_cli("recover", tmp_path / "a.blend", *options, "-o", tmp_path / "out")
    assert code == 2 and words in err and len(err.strip().splitlines()) == 1 and not (tmp_path / "out").exists()


def test_inspect_sends_scenes_to_blender(tmp_path):
    (tmp_path / "a.blend").touch()
    code, out, err = run_cli("inspect", tmp_path / "a.blend")
    assert code == 2 and "checked in Blender" in out + err
