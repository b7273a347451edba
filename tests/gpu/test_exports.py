"""Exports read back by hand: glTF by its chunks, OpenLIME by its shader's formulas, PTM by its format's description."""

import functools
import json
import struct

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from irpso_addon.exports import gltf, openlime, ptm, textures
from irpso_addon.exports.result import Result, read_result
from irpso_addon.geometry import bake, frames
from irpso_addon.geometry.mesh import extract_mesh
from irpso_addon.gpu import probe
from irpso_addon.maps.blender_images import decode
from irpso_addon.maps.height import Height
from irpso_addon.maps.material import apply_material, build_material
from irpso_addon.maps.result import Maps
from irpso_addon.maps.write import write_maps
from irpso_addon.reflectance.model import load_model
from tests import cli_maker, oracles
from tests.cli_maker import angle, run_cli

SHAPE = (20, 28)
RANGES = {
    "lambert": {},
    "principled": {"roughness": (0.3, 0.7), "specular": (0.2, 0.9)},
    "cook_torrance_two_lobe": {"r1": (0.1, 0.2), "r2": (0.3, 0.5), "w": (0.3, 0.8)},
}


@pytest.fixture(scope="module", autouse=True)
def one_probe():
    """Ask the GPU once: every command asks it in a child process, which takes seconds."""
    before, probe.probe = probe.probe, functools.cache(probe.probe)
    yield
    probe.probe = before


@pytest.fixture(autouse=True)
def empty_file():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def result_of(name, shape=SHAPE, tilt=25.0, covered=None, tiles=(1001,)):
    """Return maps of a shipped model as a result, every component a smooth wave."""
    values = cli_maker.smooth_maps(shape, RANGES[name], seed=2, tilt=tilt)
    values = {key: np.float32(value).reshape(*shape, -1) for key, value in values.items()}
    covered = np.ones(shape, bool) if covered is None else covered
    return Result("leaf", Maps(load_model(name), values, covered, tiles=tiles))


def picture(path):
    """Return (H, W, C) code values 0…1 of a PNG as Blender reads it, row 0 at the bottom."""
    return decode(path).values


def srgb(linear):
    """IEC 61966-2-1."""
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def unsrgb(code):
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


# --- textures -------------------------------------------------------------------------------------------------------


def test_a_texture_set_holds_each_map_under_the_usual_names(tmp_path):
    result = result_of("principled")
    height = Height(np.linspace(-2, 3, 560, dtype=np.float32).reshape(SHAPE), np.ones(SHAPE, bool), "texels")
    found = textures.write_textures(Result("leaf", result.maps, height), tmp_path / "set")
    names = {f"leaf_{n}.png" for n in ("BaseColor", "Normal", "Roughness", "Metallic", "Specular", "ORM", "Height")}
    assert set(found["files"]) == names == {path.name for path in (tmp_path / "set").iterdir()}
    v, shown = result.maps.values, {n[5:-4]: picture(tmp_path / "set" / n)[..., :3] for n in names}
    np.testing.assert_allclose(shown["BaseColor"], srgb(v["base_color"]), atol=0.51 / 255)
    np.testing.assert_allclose(shown["Normal"], v["normal"] * 0.5 + 0.5, atol=1e-5)
    np.testing.assert_allclose(shown["Roughness"][..., :1], v["roughness"], atol=0.51 / 255)
    np.testing.assert_allclose(shown["Specular"][..., :1], v["specular"], atol=0.51 / 255)
    orm = np.stack([np.ones(SHAPE), v["roughness"][..., 0], np.zeros(SHAPE)], axis=-1)
    np.testing.assert_allclose(shown["ORM"], orm, atol=0.51 / 255)
    np.testing.assert_allclose(shown["Height"][..., 0] * 5 - 2, height.values, atol=1e-4)


