"""Light that follows no lamp, on surfaces of the float64 oracles: found where it was added, never where it was not."""

import numpy as np
import pytest

from irpso_addon.capture.inspect.report import inspect_capture
from irpso_addon.capture.inspect.room_light import room_light
from tests.builders.captures import decode_png, sphere, write_png
from tests.builders.command_line import dome_lights
from tests.builders.domains import unit
from tests.oracles import reflectance as oracles

VIEW = np.array([0.0, 0.0, 1.0])
SURFACES = {
    "white": ("lambert", {"base_color": (0.8, 0.8, 0.8)}),
    "clay": ("principled", {"base_color": (0.6, 0.4, 0.2), "roughness": 0.8, "specular": 0.5}),
    "glazed": ("principled", {"base_color": (0.7, 0.7, 0.6), "roughness": 0.15, "specular": 0.5}),
    "black": ("principled", {"base_color": (0.02, 0.02, 0.02), "roughness": 0.5, "specular": 0.5}),
    "metal": ("principled_metallic",
              {"base_color": (0.7, 0.6, 0.5), "roughness": 0.5, "specular": 0.5, "metallic": 1.0}),
}  # fmt: skip
LIGHTS = {"wide": dome_lights(24, 65), "narrow": dome_lights(12, 25)}


def photographs(surface, lights, part, size=40):
    """Return (K, T, 3) radiance of a sphere in a room that adds ``part`` of a pixel's bright sample, with noise."""
    normals, mask = sphere(size)
    model, values = SURFACES[surface]
    maps = {name: np.broadcast_to(value, (*mask.shape, *np.shape(value))) for name, value in values.items()}
    images = np.stack([oracles.MODELS[model]({"normal": normals, **maps}, light, VIEW) for light in lights])[:, mask]
    images = images * (1 - part) + part * np.percentile(images, 90, axis=0)
    scale = np.percentile(images, 95)
    return np.maximum(images / scale + np.random.default_rng(1).normal(scale=0.004, size=images.shape), 0), mask


def write_photographs(folder, pixels, mask, lights):
    """Write ``photographs`` of 16 bits, their mask, and lists of their names and lights."""
    images = np.zeros((len(pixels), *mask.shape, 3))
    images[:, mask] = pixels
    for number, image in enumerate(images):
        write_png(folder / f"{number}.png", np.rint(65535 * np.clip(0.8 * image, 0, 1)).astype(int), bits=16)
    write_png(folder / "mask.png", 255 * mask.astype(int)[..., None].repeat(3, axis=-1))
    (folder / "filenames.txt").write_text("\n".join(f"{number}.png" for number in range(len(images))))
    np.savetxt(folder / "light_directions.txt", lights)


@pytest.mark.parametrize("lights", LIGHTS)
@pytest.mark.parametrize("surface", SURFACES)
def test_a_dark_room_is_dark_on_every_surface(surface, lights):
    values = photographs(surface, LIGHTS[lights], 0.0)[0].mean(axis=-1)
    assert room_light(values, values > 0, LIGHTS[lights][:, None]) == 0


@pytest.mark.parametrize("part", [0.15, 0.3])
@pytest.mark.parametrize("surface", ["white", "clay", "glazed"])
def test_the_light_of_a_room_is_measured(surface, part):
    values = photographs(surface, LIGHTS["wide"], part)[0].mean(axis=-1)
    assert room_light(values, values > 0, LIGHTS["wide"][:, None]) == pytest.approx(part, abs=0.06)


def test_photographs_too_few_to_tell_are_not_accused():
    values = photographs("white", LIGHTS["wide"][:5], 0.3)[0].mean(axis=-1)
    assert room_light(values, values > 0, LIGHTS["wide"][:5, None]) == 0
    values = photographs("white", LIGHTS["wide"], 0.3)[0].mean(axis=-1)
    for few in (values[:, :90], values[:, :0]):
        assert room_light(few, few > 0, LIGHTS["wide"][:, None]) == 0


@pytest.mark.parametrize(("part", "expected"), [(0.0, 0), (0.25, 1)])
def test_inspect_says_that_the_room_was_not_dark(part, expected, tmp_path):
    write_photographs(tmp_path, *photographs("clay", LIGHTS["wide"], part), LIGHTS["wide"])
    found = [finding for finding in inspect_capture(tmp_path, decode_png).findings if finding.code == "room_light"]
    assert len(found) == expected
    assert all("comes from no lamp" in finding.message and "--dark" in finding.message for finding in found)


def test_unequal_lamps_over_a_nearly_flat_card_are_no_room_light():
    lights, rng = dome_lights(8, 40), np.random.default_rng(5)
    normals = unit(rng.normal(scale=0.03, size=(576, 3)) * (1, 1, 0) + (0, 0, 1))
    albedo = 0.35 + 0.3 * rng.random(576)
    for seed in range(12):
        strengths = 0.6 * np.exp(0.3 * np.random.default_rng(seed).standard_normal(8))
        values = np.maximum(lights @ normals.T, 0) * albedo * strengths[:, None]
        assert room_light(values, values > 0, lights[:, None]) == 0, seed
