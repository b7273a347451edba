"""Materials and lights rendered by Cycles, an independent renderer, against the equations in float64."""

import dataclasses
import math
from pathlib import Path

import bpy
import numpy as np
import OpenEXR
import pytest
from mathutils import Matrix, Vector

from irpso_addon.blender.materials import two_lobe_nodes as two_lobe
from irpso_addon.blender.materials.material import apply_material, build_material, card_object
from irpso_addon.blender.scenes import light_units as lights
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import Maps
from tests.oracles import reflectance as oracles

pytestmark = pytest.mark.bpy_only

CELLS = 8  # by 8 different texels, each spread over 4×4 so that bilinear filtering leaves its middle alone
SIZE = 4 * CELLS


@pytest.fixture(autouse=True)
def scene():
    """An empty scene whose camera sees a card of one unit from straight above, texel for pixel."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 4
    scene.cycles.use_denoising = False
    scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.filter_width = 1.0
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type = "ORTHO"
    camera.data.ortho_scale = 1.0
    scene.collection.objects.link(camera)
    scene.camera = camera
    look_from((0, 0, 1))
    return scene


def look_from(direction):
    place(bpy.context.scene.camera, direction, 5)


def place(thing, direction, distance):
    """Put a camera or lamp, which look along their −z, so that it looks at the origin, upright on the picture."""
    z = Vector(direction).normalized()
    x = Vector((0, 1, 0)).cross(z).normalized()
    thing.matrix_world = Matrix((x, z.cross(x), z)).transposed().to_4x4()
    # A hair aside: rays that meet the edge between the card's two triangles exactly may slip through.
    thing.location = z * distance + Vector((1e-4, 3e-5, 0))


def add_light(kind, energy, direction, distance=3.0):
    data = bpy.data.lights.new(kind, kind)
    data.energy = energy
    if kind == "SUN":
        data.angle = 0
    else:
        data.shadow_soft_size = 0
    thing = bpy.data.objects.new(kind, data)
    bpy.context.scene.collection.objects.link(thing)
    place(thing, direction, distance)


def render(tmp_path: Path):
    """Return (SIZE, SIZE, 3) float64 radiance, row 0 at the bottom."""
    bpy.context.scene.render.filepath = str(tmp_path / "render.exr")
    bpy.ops.render.render(write_still=True)
    with OpenEXR.File(bpy.context.scene.render.filepath, separate_channels=True) as file:
        channels = file.channels()
        return np.stack([channels[c].pixels for c in "RGB"], axis=-1)[::-1].astype(np.float64)


def middles(image):
    """Return (CELLS, CELLS, …): the mean of the two by two pixels in the middle of every cell."""
    cells = image.reshape(CELLS, 4, CELLS, 4, *image.shape[2:])[:, 1:3, :, 1:3]
    return cells.mean(axis=(1, 3))


def cells_of(model, seed, tilt=35.0, **fixed):
    """Return random maps of ``model`` in cells, normals up to ``tilt`` degrees off the card's own."""
    rng = np.random.default_rng(seed)
    values = {}
    for parameter in model.parameters:
        if parameter.is_normal:
            theta = np.radians(tilt) * np.sqrt(rng.random((CELLS, CELLS)))
            phi = 2 * np.pi * rng.random((CELLS, CELLS))
            value = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
        else:
            low, high = fixed.get(parameter.name, parameter.range)
            value = low + (high - low) * rng.random((CELLS, CELLS, parameter.components))
        values[parameter.name] = value[..., 0] if parameter.components == 1 else value
    wide = {k: v.repeat(4, axis=0).repeat(4, axis=1).astype(np.float32) for k, v in values.items()}
    return values, Maps(model, wide, np.ones((SIZE, SIZE), bool))


def render_model(maps, direction, tmp_path, intensity=1.0):
    material = build_material(maps, "subject")
    apply_material(card_object("subject", SIZE, SIZE), material)
    add_light("SUN", lights.sun_strength(intensity), direction)
    return middles(render(tmp_path))


def tilted(degrees, around):
    """A unit vector so many degrees off the card's normal, and so many around it."""
    theta, phi = math.radians(degrees), math.radians(around)
    return np.array([math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)])


def unit(*v):
    return np.asarray(v, np.float64) / np.linalg.norm(v)