@pytest.mark.parametrize(
    ("convention", "name", "turned"),
    [("unreal", "T_leaf_N", True), ("unity", "leaf_Normal", False), ("substance", "leaf_Normal_DirectX", True)],
)
def test_a_program_gets_the_normals_that_it_expects(convention, name, turned, tmp_path):
    result = result_of("principled")
    textures.write_textures(result, tmp_path, convention)
    green = picture(tmp_path / f"{name}.png")[..., 1] * 2 - 1
    np.testing.assert_allclose(green, (-1 if turned else 1) * result.maps.values["normal"][..., 1], atol=5e-5)


def test_unitys_mask_map_holds_smoothness_in_alpha(tmp_path):
    result = result_of("principled")
    textures.write_textures(result, tmp_path, "unity")
    mask = picture(tmp_path / "leaf_MaskMap.png")
    np.testing.assert_allclose(mask[..., 3], 1 - result.maps.values["roughness"][..., 0], atol=0.51 / 255)
    assert (mask[..., 0] == 0).all() and (mask[..., 1] == 1).all()


def test_udim_tiles_are_files_of_their_own(tmp_path):
    result = result_of("principled", shape=(16, 32), tiles=(1001, 1012))
    found = textures.write_textures(result, tmp_path)
    assert {"leaf_BaseColor.1001.png", "leaf_BaseColor.1012.png"} <= set(found["files"])
    second = picture(tmp_path / "leaf_Roughness.1012.png")[..., :1]
    np.testing.assert_allclose(second, result.maps.values["roughness"][:, 16:], atol=0.51 / 255)


# --- glTF -----------------------------------------------------------------------------------------------------------


def read_glb(path):
    """Return the JSON of a .glb and its binary chunk, by the glTF 2.0 specification, section 4."""
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON"
    table = json.loads(data[20 : 20 + size])
    binary, kind = struct.unpack_from("<I4s", data, 20 + size)
    assert kind == b"BIN\0"
    return table, data[28 + size : 28 + size + binary]


