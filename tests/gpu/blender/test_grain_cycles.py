"""A grain that was recovered on a mesh, in Blender's material: against the model in float64, and across UV seams."""

import bpy
import numpy as np
import pytest

from irpso_addon.blender.materials.margins import blender_maps
from irpso_addon.blender.materials.material import apply_material, build_material
from irpso_addon.blender.materials.tangent_frames import maps_from_blender, maps_to_blender
from irpso_addon.blender.mesh import extract_mesh
from irpso_addon.blender.scenes import light_units
from irpso_addon.geometry.seams.seams import seams_of
from irpso_addon.geometry.surface.bake import bake_uv
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import Maps
from tests.gpu.blender.test_material_cycles import add_light, relative_difference, render, scene, tilted, unit
from tests.gpu.geometry.test_geometry_bake import monkey
from tests.oracles import reflectance as oracles

pytestmark = pytest.mark.bpy_only
__all__ = ["scene"]  # a fixture of every test

TEXELS = 64
GRAIN = load_model("anisotropic")
SQUARE = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float)


def object_of(points, faces, uvs):
    mesh = bpy.data.meshes.new("subject")
    mesh.from_pydata(np.asarray(points, float).tolist(), [], faces)
    mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", np.float32(uvs).ravel())
    obj = bpy.data.objects.new("subject", mesh)
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return obj


def constant_maps(**values):
    return {name: np.tile(np.float32(value), (TEXELS, TEXELS, 1)) for name, value in values.items()}


def rotation(degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s], [s, c]])