def lambda_beckmann(c, m):
    """Walter et al. 2007, Eq. 15: the rational approximation of Smith's Λ that renderers use."""
    a = c / (m * np.sqrt(1 - c**2))
    return np.where(a < 1.6, (1 - 1.259 * a + 0.396 * a**2) / (3.535 * a + 2.181 * a**2), 0.0)


def two_lobe_smith(p, light, view):
    """The paper's model with Smith's masking for that of V cavities: what Cycles has."""
    c = oracles.Configuration(p["normal"], light, view)
    f = oracles.schlick(c.between, oracles.F0_SKIN) / (4 * c.view)
    total = 0
    for weight, m in ((p["w"], p["r1"]), (1 - p["w"], p["r2"])):
        g = 1 / (1 + lambda_beckmann(c.light, m) + lambda_beckmann(c.view, m))
        total = total + np.pi * weight * oracles.beckmann(c.theta, m) * g * f
    return p["base_color"] * c.light[..., None] + total[..., None]


def relative_difference(rendered, expected):
    return np.abs(rendered - expected).max(axis=-1) / expected.mean(axis=-1)


def test_a_sun_of_intensity_1_gives_a_white_card_radiance_1_and_strength_1_gives_1_over_pi(tmp_path):
    model = load_model("lambert")
    shape = (SIZE, SIZE)
    flat = np.broadcast_to(np.array([0, 0, 1], np.float32), (*shape, 3))
    maps = Maps(model, {"base_color": np.ones((*shape, 3), np.float32), "normal": flat}, np.ones(shape, bool))
    np.testing.assert_allclose(render_model(maps, (0, 0, 1), tmp_path), 1.0, rtol=2e-4)
    bpy.data.lights["SUN"].energy = 1.0
    np.testing.assert_allclose(middles(render(tmp_path)), 1 / np.pi, rtol=2e-4)
    assert lights.sun_intensity(lights.sun_strength(0.7)) == pytest.approx(0.7)


@pytest.mark.parametrize("distance", [1.0, 3.0])
def test_a_point_light_of_intensity_1_has_irradiance_pi_one_unit_away_and_falls_with_the_square(distance, tmp_path):
    model = load_model("lambert")
    shape = (SIZE, SIZE)
    flat = np.broadcast_to(np.array([0, 0, 1], np.float32), (*shape, 3))
    maps = Maps(model, {"base_color": np.ones((*shape, 3), np.float32), "normal": flat}, np.ones(shape, bool))
    apply_material(card_object("subject", SIZE, SIZE), build_material(maps, "subject"))
    add_light("POINT", lights.point_power(1.0), (0, 0, 1), distance)
    centres = (np.arange(SIZE) + 0.5) / SIZE - 0.5
    squared = centres[:, None] ** 2 + centres[None] ** 2 + distance**2
    expected = distance / squared**1.5
    np.testing.assert_allclose(render(tmp_path)[..., 1], expected, rtol=1e-2)
    assert lights.point_intensity(lights.point_power(0.7)) == pytest.approx(0.7)