def accessor(table, binary, index):
    """Return (count, components) of an accessor."""
    entry = table["accessors"][index]
    view = table["bufferViews"][entry["bufferView"]]
    kind = {5123: np.uint16, 5125: np.uint32, 5126: np.float32}[entry["componentType"]]
    count = entry["count"] * {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[entry["type"]]
    start = view.get("byteOffset", 0) + entry.get("byteOffset", 0)
    return np.frombuffer(binary, kind, count, start).reshape(entry["count"], -1)


def image_of(table, binary, texture, folder):
    """Return the code values of the image that a texture reference names."""
    view = table["bufferViews"][table["images"][table["textures"][texture["index"]]["source"]]["bufferView"]]
    start = view.get("byteOffset", 0)
    path = folder / f"image{texture['index']}.png"
    path.write_bytes(binary[start : start + view["byteLength"]])
    return picture(path)


def bent_sheet(size=1.0):
    """A sheet of 6 × 6 bent quads whose left half is mirrored in the UV square, turned and moved in the world."""
    u, v = np.meshgrid(np.linspace(-1, 1, 7), np.linspace(-1, 1, 7))
    points = np.stack([u, v, 0.3 * np.cos(1.5 * u) + 0.2 * np.sin(2 * v)], axis=-1).reshape(-1, 3) * size
    corner = np.arange(42).reshape(6, 7)[:, :-1].ravel()
    faces = np.stack([corner, corner + 1, corner + 8, corner + 7], axis=-1)
    mesh = bpy.data.meshes.new("sheet")
    mesh.from_pydata(points.tolist(), [], faces.tolist())
    mesh.polygons.foreach_set("use_smooth", np.ones(len(faces), bool))
    x, y = points[faces][..., 0] / size, points[faces][..., 1] / size
    left = x.mean(axis=1, keepdims=True) < 0
    flat = np.stack([np.where(left, -0.45 * x + 0.03, 0.52 + 0.45 * x), 0.5 + 0.45 * y], axis=-1)
    mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", flat.ravel().astype(np.float32))
    obj = bpy.data.objects.new("sheet", mesh)
    obj.matrix_world = Matrix.Translation((1, 2, 3)) @ Matrix.Rotation(0.7, 4, "X") @ Matrix.Scale(1.5, 4)
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return obj


def on_a_sheet(name, texels=192):
    """Return a result whose normals lean off a bent sheet in the world by a known field, the object, and that field."""
    obj = bent_sheet()
    mesh = extract_mesh(obj)
    surface = bake.bake_uv(mesh, texels, texels)
    values = cli_maker.smooth_maps((texels, texels), RANGES[name], seed=2)
    values = {key: np.float32(value).reshape(texels, texels, -1) for key, value in values.items()}
    wanted = oracles.unit(surface.normal + lean(surface.position))
    values["normal"] = frames.to_blender(mesh, surface, np.einsum("hwij,hwj->hwi", surface.frames(), wanted))
    result = Result("leaf", Maps(load_model(name), values, surface.coverage))
    apply_material(obj, build_material(result.maps, "leaf"))
    return result, obj


def lean(position):
    x, y, z = np.moveaxis(np.asarray(position, np.float64), -1, 0)
    return 0.4 * np.stack([np.sin(2 * x + y), np.cos(1.5 * y - z), np.sin(z + x)], axis=-1)


def counts():
    return [len(getattr(bpy.data, kind)) for kind in ("objects", "meshes", "materials", "images", "node_groups")]


def test_gltf_carries_every_map_pixel_for_pixel(tmp_path):
    result, obj = on_a_sheet("principled")
    before = counts()
    gltf.write_gltf(result, tmp_path / "leaf.glb", obj)
    assert counts() == before and obj.select_get() is False
    table, binary = read_glb(tmp_path / "leaf.glb")
    (material,) = table["materials"]
    pbr, inside, v = material["pbrMetallicRoughness"], result.maps.covered, result.maps.values
    show = functools.partial(image_of, table, binary, folder=tmp_path)
    half = 0.51 / 255
    color = show(pbr["baseColorTexture"])[..., :3]
    np.testing.assert_allclose(color[inside], srgb(v["base_color"])[inside], atol=half)
    orm = show(pbr["metallicRoughnessTexture"])
    assert (orm[..., 0] == 1).all() and (orm[..., 2] == 0).all()
    np.testing.assert_allclose(orm[..., 1][inside], v["roughness"][..., 0][inside], atol=half)
    # Factors that are not written are 1.
    assert not {"roughnessFactor", "metallicFactor", "baseColorFactor"} & set(pbr)
    normal = show(material["normalTexture"])[..., :3]
    np.testing.assert_allclose(normal[inside], (v["normal"] * 0.5 + 0.5)[inside], atol=half)
    assert "scale" not in material["normalTexture"]
    # F0 = ((n − 1) / (n + 1))² · factor, the factor in alpha (KHR_materials_ior, KHR_materials_specular).
    ior = material["extensions"]["KHR_materials_ior"]["ior"]
    specular = material["extensions"]["KHR_materials_specular"]
    factor = show(specular["specularTexture"])[..., 3] * specular.get("specularFactor", 1.0)
    f0 = ((ior - 1) / (ior + 1)) ** 2 * factor
    np.testing.assert_allclose(f0[inside], 0.08 * v["specular"][..., 0][inside], atol=0.08 * half)
    assert specular.get("specularColorFactor", [1, 1, 1]) == [1, 1, 1]


def gltf_normals(table, binary, path, unit_frame):
    """Return the angle (degrees) between what a glTF viewer shades with and the field, at points of all triangles."""
    (primitive,) = table["meshes"][0]["primitives"]
    read = {key: accessor(table, binary, at).astype(np.float64) for key, at in primitive["attributes"].items()}
    corner = accessor(table, binary, primitive["indices"]).reshape(-1, 3)
    weights = np.array([[0.6, 0.3, 0.1], [1 / 3, 1 / 3, 1 / 3], [0.2, 0.2, 0.6]])
    at = {
        key: np.einsum("pk,tki->tpi", weights, value[corner]).reshape(-1, value.shape[1]) for key, value in read.items()
    }
    image = image_of(table, binary, table["materials"][0]["normalTexture"], path)[::-1]  # v runs down in glTF
    height, width = image.shape[:2]
    x, y = at["TEXCOORD_0"][:, 0] * width - 0.5, at["TEXCOORD_0"][:, 1] * height - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]
    texel = (image[y0, x0] * (1 - fx) + image[y0, x0 + 1] * fx) * (1 - fy)
    texel = (texel + (image[y0 + 1, x0] * (1 - fx) + image[y0 + 1, x0 + 1] * fx) * fy)[:, :3] * 2 - 1
    normal, tangent = at["NORMAL"], at["TANGENT"][:, :3]
    sign = np.sign(at["TANGENT"][:, 3:])
    if unit_frame:  # as three.js does, and the Khronos sample viewer
        normal, tangent = oracles.unit(normal), oracles.unit(tangent)
    shaded = texel[:, :1] * tangent + texel[:, 1:2] * sign * np.cross(normal, tangent) + texel[:, 2:] * normal
    node = table["nodes"][0]
    turn = Matrix.LocRotScale(node["translation"], _quaternion(node["rotation"]), node["scale"])
    to_world = np.array(turn)
    shaded = oracles.unit(shaded @ to_world[:3, :3].T)
    surface = oracles.unit(oracles.unit(at["NORMAL"]) @ to_world[:3, :3].T)
    place = at["POSITION"] @ to_world[:3, :3].T + to_world[:3, 3]
    # glTF's y is up: (x, y, z) is Blender's (x, −z, y).
    to_blender = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    place, surface, shaded = (vector @ to_blender.T for vector in (place, surface, shaded))
    return angle(shaded, oracles.unit(surface + lean(place)))