@pytest.mark.parametrize("stretch, slant", [(0.6, 0.0), (0.2, 0.6), (-0.3, 0.5), (0.9, -0.8)])
@pytest.mark.parametrize("degrees, mirrored, scale", [
    (0, False, (1, 1, 1)), (30, False, (1.5, 1.5, 1.5)), (0, True, (1, 1, 1)), (30, True, (1, 1, 1)),
    (0, False, (-1, 1, 1)), (30, True, (1, -1, 1)), (45, False, (2, 1, 1)), (30, True, (-2, 1, 0.5)),
])  # fmt: skip
def test_cycles_shows_the_recovered_grain(degrees, mirrored, scale, stretch, slant, tmp_path):
    uvs = (SQUARE - 0.5) @ rotation(degrees) * 0.6 * (-1 if mirrored else 1, 1) + 0.5
    obj = object_of(np.pad(2 * SQUARE - 1, ((0, 0), (0, 1))), [(0, 1, 2, 3)], uvs)
    obj.scale = scale
    bpy.context.view_layer.update()
    mesh = extract_mesh(obj)
    surface = bake_uv(mesh, TEXELS, TEXELS)
    material = {"base_color": (0.9, 0.5, 0.3), "normal": unit(0.2, -0.15, 1), "roughness": 0.45, "metallic": 0.8,
                "stretch": stretch, "slant": slant}  # fmt: skip
    values = maps_to_blender(GRAIN, constant_maps(**material), mesh, surface)
    apply_material(obj, build_material(Maps(GRAIN, values, surface.coverage), "subject"))
    light, view = tilted(40, 20), unit(0, 0, 1)
    add_light("SUN", light_units.sun_strength(1.0), light)
    rendered = render(tmp_path)[16:20, 16:20].mean(axis=(0, 1))
    frame = surface.frames()[TEXELS // 2, TEXELS // 2]
    arrays = {name: np.asarray(value)[None] for name, value in material.items()}
    (expected,) = oracles.anisotropic(arrays, frame @ light, frame @ view)
    difference = relative_difference(rendered, expected)
    print(f"\n{difference.max():.2%}")
    assert difference.max() < 0.01


def test_maps_come_back_from_blenders_frames():
    mesh = extract_mesh(monkey(0, scale=(-1, 1.4, 0.8)))
    surface, rng = bake_uv(mesh, TEXELS, TEXELS), np.random.default_rng(0)
    angle, strength = rng.uniform(0, 2 * np.pi, (TEXELS, TEXELS, 1)), rng.uniform(0, 1, (TEXELS, TEXELS, 1))
    values = {"stretch": strength * np.cos(angle), "slant": strength * np.sin(angle)}
    values["normal"] = oracles.unit(rng.normal(size=(TEXELS, TEXELS, 3)) * (0.3, 0.3, 0) + (0, 0, 1))
    written = maps_to_blender(GRAIN, values, mesh, surface)
    read = maps_from_blender(GRAIN, written, mesh, surface)
    inside = surface.coverage
    assert inside.sum() > 500 and np.abs(written["slant"] - values["slant"])[inside].max() > 0.5
    for name, value in values.items():
        np.testing.assert_allclose(read[name][inside], value[inside], atol=2e-6)


def test_numbers_are_turned_into_the_solvers_frames_as_maps_are():
    mesh = extract_mesh(monkey(0, scale=(-1, 1.4, 0.8)))
    surface = bake_uv(mesh, TEXELS, TEXELS)
    numbers = {"stretch": np.float32([0.2]), "slant": np.float32([0.6])}
    maps = {name: np.tile(number, (TEXELS, TEXELS, 1)) for name, number in numbers.items()}
    found, expected = (maps_from_blender(GRAIN, values, mesh, surface) for values in (numbers, maps))
    assert np.ptp(expected["slant"][surface.coverage]) > 0.1
    for name in numbers:
        np.testing.assert_array_equal(found[name], expected[name])
    none = {name: np.zeros(1, np.float32) for name in numbers}
    assert maps_from_blender(GRAIN, none, mesh, surface).keys() == none.keys()


@pytest.mark.parametrize("fold", [0, 60])
@pytest.mark.parametrize(
    "degrees, mirrored", [(0, False), (90, False), (180, False), (30, False), (0, True), (90, True)]
)
def test_a_straight_grain_stays_straight_past_a_seam(degrees, mirrored, fold):
    c, s = np.cos(np.radians(fold)), np.sin(np.radians(fold))
    points = [(-1, 0, 0), (0, 0, 0), (0, 1, 0), (-1, 1, 0), (c, 0, s), (c, 1, s)]
    right = (SQUARE - 0.5) @ rotation(degrees) * (-1 if mirrored else 1, 1) * 0.3
    uvs = np.concatenate([SQUARE * 0.35 + (0.05, 0.3), right + (0.72, 0.5)])
    mesh = extract_mesh(object_of(points, [(0, 1, 2, 3), (1, 4, 5, 2)], uvs))
    surface = bake_uv(mesh, TEXELS, TEXELS)
    frames, covered = surface.frames(), surface.coverage
    x = np.where((surface.position[..., :1] > 0) & covered[..., None], (c, 0, s), (1, 0, 0))
    grain = 0.8 * x + 0.6 * np.array([0, 1, 0])  # continues over the fold
    angle = np.arctan2(*(np.einsum("hwi,hwi->hw", frames[..., axis, :], grain) for axis in (1, 0)))[..., None]
    values = constant_maps(base_color=(0.5, 0.5, 0.5), normal=(0, 0, 1), roughness=0.4, metallic=1.0)
    values |= {"stretch": np.float32(0.7 * np.cos(2 * angle)), "slant": np.float32(0.7 * np.sin(2 * angle))}
    written = blender_maps(Maps(GRAIN, values, covered), mesh, surface, seams_of(mesh, surface.triangle))
    places, texels = np.argwhere(written.margin), np.argwhere(covered)
    beside = texels[((places[:, None] - texels) ** 2).sum(axis=-1).argmin(axis=1)]
    assert len(places) > 100
    for name in ("stretch", "slant"):
        value = written.values[name][..., 0]
        np.testing.assert_allclose(value[tuple(places.T)], value[tuple(beside.T)], atol=1e-5)
