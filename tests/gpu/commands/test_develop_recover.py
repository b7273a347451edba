"""From a camera's JPEG brackets to maps: develop, inspect and recover through the command line."""

import json
import struct

import numpy as np
import pytest

from tests.builders.command_line import angle, dome_lights, read_map, run_cli, smooth_maps
from tests.oracles import reflectance as oracles

SHAPE = (24, 32)
LIGHTS = dome_lights(12)
SECONDS = (240, 60)  # one over


def exif(below):
    """An EXIF block with an exposure of 1/below s and nothing else, byte by byte."""
    head = b"II*\0" + struct.pack("<I", 8)
    pointer = struct.pack("<H", 1) + struct.pack("<HHII", 34665, 4, 1, 26) + bytes(4)
    time = struct.pack("<H", 1) + struct.pack("<HHII", 33434, 5, 1, 44) + bytes(4) + struct.pack("<II", 1, below)
    return b"Exif\0\0" + head + pointer + time


def write_jpeg(path, light, below):
    """Write linear light (H, W, 3), row 0 at the bottom, as the sRGB JPEG of a camera, by Blender."""
    import bpy

    light = np.clip(light, 0, 1)
    codes = np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)
    big = np.repeat(np.repeat(codes, 8, axis=0), 8, axis=1)  # JPEG keeps even blocks exactly, colour apart
    image = bpy.data.images.new("photograph", big.shape[1], big.shape[0])
    image.pixels.foreach_set(np.concatenate([big, np.ones((*big.shape[:2], 1))], axis=-1).astype(np.float32).ravel())
    image.filepath_raw, image.file_format = str(path), "JPEG"
    image.save(quality=100)
    bpy.data.images.remove(image)
    data, block = path.read_bytes(), exif(below)
    path.write_bytes(data[:2] + b"\xff\xe1" + struct.pack(">H", 2 + len(block)) + block + data[2:])


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A folder of JPEG brackets of a matt card, four times too bright for the longer exposure, and its maps."""
    folder = tmp_path_factory.mktemp("brackets")
    maps = smooth_maps(SHAPE, {})
    for k, light in enumerate(LIGHTS):
        radiance = oracles.MODELS["lambert"](maps, light, np.array([0.0, 0.0, 1.0]))
        for i, below in enumerate(SECONDS):
            write_jpeg(folder / f"IMG_{2 * k + i}.jpg", radiance * SECONDS[0] / below, below)
    (folder / "filenames.txt").write_text("".join(f"IMG_{2 * k}.jpg\n" for k in range(len(LIGHTS))))
    np.savetxt(folder / "light_directions.txt", LIGHTS, fmt="%.8f")
    return folder, maps


def test_a_developed_folder_is_recovered_as_it_is(scene, tmp_path):
    folder, maps = scene
    code, _, err = run_cli("develop", folder, "-o", tmp_path / "linear", "--brackets", "exif", "--quiet")
    assert (code, err) == (0, "")
    code, out, _ = run_cli("inspect", tmp_path / "linear", "--json")
    assert code == 0 and json.loads(out)["facts"]["images"] == str(len(LIGHTS))
    code, _, err = run_cli("recover", tmp_path / "linear", "-o", tmp_path / "maps", "--model", "lambert", "--quiet")
    assert code == 0, err
    inner = np.s_[4::8, 4::8]  # the middle of each block of 8 pixels
    normal = read_map(tmp_path / "maps" / "normal.exr")[inner]
    colour = read_map(tmp_path / "maps" / "base_color.exr")[inner]
    off = angle(normal, maps["normal"])
    assert off.mean() < 1.0
    assert np.abs(colour - maps["base_color"]).mean() < 0.01