def _quaternion(xyzw):
    from mathutils import Quaternion

    return Quaternion((xyzw[3], *xyzw[:3]))


def test_a_gltf_viewer_shades_with_the_recovered_world_normals(tmp_path):
    result, obj = on_a_sheet("principled", texels=384)
    gltf.write_gltf(result, tmp_path / "leaf.glb", obj)
    table, binary = read_glb(tmp_path / "leaf.glb")
    for frame in (False, True):
        error = gltf_normals(table, binary, tmp_path, frame)
        median, high = np.percentile(error, (50, 99))
        print(f"\nglTF, {'unit' if frame else 'interpolated'} frames: median {median:.3f}°, 99 % {high:.3f}°")
        # 8 bits are 0.3°.
        assert median < (0.8 if frame else 0.3) and high < (3.0 if frame else 0.8)


def test_blenders_exporter_alone_carries_all_maps_but_specular(tmp_path):
    """Why the material is built anew for it."""
    result, obj = on_a_sheet("principled")
    obj.select_set(True)
    bpy.ops.export_scene.gltf(filepath=str(tmp_path / "own.glb"), use_selection=True, export_format="GLB")
    table, binary = read_glb(tmp_path / "own.glb")
    (material,) = table["materials"]
    inside, v = result.maps.covered, result.maps.values
    show = functools.partial(image_of, table, binary, folder=tmp_path)
    color = show(material["pbrMetallicRoughness"]["baseColorTexture"])[..., :3]
    np.testing.assert_allclose(color[inside], srgb(v["base_color"])[inside], atol=0.51 / 255)
    normal = show(material["normalTexture"])[..., :3]
    np.testing.assert_allclose(normal[inside], (v["normal"] * 0.5 + 0.5)[inside], atol=0.51 / 255)
    roughness = show(material["pbrMetallicRoughness"]["metallicRoughnessTexture"])[..., 1:2]
    np.testing.assert_allclose(roughness[inside], v["roughness"][inside], atol=0.51 / 255)
    # The factor is alpha, and the picture that it names has none, or 1 everywhere: specular is 0.5 for a viewer.
    specular = show(material["extensions"]["KHR_materials_specular"]["specularTexture"])
    assert specular.shape[-1] < 4 or (specular[..., 3] == 1).all()


