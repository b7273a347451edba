"""Images and textures under an OpenColorIO configuration of ACES, which has none of Blender's names."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

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
from irpso_addon.blender.colour_spaces import use_of, use_space
from irpso_addon.blender.images import decode
image = bpy.data.images.new("a", 2, 2)
found = {"uses": []}
for use in ("data", "srgb", "linear"):
    try:
        use_space(image, use)
        found["uses"].append([image.colorspace_settings.name, use_of(image)])
    except Exception as error:
        found["uses"].append([type(error).__name__, str(error)])
found["codes"] = decode(sys.argv[1]).values[..., :3].tolist()
print("FOUND", json.dumps(found))
"""


def asked(tmp_path, srgb):
    codes = np.arange(0, 240, 20, dtype=np.uint8).reshape(2, 2, 3)
    write_png(tmp_path / "a.png", codes, 8)
    (tmp_path / "config.ocio").write_text(CONFIG.replace("SRGB", srgb))
    environment = os.environ | {"OCIO": str(tmp_path / "config.ocio")}
    command = [sys.executable, "-c", SCRIPT, str(tmp_path / "a.png")]
    told = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    line = next((one for one in told.stdout.splitlines() if one.startswith("FOUND")), None)
    assert line, told.stdout + told.stderr
    found = json.loads(line.removeprefix("FOUND"))
    np.testing.assert_allclose(found["codes"], codes[::-1] / 255, atol=1e-6)
    return found["uses"]


@pytest.mark.bpy_only
def test_names_are_those_of_the_configuration_and_codes_stay(tmp_path):
    data, srgb, linear = asked(tmp_path, "sRGB - Texture")
    assert (data, srgb) == (["Raw", "data"], ["sRGB - Texture", "srgb"])
    assert linear[0] == "InputError" and "no colour space for linear Rec. 709" in linear[1]


@pytest.mark.bpy_only
def test_a_configuration_without_srgb_is_named(tmp_path):
    _, srgb, _ = asked(tmp_path, "Print")
    assert srgb[0] == "InputError" and "no colour space for sRGB textures" in srgb[1]
