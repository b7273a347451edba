"""Colours in other spaces than Rec. 709: a configuration of ACES, and the space that a file of Blender 5 renders in."""

import json
import os
import subprocess
import sys
from types import SimpleNamespace

import bpy
import numpy as np
import OpenEXR
import pytest

from irpso_addon.blender.colour_spaces import use_space, working_matrix
from irpso_addon.blender.materials.material import apply_material, build_material, card_object
from irpso_addon.blender.scenes.scene_images import open_photograph
from irpso_addon.blender.scenes.scene_lights import light_of
from irpso_addon.blender.scenes.scene_objects import set_light
from irpso_addon.capture.images.image import ImageRef, ImageStore
from irpso_addon.capture.types import Light
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import Maps
from irpso_addon.ui.session.scene_job import _fixed_map, image_map
from tests.builders.captures import write_png

CONFIG = """ocio_profile_version: 2
environment: {}
search_path: ""
roles:
  data: Raw
  default: SRGB
  scene_linear: ACEScg
  color_picking: SRGB
  default_byte: SRGB
  default_float: ACEScg
  default_sequencer: SRGB
  aces_interchange: ACES2065-1
displays:
  sRGB - Display:
    - !<View> {name: Raw, colorspace: Raw}
active_displays: [sRGB - Display]
active_views: [Raw]
colorspaces:
  - !<ColorSpace> {name: ACEScg}
  - !<ColorSpace>
    name: ACES2065-1
    from_scene_reference: !<BuiltinTransform> {style: ACEScg_to_ACES2065-1}
  - !<ColorSpace>
    name: SRGB
    from_scene_reference: !<ExponentTransform> {value: [2.2, 2.2, 2.2, 1], direction: inverse}
  - !<ColorSpace> {name: Raw, isdata: true}
"""
SCRIPT = """
import json, sys
import bpy
from irpso_addon.blender.colour_spaces import use_of, use_space, working_matrix
from irpso_addon.blender.images import decode
image = bpy.data.images.new("a", 2, 2)
found = {"uses": []}
for use in ("data", "srgb", "linear"):
    try:
        use_space(image, use)
        found["uses"].append([image.colorspace_settings.name, use_of(image)])
    except Exception as error:
        found["uses"].append([type(error).__name__, str(error)])
if "InputError" not in [use[0] for use in found["uses"]]:
    found["matrix"] = working_matrix().tolist()
found["codes"] = decode(sys.argv[1]).values[..., :3].tolist()
print("FOUND", json.dumps(found))
"""


def asked(tmp_path, config):
    codes = np.arange(0, 240, 20, dtype=np.uint8).reshape(2, 2, 3)
    write_png(tmp_path / "a.png", codes, 8)
    environment = os.environ | {"OCIO": config}
    command = [sys.executable, "-c", SCRIPT, str(tmp_path / "a.png")]
    told = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    line = next((one for one in told.stdout.splitlines() if one.startswith("FOUND")), None)
    assert line, told.stdout + told.stderr
    found = json.loads(line.removeprefix("FOUND"))
    np.testing.assert_allclose(found["codes"], codes[::-1] / 255, atol=1e-6)
    return found["uses"], found.get("matrix")


def made(tmp_path, srgb):
    """Write a configuration whose space for textures has a name."""
    (tmp_path / "config.ocio").write_text(CONFIG.replace("SRGB", srgb))
    return str(tmp_path / "config.ocio")


@pytest.mark.bpy_only
def test_names_are_those_of_the_configuration_and_codes_stay(tmp_path):
    (data, srgb, linear), _ = asked(tmp_path, made(tmp_path, "sRGB - Texture"))
    assert (data, srgb) == (["Raw", "data"], ["sRGB - Texture", "srgb"])
    assert linear[0] == "InputError" and "no colour space for linear Rec. 709" in linear[1]


@pytest.mark.bpy_only
def test_a_configuration_without_srgb_is_named(tmp_path):
    (_, srgb, _), _ = asked(tmp_path, made(tmp_path, "Print"))
    assert srgb[0] == "InputError" and "no colour space for sRGB textures" in srgb[1]


@pytest.mark.bpy_only
def test_the_academys_own_configuration_is_known_and_renders_in_acescg(tmp_path):
    uses, matrix = asked(tmp_path, "ocio://cg-config-v1.0.0_aces-v1.3_ocio-v2.1")  # OpenColorIO holds it
    assert uses == [["Raw", "data"], ["sRGB - Texture", "srgb"], ["Linear Rec.709 (sRGB)", "linear"]]
    np.testing.assert_allclose(matrix, SPACES["ACEScg"], atol=1e-4)