def test_two_lobes_become_one_with_the_error_told(tmp_path):
    result, obj = on_a_sheet("cook_torrance_two_lobe")
    found = gltf.write_gltf(result, tmp_path / "leaf.glb", obj)
    assert 0.05 < found["one_lobe_error"]["median"] < 0.5
    table, binary = read_glb(tmp_path / "leaf.glb")
    texture = table["materials"][0]["pbrMetallicRoughness"]["metallicRoughnessTexture"]
    alpha = image_of(table, binary, texture, tmp_path)[..., 1] ** 2
    inside, v = result.maps.covered, result.maps.values
    # Between the two lobes' own widths, GGX being a little wider than Beckmann at the same peak.
    assert (alpha[inside] > v["r1"][..., 0][inside] * 0.9).all() and (alpha[inside] < v["r2"][..., 0][inside]).all()


def test_gltf_of_lambert_has_no_highlight(tmp_path):
    result, obj = on_a_sheet("lambert", texels=32)
    gltf.write_gltf(result, tmp_path / "leaf.glb", obj)
    (material,) = read_glb(tmp_path / "leaf.glb")[0]["materials"]
    assert material["extensions"]["KHR_materials_specular"]["specularFactor"] == 0


# --- OpenLIME -------------------------------------------------------------------------------------------------------


def openlime_radiance(folder, light):
    """Return (H, W, 3) what OpenLIME's shader computes before its gamma, by the formulas of its ShaderBRDF."""
    info = json.loads((folder / "info.json").read_text())
    kd, ks, normals, gloss = (picture(folder / info["channels"][c]) for c in ("kd", "ks", "normals", "gloss"))
    assert info["colorspaces"] == {"kd": "srgb", "ks": "srgb"}
    n = normals[..., :3] * 2.0 - 1
    length = np.linalg.norm(n, axis=-1, keepdims=True)
    n = n / np.maximum(length, 1e-9)
    low, high = info["alphaLimits"]
    least, most = 1 - high**0.25, 1 - low**0.25
    alpha = (1 - gloss[..., 0] * (most - least) - least) ** 4
    half = oracles.unit(light + np.array([0, 0, 1.0]))
    nl, nv, nh = n @ light, n[..., 2], n @ half
    ward = np.exp(-(np.tan(np.arccos(np.clip(nh, -1, 1))) ** 2) / alpha**2)
    ward = ward / (4 * np.pi * alpha**2 * np.sqrt(np.maximum(nl * nv, 1e-9)))
    shaded = (unsrgb(kd[..., :3]) / np.pi + unsrgb(ks[..., :3]) * ward[..., None]) * np.maximum(nl, 0)[..., None]
    return np.where(length < 0.5, 0, shaded * info["brightness"])


@pytest.mark.parametrize(("name", "bound"), [("cook_torrance_two_lobe", 0.06), ("principled", 0.06), ("lambert", 0.02)])
def test_openlimes_layer_looks_like_the_material(name, bound, tmp_path):
    result = result_of(name)
    found = openlime.write_openlime(result, tmp_path / "layer")
    values = {k: v[..., 0] if v.shape[-1] == 1 else v for k, v in result.maps.values.items()}
    lights = cli_maker.dome_lights(24, widest=65)
    shown = np.stack([openlime_radiance(tmp_path / "layer", light) for light in lights])
    truth = cli_maker.render_oracle(name, values, lights)
    error = np.sqrt(((shown - truth) ** 2).mean() / (truth**2).mean())
    print(f"\n{name} in OpenLIME: {100 * error:.2f} % RMS of the radiance; lobe {found['info']['ward_error']['mean']}")
    assert error < bound


