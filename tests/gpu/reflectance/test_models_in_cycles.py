"""Models against Cycles, an independent renderer of the same physics."""

import math

import bpy
import numpy as np
import pytest

from irpso_addon.reflectance.model import load_model
from tests.builders.model_probe import evaluate, single
from tests.oracles import reflectance as oracles

SIDE = 32
same_coat = pytest.mark.skipif(
    bpy.app.version < (4, 5), reason="Cycles 4.2 renders a coat otherwise: docs/reading_maps.md gives by how much"
)


@pytest.fixture(scope="module")
def facets():
    """A scene with one small facet at the centre of every pixel; returns render(light) and the facets' normals.

    Facets rather than a sphere: their normals are known exactly, where a sphere's are interpolated. A tenth of a
    degree at the edge of a highlight of roughness 0.05 would be an error of several per cent.
    """
    rng = np.random.default_rng(5)
    normals = oracles.unit(rng.normal(size=(SIDE, SIDE, 3)))
    normals[..., 2] = np.abs(normals[..., 2])
    light = oracles.unit([0.6, 0.3, 0.74])
    half = oracles.unit(light + [0, 0, 1])
    spread = 0.005 * 2.0 ** np.arange(SIDE // 2)[None, :, None].clip(0, 7)
    normals[:, : SIDE // 2] = oracles.unit(half + spread * rng.normal(size=(SIDE, SIDE // 2, 3)))
    # No facet edge-on: the camera would miss it.
    normals[..., 2] = np.maximum(np.abs(normals[..., 2]), 0.06)
    normals = oracles.unit(normals)
    scene = bpy.data.scenes.new("facets")
    material = bpy.data.materials.new("facets")
    if material.node_tree is None:  # since Blender 5.0 every material has one
        material.use_nodes = True
    normals = make_facets(scene, material, normals)
    lamp, camera = prepare(scene)
    return scene, material, lamp, normals, light


def make_facets(scene, material, normals):
    """Add the mesh; return the normals as its float32 vertices give them."""
    axis = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
    centres = np.stack([*np.meshgrid(axis, axis), np.zeros((SIDE, SIDE))], axis=-1).reshape(-1, 3)
    flat = normals.reshape(-1, 3)
    across = np.where(np.abs(flat[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]])
    tangent = oracles.unit(np.cross(flat, across))
    bitangent = np.cross(flat, tangent)
    corners = [tangent * math.cos(a) + bitangent * math.sin(a) for a in (0, 2 * math.pi / 3, 4 * math.pi / 3)]
    vertices = np.stack([centres + 0.9 / SIDE * corner for corner in corners], axis=1)
    mesh = bpy.data.meshes.new("facets")
    mesh.from_pydata(vertices.reshape(-1, 3).tolist(), [], np.arange(3 * SIDE**2).reshape(-1, 3).tolist())
    mesh.materials.append(material)
    scene.collection.objects.link(bpy.data.objects.new("facets", mesh))
    stored = single(vertices)
    exact = oracles.unit(np.cross(stored[:, 1] - stored[:, 0], stored[:, 2] - stored[:, 0]))
    return exact.reshape(SIDE, SIDE, 3)


def prepare(scene):
    """Camera, sun and settings: every sample at the pixel's centre, direct light only, no shadows, no world."""
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 2.0, (0, 0, 5)
    lamp = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    lamp.data.angle, lamp.data.energy, lamp.data.use_shadow = 0.0, math.pi, False
    lamp.rotation_mode = "QUATERNION"
    for thing in (camera, lamp):
        scene.collection.objects.link(thing)
    scene.camera = camera
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.device, cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = "CPU", 4, False, False
    cycles.max_bounces, cycles.pixel_filter_type, cycles.filter_width = 0, "BLACKMAN_HARRIS", 0.01
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
    scene.render.resolution_x = scene.render.resolution_y = SIDE
    scene.render.resolution_percentage = 100
    scene.render.film_transparent = True
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_mode, scene.render.image_settings.color_depth = "RGBA", "32"
    return lamp, camera


def render(facets, folder):
    """What Cycles makes of the scene: (SIDE, SIDE, 4), row 0 at the bottom; alpha is 1 where every sample hit."""
    import OpenEXR
    from mathutils import Vector

    scene, _, lamp, _, light = facets
    lamp.rotation_quaternion = Vector(light).to_track_quat("Z", "Y")
    scene.render.filepath = str(folder / "facets.exr")
    bpy.ops.render.render(write_still=True, scene=scene.name)
    return OpenEXR.File(scene.render.filepath).channels()["RGBA"].pixels[::-1].astype(np.float64)


def principled_node(facets, **inputs):
    """The scene's Principled BSDF, with ``inputs`` set, underscores for spaces."""
    node = next(n for n in facets[1].node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    node.distribution = "GGX"
    for name, value in inputs.items():
        node.inputs[name.replace("_", " ")].default_value = value
    return node


def compare(facets, folder, root, model, settings):
    """Relative difference of our radiance to Cycles', over facets where both cosines exceed 0.05."""
    _, _, _, normals, light = facets
    theirs = render(facets, folder).reshape(-1, 4)
    theirs, hit = theirs[:, :3], theirs[:, 3] > 0.999
    flat, count = normals.reshape(-1, 3), SIDE**2
    values = {p.name: np.tile(settings.get(p.name, p.default), (count, 1)) for p in model.parameters}
    values["normal"] = flat
    view = np.tile([0.0, 0.0, 1.0], (count, 1))
    ours = evaluate(root, model, values, np.tile(light, (count, 1)), view)
    keep = hit & (oracles.dot(flat, light) > 0.05) & (flat[:, 2] > 0.05) & (theirs > 1e-6).all(axis=1)
    assert keep.mean() > 0.6
    return np.abs(ours[keep] / theirs[keep] - 1)


def test_lambert_is_what_cycles_renders(facets, tmp_path, root):
    principled_node(facets, Base_Color=(0.8, 0.4, 0.1, 1), Specular_IOR_Level=0.0, Roughness=1.0)
    error = compare(facets, tmp_path, root, load_model("lambert"), {"base_color": (0.8, 0.4, 0.1)})
    assert error.max() < 1e-5


@pytest.mark.parametrize("roughness", [0.3, 0.5, 0.8, 1.0])
@pytest.mark.parametrize("specular", [0.25, 0.5, 1.0])
def test_the_lobe_of_principled_is_what_cycles_renders(facets, tmp_path, root, roughness, specular):
    principled_node(facets, Base_Color=(0, 0, 0, 1), Specular_IOR_Level=specular, Roughness=roughness)
    settings = {"base_color": (0, 0, 0), "roughness": roughness, "specular": specular}
    error = compare(facets, tmp_path, root, load_model("principled"), settings)
    assert np.median(error) < 3e-6
    # What is left at the peak of a narrow lobe is Cycles' own 1 − cos², in float32.
    assert error.max() < (2e-4 if roughness < 0.5 else 2e-5)


@pytest.mark.parametrize(("roughness", "worst"), [(0.05, 0.06), (0.3, 0.01), (0.6, 0.003), (1.0, 0.003)])
@pytest.mark.parametrize("specular", [0.5, 1.0])
def test_a_white_principled_surface_is_what_cycles_renders(facets, tmp_path, root, roughness, worst, specular):
    principled_node(facets, Base_Color=(1, 1, 1, 1), Specular_IOR_Level=specular, Roughness=roughness)
    settings = {"base_color": (1, 1, 1), "roughness": roughness, "specular": specular}
    error = compare(facets, tmp_path, root, load_model("principled"), settings)
    # Cycles reads the layer's albedo from 16 values a dimension; at 0.05 its lobe's peak is off by some per cent.
    assert error.max() < worst
    assert error.mean() < 0.0025


@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
@pytest.mark.parametrize("metallic", [0.0, 0.5, 1.0])
@pytest.mark.parametrize(
    ("name", "specular"), [("principled_metallic", 0.5), ("metallic_roughness", 0.25), ("metallic_roughness", 1.0)]
)
def test_metals_and_what_lies_between_are_what_cycles_renders(
    facets, tmp_path, root, roughness, metallic, name, specular
):
    gold = (0.9, 0.6, 0.25)
    node = principled_node(facets, Base_Color=(*gold, 1), Specular_IOR_Level=specular, Roughness=roughness)
    node.inputs["Metallic"].default_value = metallic
    settings = {"base_color": gold, "roughness": roughness, "metallic": metallic, "specular": specular}
    try:
        error = compare(facets, tmp_path, root, load_model(name), settings)
    finally:
        node.inputs["Metallic"].default_value = 0.0
    assert error.max() < 0.01
    assert error.mean() < 0.0025


GOLD = (0.9, 0.6, 0.25)


def set_back(node):
    """Undo what the tests below set, for the tests that share the scene."""
    for name, value in {"Metallic": 0, "Coat Weight": 0, "Anisotropic": 0, "Anisotropic Rotation": 0}.items():
        node.inputs[name].default_value = value


@same_coat
@pytest.mark.parametrize(("coat_roughness", "worst"), [(0.1, 0.04), (0.3, 0.012), (0.45, 0.012), (0.6, 0.012)])
@pytest.mark.parametrize("weight", [0.4, 1.0])
@pytest.mark.parametrize(("roughness", "metallic"), [(0.3, 0.0), (0.6, 0.5), (0.9, 1.0)])
def test_a_clear_coat_is_what_cycles_renders(
    facets, tmp_path, root, coat_roughness, worst, weight, roughness, metallic
):
    node = principled_node(
        facets, Base_Color=(*GOLD, 1), Specular_IOR_Level=0.5, Roughness=roughness, Metallic=metallic,
        Coat_Weight=weight, Coat_Roughness=coat_roughness, Coat_IOR=1.5,
    )  # fmt: skip
    settings = {
        "base_color": GOLD, "roughness": roughness, "metallic": metallic, "coat_weight": weight,
        "coat_roughness": coat_roughness,
    }  # fmt: skip
    try:
        error = compare(facets, tmp_path, root, load_model("clear_coat"), settings)
    finally:
        set_back(node)
    print(f"\ncoat {weight} {coat_roughness} over {roughness} {metallic}: {error.mean():.2%}, max {error.max():.2%}")
    # The fits of what the coat and the base's own layer take add up. At grazing views Cycles reads what a narrow coat
    # takes from a coarse table: at n·v = 0.06 and roughness 0.1, 0.665 in place of 0.684.
    assert error.max() < worst
    assert error.mean() < 0.0025


@same_coat
@pytest.mark.parametrize("coat_roughness", [0.2, 0.4, 0.6])
def test_the_lobe_of_a_coat_is_what_cycles_renders(facets, tmp_path, root, coat_roughness):
    # A black metal reflects nothing but its edge, 1e-6 at this angle between light and view.
    node = principled_node(
        facets, Base_Color=(0, 0, 0, 1), Specular_IOR_Level=0.5, Roughness=1.0, Metallic=1.0, Coat_Weight=1.0,
        Coat_Roughness=coat_roughness, Coat_IOR=1.5,
    )  # fmt: skip
    settings = {"base_color": (0, 0, 0), "roughness": 1.0, "metallic": 1.0, "coat_weight": 1.0}
    try:
        error = compare(facets, tmp_path, root, load_model("clear_coat"), settings | {"coat_roughness": coat_roughness})
    finally:
        set_back(node)
    print(f"\ncoat's lobe {coat_roughness}: median {np.median(error):.1e}, max {error.max():.1e}")
    # The gain by further reflections, up to 1.02, is fitted.
    assert np.median(error) < 3e-4 and error.max() < 2e-3


@pytest.fixture(scope="module")
def brushed(facets):
    """The scene with a UV map whose tangent is x, laid into each facet's plane, and a Tangent node that reads it."""
    scene, material, _, normals, _ = facets
    mesh = next(thing.data for thing in scene.objects if thing.type == "MESH")
    corners = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", corners)
    corners = corners.reshape(-1, 3, 3)
    axes = np.stack(oracles.grain(normals.reshape(-1, 3), np.zeros(SIDE**2)), axis=1)
    places = np.einsum("fcx,fax->fca", corners - corners.mean(axis=1, keepdims=True), axes)
    # Every facet has three vertices of its own, in the order of its corners.
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", (10 * places).astype(np.float32).ravel())
    tree = material.node_tree
    tangent = tree.nodes.new("ShaderNodeTangent")
    tangent.direction_type = "UV_MAP"
    tree.links.new(tangent.outputs["Tangent"], principled_node(facets).inputs["Tangent"])
    yield facets
    tree.nodes.remove(tangent)


@pytest.mark.parametrize("color", [GOLD, (0, 0, 0)])
@pytest.mark.parametrize("roughness", [0.3, 0.6, 0.9])
@pytest.mark.parametrize(
    ("anisotropic", "rotation", "metallic"), [(0.3, 0.0, 0.0), (0.7, 0.1, 1.0), (0.9, 0.3, 0.5), (1.0, 0.45, 1.0)]
)
def test_a_brushed_surface_is_what_cycles_renders(
    brushed, tmp_path, root, color, roughness, anisotropic, rotation, metallic
):
    metallic = metallic if any(color) else 0.0  # of a black metal only the edge is seen
    node = principled_node(
        brushed, Base_Color=(*color, 1), Specular_IOR_Level=0.5, Roughness=roughness, Metallic=metallic,
        Anisotropic=anisotropic, Anisotropic_Rotation=rotation,
    )  # fmt: skip
    angle = 4 * math.pi * rotation
    settings = {
        "base_color": color, "roughness": roughness, "metallic": metallic,
        "stretch": anisotropic * math.cos(angle), "slant": anisotropic * math.sin(angle),
    }  # fmt: skip
    try:
        error = compare(brushed, tmp_path, root, load_model("anisotropic"), settings)
    finally:
        set_back(node)
    print(f"\nbrushed {anisotropic} {rotation} at {roughness} {metallic}: {error.mean():.2%}, max {error.max():.2%}")
    assert error.max() < (0.01 if any(color) else 1e-4)
    assert error.mean() < (0.0025 if any(color) else 1e-5)
