"""Every model on the GPU against float64, the contract of shaders/README.md, and Cycles."""

import itertools
import math

import numpy as np
import pytest

from irpso_addon.gpu import textures
from irpso_addon.gpu.passes import Kernel, Output, Pass
from irpso_addon.reflectance.glsl import material_declaration
from irpso_addon.reflectance.model import load_model, shipped_models
from tests import oracles

EPS = 2.0**-23
UNSEEN = ("ward", "oren_nayar")  # written as a user would, known to nothing but these tests
ALL = (*shipped_models(), *UNSEEN)


@pytest.fixture
def model(request, root):
    """The model of a test's parameter, by name or by the path of a user's own file."""
    name = request.param
    return load_model(root / "tests/gpu/models" / f"{name}.toml" if name in UNSEEN else name)


every_model = pytest.mark.parametrize("model", ALL, indirect=True)


def evaluate(root, model, values, light, view, value="reflectance(s, l, v)", entry="fragment"):
    """The GLSL expression ``value`` at N materials, lights and views: (N, 3)."""
    count = len(light)
    components = np.concatenate(
        [np.reshape(values[p.name], (count, p.components)) for p in model.parameters]
        + [np.zeros((count, 12 - model.components))],
        axis=1,
    )
    inputs = {f"u_components_{i}": components[None, :, 4 * i : 4 * i + 4] for i in range(3)}
    inputs |= {"u_light_in": light[None], "u_view_in": view[None]}
    kernel = Kernel(
        str(root / "tests/gpu/kernels/model_probe.glsl"), (Output("o_value"),), {n: "FLOAT_2D" for n in inputs}, {},
        {"VALUE": value}, {"material.glsl": material_declaration(model), "model.glsl": model.shader},
    )  # fmt: skip
    one = Pass(kernel, entry)
    target = textures.empty(count, 1, "RGBA32F")
    one.run([target], {n: textures.upload(np.ascontiguousarray(a, np.float32)) for n, a in inputs.items()})
    if entry == "compute":
        copy = Pass(Kernel("view/copy.glsl", (Output("o_copy"),), {"u_source": "FLOAT_2D"}, {}, {}))
        copied = textures.empty(count, 1, "RGBA32F")
        copy.run([copied], {"u_source": target})
        target = copied
    return textures.download(target)[0, :, :3].astype(np.float64)


def single(a):
    """Rounded to float32, held as float64."""
    return np.asarray(a, np.float32).astype(np.float64)


def random_materials(model, count, rng):
    """Uniform over the table's ranges, a third of each parameter at an end of its range."""
    values = {}
    for p in model.parameters:
        if p.is_normal:
            values[p.name] = oracles.unit(rng.normal(size=(count, 3)) * 0.5 + [0, 0, 1])
            continue
        low, high = p.range
        value = rng.uniform(low, high, (count, p.components))
        ends = rng.random((count, p.components))
        value = np.where(ends < 1 / 6, low, np.where(ends > 5 / 6, high, value))
        values[p.name] = value if p.components > 1 else value[:, 0]
    return {name: single(value) for name, value in values.items()}