def test_what_is_outside_is_transparent_in_openlime(tmp_path):
    covered = np.ones(SHAPE, bool)
    covered[:4] = False
    openlime.write_openlime(result_of("principled", covered=covered), tmp_path)
    length = np.linalg.norm(picture(tmp_path / "normals.png")[..., :3] * 2 - 1, axis=-1)
    assert (length[:4] < 0.5).all() and (length[4:] > 0.9).all()


# --- PTM ------------------------------------------------------------------------------------------------------------


def read_ptm(path):
    """Return coefficients (H, W, 3, 6), row 0 at the bottom, by Malzbender & Gelb 2001."""
    data = path.read_bytes()
    lines, at = [], 0
    while len(lines) < 6:
        end = data.index(b"\n", at)
        lines.append(data[at:end].decode("ascii"))
        at = end + 1
    assert lines[:2] == ["PTM_1.2", "PTM_FORMAT_RGB"]
    width, height = int(lines[2]), int(lines[3])
    scale, bias = np.array(lines[4].split(), float), np.array([int(word) for word in lines[5].split()])
    assert len(data) - at == 18 * width * height
    found = np.zeros((height, width, 3, 6))
    for channel in range(3):
        for y in range(height):
            for x in range(width):
                place = at + 6 * (width * height * channel + width * y + x)
                found[y, x, channel] = (np.frombuffer(data, np.uint8, 6, place) - bias) * scale
    return found


def test_a_ptm_shows_the_material_under_lights_that_it_was_not_fitted_to(tmp_path):
    covered = np.ones(SHAPE, bool)
    covered[:, :3] = False
    result = result_of("lambert", covered=covered, tilt=15)
    report = ptm.write_ptm(result, tmp_path / "leaf.ptm")
    coefficients = read_ptm(tmp_path / "leaf.ptm")
    lights = cli_maker.dome_lights(7, widest=50)
    shown = np.stack([coefficients @ [u * u, v * v, u * v, u, v, 1] for u, v, _ in lights])
    truth = 255 * srgb(cli_maker.render_oracle("lambert", result.maps.values, lights))
    psnr = 10 * np.log10(255**2 / ((np.clip(shown, 0, 255) - truth)[:, covered] ** 2).mean())
    print(f"\nPTM of lambert: {psnr:.1f} dB under other lights, fit {report['leaf.ptm']}")
    assert psnr > 30
    assert np.abs(shown[:, ~covered]).max() < 3


def test_the_coefficients_are_the_least_squares_ones_but_for_their_bytes(tmp_path):
    result = result_of("principled")
    ptm.write_ptm(result, tmp_path / "leaf.ptm")
    found = read_ptm(tmp_path / "leaf.ptm")
    lights = ptm.even_lights(64, 80.0)
    values = {k: v[..., 0] if v.shape[-1] == 1 else v for k, v in result.maps.values.items()}
    pictures = 255 * srgb(cli_maker.render_oracle("principled", values, lights))
    terms = np.stack([[u * u, v * v, u * v, u, v, 1] for u, v, _ in lights])
    truth, *_ = np.linalg.lstsq(terms, pictures.reshape(64, -1), rcond=None)
    truth = np.moveaxis(truth.reshape(6, *SHAPE, 3), 0, -1)
    step = np.ptp(truth, axis=(0, 1, 2)) / 254
    assert (np.abs(found - truth).max(axis=(0, 1, 2)) < 0.51 * step + 0.02).all()


# --- the command ----------------------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path):
    """A result's folder with material.blend."""
    result, obj = on_a_sheet("principled", texels=48)
    report = {"model": "principled", "settings": {"model": "principled"}}
    height = Height(result.maps.values["specular"][..., 0], result.maps.covered, "world")
    write_maps(result.maps, tmp_path / "leaf", report | {"height": height.described()}, None, [height.as_map()])
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "leaf" / "material.blend"), copy=True)
    return tmp_path / "leaf"


def test_a_results_folder_is_read_as_it_was_written(folder):
    found = read_result(folder)
    assert found.name == "leaf" and found.blend == folder / "material.blend" and found.height.unit == "world"
    assert found.maps.covered.any() and not found.maps.covered.all()