def test_a_cards_border_does_not_wrap_to_the_opposite_side(tmp_path):
    flat = np.broadcast_to(np.float32([0, 0, 1]), (4, 4, 3))
    albedo = np.repeat(np.float32([0.8, 0.5, 0.5, 0.0]), 3).reshape(1, 4, 3).repeat(4, axis=0)
    maps = Maps(load_model("lambert"), {"base_color": albedo, "normal": flat}, np.ones((4, 4), bool))
    apply_material(card_object("subject", SIZE, SIZE), build_material(maps, "subject"))
    add_light("SUN", lights.sun_strength(1.0), (0, 0, 1))
    row = render(tmp_path)[SIZE // 2, :, 0]
    # Pixels lie within the outer half of a texel: repeated, the first would be 0.45, the last 0.35.
    half = SIZE // 8 - 1
    np.testing.assert_allclose(row[:half], 0.8, rtol=2e-3)
    np.testing.assert_allclose(row[-half:], 0.0, atol=2e-3)
    other = build_material(dataclasses.replace(maps, wrapped=True), "subject").node_tree.nodes["IRPSO map base_color"]
    assert other.extension == "REPEAT"  # a mesh's UV map may go all around


def test_the_lambert_material_renders_albedo_times_cosine(tmp_path):
    values, maps = cells_of(load_model("lambert"), 1, tilt=60)
    light = unit(0.3, -0.2, 1)
    rendered = render_model(maps, light, tmp_path, intensity=2.0)
    expected = 2 * values["base_color"] * np.maximum(values["normal"] @ light, 0)[..., None]
    # 16-bit textures and float32: what is left is Cycles' own noise.
    np.testing.assert_allclose(rendered, expected, atol=1e-3)


needs_metallic = pytest.mark.skipif(
    not two_lobe.has_metallic(), reason="Blender before 4.3 has no Beckmann lobe with a Fresnel of the half vector"
)


@needs_metallic
@pytest.mark.parametrize("degrees", [20, 50])
def test_the_two_lobe_material_renders_the_papers_model_except_the_masking_term(degrees, tmp_path):
    values, maps = cells_of(load_model("cook_torrance_two_lobe"), 2, tilt=30)
    light, view = tilted(degrees, 30), unit(0, 0, 1)
    rendered = render_model(maps, light, tmp_path)
    np.testing.assert_allclose(rendered, two_lobe_smith(values, light, view), rtol=2e-3, atol=2e-4)
    difference = relative_difference(rendered, oracles.cook_torrance_two_lobe(values, light, view))
    print(f"\ntwo lobes, light at {degrees}°: mean {difference.mean():.2%}, max {difference.max():.2%}")
    assert difference.mean() < 0.01 and difference.max() < 0.04


def test_the_two_lobe_ggx_material_renders_its_own_model_exactly(tmp_path):
    values, maps = cells_of(load_model("principled_two_lobe"), 3, tilt=30)
    light, view = unit(-0.4, 0.5, 1), unit(0, 0, 1)
    rendered = render_model(maps, light, tmp_path)
    np.testing.assert_allclose(rendered, oracles.principled_two_lobe(values, light, view), rtol=2e-3, atol=2e-4)


@pytest.mark.parametrize("degrees", [20, 50])
def test_the_principled_material_renders_its_own_model(degrees, tmp_path):
    values, maps = cells_of(load_model("principled"), 4, tilt=30, roughness=(0.15, 1.0))
    light, view = tilted(degrees, 200), unit(0, 0, 1)
    rendered = render_model(maps, light, tmp_path)
    difference = relative_difference(rendered, oracles.principled(values, light, view))
    print(f"\nprincipled, light at {degrees}°: mean {difference.mean():.2%}, max {difference.max():.2%}")
    assert difference.mean() < 0.002 and difference.max() < 0.01


@pytest.mark.parametrize(
    ("name", "fixed"),
    [("clear_coat", {"roughness": (0.3, 1.0), "coat_roughness": (0.2, 0.6)}),
     ("anisotropic", {"roughness": (0.3, 1.0), "stretch": (-0.7, 0.7), "slant": (-0.7, 0.7)})],
)  # fmt: skip
@pytest.mark.parametrize("degrees", [20, 50])
def test_the_material_of_a_coat_and_of_a_grain_renders_its_own_model(name, fixed, degrees, tmp_path):
    values, maps = cells_of(load_model(name), 9, tilt=30, **fixed)
    light, view = tilted(degrees, 200), unit(0, 0, 1)
    rendered = render_model(maps, light, tmp_path)
    difference = relative_difference(rendered, oracles.MODELS[name](values, light, view))
    print(f"\n{name}, light at {degrees}°: mean {difference.mean():.2%}, max {difference.max():.2%}")
    assert difference.mean() < 0.003 and difference.max() < 0.015


def test_the_grain_of_a_mesh_follows_its_own_uv_map(tmp_path):
    model = load_model("anisotropic")
    values, maps = cells_of(model, 10, tilt=1e-3, roughness=(0.3, 0.6), stretch=(0.3, 0.7), slant=(-0.5, 0.5))
    card = card_object("subject", SIZE, SIZE)
    apply_material(card, build_material(maps, "subject"))
    add_light("SUN", lights.sun_strength(1.0), tilted(40, 20))
    card.rotation_euler.z = math.pi / 2  # the grain turns with the card, which a tangent of the world's would not do
    rendered = middles(render(tmp_path))
    # The picture is that of a card that lies still, turned with the light; its first axis runs up.
    still = oracles.anisotropic(values, tilted(40, 20 - 90), unit(0, 0, 1))
    difference = relative_difference(rendered, np.rot90(still, -1))
    worst = np.unravel_index(difference.argmax(), difference.shape)
    print(f"\nmean {difference.mean():.2%}, max {difference.max():.2%} at {worst}: {rendered[worst]}")
    assert difference.mean() < 0.002 and difference.max() < 0.015
    untouched = oracles.anisotropic(values, tilted(40, 20), unit(0, 0, 1))
    assert relative_difference(rendered, np.rot90(untouched, -1)).max() > 0.1


@needs_metallic
def test_the_two_lobe_material_seen_at_60_degrees_renders_its_model(tmp_path):
    assert seen_at_60_degrees("cook_torrance_two_lobe", tmp_path) < 0.05


@pytest.mark.parametrize(("name", "bound"), [("principled_two_lobe", 0.002), ("principled", 0.01)])
def test_a_ggx_material_seen_at_60_degrees_renders_its_model(name, bound, tmp_path):
    assert seen_at_60_degrees(name, tmp_path) < bound


def seen_at_60_degrees(name, tmp_path):
    """Return the largest relative difference of four texels, each filling the picture for itself.

    A slanted view of them all would shift cells against pixels.
    """
    values, maps = cells_of(load_model(name), 7, tilt=1e-3, roughness=(0.2, 1.0))
    view, light = tilted(60, 0), tilted(45, 150)
    apply_material(card_object("subject", SIZE, SIZE), build_material(maps, "subject"))
    add_light("SUN", lights.sun_strength(1.0), light)
    look_from(view)
    camera = bpy.context.scene.camera
    camera.data.ortho_scale = 0.01
    home = camera.location.copy()
    expected = getattr(oracles, name)(values, light, view)
    worst = 0
    for row, column in ((0, 0), (3, 5), (7, 2), (5, 6)):
        camera.location = home + Vector(((column + 0.5) / CELLS - 0.5, (row + 0.5) / CELLS - 0.5, 0))
        rendered = middles(render(tmp_path))[CELLS // 2, CELLS // 2]
        worst = max(worst, relative_difference(rendered, expected[row, column]))
    print(f"\n{name} seen at 60°: max {worst:.2%}")
    return worst


def test_without_the_metallic_node_a_principled_node_is_the_ggx_lobe(tmp_path, monkeypatch):
    monkeypatch.setattr(two_lobe, "has_metallic", lambda: False)
    assert seen_at_60_degrees("principled_two_lobe", tmp_path) < 0.002


@pytest.mark.parametrize("metallic", [True, False])
def test_the_dielectric_fresnel_can_be_selected(metallic, tmp_path, monkeypatch):
    if not (metallic and two_lobe.has_metallic()):
        monkeypatch.setattr(two_lobe, "has_metallic", lambda: False)
    model = load_model("principled_two_lobe")
    model = dataclasses.replace(model, material=model.material | {"fresnel": "dielectric"})
    values, maps = cells_of(model, 8, tilt=30)
    light, view = tilted(60, 30), unit(0, 0, 1)
    rendered = render_model(maps, light, tmp_path)
    black = values | {"base_color": np.zeros((CELLS, CELLS, 3))}
    lobes = oracles.principled_two_lobe(black, light, view)
    c = oracles.Configuration(values["normal"], light, view)
    skin = oracles.ior_from_f0(oracles.F0_SKIN)
    ratio = oracles.dielectric(c.between, skin) / oracles.schlick(c.between, oracles.F0_SKIN)
    expected = oracles.principled_two_lobe(values, light, view) + lobes * (ratio - 1)[..., None]
    np.testing.assert_allclose(rendered, expected, rtol=2e-3, atol=2e-4)


def test_without_the_metallic_node_the_lobes_agree_where_the_view_is_near_the_normal(tmp_path, monkeypatch):
    """Blender 4.2 has Glossy and Fresnel nodes only; the Fresnel node takes n·v for v·h."""
    monkeypatch.setattr(two_lobe, "has_metallic", lambda: False)
    values, maps = cells_of(load_model("cook_torrance_two_lobe"), 6, tilt=20)
    light, view = tilted(20, 30), unit(0, 0, 1)
    rendered = render_model(maps, light, tmp_path)
    assert not any(n.bl_idname == "ShaderNodeBsdfMetallic" for g in bpy.data.node_groups for n in g.nodes)
    difference = relative_difference(rendered, oracles.cook_torrance_two_lobe(values, light, view))
    print(f"\nGlossy with Fresnel node: mean {difference.mean():.2%}, max {difference.max():.2%}")
    assert difference.max() < 0.04