def random_directions(normal, count, rng):
    """Lights and views: everywhere, at the normal's horizon, and around each other's mirror direction."""
    light, view = (oracles.unit(rng.normal(size=(count, 3)) + 0.8 * normal) for _ in range(2))
    grazing = slice(0, count // 4)
    for direction in (light, view):
        height = 10.0 ** rng.uniform(-6, -1, count // 4)
        off = oracles.dot(direction, normal)[grazing] - height * rng.choice([1, 1, 1, -1], count // 4)
        direction[grazing] -= off[:, None] * normal[grazing]
    shiny = slice(count // 4, 3 * count // 4)
    mirror = 2 * oracles.dot(normal, light)[:, None] * normal - light
    view[shiny] = (mirror + 10.0 ** rng.uniform(-6, -0.5, (count, 1)) * rng.normal(size=(count, 3)))[shiny]
    return single(oracles.unit(light)), single(oracles.unit(view))


def forgiven(oracle, values, light, view, rng):
    """How far the radiance moves when every input moves by a float32 rounding: the best a float32 shader can do."""
    here, moved = oracle(values, light, view), 0.0
    for _ in range(12):

        def shake(a):
            return a + rng.uniform(-1, 1, np.shape(a)) * EPS * np.maximum(np.abs(a), 0.5 if np.ndim(a) > 1 else 0)

        shaken = {name: shake(a) for name, a in values.items()}
        moved = np.maximum(moved, np.abs(oracle(shaken, shake(light), shake(view)) - here))
    return here, moved


@every_model
def test_reflectance_is_the_oracles_to_float32_rounding(model, root):
    rng = np.random.default_rng(11)
    values = random_materials(model, 6000, rng)
    light, view = random_directions(values["normal"], 6000, rng)
    expected, moved = forgiven(oracles.MODELS[model.name], values, light, view, rng)
    got = evaluate(root, model, values, light, view)
    assert np.isfinite(got).all()
    # Where rounding decides whether a direction is above the horizon, either answer is right.
    cosines = np.minimum(oracles.dot(values["normal"], light), oracles.dot(values["normal"], view))
    decided = np.abs(cosines) > 4e-7
    assert decided.mean() > 0.9 and (expected > 0).mean() > 0.3
    excess = np.abs(got - expected) - (1e-5 * np.abs(expected) + 4 * moved + 1e-30)
    worst = np.argmax(np.where(decided[:, None], excess, -1).max(axis=1))
    assert excess[worst].max() <= 0, f"{got[worst]} instead of {expected[worst]}, moved {moved[worst]}"


@every_model
def test_most_values_agree_to_a_few_parts_in_a_million(model, root):
    rng = np.random.default_rng(12)
    values = random_materials(model, 4000, rng)
    light, view = (single(oracles.unit(rng.normal(size=(4000, 3)) + 2 * values["normal"])) for _ in range(2))
    expected = oracles.MODELS[model.name](values, light, view)
    seen = (expected > 1e-6).all(axis=1)
    error = np.abs(evaluate(root, model, values, light, view)[seen] / expected[seen] - 1)
    assert seen.mean() > 0.5
    assert np.median(error) < 1e-6
    assert np.quantile(error, 0.99) < 2e-5


@every_model
def test_reflectance_is_the_weighted_sum_of_its_basis(model, root):
    rng = np.random.default_rng(13)
    values = random_materials(model, 500, rng)
    light, view = random_directions(values["normal"], 500, rng)
    linear = [p.name for p in model.parameters if p.kind == "linear"]
    total = np.zeros((500, 3))
    if "basis_fixed" in model.shader.read_text(encoding="utf-8"):
        total += evaluate(root, model, values, light, view, "basis_fixed(s, l, v)")
    other = dict(values)
    for name in linear:
        other[name] = single(np.random.default_rng(1).uniform(0, 0.5, np.shape(values[name])))
    for name in linear:
        basis = evaluate(root, model, values, light, view, f"basis_{name}(s, l, v)")
        assert np.array_equal(basis, evaluate(root, model, other, light, view, f"basis_{name}(s, l, v)"))
        total += np.reshape(values[name], (500, -1)) * basis
    got = evaluate(root, model, values, light, view)
    assert np.allclose(got, total, rtol=1e-6, atol=1e-30)


@every_model
def test_a_light_or_a_view_below_the_horizon_gives_nothing(model, root):
    rng = np.random.default_rng(14)
    values = random_materials(model, 400, rng)
    up, down = (single(oracles.unit(sign * values["normal"] + 0.4 * rng.normal(size=(400, 3)))) for sign in (1, -1))
    keep = (oracles.dot(values["normal"], up) > 0) & (oracles.dot(values["normal"], down) < 0)
    for light, view in ((up, down), (down, up), (down, down), (up, -up)):
        assert not evaluate(root, model, values, light, view)[keep].any()
        assert not evaluate(root, model, values, light, view, "basis_base_color(s, l, v)")[keep].any()


@every_model
def test_radiance_is_finite_for_every_corner_of_the_table_and_every_axis(model, root):
    corners = list(itertools.product(*[(p.range if not p.is_normal else (0, 1)) for p in model.parameters]))
    axes = [np.array(a, float) for a in itertools.product((-1, 0, 1), repeat=3) if any(a)]
    axes += [np.array([1.0, 0, h]) for h in (1e-30, 1e-9, 1e-7, 2e-7, 1e-4)] + [np.array([-1.0, 0, 2e-7])]
    pairs = np.array(list(itertools.product(oracles.unit(axes), repeat=2)))
    light, view = (np.tile(pairs[:, i], (len(corners), 1)) for i in range(2))
    values = {}
    for i, p in enumerate(model.parameters):
        column = np.repeat([c[i] for c in corners], len(pairs))
        values[p.name] = np.repeat(column[:, None], 3, axis=1) if p.components == 3 else column
    values["normal"] = np.tile([0.0, 0.0, 1.0], (len(light), 1))
    got = evaluate(root, model, *cut(values, light, view))
    assert np.isfinite(got).all() and (got >= 0).all()


def cut(values, light, view, most=8000):
    """An even choice of at most ``most`` rows: a texture is no wider than 16384."""
    step = -(-len(light) // most)
    return {n: v[::step] for n, v in values.items()}, light[::step], view[::step]


@pytest.mark.parametrize("model", [n for n in ALL if n != "principled"], indirect=True)
def test_exchanging_light_and_view_leaves_the_brdf(model, root):
    rng = np.random.default_rng(15)
    values = random_materials(model, 1000, rng)
    light, view = (single(oracles.unit(rng.normal(size=(1000, 3)) + 2 * values["normal"])) for _ in range(2))
    cos_light, cos_view = oracles.dot(values["normal"], light), oracles.dot(values["normal"], view)
    keep = (cos_light > 0.05) & (cos_view > 0.05)
    there = evaluate(root, model, values, light, view)[keep] / cos_light[keep, None]
    back = evaluate(root, model, values, view, light)[keep] / cos_view[keep, None]
    assert np.allclose(there, back, rtol=2e-5, atol=1e-30)


def test_only_the_base_of_principled_depends_on_the_view_alone(root):
    model, rng = load_model("principled"), np.random.default_rng(16)
    values = random_materials(model, 500, rng)
    values["base_color"] = np.zeros((500, 3))
    light, view = (single(oracles.unit(rng.normal(size=(500, 3)) + 2 * values["normal"])) for _ in range(2))
    cos_light, cos_view = oracles.dot(values["normal"], light), oracles.dot(values["normal"], view)
    keep = (cos_light > 0.05) & (cos_view > 0.05)
    there = evaluate(root, model, values, light, view)[keep] / cos_light[keep, None]
    back = evaluate(root, model, values, view, light)[keep] / cos_view[keep, None]
    assert np.allclose(there, back, rtol=2e-5, atol=1e-30)


@pytest.mark.parametrize(
    ("model", "settings"),
    [("lambert", {}), ("principled", {"roughness": 0.2}), ("principled", {"roughness": 1.0}),
     ("principled", {"roughness": 0.5, "specular": 1.0}), ("oren_nayar", {"sigma": 1.0})],
    indirect=["model"],
)  # fmt: skip
def test_a_white_surface_reflects_no_more_than_it_receives(model, settings, root):
    for cos_view in (1.0, 0.7, 0.3, 0.1):
        albedo = directional_albedo(root, model, {"base_color": (1, 1, 1), **settings}, cos_view)
        assert albedo <= 1.006, cos_view  # the fit of the layer's albedo is good to 0.005
        assert albedo > 0.5


@pytest.mark.parametrize("model", ["cook_torrance_two_lobe", "principled_two_lobe"], indirect=True)
def test_the_lobes_alone_reflect_less_than_a_mirror_of_skin(model, root):
    for cos_view, mirror in ((1.0, 0.0281), (0.5, 0.06), (0.2, 0.35)):
        for low in model.parameter("r1").range:
            albedo = directional_albedo(root, model, {"base_color": (0, 0, 0), "r1": low, "w": 1.0}, cos_view)
            assert 0 < albedo < mirror


def directional_albedo(root, model, settings, cos_view, steps=(90, 90)):
    """∫ f_r n·l dω of a material seen at ``cos_view``, over an even grid of u = sin²θ and φ."""
    nodes, weights = np.polynomial.legendre.leggauss(steps[0])
    u, phi = (nodes + 1) / 2, (np.arange(steps[1]) + 0.5) / steps[1] * 2 * np.pi
    u, phi = (a.ravel() for a in np.meshgrid(u, phi, indexing="ij"))
    light = np.stack([np.sqrt(u) * np.cos(phi), np.sqrt(u) * np.sin(phi), np.sqrt(1 - u)], axis=-1)
    view = np.tile([np.sqrt(1 - cos_view**2), 0, cos_view], (len(light), 1))
    values = {p.name: np.tile(settings.get(p.name, p.default), (len(light), 1)) for p in model.parameters}
    radiance = evaluate(root, model, values, light, view)[:, 0]
    # dω n·l = du dφ / 2, and the radiance is π f_r n·l.
    return np.sum(radiance / light[:, 2] * np.repeat(weights / 2, steps[1]) / steps[1])


@pytest.mark.parametrize("model", ["cook_torrance_two_lobe", "principled_two_lobe"], indirect=True)
def test_exchanging_the_lobes_with_their_weights_changes_nothing(model, root):
    rng = np.random.default_rng(17)
    values = random_materials(model, 500, rng)
    light, view = random_directions(values["normal"], 500, rng)
    values["w"] = np.round(values["w"] * 1024) / 1024  # 1 − w has no rounding
    exchanged = {**values, "r1": values["r2"], "r2": values["r1"], "w": 1 - values["w"]}
    one, other = (evaluate(root, model, v, light, view) for v in (values, exchanged))
    assert model.ordered == ("r1", "r2") and model.complement == ("w",)
    assert np.allclose(one, other, rtol=1e-6, atol=1e-30)


@every_model
def test_compute_and_fragment_entries_agree(model, root):
    rng = np.random.default_rng(18)
    values = random_materials(model, 300, rng)
    light, view = random_directions(values["normal"], 300, rng)
    fragment, compute = (evaluate(root, model, values, light, view, entry=e) for e in ("fragment", "compute"))
    assert np.allclose(fragment, compute, rtol=4 * EPS, atol=1e-30)


def test_the_example_of_the_readme_keeps_the_contract(root, tmp_path):
    page = (root / "shaders/README.md").read_text(encoding="utf-8")
    page = page[page.index("## A model of your own") :]
    for kind in ("glsl", "toml"):
        text = page.split(f"```{kind}\n")[1].split("```")[0]
        (tmp_path / f"blinn_phong.{kind}").write_text(text, encoding="utf-8")
    model, rng = load_model(tmp_path / "blinn_phong.toml"), np.random.default_rng(19)
    values = random_materials(model, 3000, rng)
    light, view = random_directions(values["normal"], 3000, rng)

    def oracle(p, light, view):
        c = oracles.Configuration(p["normal"], light, view)
        power = 2 / p["slope"] ** 2 - 2
        gloss = p["strength"] * (power + 8) / 8 * np.cos(c.theta) ** power * c.light
        return np.where(c.seen[:, None], p["base_color"] * c.light[:, None] + gloss[:, None], 0)

    expected, moved = forgiven(oracle, values, light, view, rng)
    got = evaluate(root, model, values, light, view)
    cosines = np.minimum(oracles.dot(values["normal"], light), oracles.dot(values["normal"], view))
    # pow() may be off by 2e-6 of its exponent's worth, and the exponent goes up to 798.
    close = np.abs(got - expected) <= 2e-3 * expected + 4 * moved + 1e-30
    assert np.isfinite(got).all() and close[np.abs(cosines) > 4e-7].all()
    names = ("base_color", "strength")
    diffuse, gloss = (evaluate(root, model, values, light, view, f"basis_{name}(s, l, v)") for name in names)
    assert np.allclose(got, values["base_color"] * diffuse + values["strength"][:, None] * gloss, rtol=1e-6)


# --- Cycles ---------------------------------------------------------------------------------------------------------

SIDE = 32


@pytest.fixture(scope="module")
def facets():
    """A scene with one small facet at the centre of every pixel; returns render(light) and the facets' normals.

    Facets rather than a sphere: their normals are known exactly, where a sphere's are interpolated. A tenth of a
    degree at the edge of a highlight of roughness 0.05 would be an error of several per cent.
    """
    import bpy

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
    material.use_nodes = True
    normals = make_facets(scene, material, normals)
    lamp, camera = prepare(scene)
    return scene, material, lamp, normals, light


def make_facets(scene, material, normals):
    """Add the mesh; return the normals as its float32 vertices give them."""
    import bpy

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
    import bpy

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
    import bpy
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


def test_the_specular_level_is_not_a_linear_weight():
    # The mean of level 0 and 1 is off from level 0.5 by up to 19 % of a grey surface's radiance, 2 % in the mean.
    normal, light = np.array([0, 0, 1.0]), oracles.unit([0.5, 0, 0.8])
    views = oracles.unit([[np.sin(a), 0, np.cos(a)] for a in np.radians(np.linspace(-80, 80, 81))])
    p = {"normal": normal, "base_color": np.full(3, 0.3), "roughness": 0.3}
    none, half, full = (oracles.principled({**p, "specular": level}, light, views)[:, 0] for level in (0.0, 0.5, 1.0))
    assert 0.15 < np.max(np.abs((none + full) / 2 / half - 1)) < 0.2