@pytest.mark.parametrize(
    ("kind", "files"),
    [
        ("gltf", {"leaf.glb"}), ("ptm", {"leaf.ptm"}),
        ("openlime", {"kd.png", "ks.png", "normals.png", "gloss.png", "info.json"}),
        ("textures", {"T_leaf_BC.png", "T_leaf_N.png", "T_leaf_ORM.png", "T_leaf_S.png", "T_leaf_H.png"}),
    ],
)  # fmt: skip
def test_the_command_writes_each_format(kind, files, folder, tmp_path):
    code, out, err = run_cli(
        "export", folder, "--format", kind, "--convention", "unreal", "-o", tmp_path / "out", "--json"
    )
    assert (code, err) == (0, "") and str(tmp_path / "out") in json.loads(out.splitlines()[-1])["output"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == files


def test_a_file_can_be_named(folder, tmp_path):
    code, _, err = run_cli("export", folder, "--format", "gltf", "-o", tmp_path / "mine.glb", "--quiet")
    assert (code, err) == (0, "") and read_glb(tmp_path / "mine.glb")[0]["asset"]["version"] == "2.0"


def test_what_cannot_be_exported_is_refused_in_one_line_with_nothing_written(folder, tmp_path):
    out = tmp_path / "out"

    def refused(*options):
        code, _, err = run_cli("export", *options, "-o", out)
        assert code == 2 and err.count("\n") == 1 and not out.exists()
        return err

    assert "holds no report.json" in refused(tmp_path, "--format", "ptm")
    assert "no such mesh; it has 'sheet'" in refused(folder, "--format", "gltf", "--object", "cube")
    (folder / "material.blend").unlink()
    assert "holds no material.blend" in refused(folder, "--format", "gltf")
    own = cli_maker.MODELS / "two_colours.toml"
    if own.exists():
        assert "is not known" in refused(folder, "--format", "openlime", "--model", own)


def test_an_unknown_normal_map_is_refused_before_anything_is_read(tmp_path):
    code, _, err = run_cli("recover", tmp_path, "--normals", "object,tangant", "-o", tmp_path / "out")
    assert code == 2 and "'tangant' is no normal map; choose some of object, world, directx" in err


def test_recover_writes_what_is_asked_for_besides(tmp_path):
    lights = cli_maker.dome_lights(12, widest=60)
    values = cli_maker.smooth_maps(SHAPE, {}, seed=3)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    truth = 1.5 * np.sin(0.3 * x + 0.1 * y)
    slope = 1.5 * np.cos(0.3 * x + 0.1 * y)
    values["normal"] = oracles.unit(np.stack([-0.3 * slope, -0.1 * slope, np.ones(SHAPE)], axis=-1))
    cli_maker.write_card(tmp_path / "leaf", cli_maker.render_oracle("lambert", values, lights), lights)
    code, _, err = run_cli(
        "recover", tmp_path / "leaf", "--model", "lambert", "--normals", "directx,object", "--displacement",
        "--iterations", 40, "-o", tmp_path / "out", "--quiet",
    )  # fmt: skip
    assert (code, err) == (0, "")
    found = read_result(tmp_path / "out")
    green = picture(tmp_path / "out" / "normal_directx.png")[..., 1] * 2 - 1
    np.testing.assert_allclose(green, -found.maps.values["normal"][..., 1], atol=5e-5)
    described = json.loads((tmp_path / "out" / "report.json").read_text())["height"]
    assert described["unit"] == "texels"
    heights = (picture(tmp_path / "out" / "height.png")[..., 0] - described["midlevel"]) * described["scale"]
    assert np.abs(heights - heights.mean() - truth + truth.mean()).max() < 0.05
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out" / "material.blend"))
    (material,) = bpy.data.materials
    assert material.displacement_method == "BOTH" and "IRPSO displacement" in material.node_tree.nodes