# Linear Rec. 709 to ACEScg (AP1 primaries, Bradford) and to Rec. 2020 (ITU-R BT.2087), as published.
SPACES = {
    "ACEScg": [[0.613132, 0.339538, 0.047417], [0.070124, 0.916394, 0.013451], [0.020588, 0.109575, 0.869785]],
    "Linear Rec.2020": [[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]],
}
RED = np.array([0.6, 0.1, 0.05])


@pytest.fixture(params=SPACES)
def space(request):
    """A file that renders in another space, as the matrix from linear Rec. 709."""
    if not hasattr(bpy.data, "colorspace"):
        pytest.skip("Blender before 5.0 has one space for all files")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.set_working_color_space(working_space=request.param)
    yield np.array(SPACES[request.param])
    bpy.ops.wm.read_factory_settings(use_empty=True)


@pytest.mark.bpy_only
def test_the_space_of_the_file_is_measured(space):
    np.testing.assert_allclose(working_matrix(), space, atol=1e-4)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert working_matrix() is None and "IRPSO colours" not in bpy.data.images


@pytest.mark.bpy_only
def test_lights_have_the_colours_of_the_capture_and_are_read_back(space):
    lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "SUN"))
    bpy.context.scene.collection.objects.link(lamp)
    set_light(lamp, Light((0.0, 0.0, 1.0), (1.2, 0.7, 0.3)))
    expected = space @ (1.2, 0.7, 0.3)
    np.testing.assert_allclose(lamp.data.color, expected / expected.max(), atol=1e-3)
    np.testing.assert_allclose(light_of(lamp).intensity, (1.2, 0.7, 0.3), rtol=1e-4)


@pytest.mark.bpy_only
def test_a_recovered_base_colour_renders_as_what_it_is(space, tmp_path):
    scene, size = bpy.context.scene, 8
    model = load_model("lambert")
    fields = {
        "base_color": np.broadcast_to(RED, (size, size, 3)),
        "normal": np.broadcast_to([0, 0, 1], (size, size, 3)),
    }
    maps = Maps(model, {name: np.float32(values) for name, values in fields.items()}, np.ones((size, size), bool))
    apply_material(card_object("card", size, size), build_material(maps, "card"))
    lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "SUN"))
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    for thing in (lamp, camera):
        scene.collection.objects.link(thing)
    set_light(lamp, Light((0.0, 0.0, 1.0), (1.0, 1.0, 1.0)))
    camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 0.5, (0, 0, 3)
    scene.camera, scene.render.engine, scene.cycles.samples = camera, "CYCLES", 4
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.image_settings.media_type, scene.render.image_settings.file_format = "IMAGE", "OPEN_EXR"
    scene.render.image_settings.color_depth, scene.render.filepath = "32", str(tmp_path / "a.exr")
    bpy.ops.render.render(write_still=True)
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        seen = np.array([file.channels()[c].pixels.mean() for c in "RGB"])
    found = ImageStore().samples(ImageRef(tmp_path / "a.exr")).rgba[..., :3].mean(axis=(0, 1))
    np.testing.assert_allclose(found, np.linalg.solve(space, seen), atol=1e-4)
    np.testing.assert_allclose(seen, space @ RED, rtol=0.05)  # its codes as they are: 0.6, 0.1, 0.05


def painted(size=2):
    """A float image of that red, as a painter holds it in Blender's own space."""
    image = bpy.data.images.new("painted", size, size, float_buffer=True)
    use_space(image, "linear")
    pixel = [*(working_matrix() @ RED), 1.0]
    image.pixels.foreach_set(np.tile(np.float32(pixel), size * size))
    return image


@pytest.mark.bpy_only
def test_painted_photographs_and_given_colours_are_linear_rec_709(space):
    image = painted()
    seen = open_photograph(image, "light 'Sun'", ImageStore()).read().rgba[0, 0, :3]
    np.testing.assert_allclose(seen, RED, atol=1e-4)
    model = load_model("principled")
    base_color = model.parameter("base_color")
    np.testing.assert_allclose(image_map(image, model, "base_color", (2, 2))[0, 0], RED, atol=1e-4)
    item = SimpleNamespace(image=None, color=tuple(space @ RED), value=0.0)
    np.testing.assert_allclose(_fixed_map(item, model, base_color, (2, 2), (1001,)), RED, atol=1e-4)
    item.color = (1.0, 1.0, 1.0)  # white stays inside the parameter's limits
    np.testing.assert_allclose(_fixed_map(item, model, base_color, (2, 2), (1001,)), 1, atol=1e-4)
